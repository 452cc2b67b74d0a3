"""A study on disk: settings, a journal of each unfinished row, and Parquet tables of finished rows.

    STUDY/study.json                        what the study is; checked whenever it is opened to write
    STUDY/evaluations/row-01.parquet        every DEM run of a finished row
    STUDY/calibrations/row-01.parquet       its result
    STUDY/heaps/row-01.parquet              its heap at the DEM optimum
    STUDY/journal/row-01.jsonl              DEM runs of a row that is not finished; one line each
    STUDY/runs/                             scratch of running simulations, and of failed or kept ones

A line of the journal is durable before its DEM run counts. A row's journal goes when its tables are
in place; they are written beside their name and moved there, so that none is ever half there.
"""

from __future__ import annotations

import fcntl
import json
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from calstudy.errors import SetupError, StoreError
from calstudy.identity import content_hash
from calstudy.journal import Stored, decode, encode
from calstudy.records import Evaluation, Phase, Run, Target
from calstudy.schema import TABLES, arrow_schema

SETTINGS_FILE = "study.json"


@dataclass(frozen=True, slots=True)
class StudySettings:
    """What makes two studies the same."""

    plan: str
    plan_hash: str
    model: str
    deck: int
    model_hash: str
    fidelity: str
    variant: str
    engine: str
    calstudy: str
    mode: str
    budget: int | None
    """Most DEM runs of a row's second optimisation."""
    seed: int
    target: Target

    @property
    def id(self) -> str:
        """Identity of the study by content."""
        return content_hash(asdict(self))[:12]

    @property
    def provenance(self) -> dict[str, Any]:
        """Columns that every stored line carries, but the row."""
        return {
            "study": self.id,
            "model": self.model,
            "deck": self.deck,
            "model_hash": self.model_hash,
            "fidelity": self.fidelity,
            "variant": self.variant,
            "engine": self.engine,
            "calstudy": self.calstudy,
            "mode": self.mode,
        }


class Store:
    """A study directory that is open for writing, by this process alone; use as a context manager."""

    def __init__(self, directory: Path, settings: StudySettings) -> None:
        self.directory, self.settings = directory, settings
        self.notes: list[str] = []
        """What was found damaged and left out, one line each."""
        self._writing = threading.Lock()
        self._lock_file: Any = None

    def __enter__(self) -> Store:
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            self._lock()
            self._settle_settings()
            for name in (*TABLES, "journal"):
                (self.directory / name).mkdir(exist_ok=True)
            for row in finished_rows(self.directory):
                self._journal(row).unlink(missing_ok=True)  # a crash came between the tables and this
            _force_names_to_disk(self.directory)
        except OSError as error:
            self.close()
            raise SetupError(
                f"{self.directory}: {error.strerror}; choose another --study directory"
            ) from error
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the study."""
        if self._lock_file is not None:
            self._lock_file.close()
            self._lock_file = None

    def _lock(self) -> None:
        handle = (self.directory / "lock").open("a+")
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            handle.seek(0)
            owner = handle.read().strip() or "another process"
            handle.close()
            raise StoreError(
                f"{self.directory}: in use by {owner}; wait for it or choose another --study"
            ) from error
        handle.truncate(0)
        handle.write(f"process {os.getpid()} on {os.uname().nodename}\n")
        handle.flush()
        self._lock_file = handle

    def _settle_settings(self) -> None:
        path = self.directory / SETTINGS_FILE
        if not path.exists():
            write_atomically(path, json.dumps(asdict(self.settings), indent=2).encode() + b"\n")
            return
        there = read_settings(self.directory)
        if there == self.settings:
            return
        was, now = asdict(there), asdict(self.settings)
        differing = [f"{k} is {was[k]!r}, asked for {now[k]!r}" for k in was if was[k] != now[k]]
        raise StoreError(
            f"{self.directory} holds another study: {'; '.join(differing)}; "
            "choose another --study directory or the same settings"
        )

    # ---- DEM runs ---------------------------------------------------------------------------------

    def record(self, evaluation: Evaluation) -> Stored:
        """Append an evaluation to its row's journal and force it to disk."""
        stored = Stored(evaluation, os.uname().nodename, datetime.now(UTC).isoformat(timespec="seconds"))
        path = self._journal(evaluation.request.row)
        try:
            with self._writing, path.open("ab") as journal:
                is_new = not journal.tell()
                # A line that a crash or a full disk cut short must not swallow this one.
                if not is_new and not _ends_with_newline(path):
                    journal.write(b"\n")
                journal.write(encode(stored))
                journal.flush()
                os.fsync(journal.fileno())
                if is_new:
                    _force_names_to_disk(path.parent)
        except OSError as error:
            raise SetupError(
                f"{path}: cannot be written: {error.strerror}; free space and run it again"
            ) from error
        return stored

    def journal(self, row: int) -> list[Stored]:
        """Evaluations of an unfinished row; damaged lines are left out and noted, their runs run again."""
        path = self._journal(row)
        if not path.exists():
            return []
        decoded = [decode(line) for line in path.read_bytes().split(b"\n") if line]
        stored = [entry for entry in decoded if entry is not None]
        if damaged := len(decoded) - len(stored):
            self.notes.append(
                f"{path.name}: {damaged} damaged line(s) left out; those DEM runs are run again"
            )
        return stored

    def _journal(self, row: int) -> Path:
        return self.directory / "journal" / f"row-{row:02d}.jsonl"

    # ---- finished rows -------------------------------------------------------------------------------

    def finished_rows(self) -> set[int]:
        """Rows whose tables are in place."""
        return finished_rows(self.directory)

    def finish(
        self,
        row: int,
        calibration: Mapping[str, Any],
        evaluations: Sequence[Stored],
        heap: Run | None,
        run_id: str,
        particle_diameter: float,
    ) -> None:
        """Write a row's tables; ``calibration`` comes last, for its presence makes the row finished."""
        provenance = self.settings.provenance | {"row": row}
        ordered = sorted(
            evaluations,
            key=lambda s: (list(Phase).index(s.evaluation.request.phase), s.evaluation.request.index),
        )
        self._write("evaluations", row, pd.DataFrame([provenance | evaluation_line(s) for s in ordered]))
        if heap is not None and heap.heap is not None:
            beads = pd.DataFrame(heap.heap, columns=list("xyz"))
            self._write(
                "heaps", row, beads.assign(**provenance, run_id=run_id, particle_diameter=particle_diameter)
            )
        self._write("calibrations", row, pd.DataFrame([provenance | dict(calibration)]))
        self._journal(row).unlink(missing_ok=True)

    def _write(self, table: str, row: int, frame: pd.DataFrame) -> None:
        schema = arrow_schema(table)
        frame = frame.reindex(columns=schema.names)
        try:
            content = pa.Table.from_pandas(frame, schema=schema, preserve_index=False)
        except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
            raise StoreError(f"table {table}, row {row}: {error}") from error
        # Pandas' own metadata names library versions, which are no content.
        content = content.replace_schema_metadata(schema.metadata)
        sink = pa.BufferOutputStream()
        pq.write_table(content, sink, compression="zstd", write_page_checksum=True)
        path = self.directory / table / f"row-{row:02d}.parquet"
        try:
            write_atomically(path, sink.getvalue().to_pybytes())
        except OSError as error:
            raise SetupError(
                f"{path}: cannot be written: {error.strerror}; free space and run it again"
            ) from error


def read_settings(directory: Path) -> StudySettings:
    """Settings of a study; StoreError when the directory is none or its settings are damaged."""
    path = directory / SETTINGS_FILE
    try:
        data = json.loads(path.read_text())
        return StudySettings(**{**data, "target": Target(**data["target"])})
    except (FileNotFoundError, NotADirectoryError) as error:
        raise StoreError(
            f"{directory} is no study: {SETTINGS_FILE} is missing; check the directory's name"
        ) from error
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror}; check its permissions") from error
    except (ValueError, TypeError, KeyError) as error:
        raise StoreError(f"{path} is damaged ({error}); restore it, or start a new study") from error


def read_table(directory: Path, table: str) -> pd.DataFrame:
    """A study's table over all finished rows, in the order of rows; empty when there is none.

    Raises StoreError that names a damaged file. ``pandas.read_parquet(directory / table)`` reads the
    same, without the checks.
    """
    schema = arrow_schema(table)
    parts = [read_part(path, schema) for path in sorted((directory / table).glob("row-*.parquet"))]
    return pa.concat_tables(parts or [schema.empty_table()]).to_pandas()


def read_part(path: Path, schema: pa.Schema) -> pa.Table:
    """One row's part of a table, its checksums verified."""
    try:
        part = pq.read_table(path, page_checksum_verification=True, partitioning=None)
        found = part.schema.names, part.schema.types
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        raise StoreError(
            f"{path} is damaged ({str(error).splitlines()[0][:80]}); "
            "delete the row's files in evaluations, calibrations and heaps to run it again"
        ) from error
    # The footer has no checksum: a flipped byte there may turn a column's name or type into another.
    if found != (schema.names, schema.types):
        raise StoreError(
            f"{path}: columns are not those of this version of calstudy; use the version that wrote it, "
            "or delete the row's files in evaluations, calibrations and heaps if the file is damaged"
        )
    return part


def finished_rows(directory: Path) -> set[int]:
    """Rows of a study whose calibration is in place."""
    return {
        int(path.stem.removeprefix("row-")) for path in (directory / "calibrations").glob("row-*.parquet")
    }


def evaluation_line(stored: Stored) -> dict[str, Any]:
    """Line of the table of evaluations, without what all lines of a row share."""
    request = stored.evaluation.request
    return {
        "phase": str(request.phase),
        "index": request.index,
        "run_id": stored.evaluation.run_id,
        "seed": request.seed,
        **request.parameters,
        **run_line(stored.evaluation.run),
        "host": stored.host,
        "finished_at": stored.finished_at,
    }


def run_line(run: Run) -> dict[str, Any]:
    """What the table of evaluations says of a run itself, by its columns' names."""
    beads = run.beads
    return {
        **run.responses,
        "outcome": str(run.outcome),
        "reason": run.reason,
        "heap_radius": run.radius,
        "heap_height": run.height,
        **{f"beads_{k}": getattr(beads, k) if beads else None for k in ("poured", "filled", "heap", "lost")},
        "engine_time_step": run.engine_time_step,
        "simulated_time": run.simulated_time,
        "wall_time": run.wall_time,
        "cpu_time": run.cpu_time,
    }


def _ends_with_newline(path: Path) -> bool:
    with path.open("rb") as handle:
        handle.seek(-1, os.SEEK_END)
        return handle.read(1) == b"\n"


def write_atomically(path: Path, content: bytes) -> None:
    """Write beside the name, force it to disk, move it there; a dot keeps the part out of the table."""
    beside = path.with_name(f".{path.name}.part")
    try:
        with beside.open("wb") as handle:
            handle.write(content)
            handle.flush()
            os.fsync(handle.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    _force_names_to_disk(path.parent)


def _force_names_to_disk(directory: Path) -> None:
    """Make the names of new and moved files in a directory outlive a power cut."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
