"""Ends the programs that a killed calstudy leaves running. The killed process cannot do that itself.

The guardian is a small separate process. It sleeps on a pipe that closes when its parent ends, for whatever
reason. Then it ends every process whose environment carries the parent's mark. So programs are found in
process groups of their own and behind wrappers (a shell, a container's starter), and other processes are
never hit.
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
    """Environment of a program that must not outlive this process. The first call starts the guardian."""
    with _STARTING:
        return {VARIABLE: _guarded(os.getpid())}


@cache
def _guarded(process: int) -> str:
    """Mark of a process. It is cached by process id, because a fork inherits the cache."""
    name = f"{process}-{uuid.uuid4().hex}"
    read, _ = os.pipe()  # the other end stays open as long as this process lives
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
    """Ids of the processes with a mark in their environment."""
    wanted = f"{VARIABLE}={name}".encode()
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # it has ended meanwhile, or belongs to another user
            if wanted in environment.read_bytes().split(b"\0"):
                yield int(environment.parent.name)


def watch(name: str) -> None:
    """Wait for standard input to close, then end marked processes until there are none left."""
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
