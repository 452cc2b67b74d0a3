"""A sweep: DEM runs that are listed in a table, whatever asked for them; resumable, kept as one table.

    OUT/runs.parquet    a line for each finished run, in the order of the design
    OUT/heaps.parquet   the beads of the heaps, where they are kept
    OUT/journal.jsonl   runs that have finished since; gone when a sweep ends in peace

A run is known by its content (model hash, engine, parameters, seed), so a design may grow between two
sweeps, and nothing finished is run again. Runs of two versions of a model never share a table.
"""

from __future__ import annotations

import csv
import io
import math
import os
import tempfile
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from calstudy import __version__
from calstudy.engine import LiggghtsEngine, Stopped
from calstudy.errors import InputError, SetupError, StoreError
from calstudy.journal import Stored, decode, encode
from calstudy.model import check_physics
from calstudy.plan import PARAMETERS
from calstudy.records import Evaluation, Phase, Request
from calstudy.schema import SWEEP, SWEEP_HEAPS, Column, schema_of
from calstudy.store import run_line, write_atomically

DESIGN_COLUMNS = ("label", "fidelity", "variant", "seed", *PARAMETERS)
RUNS, HEAPS, JOURNAL = "runs.parquet", "heaps.parquet", "journal.jsonl"


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a design: a DEM run, and the label under which its result is looked for."""

    label: str
    fidelity: str
    variant: str
    seed: int
    parameters: Mapping[str, float]


def read_design(path: Path) -> list[Line]:
    """Lines of a design; InputError names the line that cannot be run."""
    try:
        reader = csv.DictReader(io.StringIO(path.read_text()))
        cells = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV; check the file") from error
    if tuple(reader.fieldnames or ()) != DESIGN_COLUMNS:
        raise InputError(f"{path}: the columns must be {','.join(DESIGN_COLUMNS)}")
    lines = []
    for number, cell in enumerate(cells, start=2):
        try:
            parameters = {name: float(cell[name]) for name in PARAMETERS}
            seed = int(cell["seed"])
        except (TypeError, ValueError) as error:
            raise InputError(f"{path}, line {number}: a number is missing or is none") from error
        if None in cell or seed < 0:
            raise InputError(f"{path}, line {number}: too many cells, or a negative seed")
        lines.append(Line(cell["label"], cell["fidelity"], cell["variant"], seed, parameters))
    if not lines:
        raise InputError(f"{path}: holds no run; add lines")
    return lines


def sweep(
    design: Sequence[Line],
    engine_of: Callable[[str, str], LiggghtsEngine],
    out: Path,
    workers: int,
    stop: threading.Event,
    say: Callable[[int, int, float], None],
    keep_heaps: bool = False,
) -> pd.DataFrame:
    """Run what is not there yet, and return the table of all finished runs.

    ``engine_of`` gives the engine of a fidelity and variant; ``say`` hears how many runs are done, how
    many there are, and the expected seconds of one core that are left. Raises Stopped when ``stop`` is
    set; what is finished is in the table by then.
    """
    engines = {(line.fidelity, line.variant): None for line in design}
    known = {key: engine_of(*key) for key in engines}
    requests = [_request(k, line) for k, line in enumerate(design)]
    for line in design:
        check_physics(line.parameters, known[line.fidelity, line.variant].model.fixed)
    ids = [
        request.run_id(
            known[line.fidelity, line.variant].model_hash, known[line.fidelity, line.variant].identity
        )
        for request, line in zip(requests, design, strict=True)
    ]
    if len(set(ids)) < len(ids):
        raise InputError("the design asks for one DEM run twice; give each line a seed of its own")
    out.mkdir(parents=True, exist_ok=True)
    table, heaps = _read(out / RUNS, SWEEP), _read(out / HEAPS, SWEEP_HEAPS)
    _refuse_other_models(table, [engine.model_hash for engine in known.values()], out)
    journal = _read_journal(out / JOURNAL)
    finished = set(table["run_id"]) | {entry.evaluation.run_id for entry in journal}
    todo = [k for k, run_id in enumerate(ids) if run_id not in finished]

    def seconds(which: Iterable[int]) -> float:
        return sum(known[design[k].fidelity, design[k].variant].expected_seconds for k in which)

    def one(k: int, scratch: Path) -> Stored:
        line = design[k]
        run = known[line.fidelity, line.variant].run(line.parameters, line.seed, scratch / str(k), stop)
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return Stored(Evaluation(requests[k], ids[k], run), os.uname().nodename, now)

    left = set(todo)
    try:
        with tempfile.TemporaryDirectory(prefix="calstudy-") as scratch, ThreadPoolExecutor(workers) as pool:
            jobs = {pool.submit(one, k, Path(scratch)): k for k in todo}
            try:
                say(len(ids) - len(left), len(ids), seconds(left))
                pending = set(jobs)
                while pending:
                    ended, pending = wait(pending, return_when=FIRST_COMPLETED)
                    for job in ended:
                        entry = job.result()
                        journal.append(entry)
                        _append(out / JOURNAL, entry)
                        left.discard(jobs[job])
                        say(len(ids) - len(left), len(ids), seconds(left))
            except Stopped as error:
                raise Stopped(
                    f"stopped; {len(ids) - len(left)} of {len(ids)} runs are in {out / RUNS}, "
                    "the same command goes on"
                ) from error
            except BaseException:
                stop.set()
                raise
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
    finally:
        place = {run_id: k for k, run_id in enumerate(ids)}
        lines = [_line(design, known, place, entry) for entry in journal if entry.evaluation.run_id in place]
        table = _merge(table, pd.DataFrame(lines), place)
        _write(out / RUNS, table, SWEEP)
        if keep_heaps:
            beads = [_beads(entry) for entry in journal if entry.evaluation.run.heap is not None]
            _write(out / HEAPS, pd.concat([heaps, *beads]), SWEEP_HEAPS)
        (out / JOURNAL).unlink(missing_ok=True)
    return table


def _request(index: int, line: Line) -> Request:
    return Request(row=0, phase=Phase.SAMPLING, index=index, parameters=line.parameters, seed=line.seed)


def _line(
    design: Sequence[Line],
    engines: Mapping[tuple[str, str], LiggghtsEngine],
    place: Mapping[str, int],
    entry: Stored,
) -> dict[str, object]:
    line = design[place[entry.evaluation.run_id]]
    engine = engines[line.fidelity, line.variant]
    return {
        "label": line.label,
        "model": engine.model.name,
        "deck": engine.model.deck,
        "model_hash": engine.model_hash,
        "fidelity": line.fidelity,
        "variant": line.variant,
        "engine": engine.identity,
        "calstudy": __version__,
        "run_id": entry.evaluation.run_id,
        "seed": line.seed,
        **line.parameters,
        **run_line(entry.evaluation.run),
        "host": entry.host,
        "finished_at": entry.finished_at,
    }


def _beads(entry: Stored) -> pd.DataFrame:
    return pd.DataFrame(entry.evaluation.run.heap, columns=list("xyz")).assign(run_id=entry.evaluation.run_id)


def _merge(table: pd.DataFrame, new: pd.DataFrame, place: Mapping[str, int]) -> pd.DataFrame:
    """Old and new lines in the design's order; lines that the design no longer has come last."""
    frames = [frame for frame in (table, new) if len(frame)]
    merged = pd.concat(frames) if frames else table
    order = [place.get(run_id, math.inf) for run_id in merged["run_id"]]
    return merged.assign(_order=order).sort_values("_order", kind="stable").drop(columns="_order")


def _refuse_other_models(table: pd.DataFrame, hashes: Sequence[str], out: Path) -> None:
    if others := sorted(set(table["model_hash"]) - set(hashes)):
        raise StoreError(
            f"{out / RUNS} holds runs of another version of the model ({others[0][:12]}); "
            "choose another --out"
        )


def _read(path: Path, columns: Sequence[Column]) -> pd.DataFrame:
    schema = schema_of(columns, path.stem)
    if not path.exists():
        return schema.empty_table().to_pandas()
    try:
        table = pq.read_table(path, page_checksum_verification=True)
    except (OSError, pa.ArrowException) as error:
        raise StoreError(f"{path} is damaged; restore it, or choose another --out") from error
    if (table.schema.names, table.schema.types) != (schema.names, schema.types):
        raise StoreError(f"{path}: its columns are not a sweep's; choose another --out")
    return table.to_pandas()


def _write(path: Path, frame: pd.DataFrame, columns: Sequence[Column]) -> None:
    schema = schema_of(columns, path.stem)
    content = pa.Table.from_pandas(frame.reindex(columns=schema.names), schema=schema, preserve_index=False)
    sink = pa.BufferOutputStream()
    pq.write_table(
        content.replace_schema_metadata(schema.metadata), sink, compression="zstd", write_page_checksum=True
    )
    try:
        write_atomically(path, sink.getvalue().to_pybytes())
    except OSError as error:
        raise SetupError(
            f"{path}: cannot be written: {error.strerror}; free space and run it again"
        ) from error


def _read_journal(path: Path) -> list[Stored]:
    if not path.exists():
        return []
    entries = [decode(line) for line in path.read_bytes().split(b"\n") if line]
    return [entry for entry in entries if entry is not None]


def _append(path: Path, entry: Stored) -> None:
    """Make a finished run durable."""
    try:
        with path.open("ab") as journal:
            journal.write(b"\n" + encode(entry))  # an empty line ends one that was cut short
            journal.flush()
            os.fsync(journal.fileno())
    except OSError as error:
        raise SetupError(
            f"{path}: cannot be written: {error.strerror}; free space and run it again"
        ) from error
