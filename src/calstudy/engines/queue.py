"""The queue of DEM runs, and its executor on this machine. ``cluster`` has the one for Dask."""

from __future__ import annotations

import heapq
import itertools
import os
import threading
import time
import uuid
from bisect import bisect_right
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Protocol

from calstudy.disk import ours
from calstudy.engines.interface import Engine
from calstudy.errors import OutOfTime, Stopped
from calstudy.records import Outcome, Run

MARGIN = 1.2
"""A run may take this factor longer than the longest so far."""


@dataclass(frozen=True, slots=True)
class Job:
    """One DEM run, with everything that is needed to run it."""

    engine: Engine
    parameters: Mapping[str, float]
    seed: int
    run_id: str
    scratch: Path
    session: str
    """Token of the session that requests it. A later session finds a killed one's leftovers by it."""
    keep: bool = False
    """Whether to keep the run's directory even if it succeeded."""


def run_job(job: Job, stop: threading.Event) -> Run:
    """Run a job in its own directory. Stopped: ``stop`` was set. SetupError: the machine is at fault."""
    if stop.is_set():
        raise Stopped("interrupted")
    # A new name: a killed session or a lost machine may still be writing into its directory.
    scratch = ours.scratch_of_ours(job.scratch, job.session)
    directory = scratch / f"{job.run_id}.{job.session}.{uuid.uuid4().hex[:8]}"
    try:
        run = job.engine.run(job.parameters, job.seed, directory, stop)
    except BaseException:
        ours.discard(directory)
        raise
    if run.usable and not job.keep:
        ours.discard(directory)
    else:
        ours.keep(directory, job.run_id)
    if run.finished_at:  # it was run before, and read anew
        return run
    finished_at = datetime.now(UTC).isoformat(timespec="seconds")
    return replace(run, host=os.uname().nodename, finished_at=finished_at)


class Executor(Protocol):
    """Where DEM runs are run."""

    @property
    def slots(self) -> int:
        """Number of runs at once. It may change while the executor is open."""

    def submit(self, job: Job) -> Future[Run]:
        """Run a job as soon as a slot is free. SetupError: there will never be one."""

    def remove_leftovers(self, scratch: Path, sessions: set[str]) -> None:
        """Remove the run directories that ended sessions left, on every machine that runs DEM runs."""

    def close(self) -> None:
        """End the runs that are under way."""


class LocalExecutor:
    """Threads of this process, each waiting for one DEM program until it ends or ``stop`` is set."""

    def __init__(self, slots: int, stop: threading.Event) -> None:
        self.slots, self._stop = slots, stop
        self._threads = ThreadPoolExecutor(slots, thread_name_prefix="dem")

    def submit(self, job: Job) -> Future[Run]:
        """Run a job as soon as a thread is free."""
        return self._threads.submit(run_job, job, self._stop)

    def remove_leftovers(self, scratch: Path, sessions: set[str]) -> None:
        """Remove the run directories that ended sessions left on this machine."""
        ours.sweep(scratch, sessions)

    def close(self) -> None:
        """End the runs that are under way, and wait until they have ended."""
        self._stop.set()
        self._threads.shutdown()


@dataclass(frozen=True, slots=True)
class Usage:
    """How the slots of a queue were used. Times in s."""

    running: int
    waiting: int
    dem_seconds: float
    dem_cpu_seconds: float
    busy_seconds: float
    """Part of dem_seconds during which another run was waiting."""
    offered_seconds: float
    """Slots times the seconds during which a run was waiting."""


def _too_late(longest: float) -> str:
    """Why a run is refused, from the longest run so far in s."""
    return f"not enough time is left for another DEM run, which may take {MARGIN * longest:.0f} s"


class Queue:
    """DEM runs that wait for a slot. The lowest rank goes first; equal ranks go in the order of request.

    Nothing is handed out after ``stop`` is set, and no run that might end after ``deadline``, a time of
    time.monotonic.
    """

    def __init__(
        self,
        executor: Executor,
        expected_seconds: float,
        stop: threading.Event,
        deadline: float | None = None,
    ) -> None:
        self.executor, self.stop, self.deadline = executor, stop, deadline
        self.longest = expected_seconds
        """Seconds of the longest run so far."""
        self.late = False
        """Whether runs were refused because too little time was left."""
        self._refusal: BaseException | None = None
        """Why no run is handed out any more."""
        self._guard = threading.Lock()
        self._waiting: list[tuple[int, int, Job, Future[Run]]] = []
        """Priority queue of rank, number, job and answer."""
        self._numbers = itertools.count()
        self._running: dict[Future[Run], float] = {}
        self._dem = self._cpu = self._busy = self._offered = 0.0
        # Seconds during which a run waited, as a function of time: by turns constant and rising.
        self._turns: list[tuple[float, float]] = [(time.monotonic(), 0.0)]
        self._looked = time.monotonic()

    def submit(self, job: Job, rank: int = 0) -> Future[Run]:
        """Future of a job's run. It fails with OutOfTime or Stopped if the job comes too late."""
        answer: Future[Run] = Future()
        with self._guard:
            self._note()
            heapq.heappush(self._waiting, (rank, next(self._numbers), job, answer))
        self.hand_out()
        return answer

    def refuse(self, reason: BaseException) -> None:
        """Begin no further run: it would be lost as one was. Those that wait fail with the same reason."""
        self._refusal = reason

    def hand_out(self) -> None:
        """Fill free slots. Call it now and then, because slots may be added and time runs out."""
        refused: list[tuple[Future[Run], BaseException]] = []
        begun: list[tuple[Future[Run], Future[Run]]] = []
        with self._guard:
            self._note()
            longest = self.longest
            is_late = self.deadline is not None and time.monotonic() + MARGIN * longest > self.deadline
            self.late |= is_late and bool(self._waiting)
            why = self._refusal
            if why is None and (is_late or self.stop.is_set()):
                why = OutOfTime(_too_late(longest)) if is_late else Stopped("interrupted")
            if why is not None:
                refused = [(answer, why) for *_, answer in self._waiting]
                self._waiting.clear()
            slots = self.executor.slots
            while self._waiting and len(self._running) < slots:
                *_, job, answer = heapq.heappop(self._waiting)
                try:
                    run = self.executor.submit(job)
                except Exception as error:
                    refused.append((answer, error))  # the caller that waits must learn of it
                    continue
                self._running[run] = time.monotonic()
                begun.append((run, answer))
            self._note()
        # Answers are set outside the guard: what a waiting caller does next may need other guards.
        for run, answer in begun:
            run.add_done_callback(partial(self._ended, answer))
        for answer, reason in refused:
            answer.set_exception(reason)

    def took(self, run: Run) -> None:
        """Note how long a run took. One that timed out says nothing about the others."""
        if run.outcome is not Outcome.TIMED_OUT:
            self.longest = max(self.longest, run.wall_time)

    def _ended(self, answer: Future[Run], ended: Future[Run]) -> None:
        """Account for a run that ended, and answer its caller."""
        error = Stopped("interrupted") if ended.cancelled() else ended.exception()
        run = None if error else ended.result()
        with self._guard:
            self._note()
            if run is not None:
                now = time.monotonic()
                self.took(run)
                self._dem += run.wall_time
                self._cpu += run.cpu_time
                self._busy += self._waited(now) - self._waited(now - run.wall_time)
        # The caller stores the answer before the slot counts as free. So an idle queue has nothing pending.
        if error:
            answer.set_exception(error)
        elif run is not None:
            answer.set_result(run)
        with self._guard:
            del self._running[ended]
        self.hand_out()

    @property
    def seconds_left(self) -> float | None:
        """Seconds until the deadline; None if there is none."""
        return None if self.deadline is None else self.deadline - time.monotonic()

    def close(self) -> None:
        """Drop all waiting runs, and end those under way."""
        self.stop.set()
        self.hand_out()
        self.executor.close()

    @property
    def idle(self) -> bool:
        """Whether no run is under way and all answers have been handled."""
        with self._guard:
            return not self._running

    @property
    def usage(self) -> Usage:
        """How the slots have been used so far. Runs under way count up to now."""
        with self._guard:
            self._note()
            now = time.monotonic()
            under_way = sum(self._waited(now) - self._waited(since) for since in self._running.values())
            return Usage(
                running=len(self._running),
                waiting=len(self._waiting),
                dem_seconds=self._dem,
                dem_cpu_seconds=self._cpu,
                busy_seconds=self._busy + under_way,
                offered_seconds=self._offered,
            )

    def _note(self) -> None:
        """Account for the time since the last call, during which nothing has changed."""
        now = time.monotonic()
        waited = now - self._looked if self._waiting else 0.0
        self._offered += self.executor.slots * waited
        if len(self._turns) > 1 and (self._turns[-1][1] > self._turns[-2][1]) == (waited > 0):
            last = self._turns.pop()
        else:
            last = self._turns[-1]
        self._turns.append((now, last[1] + waited))
        self._looked = now

    def _waited(self, when: float) -> float:
        """Seconds up to ``when`` during which a run was waiting."""
        place = bisect_right(self._turns, when, key=lambda turn: turn[0])
        if place == 0:
            return 0.0
        since, waited = self._turns[place - 1]
        if place == len(self._turns):
            return waited
        until, then = self._turns[place]
        return waited + (then - waited) * (when - since) / (until - since)


def cores() -> int:
    """Number of cores that this process may use: its affinity, and the quota of a container."""
    from joblib import cpu_count

    return int(cpu_count())
