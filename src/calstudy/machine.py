"""What the operating system alone knows: processes and their groups, locks, the processor.

No other module asks it (a test holds that). Linux answers everything. macOS has no /proc: there a dead
session is known by its silence, a killed calstudy's programs by their groups, and how long a run waits for a
core is not told. calstudy was not tried on macOS. Windows is refused.

It stands alone, because it is also a program: ``python machine.py MARK PROC`` is the guardian.
"""

from __future__ import annotations

import contextlib
import os
import platform
import select
import signal
import sys
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

with contextlib.suppress(ImportError):  # Windows, which is refused
    import fcntl

PROC = Path("/proc")
"""Where Linux tells of processes."""


QUIET_LOOKS, LOOK_SECONDS, GIVE_UP_SECONDS = 3, 0.05, 60.0
PARENT = "CALSTUDY_PARENT"
"""Variable in the environment of programs that must not outlive the process that it names."""
BEGUN, ENDED = "+", "-"
"""What the guardian is told of a process group."""
SIGNALS, CALM = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM), 0
"""Bytes: a signal to its parent, as the system itself writes it, and that none is to be heeded any more."""
STUCK_SECONDS = 9.6
"""Seconds from a signal to the end of a parent that has not ended by itself."""


def refusal(system: str = sys.platform) -> str | None:
    """Why this system cannot be taken, with the remedy; None if it can."""
    if system not in ("win32", "cygwin"):
        return None
    return (
        "calstudy does not run on Windows itself; run it in WSL, the Windows Subsystem for Linux: type 'wsl "
        "--install' in a terminal, then install calstudy in the Ubuntu that this brings"
    )


def tells_of_processes() -> bool:
    """Whether the system has a /proc that tells of this process."""
    return (PROC / "self" / "environ").exists()


def marked(name: str) -> Iterator[int]:
    """Ids of the processes with a mark in their environment; none without /proc."""
    wanted = f"{PARENT}={name}".encode()
    for environment in PROC.glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):  # it has ended meanwhile, or belongs to another user
            if wanted in environment.read_bytes().split(b"\0"):
                yield int(environment.parent.name)


def place() -> str:
    """Boot of the machine and namespace of its process ids, within which an id is unique.

    Without /proc it is a new one each time: then only signs of life tell who is alive.
    """
    try:
        boot = (PROC / "sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {(PROC / 'self/ns/pid').stat().st_ino}"
    except OSError:
        return uuid.uuid4().hex


def born(process: int) -> int | None:
    """Start of a process of this machine in clock ticks; None if it has ended, or without /proc."""
    try:
        fields = (PROC / str(process) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[19])


def waited(session: int) -> float:
    """Seconds that a process of the session has waited for a core, the most of any; 0 where it is not told.

    Linux keeps the account. A machine that others use, too, would otherwise make slow runs failed ones.
    """
    most = 0.0
    for path in PROC.glob("[0-9]*"):
        try:
            # The command in brackets may hold blanks; the session is the fourth word behind it.
            of = (path / "stat").read_text().rpartition(")")[2].split()[3]
            if int(of) == session:
                most = max(most, 1e-9 * int((path / "schedstat").read_text().split()[1]))
        except (OSError, IndexError, ValueError):
            continue  # it has just ended, or this system keeps no such account
    return most


def processor() -> str:
    """Such as ``AMD EPYC, family 25, model 17, x86_64, 2 core(s)``, the cores that this process may use."""
    try:
        lines = (PROC / "cpuinfo").read_text().partition("\n\n")[0].splitlines()
    except OSError:
        lines = []
    said = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    kind = [said["model name"]] if "model name" in said else []
    kind += [f"{name.removeprefix('cpu ')} {said[name]}" for name in ("cpu family", "model") if name in said]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return ", ".join([*kind, platform.machine(), f"{cores} core(s)"])


def end_group(leader: int) -> None:
    """End what still runs in a process group, if anything."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)


def start_apart(argv: Sequence[str], environment: Mapping[str, str], stdin: int) -> None:
    """Start a program in a session of its own, without output, that nobody waits for."""
    actions = [(os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_WRONLY, 0) for stream in (1, 2)]
    os.posix_spawn(
        argv[0],
        list(argv),
        dict(environment),
        file_actions=[(os.POSIX_SPAWN_DUP2, stdin, 0), *actions],
        setsid=True,
    )


def lock(handle: int) -> None:
    """Lock an open file or directory against other processes of this machine.

    BlockingIOError: another one has it. Another OSError: the file system cannot lock.
    """
    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def left(told: str) -> set[int]:
    """Process groups that have begun and not ended, of all that was told; a last line may be cut."""
    groups: set[int] = set()
    for line in told.splitlines(keepends=True):
        if line.endswith("\n"):
            (groups.add if line[0] == BEGUN else groups.discard)(int(line[1:]))
    return groups


def listen(parent: int, handle: int = 0) -> str:
    """What the guardian is told until the pipe closes. Ends a parent that a signal does not end in time.

    A thread that never gives up Python's lock keeps the parent from doing anything itself.
    """
    told, due = bytearray(), None
    while True:
        patience = None if due is None else max(due - time.monotonic(), 0.0)
        if not select.select([handle], [], [], patience)[0]:
            due = None
            if os.getppid() == parent:
                os.kill(parent, signal.SIGKILL)
            continue
        more = os.read(handle, 65536)
        if not more:
            return told.decode()
        for byte in more:
            if byte == CALM:
                due = None
            elif byte in SIGNALS:
                due = due or time.monotonic() + STUCK_SECONDS
            else:
                told.append(byte)


def watch(name: str) -> None:
    """Wait for standard input to close, then end what its parent has left until there is none of it."""
    told = listen(int(name.partition("-")[0]))
    if not tells_of_processes():
        for group in left(told):
            end_group(group)
        return
    quiet, end = 0, time.monotonic() + GIVE_UP_SECONDS
    while quiet < QUIET_LOOKS and time.monotonic() < end:
        found = list(marked(name))
        for process in found:
            with contextlib.suppress(OSError):
                os.kill(process, signal.SIGKILL)
        quiet = 0 if found else quiet + 1
        time.sleep(LOOK_SECONDS)


if __name__ == "__main__":
    PROC = Path(sys.argv[2])
    watch(sys.argv[1])
