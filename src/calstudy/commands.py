"""What each command does: it builds the parts, calls one function, and prints what comes back."""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
import signal
import sys
import tempfile
import threading
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console
from rich.progress import track
from rich.table import Table

from calstudy import __version__, progress, report
from calstudy import plan as plans
from calstudy.campaign import Campaign, expected_optimisation_runs
from calstudy.engine import LiggghtsEngine
from calstudy.errors import InputError, RunError, SetupError
from calstudy.liggghts import PROVEN_VERSION, Liggghts, find_liggghts
from calstudy.measurement import measure as measure_pictures
from calstudy.model import AngleOfReposeModel, check_physics, load_model
from calstudy.modes import mode_of
from calstudy.plan_check import check
from calstudy.records import MEASURED, RAYLEIGH_TIME_STEP, RESPONSES, UNITS, Outcome, Run
from calstudy.schema import PARAMETER_UNITS, TABLES
from calstudy.silhouette import side_view, top_view, write_picture
from calstudy.store import Store, StudySettings, finished_rows, read_settings, read_table
from calstudy.targets import REFERENCE, parse_target, replicates, write_twin

FAILED_ROWS = 8


# ---- plan ---------------------------------------------------------------------------------------------


def plan_show(a: Namespace) -> None:
    """Show the plan."""
    plan = plans.load_plan(a.plan)
    if a.json:
        rows = [
            asdict(row) | {"calibrated": list(row.calibrated), "samples": row.samples} for row in plan.rows
        ]
        _print_json({"plan": plan.name, "hash": plan.hash, "rows": rows})
        return
    console = _results_console()
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
        _print_json(asdict(result) | {"ok": result.ok})
    else:
        table = Table("check", "", "found", "expected", title=f"Plan {result.plan}")
        for f in result.findings:
            table.add_row(f.name, "[green]ok[/]" if f.ok else "[red]wrong[/]", f.found, f.expected)
        _results_console().print(table)
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
    workers = a.workers or _cores()
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
    with Store(directory, settings) as store, _stop_on_signals(console) as stop:
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
        with progress.shown(campaign, console):
            summary = campaign.run(rows)
        for note in store.notes:
            console.print(f"NOTE {note}", highlight=False, soft_wrap=True)
    tables = {name: read_table(directory, name) for name in TABLES}
    chosen = tables["calibrations"][tables["calibrations"]["row"].isin(rows)]
    if a.json:
        _print_json(chosen.to_dict("records"))
    else:
        out = _results_console()
        report.print_results(out, chosen, plan, settings)
        pictures = [path for row in summary.finished for path in report.draw_row(directory, tables, row)]
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
    stored = 700 * (sampling + optimisation) + len(rows) * (20_000 + 6 * model.fidelity.poured_beads)
    scratch = workers * 250 * model.fidelity.poured_beads
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
        _print_json(estimate)
        return
    out = _results_console()
    out.print(
        f"{len(rows)} row(s) at {a.fidelity} fidelity in {directory}: {sampling} sampling runs and about "
        f"{estimate['runs_optimisation_expected']} of the second optimisation,\n"
        f"about {estimate['core_hours_expected']} core-hours, {progress.duration(elapsed)}"
        f" with {workers} worker(s); {stored / 1e6:.1f} MB in the end, {scratch / 1e6:.1f} MB of scratch. "
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
        _print_json(state)
        return
    out = _results_console()
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


# ---- single runs ---------------------------------------------------------------------------------------


def simulate(a: Namespace) -> None:
    """Run the DEM model once, or with several seeds."""
    engine = LiggghtsEngine(_model(a), find_liggghts(a.liggghts))
    parameters = _parameters(a.set)
    check_physics(parameters, engine.model.fixed)
    seeds = range(a.seed, a.seed + a.replicates)
    out = a.out
    if out is not None and out.exists() and any(out.iterdir()):
        raise InputError(f"--out {out} is not empty; name a new directory")
    folders = {seed: out if a.replicates == 1 else out / f"seed-{seed}" for seed in seeds} if out else {}
    runs = _run_all(engine, parameters, seeds, a.workers or _cores(), folders)
    _refuse_if_all_failed(runs)
    if a.replicates == 1:
        result = _in_one_line(runs[0]) | {"seed": a.seed}
    else:
        found = replicates(runs)
        result = {**found.mean, **{f"{n}_sd": found.sd[n] for n in MEASURED}}
        result |= {RAYLEIGH_TIME_STEP: runs[0].responses[RAYLEIGH_TIME_STEP]}
        result |= {"replicates": found.used, "failed": found.failed, "runs": [_in_one_line(r) for r in runs]}
    result |= {"fidelity": a.fidelity, "variant": a.variant, "model_hash": engine.model_hash, **parameters}
    if a.json:
        _print_json(result)
    else:
        console = _results_console()
        console.print(_simulation_table(result, engine, parameters))
        if out:
            console.print(f"Deck, log, pictures and beads: {out}", highlight=False, soft_wrap=True)


def twin(a: Namespace) -> None:
    """Make a twin target."""
    engine = LiggghtsEngine(_model(a), find_liggghts(a.liggghts))
    parameters = _parameters(a.set)
    check_physics(parameters, engine.model.fixed)
    runs = _run_all(engine, parameters, range(a.seed, a.seed + a.replicates), a.workers or _cores(), {})
    _refuse_if_all_failed(runs)
    found = replicates(runs)
    chosen = " ".join(f"--set {shlex.quote(text)}" for text in a.set)
    command = (
        f"calstudy twin --fidelity {a.fidelity} --variant {a.variant} {chosen} "
        f"--seed {a.seed} --replicates {a.replicates} --out {a.out.name}"
    )
    write_twin(a.out, engine.model, engine.identity, parameters, found, " ".join(command.split()))
    if a.json:
        _print_json({**found.mean, **{f"{n}_sd": found.sd[n] for n in MEASURED}, "replicates": found.used})
    else:
        words = [f"{n} = {found.mean[n]:.5g} (sd {found.sd[n]:.2g}) {UNITS[n]}" for n in MEASURED]
        _results_console().print(
            f"{', '.join(words)} over {found.used} runs; written to {a.out}", highlight=False, soft_wrap=True
        )


def measure(a: Namespace) -> None:
    """Measure two pictures."""
    found = measure_pictures(
        a.top,
        a.side,
        sphere_diameter=1e-3 * a.sphere_diameter_mm,
        particle_diameter=1e-3 * a.particle_diameter_mm,
    )
    if a.json:
        _print_json(asdict(found))
        return
    heap = "" if found.heap else " (no heap: nothing stands above the first layer)"
    _results_console().print(
        f"angle of repose {found.angle_of_repose_deg:.2f} deg, radius {1e3 * found.radius:.2f} mm, "
        f"height {1e3 * found.height:.2f} mm{heap}",
        highlight=False,
    )


def doctor(a: Namespace) -> None:
    """Say what the machine has, and test LIGGGHTS."""
    program = find_liggghts(a.liggghts)
    free = shutil.disk_usage(Path.cwd()).free
    plan = plans.load_plan()
    model = load_model(plan.fixed, "tiny")
    # The cylinder is filled and hardly raised: it takes two seconds and shows that LIGGGHTS does its work.
    model = replace(model, schedule={**model.schedule, "lift_intervals": 4})
    run = _run_all(LiggghtsEngine(model, program), REFERENCE, [1], 1, {}, quiet=True)[0]
    works = run.outcome not in (Outcome.FAILED, Outcome.TIMED_OUT)
    state = {
        "calstudy": __version__,
        "liggghts": shlex.join(program.argv),
        "liggghts_version": program.version,
        "liggghts_proven_version": PROVEN_VERSION,
        "cores": _cores(),
        "disk_free_bytes": free,
        "self_test": "passed" if works else run.reason,
        "self_test_seconds": round(run.wall_time, 2),
    }
    if a.json:
        _print_json(state)
    else:
        out = _results_console()
        out.print(
            f"calstudy   {__version__}\nLIGGGHTS   {state['liggghts']}, version {program.version}",
            highlight=False,
        )
        if program.version != PROVEN_VERSION:
            out.print(f"           (calstudy is tested with {PROVEN_VERSION})", highlight=False)
        out.print(f"cores      {state['cores']}\ndisk free  {free / 1e9:.1f} GB here", highlight=False)
        if works:
            out.print(f"self-test  passed in {run.wall_time:.1f} s", highlight=False)
    if not works:
        raise RunError(f"the self-test failed: {run.reason}; check the LIGGGHTS installation")


# ---- shared by commands -----------------------------------------------------------------------------------


def _model(a: Namespace) -> AngleOfReposeModel:
    return load_model(plans.load_plan().fixed, a.fidelity, a.variant)


def _parameters(settings: Sequence[str]) -> dict[str, float]:
    """The reference point with what ``--set`` changes."""
    parameters = dict(REFERENCE)
    for text in settings:
        name, equals, number = text.partition("=")
        if name not in parameters or not equals:
            raise InputError(f"--set {text}: use NAME=VALUE with NAME one of {', '.join(parameters)}")
        try:
            parameters[name] = float(number)
        except ValueError as error:
            raise InputError(f"--set {text}: {number!r} is no number; give {name} in SI units") from error
    return parameters


def _run_all(
    engine: LiggghtsEngine,
    parameters: Mapping[str, float],
    seeds: Sequence[int],
    workers: int,
    folders: Mapping[int, Path],
    quiet: bool = False,
) -> list[Run]:
    """Runs that differ in their seed, in the order of the seeds; files are kept in the seeds' folders."""
    console = Console(stderr=True)
    with tempfile.TemporaryDirectory(prefix="calstudy-") as scratch, _stop_on_signals(console) as stop:

        def one(seed: int) -> Run:
            directory = Path(scratch) / str(seed)
            run = engine.run(parameters, seed, directory, stop)
            if seed in folders:
                _keep(engine, run, directory, folders[seed])
            return run

        with ThreadPoolExecutor(workers) as pool:
            answers = pool.map(one, seeds)
            if quiet:
                return list(answers)
            expected = progress.duration(engine.expected_seconds)
            title = f"{len(seeds)} DEM run(s) of about {expected}"
            return list(track(answers, title, total=len(seeds), console=console, transient=True))


def _keep(engine: LiggghtsEngine, run: Run, directory: Path, folder: Path) -> None:
    """Keep deck, log, pictures and beads of a run."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in (*engine.model.files, "parameters.in", "log.liggghts", "output.txt"):
            if (directory / name).exists():
                shutil.copy(directory / name, folder / name)
        if run.heap is not None:
            for name, view in (("top.png", top_view), ("side.png", side_view)):
                picture = view(
                    run.heap,
                    engine.model.particle_radius,
                    pixels_per_mm=engine.model.pixels_per_mm,
                    sphere_diameter=engine.model.sphere_diameter,
                )
                write_picture(folder / name, picture)
            pd.DataFrame(run.heap, columns=list("xyz")).to_parquet(folder / "heap.parquet", index=False)
    except OSError as error:
        raise SetupError(f"{folder}: cannot be written: {error.strerror}; choose another --out") from error


def _refuse_if_all_failed(runs: Sequence[Run]) -> None:
    if all(run.outcome in (Outcome.FAILED, Outcome.TIMED_OUT) for run in runs):
        raise RunError(f"the DEM run failed: {runs[0].reason}")


def _in_one_line(run: Run) -> dict[str, Any]:
    beads = {f"beads_{k}": v for k, v in asdict(run.beads).items()} if run.beads else {}
    return {
        **run.responses,
        "outcome": str(run.outcome),
        "reason": run.reason,
        "heap_radius": run.radius,
        "heap_height": run.height,
        **beads,
        "simulated_time": run.simulated_time,
        "wall_time": run.wall_time,
        "cpu_time": run.cpu_time,
    }


def _simulation_table(
    result: Mapping[str, Any], engine: LiggghtsEngine, parameters: Mapping[str, float]
) -> Table:
    model = engine.model
    table = Table(
        title=f"{model.name}, {model.fidelity.name} fidelity, {model.variant.name}: {model.variant.meaning}",
        title_justify="left",
    )
    table.add_column("")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, value in parameters.items():
        table.add_row(name, f"{value:.6g}", PARAMETER_UNITS[name])
    table.add_section()
    for name in RESPONSES:
        sd = f" (sd {result[f'{name}_sd']:.2g})" if f"{name}_sd" in result else ""
        table.add_row(name, f"{result[name]:.6g}{sd}", UNITS[name])
    table.add_section()
    if "runs" in result:
        table.add_row("runs", str(result["replicates"]), f"{result['failed']} failed")
        times = [run["wall_time"] for run in result["runs"]]
        table.add_row("wall time of a run", f"{sum(times) / len(times):.1f}", "s")
        return table
    table.add_row("outcome", result["outcome"], result["reason"])
    for name in ("heap_radius", "heap_height"):
        table.add_row(name, f"{1e3 * result[name]:.2f}", "mm")
    for name in ("beads_poured", "beads_filled", "beads_heap", "beads_lost"):
        table.add_row(name, str(result.get(name, "")), "")
    table.add_row("wall time", f"{result['wall_time']:.1f}", "s")
    return table


@contextmanager
def _stop_on_signals(console: Console) -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set; a second one ends the program at once."""
    stop = threading.Event()

    def handle(number: int, _: object) -> None:
        if stop.is_set():
            os._exit(130)
        stop.set()
        console.print("stopping; what is finished is kept (again: stop at once)", highlight=False)

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _results_console() -> Console:
    """Standard output; wide enough for the tables when it is no terminal."""
    return Console() if sys.stdout.isatty() else Console(width=140)


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _print_json(value: Any) -> None:
    print(json.dumps(_plain(value), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    """JSON's types: NaN is null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
