"""The commands that calibrate rows of the plan: ``plan run``, and ``plan rerun`` beside what was shipped."""

from __future__ import annotations

import shlex
import threading
import time
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from rich.console import Console
from rich.table import Table

from calstudy import plan as plans
from calstudy.calibration.modes import Mode, mode_of
from calstudy.calibration.task import (
    Task,
    expected_batches,
    expected_optimisation_runs,
    least_waves,
    tasks_of,
)
from calstudy.cli.choices import _target, chosen_emulator, parse_rows_option
from calstudy.cli.terminal import messages_console, print_json, results_console, say, stop_on_signals
from calstudy.emulator.emulator import Emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.emulator.replicates import CALIBRATIONS as REPLICATES
from calstudy.emulator.replicates import ROW_SECONDS, Replicates, Replication
from calstudy.engines.choose import (
    engines_and_executor,
    planned_engine,
    program_that_made,
)
from calstudy.engines.interface import Engine
from calstudy.engines.queue import Executor, LocalExecutor, cores
from calstudy.errors import FAILED_ROWS, InputError, StoreError
from calstudy.models.angle_of_repose import AngleOfReposeModel, load_model
from calstudy.models.heap import UNITS
from calstudy.plan_check import check
from calstudy.plan_file import load_plan
from calstudy.records import Request, proportional
from calstudy.report import progress
from calstudy.report import terminal as report
from calstudy.report.pictures import draw_row
from calstudy.report.terminal import print_failures
from calstudy.study.campaign import MaterialTest, Summary
from calstudy.study.reading import RowComparison, Study, compare_row, read_study, requests_of
from calstudy.study.run import MISSED, Running, Work, plan_settings, print_paths, run
from calstudy.study.schema import TABLES
from calstudy.study.session import duration
from calstudy.study.settings import StudySettings
from calstudy.study.status import failures
from calstudy.study.store import (
    Store,
    finished_replicates,
    finished_rows,
    grid_there,
    mismatch,
    version_there,
)

Lines = list[dict[str, Any]]
"""Of a table; pandas does not say that the names of its columns are strings."""
OTHERWISE = 10
"""Exit code where a row that was run again came out otherwise."""


def plan_run(a: Namespace) -> int:
    """Calibrate rows of the plan."""
    plan = load_plan(a.plan)
    check(plan).refuse_if_wrong()
    rows = parse_rows_option(a.rows, plan) if a.rows else tuple(row.run for row in plan.rows)
    emulator = chosen_emulator(a.engine, a.emulator, a.fidelity, a.variant, a.scheduler, a.replicates)
    a.fidelity = a.fidelity or (emulator.origin.fidelity if emulator else "soft")
    model = load_model(plan.fixed, a.fidelity, a.variant)
    answers = f"emulator-{emulator.version}" if emulator else a.fidelity
    directory = a.study or Path("studies") / f"{answers}-{a.variant}-{a.mode}-{a.seed}"
    mode = mode_of(a.mode, a.budget, grid_there(directory)).knowing(proportional(model.responses))
    version = version_there(directory)
    if a.dry_run:
        stand_in = _emulated(model, emulator, mode) if emulator else planned_engine(model, a.engine)
        settings = _settings(a, plan, model, mode, stand_in, version)
        other = mismatch(directory, settings, any_version=True)
        tasks = tasks_of(plan, settings.target, mode, a.seed, a.share_samples)
        chosen = {row: tasks[row] for row in rows}
        begun = None if other else directory
        _print_estimate(a, chosen, plan, model, stand_in, directory, begun, a.workers or cores())
        if other:
            raise other
        return 0
    console = messages_console()
    with stop_on_signals(console) as stop:
        engine, executor = _engine_and_executor(a, model, emulator, mode, stop)
        settings = _settings(a, plan, model, mode, engine, version)
        of = None
        if emulator is not None and a.replicates:
            of = Replication(settings, plan, rows, mode, model, emulator)
        work = _Work(plan, rows, mode, settings, directory)
        summary, repeated = _calibrate(a, work, engine, executor, stop, console, of)
    code = _print_outcome(a, plan, settings, directory, rows, summary)
    if repeated is not None:
        console.print(
            f"{repeated.in_words()}: {directory / REPLICATES}; their bands: calstudy analyse {directory}",
            highlight=False,
            soft_wrap=True,
        )
        code = FAILED_ROWS if repeated.failed_rows else code
    return code


def _settings(
    a: Namespace, plan: plans.Plan, model: AngleOfReposeModel, mode: Mode, engine: Engine, calstudy: str
) -> StudySettings:
    """What makes two studies the same."""
    target = _target(a, plan, model, engine)
    return plan_settings(plan, model, engine.identity, mode, target, a.seed, a.share_samples, calstudy)


def plan_rerun(a: Namespace) -> int:
    """Run rows of a study again, by its own settings, and compare run by run."""
    there = read_study(a.study, a.plan)
    was = there.settings
    rows = parse_rows_option(a.rows, there.plan)
    if missing := sorted(set(rows) - set(there.calibrations["row"])):
        raise InputError(f"--rows: {a.study} has no row {missing[0]} to compare with; choose a finished one")
    program = program_that_made(was.engine)
    if program is None:
        raise InputError(f"{a.study} was made by {was.engine}; make it again with 'calstudy plan run'")
    model = load_model(there.plan.fixed, was.fidelity, was.variant)
    if model.hash != was.model_hash:
        raise StoreError(
            f"{a.study} was made with deck {was.deck} of the model, hash {was.model_hash[:12]}, here it is "
            f"{model.deck}, {model.hash[:12]}; take the calstudy that made it"
        )
    directory = a.out or Path("studies") / f"rerun-{was.id}"
    if a.dry_run:
        done = there.calibrations[there.calibrations["row"].isin(rows)]
        runs, hours = int(done["runs_total"].sum()), done["cpu_time"].sum() / 3600
        if a.json:
            print_json({"rows": rows, "runs": runs, "core_hours": hours})
        else:
            results_console().print(f"{len(rows)} row(s) took {runs} DEM runs, {hours:.2f} core-hours.")
        settings = replace(was, calstudy=version_there(directory))
        if other := mismatch(directory, settings, "--out", any_version=True):
            raise other
        return 0
    console = messages_console()
    with stop_on_signals(console) as stop:
        (engine,), executor = engines_and_executor(a, [(model, "")], stop, program)
        settings = replace(was, engine=engine.identity, calstudy=version_there(directory))
        follow = requests_of(there, rows)
        as_it_was = mode_of(was.mode, was.budget, was.grid).knowing(proportional(model.responses))
        work = _Work(there.plan, rows, as_it_was, settings, directory, follow, "--out")
        _calibrate(a, work, engine, executor, stop, console)
    again = read_study(directory, a.plan)
    return _print_comparison(a, there, again, [compare_row(there, again, row) for row in rows])


@dataclass(frozen=True, slots=True)
class _Work:
    """Rows to be calibrated, and where they go."""

    plan: plans.Plan
    rows: Sequence[int]
    mode: Mode
    settings: StudySettings
    directory: Path
    follow: Sequence[Request] = ()
    """What another study's rows asked for, to be asked again."""
    option: str = "--study"
    """What names the directory on the command line."""


def _calibrate(
    a: Namespace,
    work: _Work,
    engine: Engine,
    executor: Executor,
    stop: threading.Event,
    console: Console,
    of: Replication | None = None,
) -> tuple[Summary, Replicates | None]:
    """Calibrate rows into a study directory, then its replicates; closes the executor."""
    settings, directory = work.settings, work.directory
    tell = partial(say, console)
    tell(f"Study {directory}: {len(work.rows)} row(s), {executor.slots} DEM run(s) at once")
    tell(f"Target: {settings.target.origin}")
    if work.mode.takes_noise:
        tell(f"Noise: {_noise_in_words(settings.noise)}")
    deadline = None if a.time_limit is None else time.monotonic() + a.time_limit
    made: list[Replicates] = []

    def then(store: Store) -> _Repeated:
        assert of is not None
        made.append(Replicates(of, a.replicates, store, workers=a.workers or cores(), deadline=deadline))
        return _Repeated(made[0], console)

    summary = run(
        Work(
            _tasks(work),
            work.rows,
            [MaterialTest(engine, plans.PARAMETERS)],
            settings,
            directory,
            work.follow,
            work.option,
        ),
        executor,
        Running(a.workers, a.time_limit, _scratch(a, directory), a.keep_runs, a.retry_failed),
        stop,
        say=tell,
        watch=lambda campaign: progress.shown(partial(progress.look_at, campaign), console),
        then=then if of else None,
    )
    return summary, made[0] if made else None


@dataclass(frozen=True, slots=True)
class _Repeated:
    """Replicates that follow the study's own rows."""

    replicates: Replicates
    console: Console

    def run(self) -> None:
        """Run them; the campaign's event is set when it ends, so they have their own."""
        say(
            self.console,
            f"Replicates: each with seed and draw of its own, {self.replicates.workers} at once",
        )
        with stop_on_signals(self.console) as stop, progress.shown(self.replicates.look, self.console):
            self.replicates.run(stop)

    def in_words(self) -> str:
        """How many are finished."""
        return self.replicates.in_words()


def _tasks(work: _Work) -> Mapping[int, Task]:
    s = work.settings
    return tasks_of(work.plan, s.target, work.mode, s.seed, s.share_samples, s.noise)


def _scratch(a: Namespace, directory: Path) -> Path:
    """Where DEM runs work; absolute for the workers of a cluster, which work elsewhere."""
    scratch: Path = a.scratch or directory / "runs"
    return scratch.absolute() if a.scheduler else scratch


def _engine_and_executor(
    a: Namespace, model: AngleOfReposeModel, emulator: Emulator | None, mode: Mode, stop: threading.Event
) -> tuple[Engine, Executor]:
    """What runs the model, and where: an emulator always answers here."""
    if emulator is not None:
        return _emulated(model, emulator, mode), LocalExecutor(a.workers or cores(), stop)
    (engine,), executor = engines_and_executor(a, [(model, "")], stop, a.engine)
    return engine, executor


def _emulated(model: AngleOfReposeModel, emulator: Emulator, mode: Mode) -> EmulatorEngine:
    return EmulatorEngine(model, emulator, rounded=mode.grid is not None)


def _noise_in_words(noise: Mapping[str, float] | None) -> str:
    if noise is None:
        return "never measured for this model; each row estimates it from its own runs"
    return ", ".join(f"{name} {sd:.3g}" for name, sd in noise.items()) + " from seed to seed, as measured"


def _print_outcome(
    a: Namespace,
    plan: plans.Plan,
    settings: StudySettings,
    directory: Path,
    rows: Sequence[int],
    summary: Summary,
) -> int:
    study = read_study(directory, a.plan)
    chosen = study.calibrations[study.calibrations["row"].isin(rows)]
    lines = cast(Lines, chosen.to_dict("records"))
    if a.json:
        print_json(lines)
    else:
        out = results_console()
        report.print_results(out, lines, plan, settings)
        pictures = [path for row in summary.finished for path in draw_row(directory, study, row)]
        found = failures(cast(Lines, study.evaluations.to_dict("records")))
        print_failures(out, directory, found, _scratch(a, directory))
        tables = [directory / name for name in TABLES if name != "heaps" or not study.heaps.empty]
        print_paths(out, "Pictures:", pictures if len(pictures) <= 2 else [pictures[0].parent])
        print_paths(out, "Tables (pandas.read_parquet reads each):", tables)
        of_plan = f" --plan {shlex.quote(str(a.plan))}" if a.plan else ""
        print_paths(out, "Report:", [f"calstudy analyse {shlex.quote(str(directory))}{of_plan}"])
    if (chosen["outcome"] != "ok").any():
        return FAILED_ROWS
    return MISSED if any(report.missed(line, settings) for line in lines) else 0


def _print_estimate(
    a: Namespace,
    tasks: Mapping[int, Task],
    plan: plans.Plan,
    model: AngleOfReposeModel,
    engine: Engine,
    directory: Path,
    begun: Path | None,
    workers: int,
) -> None:
    """Say what would be run in ``directory``; ``begun`` is the same where it holds this very study."""
    done = finished_rows(begun) if begun else set()
    rows = [row for row in tasks if row not in done]
    sampling, optimisation = _expected_runs({row: tasks[row] for row in rows}, plan)
    runs = sampling + optimisation
    repeated = finished_replicates(begun) if begun else []
    replicates = sum(k not in repeated for k in range(1, (a.replicates or 0) + 1))
    seconds = runs * engine.expected_seconds
    if isinstance(engine, EmulatorEngine):  # its answers cost less than what is made of them
        seconds = (len(rows) + replicates * len(tasks)) * ROW_SECONDS
    longest = max((least_waves(expected_batches(tasks[row]), 1, workers) for row in rows), default=0)
    elapsed = max(seconds, longest * engine.expected_seconds * workers) / workers
    beads = 0 if isinstance(engine, EmulatorEngine) else model.fidelity.poured_beads
    stored = len(rows) * (62_000 + 10 * beads) + 150 * runs
    journals = runs * (1_000 + 4 * beads)
    scratch = workers * 250 * beads + journals
    if len(done | set(rows)) < len(plan.rows):
        stored += journals  # they go with the plan's last row
    stored += replicates * (60_000 + 70 * sum(_expected_runs(tasks, plan)))
    estimate = {
        "rows": len(rows),
        "rows_finished": len(tasks) - len(rows),
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
    finished = f", {estimate['rows_finished']} more are finished" if done & set(tasks) else ""
    again = f", and {replicates} times as replicates," if replicates else ""
    out.print(
        f"{len(rows)} row(s){again} at {a.fidelity} fidelity in {directory}{finished}: {sampling} sampling "
        f"runs and about {estimate['runs_optimisation_expected']} of the second optimisation,\n"
        f"about {estimate['core_hours_expected']} core-hours, {duration(elapsed)}"
        f" with {workers} worker(s); {stored / 1e6:.1f} MB in the end, at most {scratch / 1e6:.1f} before. "
        "Nothing was run.",
        highlight=False,
        soft_wrap=True,
    )


def _expected_runs(tasks: Mapping[int, Task], plan: plans.Plan) -> tuple[int, float]:
    """Sampling runs of rows, samples that they share counted once, and runs of their second optimisations."""
    sampled = {task.sampled_as for task in tasks.values()}
    return sum(plan.row(row).samples for row in sampled), sum(map(expected_optimisation_runs, tasks.values()))


def _print_comparison(a: Namespace, there: Study, again: Study, found: Sequence[RowComparison]) -> int:
    if a.json:
        print_json([asdict(comparison) | {"same": comparison.same} for comparison in found])
    else:
        out = results_console()
        table = Table("row", "DEM runs", "run again", "equal", "first that differs", title=f"{a.study} again")
        names = list(found[0].largest)
        for name in names:
            table.add_column(f"samples differ, {name} in {UNITS[name]}")
        for c in found:
            cells = (c.row, c.runs, c.runs_again, c.equal)
            largest = (f"{c.largest[name]:.4g}" for name in names)
            table.add_row(
                *map(str, cells), c.first_difference or "none: all digits of the runs are equal", *largest
            )
        out.print(table)
        for name in ("engine", "calstudy"):
            was, now = (getattr(study.settings, name) for study in (there, again))
            if was != now:
                out.print(f"{name}: {was} made the study, {now} made it again", highlight=False)
        if not all(c.same for c in found):
            program = there.settings.engine.split()[0]
            out.print(
                f"Another build of {program}, or another processor, may round otherwise, and collisions "
                "amplify a last digit: then runs differ by their noise, and the row goes its own way.",
                highlight=False,
                soft_wrap=True,
            )
    return 0 if all(c.same for c in found) else OTHERWISE
