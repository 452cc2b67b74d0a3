"""The commands around the plan: each builds the parts, calls one function, prints what comes back."""

from __future__ import annotations

import math
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table

from calstudy import __version__, progress, report
from calstudy import plan as plans
from calstudy.calibration import Task
from calstudy.campaign import Campaign, MaterialTest, Summary, expected_optimisation_runs
from calstudy.dispatch import Executor, LocalExecutor
from calstudy.emulator import Emulator
from calstudy.emulator_choice import chosen_emulator
from calstudy.emulator_engine import EmulatorEngine
from calstudy.engine import Engine, LiggghtsEngine, Stopped
from calstudy.errors import OutOfTime, SetupError
from calstudy.liggghts import PROVEN_VERSION, Liggghts
from calstudy.model import AngleOfReposeModel, load_model
from calstudy.modes import mode_of
from calstudy.noise import known_noise
from calstudy.plan_check import check
from calstudy.records import Target
from calstudy.replicates import CALIBRATIONS as REPLICATES
from calstudy.replicates import ROW_SECONDS, Replicates, Replication
from calstudy.rows import tasks_of
from calstudy.running import FAILED_ROWS, engines_and_executor, log_file, print_failures
from calstudy.schema import TABLES
from calstudy.status import failures, read_status
from calstudy.store import Store, StudySettings, read_table
from calstudy.study import read_study
from calstudy.targets import REFERENCE, parse_target
from calstudy.terminal import cores, print_json, results_console, stop_on_signals

PROVEN = Liggghts((), PROVEN_VERSION)


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
    emulator = chosen_emulator(a.engine, a.emulator, a.scheduler, a.replicates)
    a.fidelity = a.fidelity or (emulator.origin.fidelity if emulator else "soft")
    model = load_model(plan.fixed, a.fidelity, a.variant)
    answers = f"emulator-{emulator.version}" if emulator else a.fidelity
    directory = a.study or Path("studies") / f"{answers}-{a.variant}-{a.mode}-{a.seed}"
    scratch = a.scratch or directory / "runs"
    scratch = scratch.absolute() if a.scheduler else scratch  # workers work elsewhere
    if a.dry_run:
        stand_in = EmulatorEngine(model, emulator) if emulator else LiggghtsEngine(model, PROVEN)
        tasks = tasks_of(plan, _target(a, plan, model, stand_in), mode, a.seed, a.share_samples)
        chosen = {row: tasks[row] for row in rows}
        _print_estimate(a, chosen, plan, model, stand_in, directory, a.workers or cores())
        return 0
    console = Console(stderr=True)
    deadline = None if a.time_limit is None else time.monotonic() + a.time_limit
    with stop_on_signals(console) as stop:
        engine, executor = _engine_and_executor(a, model, emulator, stop)
        target = _target(a, plan, model, engine)
        settings = StudySettings(
            plan=plan.name,
            plan_hash=plan.hash,
            model=model.name,
            deck=model.deck,
            model_hash=model.hash,
            fidelity=a.fidelity,
            variant=a.variant,
            engine=engine.identity,
            calstudy=__version__,
            mode=mode.name,
            budget=mode.second_optimisation.budget,
            seed=a.seed,
            target=target,
            share_samples=a.share_samples,
            noise=known_noise(model.name, model.hash) if mode.takes_noise else None,
        )
        say = partial(console.print, highlight=False, soft_wrap=True)
        say(f"Study {directory}: {len(rows)} row(s), {executor.slots} DEM run(s) at once")
        say(f"Target: {target.origin}")
        if mode.takes_noise:
            say(f"Noise: {_noise_in_words(settings.noise)}")
        try:
            with Store(directory, settings) as store, log_file(directory):
                repeated = None
                if emulator is not None and a.replicates:
                    of = Replication(settings, plan, rows, mode, model, emulator)
                    repeated = Replicates(
                        of,
                        a.replicates,
                        store,
                        workers=a.workers or cores(),
                        deadline=deadline,
                    )
                for note in store.notes:
                    say(f"NOTE {note}")
                campaign = Campaign(
                    tasks_of(plan, target, mode, a.seed, a.share_samples, settings.noise),
                    [MaterialTest(engine, plans.PARAMETERS)],
                    store,
                    executor,
                    scratch=scratch,
                    keep_runs=a.keep_runs,
                    retry_failed=a.retry_failed,
                    time_limit=a.time_limit,
                    stop=stop,
                )
                with progress.shown(partial(progress.look_at, campaign), console):
                    summary = campaign.run(rows)
                for note in store.notes:
                    say(f"NOTE {note}")
                if repeated is not None:
                    say(f"Replicates: each with seed and draw of its own, {repeated.workers} at once")
                    # The campaign's event is set when it ends.
                    with stop_on_signals(console) as again, progress.shown(repeated.look, console):
                        repeated.run(again)
        except (Stopped, OutOfTime) as error:
            done = f"{campaign.in_words()}{f'; {repeated.in_words()}' if repeated else ''}"
            raise type(error)(
                f"{error}: {done}; all are saved in {directory}, and the same command goes on"
            ) from error
        finally:
            executor.close()
    code = _print_outcome(a, plan, settings, directory, scratch, rows, summary)
    if repeated is not None:
        console.print(
            f"{repeated.in_words()}: {directory / REPLICATES}; their bands: calstudy analyse {directory}",
            highlight=False,
            soft_wrap=True,
        )
        code = FAILED_ROWS if repeated.failed_rows else code
    return code


def _engine_and_executor(
    a: Namespace, model: AngleOfReposeModel, emulator: Emulator | None, stop: threading.Event
) -> tuple[Engine, Executor]:
    """What runs the model, and where: an emulator always answers here."""
    if emulator is not None:
        return EmulatorEngine(model, emulator), LocalExecutor(a.workers or cores(), stop)
    (engine,), executor = engines_and_executor(a, [(model, "")], stop)
    return engine, executor


def _noise_in_words(noise: Mapping[str, float] | None) -> str:
    if noise is None:
        return "never measured for this model; each row estimates it from its own runs"
    return ", ".join(f"{name} {sd:.3g}" for name, sd in noise.items()) + " from seed to seed, as measured"


def _target(a: Namespace, plan: plans.Plan, model: AngleOfReposeModel, engine: Engine) -> Target:
    """Target of ``--target``; an emulator makes its own twin, and its targets say that it answers."""
    if not isinstance(engine, EmulatorEngine):
        return parse_target(a.target, plan, model, engine.identity)
    if a.target == "twin":
        return engine.twin(REFERENCE)
    target = parse_target(a.target, plan, model, engine.identity)
    return replace(target, origin=f"{target.origin}; responses of {engine.identity}")


def _print_outcome(
    a: Namespace,
    plan: plans.Plan,
    settings: StudySettings,
    directory: Path,
    scratch: Path,
    rows: Sequence[int],
    summary: Summary,
) -> int:
    study = read_study(directory, a.plan)
    chosen = study.calibrations[study.calibrations["row"].isin(rows)]
    if a.json:
        print_json(chosen.to_dict("records"))
    else:
        out = results_console()
        report.print_results(out, chosen, plan, settings)
        pictures = [path for row in summary.finished for path in report.draw_row(directory, study, row)]
        print_failures(out, directory, failures(study.evaluations), scratch)
        out.print("Pictures and tables (pandas.read_parquet reads each):", highlight=False)
        shown = pictures[:2] if len(pictures) > 2 else pictures
        for path in [*shown, *(directory / name for name in TABLES)]:
            out.print(f"  {path}", highlight=False, soft_wrap=True)
    return FAILED_ROWS if (chosen["outcome"] != "ok").any() else 0


def _print_estimate(
    a: Namespace,
    tasks: Mapping[int, Task],
    plan: plans.Plan,
    model: AngleOfReposeModel,
    engine: Engine,
    directory: Path,
    workers: int,
) -> None:
    rows = list(tasks)
    sampled = {task.sampled_as for task in tasks.values()}
    sampling = sum(plan.row(row).samples for row in sampled)
    optimisation = sum(map(expected_optimisation_runs, tasks.values()))
    runs = sampling + optimisation
    replicates = a.replicates or 0
    seconds = runs * engine.expected_seconds
    if isinstance(engine, EmulatorEngine):  # its answers cost less than what is made of them
        seconds = (1 + replicates) * len(rows) * ROW_SECONDS
    elapsed = seconds / workers
    beads = 0 if isinstance(engine, EmulatorEngine) else model.fidelity.poured_beads
    stored = len(rows) * (62_000 + 10 * beads) + 150 * runs
    journals = runs * (1_000 + 4 * beads)
    scratch = workers * 250 * beads + journals
    if len(rows) < len(plan.rows):
        stored += journals  # they go with the plan's last row
    stored += replicates * (60_000 + 70 * runs)
    estimate = {
        "rows": len(rows),
        "replicates": replicates,
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
    again = f", and {replicates} times as replicates," if replicates else ""
    out.print(
        f"{len(rows)} row(s){again} at {a.fidelity} fidelity in {directory}: {sampling} sampling runs and "
        f"about {estimate['runs_optimisation_expected']} of the second optimisation,\n"
        f"about {estimate['core_hours_expected']} core-hours, {progress.duration(elapsed)}"
        f" with {workers} worker(s); {stored / 1e6:.1f} MB in the end, at most {scratch / 1e6:.1f} before. "
        "Nothing was run.",
        highlight=False,
        soft_wrap=True,
    )


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
                "seconds_left": did.seconds_left if at_work else None,
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
    if at_work:
        say(f"at work: {at_work}; {progress.activity_in_words(did)}")
    elif status.sessions:
        last = status.sessions[-1]
        say(f"last session: {last}, ended {last.seen}: {last.state}")
    print_failures(out, a.study, status.failures, a.study / "runs")
    done = read_table(a.study, "calibrations", settings.quantities)
    if len(done):
        out.print(report.study_table(done, settings))
