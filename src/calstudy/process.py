"""Run an external program: its own process group, output to files, a time limit, and no orphan left."""

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

from calstudy import guardian
from calstudy.errors import SetupError

POLL_SECONDS = 0.05
"""Looking more often would cost more processor time than the end that is seen earlier saves."""
SINGLE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


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


def run_process(
    argv: Sequence[str],
    *,
    directory: Path,
    output: Path,
    time_limit: float,
    stop: threading.Event,
    environment: Mapping[str, str] | None = None,
) -> Finished:
    """Run ``argv`` in ``directory`` with its output in a file, until it ends, is stopped, or takes too long.

    Should this very process be killed, the guardian ends the program. Raises SetupError when the program
    cannot be started.
    """
    start = time.monotonic()
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
        raise SetupError(
            f"cannot start {argv[0]}: {reason}; check --liggghts or run 'calstudy doctor'"
        ) from error
    try:
        timed_out = stopped = False
        while True:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            timed_out = time.monotonic() - start > time_limit
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
