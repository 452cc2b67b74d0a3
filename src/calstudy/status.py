"""How far a study is, read from its directory alone, whoever is at work on it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from calstudy.records import Outcome
from calstudy.session import Activity, Session, holder, read_sessions
from calstudy.store import (
    StudySettings,
    finished_replicates,
    finished_rows,
    journals,
    read_settings,
    read_table,
)


@dataclass(frozen=True, slots=True)
class Failure:
    """A kind of DEM run that gave no responses."""

    outcome: str
    runs: int
    run_id: str
    """The latest of them."""
    row: int
    host: str
    reason: str


@dataclass(frozen=True, slots=True)
class Status:
    """A study's state."""

    settings: StudySettings
    ok: tuple[int, ...]
    failed: tuple[int, ...]
    under_way: dict[int, int]
    """DEM runs of each row that is begun and not finished."""
    waiting: tuple[int, ...]
    """Rows that the last session was asked for and that are not begun."""
    runs: int
    runs_failed: int
    failures: tuple[Failure, ...]
    dem_cpu_seconds: float
    """Of finished rows."""
    holder: Session | None
    """Session at work, as of its last sign of life; None where there is none, or it is seen to be dead."""
    sessions: tuple[Session, ...]
    """Sessions that have ended."""
    replicates: int
    """Finished ones, of a study on an emulator."""

    @property
    def last(self) -> Activity:
        """What the session at work, or else the last one, has done."""
        if self.holder is not None:
            return self.holder.did
        return self.sessions[-1].did if self.sessions else Activity()

    @property
    def runs_left(self) -> int:
        """DEM runs that the last session still expected; 0 when all its rows are finished."""
        return self.last.runs_left if self.under_way or self.waiting else 0

    @property
    def utilisation(self) -> float:
        """Of all sessions: share of the slots that ran DEM programs while a runnable run waited."""
        did = [session.did for session in (*self.sessions, *([self.holder] if self.holder else []))]
        offered = sum(one.offered_seconds for one in did)
        return sum(one.busy_seconds for one in did) / offered if offered > 0 else math.nan


def read_status(directory: Path) -> Status:
    """State of a study; StoreError where the directory is none, or is damaged."""
    settings = read_settings(directory)
    quantities = settings.quantities
    done = read_table(directory, "calibrations", quantities)
    finished = finished_rows(directory)
    lines = {row: path.read_bytes().count(b"\n") for row, path in journals(directory).items()}
    under_way = {row: runs for row, runs in sorted(lines.items()) if row not in finished}
    at_work = holder(directory)
    if at_work is not None and at_work.ended_here:
        at_work = None
    sessions = tuple(read_sessions(directory))
    asked = at_work.did.rows if at_work else sessions[-1].did.rows if sessions else ()
    failed = {int(row) for row in done["row"][done["outcome"] != "ok"]}
    return Status(
        settings=settings,
        ok=tuple(sorted(finished - failed)),
        failed=tuple(sorted(failed)),
        under_way=under_way,
        waiting=tuple(row for row in asked if row not in finished and row not in under_way),
        runs=int(done["runs_total"].sum()) + sum(under_way.values()),
        runs_failed=int(done["runs_failed"].sum()),
        failures=failures(read_table(directory, "evaluations", quantities)),
        dem_cpu_seconds=float(done["cpu_time"].sum()),
        holder=at_work,
        sessions=sessions,
        replicates=len(finished_replicates(directory)),
    )


def failures(evaluations: pd.DataFrame) -> tuple[Failure, ...]:
    """DEM runs of finished rows without responses, by outcome, each with its latest example."""
    bad = evaluations[evaluations["outcome"] != Outcome.OK].drop_duplicates("run_id")
    found = []
    for outcome, lines in bad.groupby("outcome"):
        last = lines.sort_values("finished_at", kind="stable").to_dict("records")[-1]
        found.append(
            Failure(str(outcome), len(lines), last["run_id"], int(last["row"]), last["host"], last["reason"])
        )
    return tuple(found)
