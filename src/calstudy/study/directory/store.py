"""A study on disk: settings, a journal of each row's DEM runs, and Parquet tables of finished rows.

    STUDY/study.json                        what the study is; checked whenever it is opened to write
    STUDY/evaluations/row-01.parquet        every DEM run of a finished row
    STUDY/calibrations/row-01.parquet       its result
    STUDY/heaps/row-01.parquet              its heap at the DEM optimum
    STUDY/journal/row-01.jsonl              its DEM runs with their heaps, as they came; one line each
    STUDY/lock, STUDY/sessions.jsonl        who is at work here, and who was: see ``session``
    STUDY/lock-1, STUDY/claims/             the same of a job array, whose elements share it: see ``elements``
    STUDY/runs/                             scratch of running simulations, and of failed or kept ones

A line of the journal is durable before its DEM run counts. Tables are written beside their name and moved
there, so that none is ever half there. Journals stay until no row of the plan is left that could ask for
the same run.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

from calstudy.disk.files import Journal, cannot_use, cannot_write, force_names, write_atomically
from calstudy.disk.ours import make_directory, remove_file
from calstudy.disk.parquet import open_parquet
from calstudy.errors import StoreError
from calstudy.records import Evaluation, Phase
from calstudy.study.directory.begun import mismatch
from calstudy.study.directory.elements import CLAIMS, Claims, Element, alone, remove_claims
from calstudy.study.directory.journal import encode, read_journal
from calstudy.study.directory.lock import Lock
from calstudy.study.directory.session import FINISHED
from calstudy.study.schema import TABLES, Quantities, arrow_schema, evaluation_line
from calstudy.study.settings import SETTINGS_FILE, StudySettings, read_settings

if TYPE_CHECKING:
    import pandas as pd


class Store:
    """A study directory that is open for writing, by this process alone; use as a context manager.

    The elements of a job array have it open together, and each writes only rows that it has claimed.
    """

    def __init__(
        self,
        directory: Path,
        settings: StudySettings,
        option: str = "--study",
        element: Element | None = None,
    ) -> None:
        """``option`` is what names the directory on the command line."""
        self.directory, self.settings, self.option = directory, settings, option
        self.notes: list[str] = []
        """What was found damaged and left out, one line each."""
        self.mended: list[int] = []
        """Rows that were finished, and whose damaged tables are to be made again from their journals."""
        self.element = element
        self.lock = element.lock(directory) if element else Lock(directory)
        self.claims: Claims | None = None
        self._failed: dict[int, bool] = {}
        """Whether the calibrations of finished rows failed."""
        self._guard = threading.Lock()
        self._journals: dict[int, Journal] = {}
        self._is_open = True

    def __enter__(self) -> Store:
        # Arrow keeps two megabytes for each thread that encoded a table, and each row is a thread.
        self._encoding = ThreadPoolExecutor(1, thread_name_prefix="tables")
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
            self.lock.acquire()
            with alone(self.directory, self.element):
                self._settle_settings()
                for name in (*TABLES, "journal", *([CLAIMS] if self.element else [])):
                    make_directory(self.directory / name, self.directory)
                force_names(self.directory)
                for row in sorted(finished_rows(self.directory)):
                    self._mend(row)
        except OSError as error:
            self._let_go()
            raise cannot_use(self.directory, self.option, error) from error
        except BaseException:
            self._let_go()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        state = FINISHED if error is None else str(error) or type(error).__name__
        self._let_go(state)

    def claim(self, groups: Mapping[int, Sequence[int]]) -> Claims | None:
        """What this element takes of groups of rows; None where the study is open for one session alone."""
        if self.element:
            self.claims = Claims(self.directory, self.element, self.lock, groups, self.finished_rows)
        return self.claims

    def _let_go(self, state: str = FINISHED) -> None:
        with self._guard:
            self._is_open = False
        if self.claims:
            self.claims.release()
        self._encoding.shutdown(wait=False, cancel_futures=True)
        self.lock.release(state)

    def _settle_settings(self) -> None:
        path = self.directory / SETTINGS_FILE
        if not path.exists():
            write_atomically(path, self.settings.file, self.directory)
            return
        if error := mismatch(self.directory, self.settings, self.option):
            raise error

    def _mend(self, row: int) -> None:
        """Take away a finished row's tables where one is damaged and its journal can make them anew."""
        try:
            parts = {name: self._part(name, row) for name in TABLES}
            read = {name: self._read(name, row) for name in ("calibrations", "evaluations")}
            calibration = read["calibrations"].to_pylist()[0]
            self._failed[row] = calibration["outcome"] != "ok"
            # One that failed has no heap, nor have an emulator and a model of one's own that measures none.
            leaves_beads = read["evaluations"]["beads_heap"].null_count < read["evaluations"].num_rows
            is_due = calibration["outcome"] == "ok" and self.settings.case is None and leaves_beads
            if is_due or parts["heaps"].exists():
                self._read("heaps", row)
        except StoreError as error:
            if not self._journal(row).exists():
                raise
            self.mended.append(row)
            self.notes.append(f"row {row} is made again from its journal: {str(error).partition(';')[0]}")
            self._take_away(row)

    def _read(self, table: str, row: int) -> pa.Table:
        """A finished row's part of a table. StoreError: it is damaged, or of another study or row."""
        path = self._part(table, row)
        part = read_part(path, arrow_schema(table, self.settings.quantities))
        require_own(part, path, self.settings.id, row)
        return part

    def _take_away(self, row: int) -> None:
        self._failed.pop(row, None)
        for table in ("calibrations", "evaluations", "heaps"):
            remove_file(self._part(table, row), self.directory)

    # ---- DEM runs ---------------------------------------------------------------------------------

    def record(self, evaluation: Evaluation) -> None:
        """Append an evaluation to its row's journal; it is on disk when this returns, in any thread."""
        row = evaluation.request.row
        self._require_open()
        with self._guard:
            journal = self._journals.setdefault(row, Journal(self._journal(row), self.directory))
        try:
            journal.append(encode(evaluation, self.settings.id))
        except OSError as error:
            raise cannot_write(journal.path, error) from error

    def journal(self, row: int, heaps: bool = True) -> list[Evaluation]:
        """Evaluations of a row; damaged lines are left out and noted, their runs run again."""
        path = self._journal(row)
        kept = read_journal(path, self.settings.id, heaps)
        for number, kind in ((kept.damaged, "damaged line(s)"), (kept.foreign, "line(s) of another study")):
            if number:
                self.notes.append(
                    f"{path.name}: {number} {kind} left out; those DEM runs are run again if need be"
                )
        return list(kept.evaluations)

    def _require_open(self) -> None:
        """Raise StoreError if the study was closed: another session may be at work in it."""
        with self._guard:
            if not self._is_open:
                raise StoreError(f"{self.directory} is closed; nothing more is written to it")

    def journals(self) -> list[int]:
        """Rows that have a journal."""
        return sorted(journals(self.directory))

    def drop_journals(self) -> None:
        """Remove all journals: every row that could ask for their runs has its tables."""
        for row in self.journals():
            remove_file(self._journal(row), self.directory)
        remove_claims(self.directory)

    def reopen(self, row: int) -> None:
        """Make a finished row an unfinished one whose broken DEM runs are to be run again."""
        kept = [evaluation for evaluation in self.journal(row) if not evaluation.run.broke]
        path = self._journal(row)
        try:
            write_atomically(
                path, b"".join(encode(evaluation, self.settings.id) for evaluation in kept), self.directory
            )
            self._take_away(row)
        except OSError as error:
            raise cannot_write(path, error) from error

    def _journal(self, row: int) -> Path:
        return self.directory / "journal" / f"row-{row:02d}.jsonl"

    # ---- finished rows -------------------------------------------------------------------------------

    def finished_rows(self) -> set[int]:
        """Rows whose tables are in place."""
        return finished_rows(self.directory)

    def failed_rows(self) -> set[int]:
        """Finished rows whose calibration failed."""
        for row in self.finished_rows() - self._failed.keys():  # another element finished it
            self._failed[row] = self._read("calibrations", row)["outcome"].to_pylist() != ["ok"]
        return {row for row, failed in self._failed.items() if failed}

    def finish(
        self,
        row: int,
        calibration: Mapping[str, Any],
        evaluations: Sequence[Evaluation],
        best: Sequence[tuple[Evaluation, float]],
    ) -> None:
        """Write a row's tables; ``calibration`` comes last, for its presence makes the row finished.

        ``best`` are the runs at the DEM optimum with their beads' diameters in m; their heaps are kept.
        """
        self._require_open()
        ordered = sorted(
            evaluations,
            key=lambda e: (list(Phase).index(e.request.phase), e.request.index),
        )
        provenance = {e.model_hash: self.settings.provenance_of(e.model_hash) | {"row": row} for e in ordered}
        lines = [provenance[e.model_hash] | evaluation_line(e) for e in ordered]
        self._write("evaluations", row, lines)
        beads = [
            provenance[e.model_hash]
            | {"run_id": e.run_id, "particle_diameter": diameter}
            | dict(zip("xyz", map(float, centre), strict=True))
            for e, diameter in best
            if e.run.positions is not None
            for centre in e.run.positions
        ]
        if any(e.run.positions is not None for e, _ in best):
            self._write("heaps", row, beads)
        self._write("calibrations", row, [self.settings.provenance | {"row": row} | dict(calibration)])
        self._failed[row] = calibration["outcome"] != "ok"

    def _part(self, table: str, row: int) -> Path:
        return self.directory / table / f"row-{row:02d}.parquet"

    def _write(self, table: str, row: int, lines: Sequence[Mapping[str, Any]]) -> None:
        path, schema = self._part(table, row), arrow_schema(table, self.settings.quantities)
        whole = [{name: _null_if_nan(line.get(name)) for name in schema.names} for line in lines]
        made = self._encoding.submit(lambda: _parquet(pa.Table.from_pylist(whole, schema=schema)))
        try:
            content = made.result()
        except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
            raise StoreError(f"{path}: {error}") from error
        _put(path, content, self.directory)


def write_table(path: Path, frame: pd.DataFrame, schema: pa.Schema, below: Path | None = None) -> None:
    """Write a frame as Parquet, whole or not at all, with the schema's columns and metadata alone.

    ``below`` as in ``write_atomically``.
    """
    frame = frame.reindex(columns=schema.names)
    try:
        content = pa.Table.from_pandas(frame, schema=schema, preserve_index=False)
    except (pa.ArrowInvalid, pa.ArrowTypeError) as error:
        raise StoreError(f"{path}: {error}") from error
    # Pandas' own metadata names library versions, which are no content.
    _put(path, _parquet(content.replace_schema_metadata(schema.metadata)), below)


def _null_if_nan(value: Any) -> Any:
    """A table has no NaN: what is not there is null."""
    return None if isinstance(value, float) and math.isnan(value) else value


def _parquet(content: pa.Table) -> bytes:
    sink = pa.BufferOutputStream()
    pq.write_table(content, sink, compression="zstd", write_page_checksum=True)
    encoded: bytes = sink.getvalue().to_pybytes()
    return encoded


def _put(path: Path, content: bytes, below: Path | None) -> None:
    try:
        write_atomically(path, content, below)
    except OSError as error:
        raise cannot_write(path, error) from error


def read_table(directory: Path, table: str, quantities: Quantities | None = None) -> pd.DataFrame:
    """A study's table over all finished rows, in the order of rows; empty when there is none.

    ``quantities`` are those of its settings, which are read where they are not given.

    Raises StoreError that names a damaged file. ``pandas.read_parquet(directory / table)`` reads the
    same, without the checks.
    """
    frame: pd.DataFrame = _read(directory, table, quantities).to_pandas()
    return frame


def read_lines(
    directory: Path,
    table: str,
    quantities: Quantities | None = None,
    columns: Sequence[str] | None = None,
) -> list[dict[str, Any]]:
    """The same as a list of lines with some columns, where what is not there is None; needs no pandas."""
    lines: list[dict[str, Any]] = _read(directory, table, quantities, columns).to_pylist()
    return lines


def _read(
    directory: Path, table: str, quantities: Quantities | None, columns: Sequence[str] | None = None
) -> pa.Table:
    settings = read_settings(directory)
    schema = arrow_schema(table, quantities or settings.quantities)
    wanted = None if columns is None else [*dict.fromkeys((*OWNER, *columns))]
    # The calibration is written last: without it, a row's other tables were written by a killed session.
    whole = finished_rows(directory)
    paths = sorted(_numbered(directory / table, "row", "parquet").items())
    parts = {row: read_part(path, schema, columns=wanted) for row, path in paths if row in whole}
    for row, part in parts.items():
        require_own(part, directory / table / f"row-{row:02d}.parquet", settings.id, row)
    together = pa.concat_tables([*parts.values()] or [schema.empty_table()])
    return together if columns is None else together.select(columns)


OWNER = ("study", "row")
"""Columns of each table that say what a line belongs to."""


def require_own(part: pa.Table, path: Path, study: str, row: int) -> None:
    """Raise StoreError if a part of a table has lines of another study or row."""
    for name, own in zip(OWNER, (study, row), strict=True):
        if others := [value for value in part[name].unique().to_pylist() if value != own]:
            raise StoreError(
                f"{path} is of {name} {others[0]}, not of {name} {own}: it was copied here, or "
                f"{SETTINGS_FILE} was changed; restore what was here, or {ROW_REMEDY}"
            )


ROW_REMEDY = "delete the row's files in evaluations, calibrations and heaps to run it again"


def read_part(
    path: Path, schema: pa.Schema, remedy: str = ROW_REMEDY, columns: Sequence[str] | None = None
) -> pa.Table:
    """One part of a table, or some of its columns, the checksums of what is read verified.

    StoreError with the remedy where it is damaged.
    """
    try:
        with open_parquet(path) as file:
            found = file.schema_arrow.names, file.schema_arrow.types
            part = file.read(columns, use_threads=False)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} is damaged ({error}); {remedy}") from error
    # The footer has no checksum: a flipped byte there may turn a column's name or type into another.
    if found != (schema.names, schema.types):
        raise StoreError(
            f"{path}: columns are not those of this version of calstudy; use the version that wrote it, or, "
            f"if the file is damaged, {remedy}"
        )
    return part


def finished_rows(directory: Path) -> set[int]:
    """Rows of a study whose calibration is in place."""
    return set(_numbered(directory / "calibrations", "row", "parquet"))


def finished_replicates(directory: Path) -> list[int]:
    """Numbers of a study's finished replicates."""
    return sorted(_numbered(directory / "replicates", "r", "parquet"))


def journals(directory: Path) -> dict[int, Path]:
    """Journals of a study, by row."""
    return _numbered(directory / "journal", "row", "jsonl")


def _numbered(directory: Path, prefix: str, ending: str) -> dict[int, Path]:
    """Files PREFIX-NUMBER.ENDING by their number; other files, such as copies, are ignored."""
    found = {path: re.fullmatch(rf"{prefix}-(\d+)\.{ending}", path.name) for path in directory.glob("*")}
    return {int(match[1]): path for path, match in found.items() if match and path.is_file()}
