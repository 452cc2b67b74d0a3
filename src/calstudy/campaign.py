"""Many calibrations at once: every row has its own thread, and all share one pool of DEM runs."""

from __future__ import annotations

import math
import os
import shutil
import threading
import time
from collections.abc import Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    FIRST_EXCEPTION,
    CancelledError,
    Future,
    ThreadPoolExecutor,
    wait,
)
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.linalg import LinAlgError
from threadpoolctl import threadpool_limits

from calstudy.calibration import Calibration, Task, calibrate
from calstudy.cost import Cost
from calstudy.engine import Engine, Stopped
from calstudy.errors import NumericsError
from calstudy.journal import Stored
from calstudy.modes import Mode, Refinement
from calstudy.plan import PARAMETERS, Plan
from calstudy.records import MEASURED, OPTIMISATION, RESPONSES, Evaluation, Phase, Request, Run, Target
from calstudy.store import Store


@dataclass
class Progress:
    """What a campaign has done so far; read by whoever displays it."""

    rows: int
    workers: int
    expected_runs: float
    rows_done: int = 0
    rows_failed: int = 0
    runs_done: int = 0
    runs_reused: int = 0
    """Runs found on disk, or asked for by two rows."""
    runs_failed: int = 0
    running: int = 0
    run_seconds: float = 0.0
    started: float = field(default_factory=time.monotonic)
    last_row: str = ""

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.started

    def seconds_left(self, expected_seconds: float) -> float:
        """Estimate from the runs so far; before the first has ended, from what a run usually takes."""
        mean = self.run_seconds / self.runs_done if self.runs_done else expected_seconds
        left = max(self.expected_runs - self.runs_done - self.runs_reused, self.running)
        return mean * left / self.workers


@dataclass(frozen=True, slots=True)
class Summary:
    """How a campaign ended."""

    finished: tuple[int, ...]
    """Rows finished by this campaign or before."""
    failed: tuple[int, ...]


class Campaign:
    """Runs rows of a plan into a store that is open."""

    def __init__(
        self,
        plan: Plan,
        target: Target,
        mode: Mode,
        engine: Engine,
        store: Store,
        *,
        workers: int,
        scratch: Path,
        keep_runs: bool = False,
        stop: threading.Event | None = None,
    ) -> None:
        self.plan, self.target, self.mode = plan, target, mode
        self.engine, self.store = engine, store
        self.workers, self.scratch, self.keep_runs = workers, scratch, keep_runs
        self.stop = stop or threading.Event()
        self.progress = Progress(rows=0, workers=workers, expected_runs=0)
        self._failed: list[int] = []
        self._expected: dict[int, float] = {}
        self._guard = threading.Lock()
        self._known: dict[str, Future[Run]] = {}
        self._stored: dict[tuple[int, Phase, int], Stored] = {}

    def run(self, rows: Sequence[int]) -> Summary:
        """Calibrate the rows that are not finished yet; raises Stopped when ``stop`` is set meanwhile.

        A row whose calibration fails is stored as failed and the others go on. An error of the machine
        (SetupError) or of the study (StoreError) ends the campaign; what is finished is kept.
        """
        self._sweep()
        done = self.store.finished_rows()
        waiting = [row for row in rows if row not in done]
        for row in waiting:
            for stored in self.store.journal(row):
                self._remember(stored)
        self.progress = Progress(rows=len(waiting), workers=self.workers, expected_runs=0)
        for row in waiting:
            self._expect(row, self.expected_runs(row))
        with threadpool_limits(1):
            self._run_rows(waiting)
        return Summary(
            finished=tuple(row for row in rows if row in self.store.finished_rows()),
            failed=tuple(sorted(self._failed)),
        )

    def _sweep(self) -> None:
        """Remove what the runs of sessions that are no more left in the study's own scratch.

        In a scratch elsewhere another machine may be at work, whose processes cannot be seen from here.
        """
        if self.store.directory not in self.scratch.parents:
            return
        for directory in self.scratch.glob("*.*"):
            pid = directory.suffix.removeprefix(".")
            if pid.isdecimal() and not Path(f"/proc/{pid}").exists():
                shutil.rmtree(directory, ignore_errors=True)

    def expected_runs(self, row: int) -> float:
        """DEM runs that a row is expected to need: Eq. 11, and a guess for the second optimisation."""
        return self.plan.row(row).samples + expected_optimisation_runs(self.plan, row, self.mode)

    def _expect(self, row: int, runs: float) -> None:
        """Set what a row is expected to need in all."""
        self.progress.expected_runs += runs - self._expected.get(row, 0.0)
        self._expected[row] = runs

    def _next_runs(self, row: int, asked: int) -> float:
        """Guess how many runs a row that is not finished still needs: one more iteration, in the budget."""
        second = self.mode.second_optimisation
        iteration = 1 if isinstance(second, Refinement) else 2 * len(self.plan.row(row).calibrated) + 2
        limit = math.inf if second.budget is None else second.budget
        return min(iteration, max(self.plan.row(row).samples + limit - asked, 0))

    def _run_rows(self, rows: Sequence[int]) -> None:
        if not rows:
            return
        self._pool = ThreadPoolExecutor(self.workers, thread_name_prefix="dem")
        threads = ThreadPoolExecutor(len(rows), thread_name_prefix="row")
        try:
            pending = {threads.submit(self._calibrate, row) for row in rows}
            while pending:
                ended, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in ended:
                    future.result()
                if self.stop.is_set():
                    raise Stopped("interrupted")
        except BaseException:
            # After an error or an interruption: no new run starts, running ones end, rows give up.
            self.stop.set()
            raise
        finally:
            self._pool.shutdown(cancel_futures=True)
            threads.shutdown(cancel_futures=True)

    # ---- one row ------------------------------------------------------------

    def task(self, row: int) -> Task:
        """What a row calibrates."""
        plan_row = self.plan.row(row)
        space = self.plan.space(plan_row)
        cost = Cost(
            space,
            self.target,
            plan_row.WRL,
            radius=self.plan.fixed.particle_radius,
            poissons_ratio=self.plan.fixed.poissons_ratio,
        )
        seed = self.store.settings.seed
        return Task(row, space, plan_row.samples, cost, self.mode, seed)

    def _calibrate(self, row: int) -> None:
        evaluations: list[Stored] = []

        def evaluate(requests: Sequence[Request]) -> list[Evaluation]:
            asked = [self._ask(request) for request in requests]
            for ended in wait(asked, return_when=FIRST_EXCEPTION).done:
                ended.result()  # an error ends the row now, not when the runs before it have ended
            answered = [future.result() for future in asked]
            evaluations.extend(answered)
            with self._guard:
                self._expect(
                    row,
                    max(self.expected_runs(row), len(evaluations) + self._next_runs(row, len(evaluations))),
                )
            return [stored.evaluation for stored in answered]

        try:
            found: Calibration | None = calibrate(self.task(row), evaluate)
            reason = ""
        except (NumericsError, LinAlgError) as error:
            found, reason = None, str(error)
        except CancelledError as error:
            raise Stopped("interrupted") from error
        line = self._line(row, found, reason, evaluations)
        best = found.dem_evaluation if found else None
        self.store.finish(
            row,
            line,
            evaluations,
            heap=best.run if best else None,
            run_id=best.run_id if best else "",
            particle_diameter=self.engine.particle_diameter,
        )
        with self._guard:
            self.progress.rows_done += 1
            self.progress.rows_failed += found is None
            self._expect(row, len(evaluations))
            self.progress.last_row = _in_words(row, found, reason)
            if found is None:
                self._failed.append(row)

    def _line(
        self, row: int, found: Calibration | None, reason: str, evaluations: Sequence[Stored]
    ) -> dict[str, Any]:
        """Line of the table of calibrations."""
        plan_row = self.plan.row(row)
        runs = [stored.evaluation.run for stored in evaluations]
        phases = [stored.evaluation.request.phase for stored in evaluations]
        line: dict[str, Any] = {
            "WRL": plan_row.WRL,
            "SPP": plan_row.SPP,
            **{f"calibrated_{p}": p in plan_row.calibrated for p in PARAMETERS},
            "target_kind": self.target.kind,
            "target_origin": self.target.origin,
            **{f"target_{r}": self.target.values[r] for r in MEASURED},
            "outcome": "ok" if found else "failed",
            "reason": reason,
            **{f"runs_{phase}": phases.count(phase) for phase in Phase},
            "runs_optimisation": sum(phase in OPTIMISATION for phase in phases),
            "runs_total": len(runs),
            "runs_failed": sum(not run.usable for run in runs),
            "samples_left_out": sum(
                not run.usable for run, phase in zip(runs, phases, strict=True) if phase is Phase.SAMPLING
            ),
            "wall_time": sum(run.wall_time for run in runs),
            "cpu_time": sum(run.cpu_time for run in runs),
            "host": evaluations[-1].host if evaluations else "",
            "finished_at": max((s.finished_at for s in evaluations), default=""),
        }
        if found is None:
            return line
        for name, (low, high) in found.sampled_range.items():
            line[f"sampled_{name}_min"], line[f"sampled_{name}_max"] = low, high
        for name, inside in found.reachable(self.target.values).items():
            line[f"reachable_{name}"] = inside
        for name, diagnostics in found.diagnostics.items():
            line[f"leave_one_out_rmse_{name}"] = diagnostics.leave_one_out_rmse
            line[f"kriging_noise_{name}"] = diagnostics.noise_sd
            line[f"kriging_at_bound_{name}"] = ", ".join(diagnostics.at_bound)
        for prefix, point in (("kriging_", found.kriging), ("dem_", found.dem), ("last_", found.last)):
            line |= {f"{prefix}{p}": point.parameters[p] for p in PARAMETERS}
            line |= {f"{prefix}{r}": point.responses[r] for r in RESPONSES}
        return line | {
            "kriging_sum_of_squares": found.kriging.sum_of_squares,
            "kriging_stop": str(found.kriging_stop),
            "dem_sum_of_squares": found.dem.sum_of_squares,
            "dem_stop": str(found.dem_stop),
            "dem_run_id": found.dem_evaluation.run_id,
            "iterations": found.iterations,
        }

    # ---- DEM runs ------------------------------------------------------------

    def _remember(self, stored: Stored) -> None:
        evaluation = stored.evaluation
        request = evaluation.request
        self._stored[request.row, request.phase, request.index] = stored
        known: Future[Run] = Future()
        known.set_result(evaluation.run)
        self._known.setdefault(evaluation.run_id, known)

    def _ask(self, request: Request) -> Future[Stored]:
        """Future of an answer that is durable. Equal runs are run once, whoever asks."""
        run_id = request.run_id(self.engine.model_hash, self.engine.identity)
        place = (request.row, request.phase, request.index)
        there = self._stored.get(place)
        answer: Future[Stored] = Future()
        if there is not None and there.evaluation.run_id == run_id:
            with self._guard:
                self.progress.runs_reused += 1
            answer.set_result(there)
            return answer
        with self._guard:
            known = self._known.get(run_id)
            if known is None:
                run = self._known[run_id] = self._pool.submit(self._run, request, run_id)
            else:
                run = known
                self.progress.runs_reused += 1

        def settle(done: Future[Run]) -> None:
            try:
                answer.set_result(self.store.record(Evaluation(request, run_id, done.result())))
            except BaseException as error:
                answer.set_exception(error)

        run.add_done_callback(settle)
        return answer

    def _run(self, request: Request, run_id: str) -> Run:
        if self.stop.is_set():
            raise Stopped("interrupted")
        with self._guard:
            self.progress.running += 1
        # A name of its own: a killed session's run may still be writing into the one that it left.
        directory = self.scratch / f"{run_id}.{os.getpid()}"
        try:
            run = self.engine.run(request.parameters, request.seed, directory, self.stop)
        except BaseException:
            shutil.rmtree(directory, ignore_errors=True)
            raise
        finally:
            with self._guard:
                self.progress.running -= 1
        with self._guard:
            self.progress.runs_done += 1
            self.progress.runs_failed += not run.usable
            self.progress.run_seconds += run.wall_time
        if run.usable and not self.keep_runs:
            shutil.rmtree(directory, ignore_errors=True)
        elif directory.exists():
            kept = self.scratch / run_id
            shutil.rmtree(kept, ignore_errors=True)
            directory.rename(kept)
        return run


def expected_optimisation_runs(plan: Plan, row: int, mode: Mode) -> float:
    """Guess for the second optimisation: what calibrations of glass beads took on average."""
    second = mode.second_optimisation
    d = len(plan.row(row).calibrated)
    guess = 3.0 if isinstance(second, Refinement) else 1 + 2 * (2 * d) + 7
    return min(guess, math.inf if second.budget is None else second.budget)


def _in_words(row: int, found: Calibration | None, reason: str) -> str:
    if found is None:
        return f"row {row} failed: {reason}"
    r = found.dem.responses
    angle, density = (r[name] for name in MEASURED)
    runs = sum(found.runs.values())
    return f"row {row}: {angle:.1f} deg, {density:.0f} kg/m3 after {runs} DEM runs"
