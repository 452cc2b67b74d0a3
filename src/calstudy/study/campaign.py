"""Many calibrations at once. Each row under way has a thread, and all rows share one queue of DEM runs.

Earlier rows go first, so that they are finished one after the other; later ones take the slots they leave.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path

from numpy.linalg import LinAlgError
from threadpoolctl import threadpool_limits

from calstudy.calibration.expected import (
    expected_batches,
    expected_optimisation_runs,
    most_further_runs,
    number_of_sampling_runs,
    weight_left,
)
from calstudy.calibration.modes import Refinement
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Announce, Calibration, Task
from calstudy.engines.guardian import limited
from calstudy.engines.queue import Executor, Queue
from calstudy.errors import NumericsError, OutOfTime, Stopped
from calstudy.records import Evaluation, Phase, Request, Run
from calstudy.study.answers import Answers, MaterialTest
from calstudy.study.directory.elements import Claims
from calstudy.study.directory.session import Activity, read_sessions
from calstudy.study.directory.store import Store
from calstudy.study.schema import result_line

LOOK_SECONDS = 0.25
GIVE_UP_SECONDS = 5.0
"""Seconds that an interrupted row has to give up."""
LEAST_ROWS_AT_ONCE, ROWS_FOR_A_SLOT = 100, 2
"""Rows under way, each with a thread: at least the first, or the second for each slot if that is more."""
log = logging.getLogger(__name__)


@dataclass
class Progress:
    """What a campaign has done so far."""

    rows: int = 0
    expected_runs: float = 0.0
    rows_done: int = 0
    rows_failed: int = 0
    runs_done: int = 0
    weight_done: float = 0.0
    """The same with cheap ones as what they are expected to take of an expensive one's time."""
    runs_reused: int = 0
    """Runs found on disk, or asked for by two rows."""
    runs_failed: int = 0
    rows_told: list[str] = field(default_factory=list)
    """A line for each finished row, in their order."""
    started: float = field(default_factory=time.monotonic)

    @property
    def runs_left(self) -> float:
        """Runs still expected, including those under way."""
        return self.expected_runs - self.runs_done - self.runs_reused


@dataclass(frozen=True, slots=True)
class Summary:
    """How a campaign ended."""

    finished: tuple[int, ...]
    """Rows that were finished by this campaign or before it."""
    failed: tuple[int, ...]


class Campaign:
    """Runs calibrations, each a row of its tables, into a store that is open."""

    def __init__(
        self,
        tasks: Mapping[int, Task],
        tests: Sequence[MaterialTest],
        store: Store,
        executor: Executor,
        *,
        scratch: Path,
        keep_runs: bool = False,
        retry_failed: bool = False,
        time_limit: float | None = None,
        cheap: Sequence[MaterialTest] = (),
        follow: Iterable[Request] = (),
        known: Mapping[str, Run] | None = None,
        announce: Announce | None = None,
        warn: Callable[[str], object] | None = None,
        stop: threading.Event | None = None,
    ) -> None:
        self.tasks, self.tests, self.store = tasks, tests, store
        self.cheap, self.announce, self.warn = cheap, announce, warn
        self.scratch, self.retry_failed = scratch, retry_failed
        self.stop = stop or threading.Event()
        self.progress = Progress()
        deadline = None if time_limit is None else time.monotonic() + time_limit
        self.queue = Queue(
            executor, max(t.engine.expected_seconds for t in (*tests, *cheap)), self.stop, deadline
        )
        self._rows: tuple[int, ...] = ()
        self._failed: list[int] = []
        self._expected: dict[int, float] = {}
        self._batches: dict[int, tuple[list[int], list[int]]] = {}
        """Batches that are still expected of a row, of the expensive fidelity and of the cheap one."""
        self._guard = threading.RLock()
        self.answers = Answers(
            store,
            self.queue,
            scratch=scratch,
            keep_runs=keep_runs,
            retry_failed=retry_failed,
            several_models=len(tests) > 1 or bool(cheap),
            follow=follow,
            known=known,
            reused=self._reused,
            ended=self._ended,
        )

    def run(self, rows: Sequence[int]) -> Summary:
        """Calibrate the rows that are not finished, and those that the store found damaged.

        Raises Stopped if ``stop`` is set, OutOfTime if no further DEM run would end before the time limit. A
        row whose calibration fails is stored as failed, and the others continue; with ``retry_failed`` it is
        calibrated again with its broken DEM runs. An error of the machine (SetupError) or of the study
        (StoreError) ends the campaign. What is finished is kept.
        """
        # Damaged rows are always made again: their journals have the runs.
        mended = [row for row in self.store.mended if row in self.tasks and row not in rows]
        self._rows = rows = (*rows, *mended)
        self.store.lock.report = self.activity
        sessions = {session.token for session in read_sessions(self.store.directory)}
        self.queue.executor.remove_leftovers(self.scratch, sessions)
        if self.retry_failed:
            for row in self.store.failed_rows().intersection(rows):
                self.store.reopen(row)
        done = self.store.finished_rows()
        waiting = [row for row in rows if row not in done]
        self.progress = Progress(rows=len(waiting))
        log.info("%d row(s) to calibrate: %s", len(waiting), ", ".join(map(str, waiting)) or "none")
        claims = self.store.claim(self._groups(waiting))
        if claims is None:
            self._begin(waiting)
        try:
            with threadpool_limits(1), limited(self.queue.seconds_left):
                self._run_rows(waiting, claims)
        finally:
            log.info("%s", self.in_words())
        finished = self.store.finished_rows()
        if finished - self.store.failed_rows() >= set(self.tasks):
            self.store.drop_journals()
        own = rows if claims is None else tuple(self._expected)
        return Summary(
            finished=tuple(row for row in own if row in finished), failed=tuple(sorted(self._failed))
        )

    def _groups(self, rows: Sequence[int]) -> dict[int, list[int]]:
        """Rows that share samples, by the row whose samples they are."""
        of = {row: self.tasks[row].sampled_as for row in rows}
        return {group: [row for row in rows if of[row] == group] for group in of.values()}

    def _begin(self, rows: Sequence[int], among: Iterable[int] | None = None) -> None:
        """Take up what is on disk of rows, and expect their runs; ``among`` as in ``Answers.take_up``."""
        self.answers.take_up(set(rows), among)
        for row in rows:
            with self._guard:
                self._expect(row, self.expected_runs(row))
                self._batches[row] = expected_batches(self.tasks[row])

    def expected_runs(self, row: int) -> float:
        """Expected DEM runs of a row: Eq. 11, and a guess for the second optimisation."""
        task = self.tasks[row]
        return len(self.tests[: task.tests]) * sum(
            (number_of_sampling_runs(task), expected_optimisation_runs(task), most_further_runs(task))
        )

    @property
    def expected_seconds(self) -> float:
        """Expected time of a DEM run on one core in s, on average over the models."""
        return sum(test.engine.expected_seconds for test in self.tests) / len(self.tests)

    def activity(self) -> Activity:
        """What this session has done so far."""
        used, p = self.queue.usage, self.progress
        left = max(p.runs_left, used.running)
        mean = used.dem_seconds / p.weight_done if p.weight_done else self.expected_seconds
        slots = self.queue.executor.slots
        each, in_a_row = self._weight_left(slots)
        return Activity(
            rows=self._rows,
            slots=slots,
            runs_done=p.runs_done,
            runs_reused=p.runs_reused,
            runs_failed=p.runs_failed,
            runs_running=used.running,
            runs_waiting=used.waiting,
            runs_left=round(left),
            elapsed=time.monotonic() - p.started,
            seconds_left=mean * max(each * left / max(slots, 1), in_a_row),
            dem_seconds=used.dem_seconds,
            dem_cpu_seconds=used.dem_cpu_seconds,
            own_cpu_seconds=time.process_time(),
            busy_seconds=used.busy_seconds,
            offered_seconds=used.offered_seconds,
        )

    def _weight_left(self, slots: int) -> tuple[float, float]:
        """What is still expected, in expensive runs: a run on average, and the longest chain of a row."""
        with self._guard:
            left = [(self._weight(row, Phase.CHEAP), [*of[0]], [*of[1]]) for row, of in self._batches.items()]
        return weight_left(left, len(self.tests), slots)

    def _weight(self, row: int, phase: Phase) -> float:
        """Time of a run as a share of an expensive one's, as it is expected."""
        cheap = self.tasks[row].cheap
        return 1.0 if cheap is None or phase is not Phase.CHEAP else cheap.share

    def in_words(self) -> str:
        """Summary of the session, in one line."""
        p, did = self.progress, self.activity()
        used = "" if math.isnan(did.utilisation) else f"; {did.utilisation:.1%} of {did.slots} slot(s) used"
        return (
            f"{p.rows_done} row(s) finished, {p.rows_failed} of them failed; {p.runs_done} DEM run(s), "
            f"{p.runs_failed} of them failed, {p.runs_reused} reused{used}"
        )

    def _expect(self, row: int, runs: float) -> None:
        """Set the expected number of runs of a row."""
        self.progress.expected_runs += runs - self._expected.get(row, 0.0)
        self._expected[row] = runs

    def _next_runs(self, row: int, asked: int) -> float:
        """Guess how many runs an unfinished row still needs: one more iteration within the budget."""
        task, second = self.tasks[row], self.tasks[row].mode.second_optimisation
        each = len(self.tests[: task.tests])
        iteration = second.together if isinstance(second, Refinement) else 2 * task.space.box.dimension + 2
        limit = math.inf if second.budget is None else second.budget + task.confirm + most_further_runs(task)
        return min(each * iteration, max(each * (number_of_sampling_runs(task) + limit) - asked, 0))

    def _run_rows(self, rows: Sequence[int], claims: Claims | None) -> None:
        if not rows:
            self.queue.close()
            return
        threads = ThreadPoolExecutor(len(rows), thread_name_prefix="row")
        waiting, pending = deque(rows), set[Future[None]]()
        more: Sequence[int] | None = ()
        try:
            while more is not None or pending or not self.queue.idle:
                more = self._claimed(claims, len(pending)) if claims else self._next(waiting, len(pending))
                pending |= {threads.submit(self._calibrate, row) for row in more or ()}
                ended, pending = wait(pending, timeout=LOOK_SECONDS, return_when=FIRST_COMPLETED)
                for future in ended:
                    if not isinstance(future.exception(), OutOfTime):
                        future.result()
                self._look(waiting_for_runs=not pending)
            if self.queue.late:
                raise OutOfTime("the time limit does not allow another DEM run")
        finally:
            # After an error or an interruption: no new run starts, running ones end, rows give up. One that
            # computes without end is left behind: the store takes nothing from it any more.
            self.queue.close()
            threads.shutdown(wait=False, cancel_futures=True)
            wait(pending, timeout=GIVE_UP_SECONDS)

    def _next(self, waiting: deque[int], under_way: int) -> list[int] | None:
        """Rows to begin now; None if all have begun."""
        # A row under way offers one DEM run at least; more rows than that only take memory.
        at_once = max(LEAST_ROWS_AT_ONCE, ROWS_FOR_A_SLOT * self.queue.executor.slots)
        room = min(at_once - under_way, len(waiting))
        return [waiting.popleft() for _ in range(room)] if waiting else None

    def _claimed(self, claims: Claims, under_way: int) -> Sequence[int] | None:
        """Rows that this element takes now, for a slot that is free; None if nothing is left for it."""
        claims.require()
        if self.queue.late:
            return None
        used = self.queue.usage
        is_full = max(under_way, used.running + used.waiting) >= self.queue.executor.slots
        rows = () if is_full else claims.next()
        if rows:
            group = self.tasks[rows[0]].sampled_as
            self._begin(rows, [row for row, task in self.tasks.items() if task.sampled_as == group])
        return rows

    def _look(self, waiting_for_runs: bool) -> None:
        """End the campaign if it must end, and use slots that have been added."""
        if self.stop.is_set():
            raise Stopped("interrupted")
        self.store.lock.require()
        if self.queue.deadline is not None and time.monotonic() > self.queue.deadline:
            raise OutOfTime("the time limit was reached before all DEM runs under way had ended")
        self.queue.hand_out()
        if waiting_for_runs:
            self.stop.wait(LOOK_SECONDS)

    # ---- one row ------------------------------------------------------------

    def _calibrate(self, row: int) -> None:
        evaluations: list[Evaluation] = []
        task, tests = self.tasks[row], self.tests[: self.tasks[row].tests]
        cheap = self.cheap or tests

        def evaluate(requests: Sequence[Request]) -> list[Evaluation]:
            rank = self._rows.index(row)
            asked = [
                self.answers.ask(request, test, rank)
                for request in requests
                for test in (cheap if request.phase is Phase.CHEAP else tests)
            ]
            for ended in wait(asked, return_when=FIRST_EXCEPTION).done:
                ended.result()  # an error ends the row now, not when the runs before it have ended
            answered = [future.result() for future in asked]
            evaluations.extend(answered)
            with self._guard:
                expensive, cheap_ones = self._batches[row]
                del (cheap_ones if requests[0].phase is Phase.CHEAP else expensive)[:1]
                if not expensive:
                    expensive.append(1)
                self._expect(
                    row,
                    max(self.expected_runs(row), len(evaluations) + self._next_runs(row, len(evaluations))),
                )
            groups = [answered[k : k + len(tests)] for k in range(0, len(answered), len(tests))]
            return [Evaluation.joined(parts) for parts in groups]

        def warn(message: str) -> None:
            log.warning("row %d: %s", row, message)
            if self.warn is not None:
                self.warn(f"WARNING row {row}: {message}")

        try:
            found: Calibration | None = calibrate(task, evaluate, self.announce, warn)
            reason = ""
        except (NumericsError, LinAlgError) as error:
            found, reason = None, str(error)
        line = result_line(task, found, reason, evaluations)
        best = [] if found is None else self._parts(found.dem_evaluation.request, evaluations)
        self.store.finish(row, line, evaluations, best)
        self.answers.forget(row)
        with self._guard:
            self.progress.rows_done += 1
            self.progress.rows_failed += found is None
            self._expect(row, len(evaluations))
            del self._batches[row]
            told = self._row_in_words(row, found, reason)
            self.progress.rows_told.append(told)
            if found is None:
                self._failed.append(row)
        log.info("%s", told)

    def _parts(self, request: Request, evaluations: Sequence[Evaluation]) -> list[tuple[Evaluation, float]]:
        """Evaluations of a request, one for each model, with the diameter of its beads in m."""
        parts = [e for e in evaluations if e.request == request]
        # A row may do without the last tests.
        return [(e, test.engine.particle_diameter) for e, test in zip(parts, self.tests, strict=False)]

    def _row_in_words(self, row: int, found: Calibration | None, reason: str) -> str:
        if found is None:
            return f"row {row} failed: {reason}"
        task, units = self.tasks[row], self.store.settings.quantities.targeted
        values = ", ".join(f"{found.dem.responses[n]:.4g} {units[n]}" for n in task.cost.responses)
        runs = len(self.tests[: task.tests]) * sum(found.runs.values())
        alone = f"; {task.cheap.given_up}: {found.alone}" if task.cheap and found.alone else ""
        return f"row {row}: {values} after {runs} DEM runs{alone}"

    def _reused(self) -> None:
        """A request was answered without a new run."""
        with self._guard:
            self.progress.runs_reused += 1

    def _ended(self, evaluation: Evaluation) -> None:
        """A new run has ended and is on disk."""
        request, run = evaluation.request, evaluation.run
        with self._guard:
            self.progress.runs_done += 1
            self.progress.weight_done += self._weight(request.row, request.phase)
            self.progress.runs_failed += not self.tasks[request.row].usable(run)
        log.log(
            logging.INFO if run.usable else logging.WARNING,
            "row %d %s %d: DEM run %s %s in %.1f s on %s%s",
            request.row,
            request.phase,
            request.index,
            evaluation.run_id,
            run.outcome,
            run.wall_time,
            run.host,
            f": {run.reason}" if run.reason else "",
        )
