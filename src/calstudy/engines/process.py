"""Run an external program in its own process group, with a time limit, and leave no orphan."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calstudy import machine
from calstudy.engines import guardian
from calstudy.errors import RunError, SetupError

POLL_SECONDS = 0.05
"""Polling more often would cost more processor time than it saves."""
LONGEST_LOOK = 10 * POLL_SECONDS
"""Time between two looks counts up to this. If it is longer, the machine, or this process, was asleep."""
SINGLE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


NOT_THERE = (FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError)
"""Errors on opening the output of a program that did not write it."""
OUTSIDE = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


@dataclass(frozen=True, slots=True)
class Finished:
    """How a process ended. Times in s; the CPU time is the operating system's account."""

    exit_code: int
    """Negative signal number if a signal ended the process."""
    timed_out: bool
    stopped: bool
    """Ended because ``stop`` was set."""
    wall_time: float
    cpu_time: float

    @property
    def ended_from_outside(self) -> bool:
        """Whether something else ended it by a signal. A wrapper returns 128 plus the signal's number."""
        signals = {code for number in OUTSIDE for code in (-number, 128 + number)}
        return self.exit_code in signals and not (self.timed_out or self.stopped)


def output_text(path: Path, errors: str = "replace") -> str:
    """Text of a file that a program should have written; ``errors`` as in `open`.

    RunError: the file is not there, or with "strict" is not text. SetupError: the machine cannot read it.
    """
    try:
        return path.read_text(errors=errors)
    except (*NOT_THERE, UnicodeDecodeError) as error:
        raise RunError(f"{path.name} cannot be read ({type(error).__name__})") from error
    except OSError as error:
        reason = error.strerror or str(error)
        raise SetupError(
            f"{path}: cannot be read: {reason}; see to it, then the same command goes on"
        ) from error


def run_process(
    argv: Sequence[str],
    *,
    directory: Path,
    output: Path,
    time_limit: float,
    stop: threading.Event,
    environment: Mapping[str, str] | None = None,
    remedy: str = "run 'calstudy doctor'",
) -> Finished:
    """Run ``argv`` in ``directory`` with its output in a file, until it ends, is stopped, or takes too long.

    Time that it waits for a core does not count towards ``time_limit`` (s).
    If this process is killed, the guardian ends the program. SetupError, with the remedy: the program
    cannot be started.
    """
    start = looked = time.monotonic()
    had = waited = 0.0
    try:
        with output.open("wb") as sink:
            process = subprocess.Popen(
                list(argv),
                cwd=directory,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | SINGLE_THREAD | guardian.mark() | dict(environment or {}),
            )
    except OSError as error:
        reason = error.strerror or str(error)
        raise SetupError(f"cannot start {argv[0]}: {reason}; {remedy}") from error
    guardian.tell(machine.BEGUN, process.pid)
    try:
        timed_out = stopped = False
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            had += min(time.monotonic() - looked, LONGEST_LOOK)
            looked = time.monotonic()
            if had > time_limit:  # a process that ends takes its account with it
                waited = max(waited, machine.waited(process.pid))
                timed_out = had - waited > time_limit
            stopped = stop.is_set()
            if timed_out or stopped:
                machine.end_group(process.pid)
                _, status, usage = os.wait4(process.pid, 0)
                break
            stop.wait(POLL_SECONDS)
    except BaseException:
        machine.end_group(process.pid)
        process.wait()
        guardian.tell(machine.ENDED, process.pid)
        raise
    process.returncode = os.waitstatus_to_exitcode(status)
    machine.end_group(process.pid)
    guardian.tell(machine.ENDED, process.pid)
    return Finished(
        exit_code=process.returncode,
        timed_out=timed_out,
        stopped=stopped,
        wall_time=time.monotonic() - start,
        cpu_time=usage.ru_utime + usage.ru_stime,
    )
