"""Progress of a study, read from its directory alone, whether or not a session works on it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calstudy.records import Outcome
from calstudy.study.directory.elements import elements, lock_name
from calstudy.study.directory.session import LOCK_FILE, Activity, Session, holder, read_sessions, together
from calstudy.study.directory.store import finished_replicates, finished_rows, journals, read_lines
from calstudy.study.settings import StudySettings, read_settings


@dataclass(frozen=True, slots=True)
class Failure:
    """A kind of DEM run that gave no responses."""

    outcome: str
    runs: int
    run_id: str
    """Id of the latest one."""
    row: int
    host: str
    reason: str


FAILURE_COLUMNS = ("outcome", "run_id", "finished_at", "row", "host", "reason")
"""Columns of the table of evaluations from which failures are read."""


@dataclass(frozen=True, slots=True)
class Status:
    """A study's state."""

    settings: StudySettings
    ok: tuple[int, ...]
    failed: tuple[int, ...]
    under_way: dict[int, int]
    """DEM runs of each row under way."""
    waiting: tuple[int, ...]
    """Rows of the last session that have not begun."""
    runs: int
    runs_failed: int
    failures: tuple[Failure, ...]
    dem_cpu_seconds: float
    """Processor time of the DEM runs of finished rows, in s."""
    holder: Session | None
    """Session that works alone, as of its last sign of life; None if there is none or it is known dead."""
    elements: tuple[Session, ...]
    """Elements of a job array at work, likewise."""
    sessions: tuple[Session, ...]
    """Sessions that have ended."""
    replicates: int
    """Finished replicates of a study on an emulator."""

    @property
    def last(self) -> Activity:
        """What those at work, or else the last session, have done."""
        if self.at_work:
            return together([session.did for session in self.at_work])
        return self.sessions[-1].did if self.sessions else Activity()

    @property
    def at_work(self) -> tuple[Session, ...]:
        """The session that works alone, or the elements of an array."""
        return self.elements or ((self.holder,) if self.holder else ())

    @property
    def runs_left(self) -> int:
        """DEM runs that the last session still expected; 0 if all its rows are finished."""
        return self.last.runs_left if self.under_way or self.waiting else 0

    @property
    def utilisation(self) -> float:
        """Share of the slots in use while a run was waiting for one, over all sessions."""
        did = [session.did for session in (*self.sessions, *self.at_work)]
        offered = sum(one.offered_seconds for one in did)
        return sum(one.busy_seconds for one in did) / offered if offered > 0 else math.nan


def read_status(directory: Path) -> Status:
    """State of a study; StoreError if the directory is not a study, or is damaged."""
    settings = read_settings(directory)
    quantities = settings.quantities
    done = read_lines(directory, "calibrations", quantities)
    finished = finished_rows(directory)
    lines = {row: path.read_bytes().count(b"\n") for row, path in journals(directory).items()}
    under_way = {row: runs for row, runs in sorted(lines.items()) if row not in finished}
    names = (LOCK_FILE, *map(lock_name, elements(directory)))
    held = [session for name in names if (session := holder(directory, name)) and not session.ended_here]
    at_work = next((session for session in held if not session.element), None)
    array = tuple(session for session in held if session.element)
    sessions = tuple(read_sessions(directory))
    last = held or sessions[-1:]
    asked = sorted({row for session in last for row in session.did.rows})
    failed = {line["row"] for line in done if line["outcome"] != "ok"}
    return Status(
        settings=settings,
        ok=tuple(sorted(finished - failed)),
        failed=tuple(sorted(failed)),
        under_way=under_way,
        waiting=tuple(row for row in asked if row not in finished and row not in under_way),
        runs=sum(line["runs_total"] for line in done) + sum(under_way.values()),
        runs_failed=sum(line["runs_failed"] for line in done),
        failures=failures(read_lines(directory, "evaluations", quantities, FAILURE_COLUMNS)),
        dem_cpu_seconds=math.fsum(line["cpu_time"] for line in done),
        holder=at_work,
        elements=array,
        sessions=sessions,
        replicates=len(finished_replicates(directory)),
    )


def failures(evaluations: Iterable[Mapping[str, Any]]) -> tuple[Failure, ...]:
    """DEM runs of finished rows that gave no responses, by outcome, each with its latest example.

    ``evaluations`` are lines of the table of that name with FAILURE_COLUMNS at least.
    """
    bad: dict[str, Mapping[str, Any]] = {}  # rows that share a run have a line each
    for line in evaluations:
        if line["outcome"] != Outcome.OK:
            bad.setdefault(line["run_id"], line)
    found = []
    for outcome in sorted({line["outcome"] for line in bad.values()}):
        lines = [line for line in bad.values() if line["outcome"] == outcome]
        last = max(reversed(lines), key=lambda line: line["finished_at"])
        found.append(
            Failure(outcome, len(lines), last["run_id"], int(last["row"]), last["host"], last["reason"])
        )
    return tuple(found)
