"""The commands around the plan: each builds the parts, calls one function, prints what comes back."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Console
from rich.table import Table

from calstudy import __version__, progress, report
from calstudy import plan as plans
from calstudy.campaign import Campaign, expected_optimisation_runs
from calstudy.engine import LiggghtsEngine, Stopped
from calstudy.errors import SetupError
from calstudy.liggghts import PROVEN_VERSION, Liggghts, find_liggghts
from calstudy.model import AngleOfReposeModel, load_model
from calstudy.modes import mode_of
from calstudy.plan_check import check
from calstudy.schema import TABLES
from calstudy.store import Store, StudySettings, finished_rows, read_settings, read_table
from calstudy.study import read_study
from calstudy.targets import parse_target
from calstudy.terminal import cores, print_json, results_console, stop_on_signals

FAILED_ROWS = 8


def plan_show(a: Namespace) -> None:
    """Show the plan."""
    plan = plans.load_plan(a.plan)
    if a.json:
        rows = [
            asdict(row) | {"calibrated": list(row.calibrated), "samples": row.samples} for row in plan.rows
        ]
        print_json({"plan": plan.name, "hash": plan.hash, "rows": rows})
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


def plan_run(a: Namespace) -> int:
    """Calibrate rows of the plan."""
    plan = plans.load_plan(a.plan)
    check(plan).refuse_if_wrong()
    rows = plans.parse_rows_option(a.rows, plan) if a.rows else tuple(row.run for row in plan.rows)
    mode = mode_of(a.mode, a.budget)
    model = load_model(plan.fixed, a.fidelity, a.variant)
    program = None if a.dry_run else find_liggghts(a.liggghts)
    identity = LiggghtsEngine(model, program or Liggghts(("liggghts",), PROVEN_VERSION)).identity
    target = parse_target(a.target, plan, model, identity)
    directory = a.study or Path("studies") / f"{a.fidelity}-{a.variant}-{a.mode}-{a.seed}"
    workers = a.workers or cores()
    if program is None:
        _print_estimate(a, plan, rows, model, directory, workers)
        return 0
    settings = StudySettings(
        plan=plan.name,
        plan_hash=plan.hash,
        model=model.name,
        deck=model.deck,
        model_hash=model.hash,
        fidelity=a.fidelity,
        variant=a.variant,
        engine=identity,
        calstudy=__version__,
        mode=mode.name,
        budget=mode.second_optimisation.budget,
        seed=a.seed,
        target=target,
    )
    console = Console(stderr=True)
    console.print(
        f"Study {directory}: {len(rows)} row(s), {workers} worker(s)", highlight=False, soft_wrap=True
    )
    console.print(f"Target: {target.origin}", highlight=False, soft_wrap=True)
    with Store(directory, settings) as store, stop_on_signals(console) as stop:
        campaign = Campaign(
            plan,
            target,
            mode,
            LiggghtsEngine(model, program),
            store,
            workers=workers,
            scratch=a.scratch or directory / "runs",
            keep_runs=a.keep_runs,
            stop=stop,
        )
        try:
            with progress.shown(campaign, console):
                summary = campaign.run(rows)
        except Stopped as error:
            done = campaign.progress
            raise Stopped(
                f"interrupted; {done.rows_done} row(s) and {done.runs_done} DEM run(s) of this session are "
                f"saved in {directory}, and the same command goes on"
            ) from error
        for note in store.notes:
            console.print(f"NOTE {note}", highlight=False, soft_wrap=True)
    study = read_study(directory, a.plan)
    chosen = study.calibrations[study.calibrations["row"].isin(rows)]
    if a.json:
        print_json(chosen.to_dict("records"))
    else:
        out = results_console()
        report.print_results(out, chosen, plan, settings)
        pictures = [path for row in summary.finished for path in report.draw_row(directory, study, row)]
        out.print("Pictures and tables (pandas.read_parquet reads each):", highlight=False)
        shown = pictures[:2] if len(pictures) > 2 else pictures
        for path in [*shown, *(directory / name for name in TABLES)]:
            out.print(f"  {path}", highlight=False, soft_wrap=True)
    return FAILED_ROWS if (chosen["outcome"] != "ok").any() else 0


def _print_estimate(
    a: Namespace,
    plan: plans.Plan,
    rows: Sequence[int],
    model: AngleOfReposeModel,
    directory: Path,
    workers: int,
) -> None:
    mode = mode_of(a.mode, a.budget)
    sampling = sum(plan.row(row).samples for row in rows)
    optimisation = sum(expected_optimisation_runs(plan, row, mode) for row in rows)
    seconds = (sampling + optimisation) * model.expected_seconds
    elapsed = seconds / workers
    runs, beads = sampling + optimisation, model.fidelity.poured_beads
    stored = len(rows) * (62_000 + 10 * beads) + 150 * runs
    # Dumps and logs of what is running, and the journals, which go as rows finish.
    scratch = workers * 250 * beads + runs * (1_000 + 4 * beads)
    estimate = {
        "rows": len(rows),
        "runs_sampling": sampling,
        "runs_optimisation_expected": round(optimisation),
        "core_hours_expected": round(seconds / 3600, 2),
        "elapsed_seconds_expected": round(elapsed),
        "bytes_stored_expected": round(stored),
        "bytes_scratch_expected": round(scratch),
        "study": str(directory),
    }
    if a.json:
        print_json(estimate)
        return
    out = results_console()
    out.print(
        f"{len(rows)} row(s) at {a.fidelity} fidelity in {directory}: {sampling} sampling runs and about "
        f"{estimate['runs_optimisation_expected']} of the second optimisation,\n"
        f"about {estimate['core_hours_expected']} core-hours, {progress.duration(elapsed)}"
        f" with {workers} worker(s); {stored / 1e6:.1f} MB in the end, at most {scratch / 1e6:.1f} before. "
        "Nothing was run.",
        highlight=False,
        soft_wrap=True,
    )


def plan_status(a: Namespace) -> None:
    """Say how far a study is."""
    settings = read_settings(a.study)
    done = read_table(a.study, "calibrations")
    finished = finished_rows(a.study)
    journals = sorted((a.study / "journal").glob("row-*.jsonl"))
    underway = {int(p.stem.removeprefix("row-")): p.read_bytes().count(b"\n") for p in journals}
    underway = {row: runs for row, runs in underway.items() if row not in finished}
    state = {
        "study": settings.id,
        "fidelity": settings.fidelity,
        "mode": settings.mode,
        "seed": settings.seed,
        "target": settings.target.origin,
        "rows_finished": sorted(finished),
        "rows_failed": [int(row) for row in done["row"][done["outcome"] != "ok"]],
        "rows_underway": underway,
        "runs": int(done["runs_total"].sum()) + sum(underway.values()),
        "runs_failed": int(done["runs_failed"].sum()),
        "cpu_time": float(done["cpu_time"].sum()),
    }
    if a.json:
        print_json(state)
        return
    out = results_console()
    out.print(
        f"{a.study}: {settings.fidelity} fidelity, {settings.mode} mode, seed {settings.seed}",
        highlight=False,
    )
    out.print(f"Target: {settings.target.origin}", highlight=False, soft_wrap=True)
    out.print(
        f"rows: {len(finished)} finished ({len(state['rows_failed'])} failed), {len(underway)} under way\n"
        f"DEM runs: {state['runs']}, of which {state['runs_failed']} failed; "
        f"{progress.duration(state['cpu_time'])} of processor time in finished rows",
        highlight=False,
    )
    if len(done):
        out.print(report.study_table(done, settings))
