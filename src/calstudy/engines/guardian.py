"""Ends the programs that a killed calstudy leaves running: nothing in the killed process can do that.

The guardian is a small process of its own. It sleeps on a pipe that closes when its parent ends, however
that ends, and then ends every process whose environment carries the parent's mark. So neither a program's
own process groups nor wrappers (a shell, a container's starter) hide anything from it, and processes of
others cannot be hit.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from functools import cache
from pathlib import Path

VARIABLE = "CALSTUDY_PARENT"
QUIET_LOOKS = 3
LOOK_SECONDS = 0.05
GIVE_UP_SECONDS = 60.0
_STARTING = threading.Lock()


def mark() -> dict[str, str]:
    """Environment for a program that must not outlive this process; the first call starts the guardian."""
    with _STARTING:
        return {VARIABLE: _guarded(os.getpid())}


@cache
def _guarded(process: int) -> str:
    """Mark of a process, by its id because a fork has its parent's cache."""
    name = f"{process}-{uuid.uuid4().hex}"
    read, _ = os.pipe()  # the other end stays open for as long as this process lives
    devnull = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    os.posix_spawn(
        sys.executable,
        [sys.executable, "-S", "-E", str(Path(__file__).absolute()), name],
        {k: v for k, v in os.environ.items() if k != VARIABLE},
        file_actions=[(os.POSIX_SPAWN_DUP2, read, 0), *devnull],
        setsid=True,
    )
    os.close(read)
    return name


def marked(name: str) -> Iterator[int]:
    """Processes that run with a mark in their environment."""
    wanted = f"{VARIABLE}={name}".encode()
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # it has ended meanwhile, or is somebody else's
            if wanted in environment.read_bytes().split(b"\0"):
                yield int(environment.parent.name)


def watch(name: str) -> None:
    """Wait for standard input to close, then end all marked processes until none is seen any more."""
    sys.stdin.buffer.read()
    quiet, end = 0, time.monotonic() + GIVE_UP_SECONDS
    while quiet < QUIET_LOOKS and time.monotonic() < end:
        found = list(marked(name))
        for process in found:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        quiet = 0 if found else quiet + 1
        time.sleep(LOOK_SECONDS)


if __name__ == "__main__":
    watch(sys.argv[1])
