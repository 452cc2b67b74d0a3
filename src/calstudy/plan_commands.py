"""The commands around the plan: each builds the parts, calls one function, prints what comes back."""

from __future__ import annotations

import math
import sys
from argparse import Namespace
from dataclasses import asdict
from functools import partial

from rich.table import Table

from calstudy import plan as plans
from calstudy import progress, report
from calstudy.errors import SetupError
from calstudy.liggghts import PROVEN_VERSION, Liggghts
from calstudy.plan_check import check
from calstudy.running import print_failures
from calstudy.status import read_status
from calstudy.store import read_table
from calstudy.terminal import print_json, results_console

PROVEN = Liggghts((), PROVEN_VERSION)


def plan_show(a: Namespace) -> None:
    """Show the plan."""
    plan = plans.load_plan(a.plan)
    if a.json:
        rows = [
            asdict(row) | {"calibrated": list(row.calibrated), "samples": row.samples} for row in plan.rows
        ]
        found = {name: asdict(getattr(plan, name)) for name in ("source", "fixed", "targets")}
        parameters = [asdict(p) for p in plan.parameters]
        print_json({"plan": plan.name, "hash": plan.hash, "parameters": parameters, **found, "rows": rows})
        return
    console = results_console()
    console.print(
        f"Plan {plan.name}: {len(plan.rows)} rows, {plan.total_samples} samples in all", highlight=False
    )
    console.print(f"{plan.source.citation}, doi:{plan.source.doi}", highlight=False, soft_wrap=True)
    intervals = Table("parameter", "lower", "upper", "unit", "if excluded", title=plan.source.intervals)
    for p in plan.parameters:
        constant = "always calibrated" if p.constant is None else f"{p.constant:g}"
        intervals.add_row(p.name, f"{p.lower:g}", f"{p.upper:g}", p.unit, constant)
    console.print(intervals)
    fixed = Table("fixed input", "value", title=plan.source.fixed_inputs)
    for name, value in asdict(plan.fixed).items():
        fixed.add_row(name, f"{value:g}")
    console.print(fixed)
    aim = plan.targets
    console.print(
        f"Targets: {aim.angle_of_repose_deg:g} deg, {aim.bulk_density:g} kg/m3 ({plan.source.targets})",
        highlight=False,
    )
    rows_table = Table(*plans.HEADER, "calibrated", "samples", title=plan.source.rows)
    for row in plan.rows:
        cells = [f"{value:g}" for value in (row.run, *row.levels)]
        rows_table.add_row(*cells, " ".join(row.calibrated), str(row.samples))
    console.print(rows_table)


def plan_export(a: Namespace) -> None:
    """Write the plan's rows."""
    content = plans.export(plans.load_plan(a.plan), a.format)
    data = content.encode() if isinstance(content, str) else content
    if a.out is None:
        sys.stdout.buffer.write(data)
        sys.stdout.flush()
        return
    try:
        a.out.write_bytes(data)
    except OSError as error:
        raise SetupError(f"{a.out}: cannot be written: {error.strerror}; choose another --out") from error


def plan_check(a: Namespace) -> None:
    """Check the plan; refuses a wrong one."""
    result = check(plans.load_plan(a.plan))
    if a.json:
        print_json(asdict(result) | {"ok": result.ok})
    else:
        table = Table("check", "", "found", "expected", title=f"Plan {result.plan}")
        for f in result.findings:
            table.add_row(f.name, "[green]ok[/]" if f.ok else "[red]wrong[/]", f.found, f.expected)
        results_console().print(table)
    result.refuse_if_wrong()


def plan_status(a: Namespace) -> None:
    """Say how far a study is."""
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
                "seconds_left": did.seconds_left if at_work and not at_work.is_silent else None,
                "at_work": asdict(at_work) if at_work else None,
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
    say(f"{a.study}: {settings.fidelity} fidelity, {settings.mode} mode, seed {settings.seed}")
    say(f"Target: {settings.target.origin}")
    say(
        f"rows: {len(status.ok)} finished, {len(status.failed)} failed, {len(status.under_way)} under way, "
        f"{len(status.waiting)} waiting"
    )
    if status.replicates:
        say(f"replicates: {status.replicates} finished")
    say(
        f"DEM runs: {status.runs} done, of which {status.runs_failed} failed; about {status.runs_left} left; "
        f"{progress.duration(status.dem_cpu_seconds)} of processor time in finished rows"
    )
    if not math.isnan(status.utilisation):
        say(f"utilisation: {status.utilisation:.1%} of the slots while a run waited")
    if at_work and at_work.is_silent:
        say(
            f"no sign of life since {at_work.seen or at_work.started}: "
            f"{at_work}; the next 'plan run' takes over if it is dead"
        )
    elif at_work:
        say(f"at work: {at_work}; {progress.activity_in_words(did)}")
    elif status.sessions:
        last = status.sessions[-1]
        say(f"last session: {last}, ended {last.seen}: {last.state}")
    print_failures(out, a.study, status.failures, a.study / "runs")
    done = read_table(a.study, "calibrations", settings.quantities)
    if len(done):
        out.print(report.study_table(done, settings))
