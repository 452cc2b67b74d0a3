"""Sessions of a study: a `plan run` at work holds the study's lock, gives signs of life, leaves a record.

    STUDY/lock             who is at work, and every few seconds what it has done so far
    STUDY/sessions.jsonl   one line for each session that has ended, killed ones included

The lock is a file that only one process can create, which holds on network file systems too. A process of
this machine is seen to be dead by its id. One elsewhere is dead when its signs of life cease for longer than
a network file system may hide them; then its lock is taken over.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from calstudy.durable import append_line, force_names, write_atomically
from calstudy.errors import StoreError

LOCK_FILE = "lock"
SESSIONS_FILE = "sessions.jsonl"
BEAT_SECONDS = 5.0
PATIENCE_SECONDS = 90.0
"""Silence after which a process elsewhere is dead; network file systems show changes after up to 60 s."""
LOOK_SECONDS = 1.0

RUNNING, FINISHED, KILLED = "running", "finished", "killed"


def now() -> str:
    """Time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True)
class Activity:
    """What a session has done so far (times in s)."""

    rows: tuple[int, ...] = ()
    """Rows that it was asked for."""
    slots: int = 0
    """DEM runs at once: workers, or threads of the cluster."""
    runs_done: int = 0
    runs_reused: int = 0
    """Runs found on disk, or asked for by two rows."""
    runs_failed: int = 0
    runs_running: int = 0
    runs_waiting: int = 0
    """Runs that are asked for and wait for a slot."""
    runs_left: int = 0
    """Runs still expected, under way ones included."""
    elapsed: float = 0.0
    seconds_left: float = 0.0
    dem_seconds: float = 0.0
    """Elapsed time of DEM programs."""
    dem_cpu_seconds: float = 0.0
    own_cpu_seconds: float = 0.0
    """Processor time of calstudy itself on this machine."""
    busy_seconds: float = 0.0
    """Of dem_seconds, what fell into times in which a runnable run waited."""
    offered_seconds: float = 0.0
    """Slots times seconds in which a runnable run waited."""

    @property
    def utilisation(self) -> float:
        """Share of the slots that ran DEM programs while a runnable run waited; NaN when none waited."""
        return self.busy_seconds / self.offered_seconds if self.offered_seconds > 0 else math.nan

    @property
    def overhead(self) -> float:
        """Processor time of calstudy itself over that of the DEM programs; NaN before the first has ended."""
        return self.own_cpu_seconds / self.dem_cpu_seconds if self.dem_cpu_seconds > 0 else math.nan


@dataclass(frozen=True, slots=True)
class Session:
    """One `plan run` on a study."""

    token: str
    """Random; part of the names under which its DEM runs work in the scratch."""
    host: str
    process: int
    place: str
    """Boot of the machine and namespace of its process ids: where ``process`` means this very process."""
    born: int
    """Start of the process in the clock ticks of its machine, for ids are used again."""
    started: str
    state: str = RUNNING
    beat: int = 0
    """Number of signs of life."""
    seen: str = ""
    """Time of the last one."""
    did: Activity = Activity()
    machine: str = ""
    """Kind of processor, and how many cores the process may use."""

    @classmethod
    def here(cls) -> Session:
        """Session of this process."""
        return cls(
            token=uuid.uuid4().hex[:12],
            host=os.uname().nodename,
            process=os.getpid(),
            place=_place(),
            born=_born(os.getpid()) or 0,
            started=now(),
            machine=_machine(),
        )

    def __str__(self) -> str:
        return f"process {self.process} on {self.host}, started {self.started}"

    @property
    def ended_here(self) -> bool:
        """Whether it is seen from here that the process has ended; False where it cannot be seen."""
        return self.place == _place() and _born(self.process) != self.born

    @property
    def is_silent(self) -> bool:
        """Whether its last sign of life is older than it can be of one alive, by both machines' clocks."""
        last = datetime.fromisoformat(self.seen or self.started)
        return datetime.now(UTC) - last > timedelta(seconds=PATIENCE_SECONDS)

    @property
    def line(self) -> bytes:
        """The session as a line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"


def read_session(content: bytes) -> Session | None:
    """Session of a line; None where it is damaged."""
    try:
        data: dict[str, Any] = json.loads(content)
        did = data["did"] | {"rows": tuple(data["did"]["rows"])}
        return Session(**{**data, "did": Activity(**did)})
    except (ValueError, TypeError, KeyError):
        return None


def read_sessions(directory: Path) -> list[Session]:
    """Sessions of a study that have ended, in that order."""
    try:
        lines = (directory / SESSIONS_FILE).read_bytes().splitlines()
    except OSError:
        return []
    return [session for session in map(read_session, lines) if session is not None]


def holder(directory: Path) -> Session | None:
    """Session whose lock is on the study, dead or alive; None where there is none that can be read."""
    try:
        return read_session((directory / LOCK_FILE).read_bytes())
    except OSError:
        return None


class Lock:
    """The study's lock; one for each session."""

    def __init__(self, directory: Path) -> None:
        self.path = directory / LOCK_FILE
        self.session = Session.here()
        self.report: Callable[[], Activity] | None = None
        """Says what the session has done; without it, it leaves no record."""
        self.lost = threading.Event()
        """Set when another process has taken this session for dead and goes on with its work."""
        self._ended = threading.Event()
        self._beating = threading.Thread(target=self._beat, name="sign of life", daemon=True)
        self._held = False

    def acquire(self) -> None:
        """Take the lock, waiting at most until a holder elsewhere is known to be alive or dead.

        StoreError names a holder that is alive; OSError where nothing can be written.
        """
        with _alone_on_this_machine(self.path.parent):
            while not self._create():
                try:
                    dead = self._wait_for_death()
                except FileNotFoundError:
                    continue  # released meanwhile
                if dead is not None:
                    append_line(self.path.with_name(SESSIONS_FILE), replace(dead, state=KILLED).line)
                self._take_over(dead)
                break
        self._held = True
        self._beating.start()

    def _create(self) -> bool:
        try:
            handle = os.open(self.path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        except FileExistsError:
            return False
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(self.session.line)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            self.path.unlink(missing_ok=True)  # without a name in it, everybody would have to wait
            raise
        force_names(self.path.parent)
        return True

    def _wait_for_death(self) -> Session | None:
        """Session that held the lock and is dead, None if it left no name.

        StoreError when it is alive, FileNotFoundError when it has released the lock.
        """
        first = holder(self.path.parent)
        waited = time.monotonic()
        while True:
            there = holder(self.path.parent)
            if there is None and not self.path.exists():
                raise FileNotFoundError(self.path)
            if there is not None and there.ended_here:
                return there
            alive_here = there is not None and there.place == self.session.place
            changed = first is not None and there != first
            if alive_here or changed:
                raise StoreError(
                    f"{self.path.parent}: in use by {there or 'another process'}; "
                    "wait for it or choose another --study"
                )
            if max(self._age(), time.monotonic() - waited) > PATIENCE_SECONDS:
                return there
            first = first or there
            time.sleep(min(LOOK_SECONDS, PATIENCE_SECONDS / 10))

    def _age(self) -> float:
        """Seconds since the last sign of life, by the one clock of the file system."""
        probe = self.path.with_name(f".{LOCK_FILE}.{self.session.token}")
        try:
            probe.touch()
            return probe.stat().st_mtime - self.path.stat().st_mtime
        finally:
            probe.unlink(missing_ok=True)

    def _take_over(self, dead: Session | None) -> None:
        """Put this session's lock in the place of a dead one's."""
        write_atomically(self.path, self.session.line)
        if dead is None or not dead.ended_here:
            # Another machine may have come to the same conclusion; whoever wrote last has it.
            time.sleep(2 * min(LOOK_SECONDS, PATIENCE_SECONDS / 10))
            there = holder(self.path.parent)
            if there is None or there.token != self.session.token:
                raise StoreError(f"{self.path.parent}: in use by {there}; wait for it")

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_SECONDS):
            there = holder(self.path.parent)
            if there is not None and there.token != self.session.token:
                self.lost.set()
                return
            self._tell()

    def require(self) -> None:
        """StoreError where another session took this one for dead and has taken over."""
        if self.lost.is_set():
            raise StoreError(f"{self.path.parent}: taken over by another session; this one ends")

    def _tell(self) -> None:
        did = self.report() if self.report else self.session.did
        self.session = replace(self.session, beat=self.session.beat + 1, seen=now(), did=did)
        # A full disk, or a server that does not answer, is noticed where results are written.
        with contextlib.suppress(OSError):
            write_atomically(self.path, self.session.line)

    def release(self, state: str = FINISHED) -> None:
        """Give the lock back, and leave a record of the session."""
        self._ended.set()
        if not self._held:
            return
        self._held = False
        self._beating.join()
        there = holder(self.path.parent)
        if self.lost.is_set() or there is None or there.token != self.session.token:
            return
        if self.report is not None:
            self.session = replace(self.session, state=state, seen=now(), did=self.report())
            with contextlib.suppress(OSError):
                append_line(self.path.with_name(SESSIONS_FILE), self.session.line)
        self.path.unlink(missing_ok=True)


@contextlib.contextmanager
def _alone_on_this_machine(directory: Path) -> Iterator[None]:
    """Let one process of this machine at a time look at the lock, where the file system can do that."""
    handle = os.open(directory, os.O_RDONLY)
    end = time.monotonic() + PATIENCE_SECONDS
    try:
        while time.monotonic() < end:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.05)
            except OSError:
                break  # a network file system without it
        yield
    finally:
        os.close(handle)


def _place() -> str:
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {Path('/proc/self/ns/pid').stat().st_ino}"
    except OSError:
        return uuid.uuid4().hex  # nowhere: only signs of life will tell


def _machine() -> str:
    """Such as ``AMD EPYC, family 25, model 17, x86_64, 2 core(s)``."""
    cores = f"{len(os.sched_getaffinity(0))} core(s)"
    try:
        lines = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
    except OSError:
        lines = []
    said = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
    kind = [said["model name"]] if "model name" in said else []
    kind += [f"{name.removeprefix('cpu ')} {said[name]}" for name in ("cpu family", "model") if name in said]
    return ", ".join([*kind, os.uname().machine, cores])


def _born(process: int) -> int | None:
    """Start of a process of this machine; None where it has ended."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] in "ZX" else int(fields[19])
