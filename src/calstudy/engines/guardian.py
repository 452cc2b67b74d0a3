"""Ends the programs that a killed calstudy leaves running. The killed process cannot do that itself.

The guardian is a small separate process. It sleeps on a pipe that closes when its parent ends, for whatever
reason. Then it ends every process whose environment carries the parent's mark. So programs are found in
process groups of their own and behind wrappers (a shell, a container's starter), and other processes are
never hit. Where the system does not tell environments, it ends the process groups that it was told of.

It also ends a parent that heeds no signal, because a thread holds Python's lock: the system writes the number
of each signal to the pipe, whatever Python does.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import uuid
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from calstudy import machine

_STARTING = threading.Lock()


def mark() -> dict[str, str]:
    """Environment of a program that must not outlive this process. The first call starts the guardian."""
    with _STARTING:
        return {machine.PARENT: _guarded(os.getpid())[0]}


def tell(what: str, leader: int) -> None:
    """Tell the guardian that a process group has begun or ended; ``mark`` has started it."""
    with contextlib.suppress(OSError):  # somebody has ended it
        os.write(_guarded(os.getpid())[1], f"{what}{leader}\n".encode())


@contextlib.contextmanager
def ending() -> Iterator[None]:
    """While the block runs, SIGINT and SIGTERM end this process in time, whatever its threads do."""
    with _STARTING:
        pipe = _guarded(os.getpid())[1]
    before, alarm = signal.set_wakeup_fd(pipe, warn_on_full_buffer=False), signal.getsignal(signal.SIGALRM)
    signal.signal(signal.SIGALRM, _noticed)
    try:
        yield
    finally:
        signal.signal(signal.SIGALRM, alarm)
        signal.set_wakeup_fd(before)
        with contextlib.suppress(OSError):
            os.write(pipe, bytes([machine.CALM]))


@contextlib.contextmanager
def limited(seconds: float | None) -> Iterator[None]:
    """While the block runs and ``ending`` holds, a time limit counts as a signal; None: there is none."""
    if seconds is None or signal.getsignal(signal.SIGALRM) is not _noticed:
        yield
        return
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 1e-3))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _noticed(number: int, _: object) -> None:
    """Do nothing: the guardian has heard of it."""


@cache
def _guarded(process: int) -> tuple[str, int]:
    """Mark of a process, and the pipe to its guardian. Cached by process id: a fork inherits the cache."""
    name = f"{process}-{uuid.uuid4().hex}"
    read, write = os.pipe()  # this end stays open as long as this process lives
    machine.start_apart(
        [sys.executable, "-S", "-E", str(Path(machine.__file__).absolute()), name, str(machine.PROC)],
        {k: v for k, v in os.environ.items() if k != machine.PARENT},
        read,
    )
    os.close(read)
    os.set_blocking(write, False)  # a signal must not wait
    return name, write
