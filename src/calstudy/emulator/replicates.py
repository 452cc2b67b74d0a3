"""A study repeated on an emulator, so that each of its numbers can be compared with its distribution.

    STUDY/replicates/r-001.parquet        what the calibrations of replicate 1 found
    STUDY/replicate_runs/r-001.parquet    the emulator's answers to them

Replicate r is the study with the study's seed plus r, which gives it its own samples and noise, on a draw of
its own from the emulator's posterior, of the same number. So the emulator's uncertainty is in what differs
between replicates. Each is computed by one process and depends on nothing but its number. Where the plan has
several material tests, each replicate has a truth of its own, too (``calibration.task.truth_of``).
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import pandas as pd
from numpy.linalg import LinAlgError
from threadpoolctl import threadpool_limits

from calstudy.calibration.modes import Mode
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Calibration, tasks_of, truth_of
from calstudy.disk.files import cannot_write
from calstudy.disk.ours import make_directory, temporary
from calstudy.emulator.emulator import Emulator
from calstudy.emulator.engine import EmulatorEngine, twin_of
from calstudy.engines.interface import Model
from calstudy.engines.queue import Executor
from calstudy.errors import NumericsError, OutOfTime, SetupError, Stopped, StoreError
from calstudy.plan import Plan
from calstudy.records import RAYLEIGH_TIME_STEP, Evaluation, Request
from calstudy.study.campaign import Summary
from calstudy.study.directory.session import Look, duration
from calstudy.study.directory.store import Store, read_part, write_table
from calstudy.study.run.work import Running, Say, Watch, Work, run
from calstudy.study.schema import REPLICATED, arrow_schema, result_line
from calstudy.study.settings import StudySettings

CALIBRATIONS, RUNS = REPLICATED
LOOK_SECONDS = 0.25
GIVE_UP_SECONDS = 5.0
"""Seconds that an interrupted replicate has to give up."""
ROW_SECONDS = 0.25
"""Expected processor time of a calibration on an emulator, in s."""

Tables = dict[str, pd.DataFrame]
"""Lines of one replicate by name of their table."""


@dataclass(frozen=True, slots=True)
class Replication:
    """What all replicates of a study have in common."""

    settings: StudySettings
    plan: Plan
    rows: tuple[int, ...]
    mode: Mode
    model: Model
    emulator: Emulator
    further: tuple[tuple[Model, Emulator, str], ...] = ()
    """Model, emulator and prefix of each further material test of the plan."""

    def seed(self, number: int) -> int:
        """Seed of a replicate, and number of its draw from the emulator's posterior."""
        return self.settings.seed + number

    def replicate(self, number: int, stop: threading.Event, count: Callable[[], None]) -> Tables:
        """Run a replicate's calibrations; ``count`` is called after each.

        Raises Stopped once ``stop`` is set.
        """
        settings, seed = self.settings, self.seed(number)
        engines = [
            EmulatorEngine(model, emulator, seed, self.mode.grid is not None, prefix)
            for model, emulator, prefix in ((self.model, self.emulator, ""), *self.further)
        ]
        identity = "+".join(engine.identity for engine in engines)
        target = settings.target
        if self.plan.tests:
            target = twin_of(engines, tuple(target.values), truth_of(self.plan, seed))
        tasks = tasks_of(self.plan, target, self.mode, seed, settings.share_samples, settings.noise)
        common = {**settings.provenance, "engine": identity, "replicate": number, "seed": seed}
        lines: list[dict[str, Any]] = []
        runs: list[dict[str, Any]] = []
        for row in self.rows:
            asked = engines[: tasks[row].tests]
            answered: list[Evaluation] = []
            joined: list[Evaluation] = []

            def evaluate(
                requests: Sequence[Request],
                asked: Sequence[EmulatorEngine] = asked,
                answered: list[Evaluation] = answered,
                joined: list[Evaluation] = joined,
            ) -> list[Evaluation]:
                new = [
                    [Evaluation(r, "", engine.run(r.parameters, r.seed, Path(), stop)) for engine in asked]
                    for r in requests
                ]
                together = [Evaluation.joined(parts) for parts in new]
                answered.extend(evaluation for parts in new for evaluation in parts)
                joined.extend(together)
                return together

            found: Calibration | None = None
            reason = ""
            try:
                found = calibrate(tasks[row], evaluate)
            except (NumericsError, LinAlgError) as error:
                reason = str(error)
            lines.append({**common, "row": row, **result_line(tasks[row], found, reason, answered)})
            runs += [{**common, **_run_line(evaluation)} for evaluation in joined]
            count()
        return {CALIBRATIONS: pd.DataFrame(lines), RUNS: pd.DataFrame(runs)}


def _run_line(evaluation: Evaluation) -> dict[str, Any]:
    request, run = evaluation.request, evaluation.run
    return {
        "row": request.row,
        "phase": str(request.phase),
        "index": request.index,
        "outcome": str(run.outcome),
        **request.parameters,
        **{name: value for name, value in run.responses.items() if name != RAYLEIGH_TIME_STEP},
    }


# ---- files -------------------------------------------------------------------------------------------


def read_replicate(directory: Path, settings: StudySettings, number: int) -> Tables:
    """Tables of a replicate of the study with these settings.

    StoreError where one is missing, damaged, or of another study.
    """
    tables = {}
    for name in REPLICATED:
        path = _part(directory, name, number)
        tables[name] = read_part(path, arrow_schema(name, settings.quantities), _REMEDY).to_pandas()
        if set(tables[name]["study"]) != {settings.id} or set(tables[name]["replicate"]) != {number}:
            raise StoreError(f"{path} is not replicate {number} of the study {settings.id}; {_REMEDY}")
    return tables


_REMEDY = "delete it and run the same 'plan run --replicates' again"


def _part(directory: Path, table: str, number: int) -> Path:
    return directory / table / f"r-{number:03d}.parquet"


# ---- many of them ------------------------------------------------------------------------------------


class Replicates:
    """Replicates 1 to ``count`` of a study, computed by processes into a store that is open."""

    def __init__(
        self,
        of: Replication,
        count: int,
        store: Store,
        *,
        workers: int,
        deadline: float | None = None,
    ) -> None:
        """``deadline`` is a time of the monotonic clock. StoreError where other rows were replicated here."""
        self.of, self.count, self.store = of, count, store
        self.workers, self.deadline = workers, deadline
        self.failed_rows = 0
        """Calibrations that failed, over all replicates."""
        self._rows_done = 0
        self._started = time.monotonic()
        self._done = {number for number in range(1, count + 1) if self._there(number)}
        self._before = len(self._done)

    def _there(self, number: int) -> bool:
        """Whether a replicate is finished; a damaged one is noted, and made again."""
        directory = self.store.directory
        if not all(_part(directory, name, number).exists() for name in REPLICATED):
            return False
        try:
            lines = read_replicate(directory, self.of.settings, number)[CALIBRATIONS]
        except StoreError as error:
            self.store.notes.append(f"replicate {number} is made again: {str(error).partition(';')[0]}")
            return False
        if tuple(lines["row"]) != self.of.rows:
            raise StoreError(
                f"{directory / CALIBRATIONS} holds replicates of {len(lines)} row(s), {lines['row'].min()} "
                f"to {lines['row'].max()}, not of the rows asked for; ask for these, or choose another "
                "--study"
            )
        self.failed_rows += int((lines["outcome"] != "ok").sum())
        return True

    def run(self, stop: threading.Event) -> None:
        """Compute the replicates that are not there yet.

        Raises Stopped when ``stop`` is set meanwhile, OutOfTime at the deadline, StoreError when another
        session takes the study over, SetupError where nothing can be written or a process dies. What is
        finished is kept.
        """
        self._started = time.monotonic()
        waiting = [number for number in range(1, self.count + 1) if number not in self._done]
        for name in REPLICATED:
            try:
                make_directory(self.store.directory / name, self.store.directory)
            except OSError as error:
                raise cannot_write(self.store.directory / name, error) from error
        if not waiting:
            return
        with temporary() as folder:
            # As a file: through the pipe by which a process starts, one that dies in it would be waited for.
            common = folder / "replication.pickle"
            common.write_bytes(pickle.dumps(self.of))
            self._compute(waiting, common, stop)

    def _compute(self, waiting: Sequence[int], common: Path, stop: threading.Event) -> None:
        context = get_context("spawn")  # threads of the numerical libraries do not outlive a fork
        end, rows = context.Event(), context.Value("q", 0)
        pool = ProcessPoolExecutor(
            min(self.workers, len(waiting)),
            mp_context=context,
            initializer=_begin,
            initargs=(common, end, rows),
        )
        try:
            try:
                pending: set[Future[Tables]] = {pool.submit(_replicate, number) for number in waiting}
            except OSError as error:  # one process died, and the pool closed its pipes, while another started
                raise BrokenProcessPool(str(error)) from error
            while pending:
                ended, pending = wait(pending, timeout=LOOK_SECONDS, return_when=FIRST_COMPLETED)
                for future in ended:
                    self._write(future.result())
                self._rows_done = rows.value
                self._look(stop)
        except BrokenProcessPool as error:
            self._look(stop)
            raise SetupError(
                "a process that computed a replicate was ended from outside, for want of memory perhaps; run "
                "the same command again, with fewer --workers"
            ) from error
        finally:
            end.set()
            pool.shutdown(cancel_futures=True)

    def _look(self, stop: threading.Event) -> None:
        if stop.is_set():
            raise Stopped("interrupted")
        self.store.lock.require()
        if self.deadline is not None and time.monotonic() > self.deadline:
            raise OutOfTime("the time limit was reached")

    def _write(self, tables: Tables) -> None:
        """Store a replicate; its calibrations come last, for with them it is finished."""
        number = int(tables[CALIBRATIONS]["replicate"].iloc[0])
        for name in (RUNS, CALIBRATIONS):
            path = _part(self.store.directory, name, number)
            schema = arrow_schema(name, self.of.settings.quantities)
            write_table(path, tables[name], schema, self.store.directory)
        self._done.add(number)
        self.failed_rows += int((tables[CALIBRATIONS]["outcome"] != "ok").sum())

    def in_words(self) -> str:
        """How far it is, in a line."""
        failed = f", {self.failed_rows} of their calibrations failed" if self.failed_rows else ""
        return f"{len(self._done)} of {self.count} replicates finished{failed}"

    def look(self) -> Look:
        """What a display shows of it."""
        rows = (self.count - self._before) * len(self.of.rows)
        elapsed = time.monotonic() - self._started
        left = elapsed * (rows / self._rows_done - 1.0) if self._rows_done else self._guess(rows)
        words = [self.in_words(), duration(elapsed), f"about {duration(max(left, 0.0))} left"]
        return Look(self._rows_done / max(rows, 1), words)

    def _guess(self, rows: int) -> float:
        return rows * ROW_SECONDS / self.workers


# ---- after the rows of their study ------------------------------------------------------------------

WatchReplicates = Callable[[Replicates], AbstractContextManager[threading.Event]]
"""Context of running replicates, which may show them; gives the event that stops them."""


@dataclass(frozen=True, slots=True)
class _Sequel:
    """Replicates that follow the rows of their study while it is still locked."""

    replicates: Replicates
    say: Say
    watch: WatchReplicates

    def run(self) -> None:
        """Compute them."""
        self.say(f"Replicates: each with its own seed and draw, {self.replicates.workers} at once")
        with self.watch(self.replicates) as stop:
            self.replicates.run(stop)

    def in_words(self) -> str:
        """How many are finished."""
        return self.replicates.in_words()


def run_replicated(
    work: Work,
    plan: Plan,
    engine: EmulatorEngine,
    count: int,
    executor: Executor,
    how: Running,
    stop: threading.Event,
    *,
    say: Say,
    watch: Watch,
    watch_replicates: WatchReplicates,
) -> tuple[Summary, Replicates]:
    """Calibrate rows of a plan on an emulator, then replicates 1 to ``count`` of them, into one study.

    Raises as ``study.run.work.run`` and ``Replicates.run``.
    """
    deadline = None if how.time_limit is None else time.monotonic() + how.time_limit
    further = [test.engine for test in work.tests[1:]]
    of = Replication(
        work.settings,
        plan,
        tuple(work.rows),
        work.mode,
        engine.model,
        engine.emulator,
        tuple((e.model, e.emulator, e.prefix) for e in further if isinstance(e, EmulatorEngine)),
    )
    made: list[Replicates] = []

    def then(store: Store) -> _Sequel:
        made.append(Replicates(of, count, store, workers=how.slots, deadline=deadline))
        return _Sequel(made[0], say, watch_replicates)

    summary = run(work, executor, how, stop, say=say, watch=watch, then=then)
    return summary, made[0]


# ---- in a process of its own -------------------------------------------------------------------------

_here: dict[str, Any] = {}
"""What `_begin` was given, for the replicates that follow."""


def _begin(common: Path, end: Any, rows: Any) -> None:
    # Ctrl-C reaches all processes of the terminal; the first one says when to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    stop = threading.Event()
    threading.Thread(target=_watch, args=(end, stop), daemon=True).start()

    def count() -> None:
        with rows.get_lock():
            rows.value += 1

    try:
        _here.update(of=pickle.loads(common.read_bytes()), stop=stop, count=count)
    except FileNotFoundError:  # the process that asked was killed, and the next command swept its files
        os._exit(1)


def _watch(end: Any, stop: threading.Event) -> None:
    """Stop when told to, and when the process that asked has ended."""
    parent = parent_process()
    while not end.wait(LOOK_SECONDS):
        if parent is None or not parent.is_alive():
            os._exit(1)
    stop.set()
    time.sleep(GIVE_UP_SECONDS)
    os._exit(1)  # a computation that does not end would be waited for


def _replicate(number: int) -> Tables:
    of: Replication = _here["of"]
    with threadpool_limits(1):
        return of.replicate(number, _here["stop"], _here["count"])
