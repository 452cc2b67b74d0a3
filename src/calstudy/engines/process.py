"""Run an external program: its own process group, files to read, a time limit, and no orphan left."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calstudy.engines import guardian
from calstudy.errors import RunError, SetupError

POLL_SECONDS = 0.05
"""Looking more often would cost more processor time than the end that is seen earlier saves."""
LONGEST_LOOK = 10 * POLL_SECONDS
"""Time between two looks counts up to this: more means that the machine, or we with the program, slept."""
SINGLE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


NOT_THERE = (FileNotFoundError, IsADirectoryError, NotADirectoryError, PermissionError)
"""What a program that did not do its work leaves where its output should be."""
OUTSIDE = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM, signal.SIGKILL)


@dataclass(frozen=True, slots=True)
class Finished:
    """How a process ended; times in s, CPU time as accounted by the operating system."""

    exit_code: int
    """As the shell counts: negative signal number where a signal ended the process."""
    timed_out: bool
    stopped: bool
    """Ended because ``stop`` was set."""
    wall_time: float
    cpu_time: float

    @property
    def ended_from_outside(self) -> bool:
        """Whether somebody else ended it: by a signal, which a wrapper gives as 128 plus its number."""
        signals = {code for number in OUTSIDE for code in (-number, 128 + number)}
        return self.exit_code in signals and not (self.timed_out or self.stopped)


def output_text(path: Path, errors: str = "replace") -> str:
    """Text of a file that a program should have left; ``errors`` as open takes it.

    RunError where the file is not there (or, "strict", no text), SetupError where the machine cannot read it.
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

    Should this very process be killed, the guardian ends the program. Raises SetupError with the remedy
    when the program cannot be started.
    """
    start = looked = time.monotonic()
    had = 0.0
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
    try:
        timed_out = stopped = False
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            had += min(time.monotonic() - looked, LONGEST_LOOK)
            looked = time.monotonic()
            timed_out = had > time_limit
            stopped = stop.is_set()
            if timed_out or stopped:
                _end_group(process.pid)
                _, status, usage = os.wait4(process.pid, 0)
                break
            stop.wait(POLL_SECONDS)
    except BaseException:
        _end_group(process.pid)
        process.wait()
        raise
    process.returncode = os.waitstatus_to_exitcode(status)
    _end_group(process.pid)
    return Finished(
        exit_code=process.returncode,
        timed_out=timed_out,
        stopped=stopped,
        wall_time=time.monotonic() - start,
        cpu_time=usage.ru_utime + usage.ru_stime,
    )


def _end_group(leader: int) -> None:
    """End whatever still runs in the group that we started; it may be gone already."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)
