"""The command ``plan status``: shows how far a study has got."""

from __future__ import annotations

import math
from argparse import Namespace
from dataclasses import asdict
from functools import partial

from calstudy.cli.terminal import print_json, results_console
from calstudy.report import terminal as report
from calstudy.report.terminal import print_failures
from calstudy.study.directory.session import activity_in_words, duration
from calstudy.study.directory.store import read_lines
from calstudy.study.status import read_status


def plan_status(a: Namespace) -> None:
    """Show how far a study has got."""
    status = read_status(a.study)
    settings, did = status.settings, status.last
    at_work = status.holder
    if a.json:
        print_json(
            {
                "study": settings.id,
                "fidelity": settings.fidelity,
                "mode": settings.mode,
                "seed": settings.seed,
                "target": settings.target.origin,
                "rows_finished": sorted((*status.ok, *status.failed)),
                "rows_failed": list(status.failed),
                "rows_underway": status.under_way,
                "rows_waiting": list(status.waiting),
                "replicates": status.replicates,
                "runs": status.runs,
                "runs_left": status.runs_left,
                "runs_failed": status.runs_failed,
                "cpu_time": status.dem_cpu_seconds,
                "utilisation": status.utilisation,
                "seconds_left": did.seconds_left if any(not s.is_silent for s in status.at_work) else None,
                "at_work": asdict(at_work) if at_work else None,
                "elements": [asdict(element) for element in status.elements],
                "sessions": [
                    asdict(s) | {"utilisation": s.did.utilisation, "overhead": s.did.overhead}
                    for s in status.sessions
                ],
                "failures": [asdict(f) for f in status.failures],
            }
        )
        return
    out = results_console()
    say = partial(out.print, highlight=False, soft_wrap=True)
    own = settings.case is not None
    what = "a calibration, " if own else ""
    at = f"{settings.fidelity} fidelity" if settings.fidelity else settings.model
    say(f"{a.study}: {what}{at}, {settings.mode} mode, seed {settings.seed}")
    say(f"Target: {settings.target.origin}")
    say(
        f"rows: {len(status.ok)} finished, {len(status.failed)} failed, {len(status.under_way)} under way, "
        f"{len(status.waiting)} waiting"
    )
    if status.replicates:
        say(f"replicates: {status.replicates} finished")
    say(
        f"DEM runs: {status.runs} done, of which {status.runs_failed} failed; about {status.runs_left} left; "
        f"{duration(status.dem_cpu_seconds)} of processor time in finished rows"
    )
    if not math.isnan(status.utilisation):
        say(f"utilisation: {status.utilisation:.1%} of the slots while a run waited")
    for session in status.at_work:
        if session.is_silent:
            command = "calibrate" if own else "plan run"
            say(
                f"no sign of life since {session.seen or session.started}: {session}; the next '{command}' "
                "takes over if it is dead"
            )
        else:
            say(f"at work: {session}; {activity_in_words(session.did)}")
    if not status.at_work and status.sessions:
        last = status.sessions[-1]
        say(f"last session: {last}, ended {last.seen}: {last.state}")
    print_failures(out, a.study, status.failures, a.study / "runs")
    done = read_lines(a.study, "calibrations", settings.quantities)
    if done:
        report.print_study(out, done, settings)
