"""DEM runs on a Dask cluster: the executor, and the engine with the program of each worker's machine."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass
from functools import cache, partial
from ipaddress import ip_address
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from calstudy import __version__
from calstudy.disk import ours
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import ModelT
from calstudy.engines.program import Profile, Program
from calstudy.engines.queue import Job, run_job
from calstudy.errors import CalstudyError, SetupError, Stopped
from calstudy.records import Run

ANSWER_SECONDS = 20.0
"""Time in s for the scheduler or a worker to answer."""
LOOK_SECONDS = 2.0
TELL_SECONDS = 60.0
"""Time in s between two messages that there is no worker."""
WAIT_SECONDS = 86_400.0
"""Time in s without any worker after which the work is given up."""
log = logging.getLogger(__name__)

found_here = cache(Profile.find)


class WorkersEngine(ProgramEngine[ModelT]):
    """Runs a model with the program of the machine that a run takes place on.

    Only the version of ``program`` is known; ``command`` is how each machine calls it.
    """

    def __init__(self, model: ModelT, program: Program, command: str | None, prefix: str = "") -> None:
        super().__init__(model, program, prefix)
        self.command, self.calstudy = command, __version__

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Run this machine's program. SetupError: the program or calstudy is another version here."""
        if self.calstudy != __version__:
            raise SetupError(f"calstudy is {__version__}, elsewhere {self.calstudy}; use one version")
        program = found_here(self.program.profile, self.command)
        if program.version != self.program.version:
            name = program.profile.name
            raise SetupError(
                f"{name} is {program.version}, elsewhere {self.program.version}; use one version"
            )
        return ProgramEngine(self.model, program, self.prefix).run(parameters, seed, directory, stop)


@dataclass(frozen=True, slots=True)
class Equipment:
    """Versions that a worker has."""

    calstudy: str
    version: str
    """Version of the program."""
    missing: str
    """Why the program was not found; empty if it was."""


def equipment(profile: Profile, command: str | None) -> Equipment:
    """Versions on this machine. It runs on each worker."""
    try:
        return Equipment(__version__, profile.find(command).version, "")
    except SetupError as error:
        return Equipment(__version__, "", str(error))


class Released(threading.Event):
    """Set once a task is no longer wanted: it was cancelled, or its session has ended."""

    def __init__(self) -> None:
        super().__init__()
        from distributed import get_worker

        worker = get_worker()
        self._tasks, self._key = worker.state.tasks, worker.get_current_task()

    def is_set(self) -> bool:
        """Whether the task is no longer wanted."""
        task = self._tasks.get(self._key)
        return task is None or task.state != "executing"

    def wait(self, timeout: float | None = None) -> bool:
        """Sleep: a worker gives no signal when it releases a task."""
        time.sleep(LOOK_SECONDS if timeout is None else timeout)
        return self.is_set()


def run_there(job: Job) -> Run:
    """Run a job on this worker. SetupError names the machine."""
    try:
        return run_job(job, Released())
    except SetupError as error:
        raise SetupError(f"worker on {os.uname().nodename}: {error}") from error


class DaskExecutor:
    """Runs jobs on the workers of an existing cluster, one for each of their threads."""

    def __init__(self, address: str, slots: int | None = None, wait: float = WAIT_SECONDS) -> None:
        """``wait``: seconds without any worker after which no run is taken any more."""
        try:
            from distributed import Client
        except ImportError as error:
            raise SetupError(
                "--scheduler needs Dask; install it with: pip install 'calstudy[cluster]'"
            ) from error
        try:
            self._client = Client(address, timeout=ANSWER_SECONDS, set_as_default=False, name="calstudy")
        except (OSError, ValueError, TypeError) as error:
            raise SetupError(
                f"no Dask scheduler answers at {address}; check --scheduler, and that it runs"
            ) from error
        if _is_public(address):
            log.warning(
                "%s is not encrypted, and who can reach it can run programs there; use tls://", address
            )
        self.address, self._slots, self._wait = address, slots or 0, wait
        self._alone_since = time.monotonic()
        """When there was a worker last, or the start."""
        self._ended = threading.Event()
        self._answers: dict[Any, Future[Run]] = {}
        self._is_given = slots is not None
        self._count_slots()
        threading.Thread(target=self._watch_slots, name="slots", daemon=True).start()

    @property
    def slots(self) -> int:
        """Number of runs at once; 1 if the next job is to be refused, for want of a scheduler or workers."""
        return max(self._slots, int(self._is_gone or self._waited_enough))

    @property
    def _waited_enough(self) -> bool:
        return time.monotonic() - self._alone_since > self._wait

    @property
    def _is_gone(self) -> bool:
        """Whether the scheduler was lost: the client has given up by itself."""
        return self._client.status == "closed" and not self._ended.is_set()

    def _require_scheduler(self) -> None:
        """Raise SetupError if the scheduler is gone."""
        if self._is_gone:
            raise SetupError(
                f"the Dask scheduler at {self.address} is gone; start one, then the same command goes on"
            )

    def _require_workers(self) -> None:
        """Raise SetupError if there has been no worker for as long as the user would wait."""
        if self._waited_enough:
            raise self._given_up()

    def _given_up(self) -> SetupError:
        return SetupError(f"{self._alone()}; start workers, then the same command goes on")

    def _alone(self) -> str:
        """Since when there is no worker, and where to look."""
        seconds = time.monotonic() - self._alone_since
        gone = 0
        with contextlib.suppress(Exception):  # what the scheduler remembers of workers that came and went
            events = self._client.get_events("all")
            gone = sum(event.get("action") == "remove-worker" for _, event in events)
        left = f", {gone} worker(s) came and went" if gone else ""
        return (
            f"no worker at {self.address} for {seconds / 60:.0f} min{left}; if workers end at once, the logs "
            "of their jobs say why (squeue, slurm-*.out)"
        )

    def program(self, profile: Profile, command: str | None, stop: threading.Event) -> Program:
        """The workers' program, of which only the version is known. Waits for the first worker.

        SetupError: a worker lacks it, or versions differ. Stopped: ``stop`` was set while it waited.
        """
        told = time.monotonic()
        while not self._threads():
            self._require_scheduler()
            self._require_workers()
            if time.monotonic() - told > TELL_SECONDS:
                log.warning("waiting: %s", self._alone())
                told = time.monotonic()
            if stop.wait(LOOK_SECONDS):
                raise Stopped("interrupted while waiting for the cluster's first worker")
        remedy = "install it on every worker, or start workers elsewhere"
        found = self._client.run(equipment, profile, command, on_error="return")
        for worker, has in found.items():
            if isinstance(has, Exception):
                raise SetupError(f"worker {worker} cannot use calstudy ({_first_line(has)}); {remedy}")
            if has.missing:
                raise SetupError(f"worker {worker}: {has.missing}")
            if has.calstudy != __version__:
                raise SetupError(
                    f"worker {worker} has calstudy {has.calstudy}, this is {__version__}; {remedy}"
                )
        versions = {has.version: worker for worker, has in found.items()}
        if len(versions) > 1:
            said = ", ".join(f"{version} on {worker}" for version, worker in versions.items())
            raise SetupError(f"workers have different versions of {profile.name}: {said}; use one version")
        return Program(profile, (), str(next(iter(versions))))

    def submit(self, job: Job) -> Future[Run]:
        """Run a job on a worker. If the worker is lost during the run, Dask gives the job to another."""
        self._require_scheduler()
        self._require_workers()
        answer: Future[Run] = Future()
        # Not pure: a job that is requested again is meant to be run again.
        there = self._client.submit(run_there, job, pure=False)
        self._answers[there] = answer
        there.add_done_callback(partial(self._settle, job.run_id))
        return answer

    def _settle(self, run_id: str, there: Any) -> None:
        """Answer the caller of a job that has ended on the cluster."""
        answer = self._answers.pop(there, None)
        if answer is None:
            return
        try:
            answer.set_result(there.result())
        except CalstudyError as error:
            answer.set_exception(error)
        except (Exception, CancelledError) as error:
            lost = SetupError(
                f"DEM run {run_id} was lost on the cluster at {self.address} ({_first_line(error)}); "
                "see the logs of its scheduler and workers; the same command goes on"
            )
            lost.__cause__ = error
            answer.set_exception(lost)

    def remove_leftovers(self, scratch: Path, sessions: set[str]) -> None:
        """Remove the run directories that ended sessions left, here and on the present workers."""
        ours.sweep(scratch, sessions)
        with contextlib.suppress(Exception):  # leftovers take room, but do no other harm
            self._client.run(ours.sweep, scratch, sessions, on_error="ignore")

    def _threads(self) -> int | None:
        """Number of threads of all workers; None while the scheduler does not answer."""
        # A client that is losing its scheduler raises errors of many kinds.
        with contextlib.suppress(Exception):
            return sum(self._client.nthreads().values())
        return None

    def _count_slots(self) -> None:
        there = self._threads()
        if there:
            self._alone_since = time.monotonic()
        if there is not None and not self._is_given:
            self._slots = there

    def _watch_slots(self) -> None:
        while not self._ended.wait(LOOK_SECONDS):
            self._count_slots()
            for there in list(self._answers) if self._waited_enough else ():
                if answer := self._answers.pop(there, None):
                    answer.set_exception(self._given_up())

    def close(self) -> None:
        """Give up all jobs. The workers notice, and end their programs."""
        if self._ended.is_set():
            return
        self._ended.set()
        answers, self._answers = self._answers, {}
        with contextlib.suppress(Exception):  # a client that lost its scheduler can neither cancel nor close
            self._client.cancel(list(answers))
        for answer in answers.values():
            answer.set_exception(Stopped("interrupted"))
        with contextlib.suppress(Exception):
            self._client.close()


def _is_public(address: str) -> bool:
    """Whether an address leads over networks that anybody may use, without encryption."""
    there = urlsplit(address if "://" in address else f"tcp://{address}")
    if there.scheme != "tcp":
        return False
    with contextlib.suppress(OSError, ValueError):
        found = socket.getaddrinfo(there.hostname, None)
        return any(ip_address(str(at[0]).partition("%")[0]).is_global for *_, at in found)
    return False


def _first_line(error: BaseException) -> str:
    """Kind of an error with the first line of its message."""
    text = str(error).strip()
    return f"{type(error).__name__}: {text.splitlines()[0][:200]}" if text else type(error).__name__
