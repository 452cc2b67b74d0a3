"""Sessions of a study: who works on it holds its lock, gives signs of life, and leaves a record.

    STUDY/lock             who is at work, and every few seconds what it has done so far
    STUDY/lock-3           the same of element 3 of a job array: see ``elements``
    STUDY/sessions.jsonl   one line for each session that has ended, killed ones included

Only one process can create the lock file, on network file systems too. The process id tells whether a process
of this machine is alive. One on another machine counts as dead once its signs of life have been missing for
longer than a network file system may hide them. Its lock is then taken over.
"""

from __future__ import annotations

import json
import math
import os
import uuid
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from calstudy import machine
from calstudy.disk.files import content_of
from calstudy.written import json_of

LOCK_FILE = "lock"
SESSIONS_FILE = "sessions.jsonl"
PATIENCE_SECONDS = 90.0
"""Silence after which a process elsewhere is dead. Network file systems may show a change 60 s late."""

LARGEST = 100e6
"""Bytes of a file of sessions."""

RUNNING, FINISHED, KILLED = "running", "finished", "killed"


def now() -> str:
    """Time in UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True)
class Activity:
    """What a session has done so far (times in s)."""

    rows: tuple[int, ...] = ()
    """Rows to calibrate."""
    slots: int = 0
    """DEM runs at once: workers, or threads of the cluster."""
    runs_done: int = 0
    runs_reused: int = 0
    """Runs found on disk, or asked for by two rows."""
    runs_failed: int = 0
    runs_running: int = 0
    runs_waiting: int = 0
    """Runs that wait for a slot."""
    runs_left: int = 0
    """Runs still expected, including those under way."""
    elapsed: float = 0.0
    seconds_left: float = 0.0
    dem_seconds: float = 0.0
    """Elapsed time of DEM programs."""
    dem_cpu_seconds: float = 0.0
    own_cpu_seconds: float = 0.0
    """Processor time of calstudy itself on this machine."""
    busy_seconds: float = 0.0
    """Part of dem_seconds during which another run was waiting for a slot."""
    offered_seconds: float = 0.0
    """Slots times the seconds during which a run was waiting for one."""

    @property
    def utilisation(self) -> float:
        """Share of the slots in use while a run was waiting for one; NaN if none ever waited."""
        return self.busy_seconds / self.offered_seconds if self.offered_seconds > 0 else math.nan

    @property
    def overhead(self) -> float:
        """Processor time of calstudy relative to that of the DEM programs; NaN before the first has ended."""
        return self.own_cpu_seconds / self.dem_cpu_seconds if self.dem_cpu_seconds > 0 else math.nan


def together(did: Sequence[Activity]) -> Activity:
    """What several sessions have done that are at work at once: sums, and the longest times."""
    numbers = {f.name: [getattr(one, f.name) for one in did] for f in fields(Activity) if f.name != "rows"}
    longest = {name: max(numbers.pop(name)) for name in ("elapsed", "seconds_left")}
    rows = tuple(sorted({row for one in did for row in one.rows}))
    return Activity(rows=rows, **{name: sum(each) for name, each in numbers.items()}, **longest)


@dataclass(frozen=True, slots=True)
class Session:
    """One session of work on a study."""

    token: str
    """Random; part of the directory names of its DEM runs."""
    host: str
    process: int
    place: str
    """Boot of the machine and namespace of its process ids, within which ``process`` is unique."""
    born: int
    """Start of the process in clock ticks of its machine, since ids are reused."""
    started: str
    state: str = RUNNING
    beat: int = 0
    """Number of signs of life."""
    seen: str = ""
    """Time of the last one."""
    did: Activity = Activity()
    machine: str = ""
    """Kind of processor, and how many cores the process may use."""
    element: int = 0
    """Number in a job array, from 1; 0 for a session that works alone."""

    @classmethod
    def here(cls, element: int = 0) -> Session:
        """Session of this process."""
        return cls(
            token=uuid.uuid4().hex[:12],
            host=os.uname().nodename,
            process=os.getpid(),
            place=machine.place(),
            born=machine.born(os.getpid()) or 0,
            started=now(),
            machine=machine.processor(),
            element=element,
        )

    def __str__(self) -> str:
        name = f"element {self.element}, " if self.element else ""
        return f"{name}process {self.process} on {self.host}, started {self.started}"

    @property
    def ended_here(self) -> bool:
        """Whether the process is known to have ended; False if that cannot be seen from here."""
        return self.place == machine.place() and machine.born(self.process) != self.born

    @property
    def is_silent(self) -> bool:
        """Whether its last sign of life is too old for a live process, by the clocks of both machines."""
        last = datetime.fromisoformat(self.seen or self.started)
        return datetime.now(UTC) - last > timedelta(seconds=PATIENCE_SECONDS)

    @property
    def line(self) -> bytes:
        """The session as a line of JSON."""
        return json.dumps(asdict(self)).encode() + b"\n"


def read_session(content: bytes) -> Session | None:
    """Session of a line; None if the line is damaged."""
    try:
        data: dict[str, Any] = json_of(content)
        did = data["did"] | {"rows": tuple(data["did"]["rows"])}
        return Session(**{**data, "did": Activity(**did)})
    except (ValueError, TypeError, LookupError):
        return None


def read_sessions(directory: Path) -> list[Session]:
    """Sessions of a study that have ended, in order."""
    try:
        lines = content_of(directory / SESSIONS_FILE, LARGEST).splitlines()
    except OSError:
        return []
    return [session for session in map(read_session, lines) if session is not None]


def holder(directory: Path, lock: str = LOCK_FILE) -> Session | None:
    """Session that holds a lock of the study, dead or alive; None if no lock can be read."""
    try:
        return read_session(content_of(directory / lock, LARGEST))
    except OSError:
        return None


SEPARATOR = " · "


@dataclass(frozen=True, slots=True)
class Look:
    """Progress of long work at one moment."""

    share: float
    """Share of the work that is done."""
    words: Sequence[str]
    """What is done and left, in parts. A narrow terminal drops the middle ones first."""
    news: Sequence[str] = ()
    """One line for each finished part, in order; each is shown once."""


def duration(seconds: float) -> str:
    """Time in words, to two units."""
    seconds = round(seconds)
    if seconds < 60:
        return f"{seconds} s"
    minutes, seconds = divmod(seconds, 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02d} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min"


def activity_in_words(did: Activity) -> str:
    """What a session has done, what it is doing, and how long it will take."""
    return SEPARATOR.join(_parts(did))


def _parts(did: Activity) -> list[str]:
    asked = did.runs_done + did.runs_reused
    failures = f", {did.runs_failed} failed" if did.runs_failed else ""
    used = "" if math.isnan(did.utilisation) else f", {did.utilisation:.0%} used"
    nobody = did.slots == 0 and did.runs_waiting > 0
    left = "waiting for the cluster's workers" if nobody else f"about {duration(did.seconds_left)} left"
    return [
        f"DEM runs {asked} of about {asked + did.runs_left}{failures}",
        f"{did.runs_running} running{used}",
        duration(did.elapsed),
        left,
    ]


LOG_FILE = "calstudy.log"
