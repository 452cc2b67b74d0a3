"""A sweep: DEM runs listed in a table; resumable, kept as one table.

    OUT/runs.parquet    a line for each finished run, in the order of the design
    OUT/heaps.parquet   the beads of the heaps, where they are kept
    OUT/journal.jsonl   runs that have finished since; gone when a sweep ends in peace

A run is known by its content (model hash, engine, parameters, seed), so a design may grow between two
sweeps, and nothing finished is run again. Runs of two versions of a model never share a table.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import pandas as pd

from calstudy import __version__
from calstudy.disk.files import append_line, cannot_use, cannot_write, write_atomically
from calstudy.disk.ours import remove_file, temporary
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Model
from calstudy.engines.queue import Executor, Job
from calstudy.errors import InputError, SetupError, Stopped, StoreError
from calstudy.plan import PARAMETERS
from calstudy.plausible import RANGES, require_plausible
from calstudy.records import Evaluation, Phase, Request, Run
from calstudy.study.directory.journal import encode, read_journal
from calstudy.study.directory.lock import Lock
from calstudy.study.directory.store import read_part, write_table
from calstudy.study.schema import SWEEP_HEAPS, Column, Quantities, run_line, schema_of, sweep_columns
from calstudy.written import number_in, text_of, whole_number_in

DESIGN_COLUMNS = ("label", "fidelity", "variant", "seed", *PARAMETERS)
"""Of the angle-of-repose model's designs."""
LARGEST_SEED = 2**63 - 1
"""What a table can hold."""
RUNS, HEAPS, JOURNAL = "runs.parquet", "heaps.parquet", "journal.jsonl"


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a design: a DEM run, and the label under which its result is looked for."""

    label: str
    fidelity: str
    variant: str
    seed: int
    parameters: Mapping[str, float]


def design_columns(own: Model | None) -> tuple[str, ...]:
    """Columns of a design; one's own model has no variants, and one fidelity a design."""
    return DESIGN_COLUMNS if own is None else ("label", "seed", *own.parameters)


def read_design(path: Path, insist: bool = False, own: Model | None = None) -> list[Line]:
    """Lines of a design; InputError names a line that cannot be run, or is implausible without ``insist``."""
    columns = design_columns(own)
    ranges = RANGES if own is None else own.plausible
    try:
        reader = csv.reader(io.StringIO(text_of(path), newline=""), strict=True)
        rows = [(reader.line_num, cells) for cells in reader if any(cells)]
    except csv.Error as error:
        raise InputError(f"{path}: cannot be read as CSV ({error}); correct it") from error
    header = rows[0][1] if rows else []
    if tuple(header) != columns:
        semicolons = "; it has semicolons between them: write commas" if ";" in "".join(header) else ""
        raise InputError(f"{path}: the columns must be {','.join(columns)}{semicolons}")
    lines = [
        _design_line(f"{path}, line {number}", dict(zip(columns, cells, strict=False)), len(cells), columns)
        for number, cells in rows[1:]
    ]
    for (number, _), line in zip(rows[1:], lines, strict=True):
        require_plausible(line.parameters, insist, f"{path}, line {number}: ", ranges)
    if not lines:
        raise InputError(f"{path}: holds no run; add lines")
    if own is None:
        return lines
    return [replace(line, fidelity=own.labels["fidelity"], variant=own.labels["variant"]) for line in lines]


def _design_line(where: str, cell: Mapping[str, str], cells: int, columns: Sequence[str]) -> Line:
    if cells != len(columns):
        comma = "; decimals have a point, not a comma" if cells > len(columns) else ""
        raise InputError(f"{where}: has {cells} cells; write {len(columns)}{comma}")
    numbers: dict[str, float] = {}
    for name in columns[columns.index("seed") :]:
        try:
            numbers[name] = whole_number_in(cell[name]) if name == "seed" else number_in(cell[name])
        except InputError as error:
            raise InputError(f"{where}, {name}: {error}") from error
    seed = int(numbers.pop("seed"))
    if not 0 <= seed <= LARGEST_SEED:
        raise InputError(f"{where}, seed: it is {seed}; give 0 to {LARGEST_SEED}")
    return Line(cell["label"], cell.get("fidelity", ""), cell.get("variant", ""), seed, numbers)


def write_design(path: Path, design: Sequence[Line], own: Model | None = None) -> None:
    """Write a design as `read_design` reads it; SetupError where that cannot be done."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    columns = design_columns(own)
    writer.writerow(columns)
    names = columns[columns.index("seed") + 1 :]
    for line in design:
        numbers = [repr(float(line.parameters[name])) for name in names]
        labels = [] if own else [line.fidelity, line.variant]
        writer.writerow([line.label, *labels, line.seed, *numbers])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, text.getvalue().encode())
    except OSError as error:
        raise SetupError(f"{path}: cannot be written: {error.strerror}; choose another --out") from error


def sweep(
    design: Sequence[Line],
    engine_of: Callable[[str, str], ProgramEngine[Model]],
    out: Path,
    executor: Executor,
    say: Callable[[int, int, float], None],
    keep_beads: bool = False,
) -> pd.DataFrame:
    """Run what is not there yet, and return the table of all finished runs, in the design's order.

    ``engine_of`` gives the engine of a fidelity and variant; ``say`` hears how many runs are done, how
    many there are, and the expected seconds of one core that are left. What is finished is in the table
    whatever ends the sweep. Raises Stopped when the executor is stopped.
    """
    engines = {
        key: engine_of(*key) for key in dict.fromkeys((line.fidelity, line.variant) for line in design)
    }
    for line in design:
        engines[line.fidelity, line.variant].model.check(line.parameters)
    runs = [_Planned.of(k, line, engines[line.fidelity, line.variant]) for k, line in enumerate(design)]
    if len({planned.run_id for planned in runs}) < len(runs):
        raise InputError("the design asks for one DEM run twice; give each line a seed of its own")
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = Lock(out)
        lock.acquire()
    except OSError as error:
        raise cannot_use(out, "--out", error) from error
    try:
        return _sweep(runs, out, executor, lock, say, keep_beads)
    finally:
        lock.release()


@dataclass(frozen=True, slots=True)
class _Planned:
    """A line of the design, and the DEM run that answers it."""

    line: Line
    engine: ProgramEngine[Model]
    request: Request
    run_id: str

    @classmethod
    def of(cls, index: int, line: Line, engine: ProgramEngine) -> _Planned:
        request = Request(0, Phase.SAMPLING, index, line.parameters, line.seed)
        return cls(line, engine, request, request.run_id(engine.model_hash, engine.identity))


def _sweep(
    runs: Sequence[_Planned],
    out: Path,
    executor: Executor,
    lock: Lock,
    say: Callable[[int, int, float], None],
    keep_beads: bool,
) -> pd.DataFrame:
    model = runs[0].engine.model
    columns = sweep_columns(Quantities.of(model))
    table, heaps = _read(out / RUNS, columns), _read(out / HEAPS, SWEEP_HEAPS)
    _refuse_other_models(table, {planned.engine.model_hash for planned in runs}, out)
    journal = _read_journal(out / JOURNAL)
    finished = set(table["run_id"]) | {evaluation.run_id for evaluation in journal}
    left = {planned.run_id: planned for planned in runs if planned.run_id not in finished}
    engines = Counter(planned.engine for planned in left.values())

    def tell() -> None:
        seconds = sum(count * engine.expected_seconds for engine, count in engines.items())
        say(len(runs) - len(left), len(runs), seconds)

    def keep(answers: Sequence[tuple[_Planned, Run]]) -> None:
        new = [Evaluation(planned.request, planned.run_id, run) for planned, run in answers]
        _append(out / JOURNAL, new)
        journal.extend(new)
        for planned, _ in answers:
            del left[planned.run_id]
            engines[planned.engine] -= 1
            tell()

    tell()
    try:
        with temporary() as scratch:
            jobs = {executor.submit(_job(planned, scratch, lock)): planned for planned in left.values()}
            ended: SimpleQueue[Future[Run]] = SimpleQueue()
            for job in jobs:
                job.add_done_callback(ended.put)
            try:
                while left:
                    together = _all_of(ended)
                    lock.require()
                    keep([(jobs[job], job.result()) for job in together])
            finally:
                for job in jobs:
                    job.cancel()
                executor.close()
                if not lock.lost.is_set():  # what ended beside the one that ended all this
                    others = (job for job, planned in jobs.items() if planned.run_id in left)
                    keep([(jobs[job], job.result()) for job in list(others) if _has_run(job)])
    except Stopped as error:
        raise Stopped(
            f"stopped; {len(runs) - len(left)} of {len(runs)} runs are in {out / RUNS}, "
            "and the same command goes on"
        ) from error
    finally:
        # If another session has taken over, the table and the journal belong to it.
        if not lock.lost.is_set():
            table = _merge(table, journal, {planned.run_id: planned for planned in runs})
            write_table(out / RUNS, table, schema_of(columns, "runs"), out)
            there = set(table["run_id"])
            if keep_beads:
                wanted = there - set(heaps["run_id"])
                heaps = pd.concat([heaps, *(_beads(e) for e in journal if e.run_id in wanted)])
                place = {run_id: k for k, run_id in enumerate(table["run_id"])}
                heaps = heaps.sort_values("run_id", key=lambda ids: ids.map(place), kind="stable")
                write_table(out / HEAPS, heaps, schema_of(SWEEP_HEAPS, "heaps"), out)
            _drop(out / JOURNAL, there)
    return table


def without_heaps(table: pd.DataFrame, out: Path) -> int:
    """Number of runs of a sweep's table that gave beads, none of which are kept."""
    kept = set(_read(out / HEAPS, SWEEP_HEAPS)["run_id"])
    return int(((table["beads_heap"] > 0) & ~table["run_id"].isin(kept)).sum())


def _all_of(ended: SimpleQueue[Future[Run]]) -> list[Future[Run]]:
    """All that have ended by now, one at least: they are forced to disk together."""
    return [ended.get(), *(ended.get() for _ in range(ended.qsize()))]


def _has_run(job: Future[Run]) -> bool:
    return job.done() and not job.cancelled() and job.exception() is None


def _job(planned: _Planned, scratch: Path, lock: Lock) -> Job:
    return Job(
        engine=planned.engine,
        parameters=planned.line.parameters,
        seed=planned.line.seed,
        run_id=planned.run_id,
        scratch=scratch,
        session=lock.session.token,
    )


def _line(planned: _Planned, run: Run) -> dict[str, object]:
    line, engine = planned.line, planned.engine
    return {
        "label": line.label,
        "model": engine.model.name,
        "deck": engine.model.deck,
        "model_hash": engine.model_hash,
        "fidelity": line.fidelity,
        "variant": line.variant,
        "engine": engine.identity,
        "calstudy": __version__,
        "run_id": planned.run_id,
        "seed": line.seed,
        **line.parameters,
        **run_line(run),
        "host": run.host,
        "finished_at": run.finished_at,
    }


def _beads(evaluation: Evaluation) -> pd.DataFrame:
    beads = evaluation.run.positions if evaluation.run.positions is not None else np.empty((0, 3))
    return pd.DataFrame(beads, columns=list("xyz")).assign(run_id=evaluation.run_id)


def _merge(table: pd.DataFrame, journal: Sequence[Evaluation], runs: Mapping[str, _Planned]) -> pd.DataFrame:
    """Old and new lines in the design's order; lines that the design no longer has come last."""
    # A sweep that ended between its tables and its journal leaves runs in both.
    wanted = runs.keys() - set(table["run_id"])
    new = pd.DataFrame([_line(runs[e.run_id], e.run) for e in journal if e.run_id in wanted])
    parts = [part for part in (table, new) if len(part)]
    merged = pd.concat(parts, ignore_index=True) if parts else table
    place = {run_id: k for k, run_id in enumerate(runs)}
    order = merged["run_id"].map(lambda run_id: place.get(run_id, len(place)))
    return merged.iloc[np.argsort(order.to_numpy(), kind="stable")].reset_index(drop=True)


def _refuse_other_models(table: pd.DataFrame, hashes: set[str], out: Path) -> None:
    other = table[~table["model_hash"].isin(hashes)]
    if len(other):
        first = other.iloc[0]
        labels = f"{first['fidelity']} fidelity, {first['variant']}, " if first["fidelity"] else ""
        raise StoreError(
            f"{out / RUNS} holds {len(other)} run(s) of another model than the design asks for: "
            f"{labels}version {first['model_hash'][:12]}; "
            "choose another --out, or put their lines back into the design"
        )


def _read(path: Path, columns: Sequence[Column]) -> pd.DataFrame:
    schema = schema_of(columns, path.stem)
    if not path.exists():
        return schema.empty_table().to_pandas()
    return read_part(path, schema, "restore it, or choose another --out").to_pandas()


def _read_journal(path: Path) -> list[Evaluation]:
    return list(read_journal(path).evaluations)


def _drop(path: Path, run_ids: set[str]) -> None:
    """Remove what is in the table from the journal; runs that the design no longer has stay there."""
    others = [evaluation for evaluation in _read_journal(path) if evaluation.run_id not in run_ids]
    try:
        if others:
            write_atomically(path, b"".join(map(encode, others)), path.parent)
        else:
            remove_file(path, path.parent)
    except OSError as error:
        raise cannot_write(path, error) from error


def _append(path: Path, evaluations: Sequence[Evaluation]) -> None:
    """Make finished runs durable."""
    if not evaluations:
        return
    try:
        append_line(path, b"".join(map(encode, evaluations)), path.parent)
    except OSError as error:
        raise cannot_write(path, error) from error
