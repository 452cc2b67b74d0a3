"""The command ``plan run``: calibrates rows of the plan."""

from __future__ import annotations

import shlex
import threading
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from rich.console import Console

from calstudy.cli.model import own_model
from calstudy.cli.options.choices import (
    chosen_emulator,
    chosen_target,
    parse_rows_option,
    running,
    target_of_tests,
)
from calstudy.cli.terminal import (
    messages_console,
    print_json,
    print_paths,
    results_console,
    say,
    stop_on_signals,
)
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.emulator.engine import EMULATOR, EmulatorEngine
from calstudy.emulator.replicates import CALIBRATIONS as REPLICATES
from calstudy.emulator.replicates import ROW_SECONDS, Replicates, run_replicated
from calstudy.engines.choose import DEFAULT, planned_engine
from calstudy.engines.interface import Engine, Model
from calstudy.errors import FAILED_ROWS, MISSED, InputError
from calstudy.models.angle_of_repose import DEFAULT_VARIANT, load_model
from calstudy.plan import Plan
from calstudy.plan_check import check
from calstudy.plan_file import load_plan
from calstudy.records import Target
from calstudy.report import progress
from calstudy.report import terminal as report
from calstudy.report.pictures import draw_rows, drawn_meanwhile
from calstudy.report.terminal import print_failures
from calstudy.study.campaign import Campaign, Summary
from calstudy.study.directory.elements import Element
from calstudy.study.directory.session import duration
from calstudy.study.directory.store import finished_rows
from calstudy.study.reading import read_study
from calstudy.study.run.estimate import Estimate, estimate
from calstudy.study.run.rows import Rows, fitting, further_models, rows_of
from calstudy.study.run.work import Running, Watch, Work, run
from calstudy.study.schema import TABLES
from calstudy.study.status import failures

TESTS_FIDELITY = "coarse"
"""Fidelity of a plan of several tests, unless another is asked for: that of its targets and of the shipped
emulators of all its tests."""
Lines = list[dict[str, Any]]
"""Lines of a table; pandas does not type the names of columns as strings."""


def plan_run(a: Namespace) -> int:
    """Calibrate rows of the plan."""
    plan, how = load_plan(a.plan), replace(running(a), element=_element(a))
    check(plan).refuse_if_wrong()
    rows = parse_rows_option(a.rows, plan) if a.rows else tuple(row.run for row in plan.rows)
    variant = a.variant or DEFAULT_VARIANT
    asked = a.fidelity or (_of_tests(a, plan) if plan.tests else None)
    emulator = chosen_emulator(
        a.engine or DEFAULT, a.emulator, asked, variant, a.scheduler, a.replicates, a.model
    )
    fidelity = asked or (emulator.origin.fidelity if emulator else None)
    own = own_model(a.model, {"fidelity": fidelity, "variant": a.variant}, a.force, a.ranks)
    model = fitting(plan, own or load_model(plan.fixed, fidelity or "soft", variant))
    cheap = _cheap(a, plan, variant)
    labels = [label for label in model.labels.values() if label]
    labels += [plan.name] if plan.tests else []
    labels += [a.cheap] if a.cheap else []
    answers = [f"emulator-{emulator.version}", *labels[1:]] if emulator else labels
    study = "-".join([*([model.name] if own else []), *answers, a.mode, str(a.seed)])
    given = rows_of(
        plan,
        rows,
        model,
        a.study or Path("studies") / study,
        mode=a.mode,
        budget=a.budget,
        seed=a.seed,
        share_samples=a.share_samples,
        cheap=cheap,
        confirm=a.confirm,
        further=further_models(plan, fidelity),
    )
    emulated = EmulatorEngine(model, emulator, rounded=given.mode.grid is not None) if emulator else None
    if a.dry_run:
        engine = emulated or planned_engine(model, a.engine)
        other = _emulated_cheap(cheap) if emulated else planned_engine(cheap, a.engine) if cheap else None
        further = _emulated_tests(given) if emulated else [planned_engine(m, a.engine) for m in given.further]
        work = given.work(engine, _target(a, given, [engine, *further]), other, further)
        which = f"of {model.title}" if own else f"at {model.labels['fidelity']} fidelity"
        return _print_dry_run(a, work, which, 0 if emulated else model.poured_beads)
    console = messages_console()
    tell, watch = partial(say, console), progress.watching(console)
    if emulated is not None and not (how.element or a.json):  # DEM runs need the processors for themselves
        watch = partial(_drawn, a.plan, rows, watch)
    repeated: Replicates | None = None
    with stop_on_signals(console) as stop:
        if emulated is None:
            both = [*given.models, *([(cheap, "")] if cheap else [])]
            (engine, *further), executor = how.engines(both, stop, a.engine)
            other = further.pop() if cheap else None
        else:
            engine, executor, other = emulated, how.here(stop), _emulated_cheap(cheap)
            further = _emulated_tests(given)
        work = given.work(engine, _target(a, given, [engine, *further]), other, further)
        if emulated is None or not a.replicates:
            summary = run(work, executor, how, stop, say=tell, watch=watch)
            if how.element:
                tell(_share_in_words(how.element, work, summary))
                work = replace(work, rows=summary.finished)
        else:
            summary, repeated = run_replicated(
                work,
                plan,
                emulated,
                a.replicates,
                executor,
                how,
                stop,
                say=tell,
                watch=watch,
                watch_replicates=partial(_watched, console),
            )
    code = _print_outcome(a, plan, work, how, summary)
    if repeated is not None:
        tell(
            f"{repeated.in_words()}: {work.directory / REPLICATES}; "
            f"their bands: calstudy analyse {work.directory}"
        )
        code = FAILED_ROWS if repeated.failed_rows else code
    return code


def _element(a: Namespace) -> Element | None:
    """Element of ``--array``; None without it."""
    if a.array is None:
        return None
    if a.scheduler or a.replicates or a.retry_failed:
        other = "scheduler" if a.scheduler else "replicates" if a.replicates else "retry-failed"
        raise InputError(f"--{other} is for one process that works alone; leave --array out")
    return Element(*a.array)


def _cheap(a: Namespace, plan: Plan, variant: str) -> Model | None:
    """The model at the fidelity of ``--cheap``; None without it."""
    if a.cheap is None:
        return None
    if a.replicates:
        raise InputError("--replicates repeats a study of one fidelity; leave --cheap out")
    own = own_model(a.model, {"fidelity": a.cheap, "variant": a.variant}, a.force)
    return fitting(plan, own or load_model(plan.fixed, a.cheap, variant))


def _of_tests(a: Namespace, plan: Plan) -> str:
    """Fidelity of a plan of several tests; InputError for an option that is about one model."""
    for option, given in (("model", a.model), ("cheap", a.cheap), ("emulator", a.emulator)):
        if given is not None:
            raise InputError(
                f"--{option} {given}: {plan.name} has models of its own, and their shipped emulators; leave "
                f"--{option} out"
            )
    return TESTS_FIDELITY


def _target(a: Namespace, given: Rows, engines: list[Engine]) -> Target:
    """Target of ``--target``."""
    if given.plan.tests:
        return target_of_tests(a.target, given.plan, given.model, engines)
    return chosen_target(a.target or "paper", given.plan, given.model, engines[0], a.force)


def _emulated_tests(given: Rows) -> list[Engine]:
    """The shipped emulators of the plan's further material tests."""
    rounded = given.mode.grid is not None
    return [EMULATOR.open(model, rounded=rounded, prefix=prefix) for model, prefix in given.models if prefix]


def _emulated_cheap(cheap: Model | None) -> EmulatorEngine | None:
    """The shipped emulator of the cheap fidelity; None without one."""
    if cheap is None:
        return None
    at = shipped_emulator(cheap.name, cheap.labels["fidelity"], cheap.labels["variant"])
    return EmulatorEngine(cheap, read_emulator(at), rounded=True)


def _share_in_words(element: Element, work: Work, summary: Summary) -> str:
    """Which rows an element calibrated, and what others have of those that are left."""
    left = sorted(set(work.rows) - finished_rows(work.directory))
    at_work = f"; row(s) {', '.join(map(str, left))} are being calibrated by others" if left else ""
    return f"{element}: {len(summary.finished)} row(s) calibrated here{at_work}"


@contextmanager
def _watched(console: Console, replicates: Replicates) -> Iterator[threading.Event]:
    """Show replicates. The event of the campaign is set when it ends, so they have their own."""
    with stop_on_signals(console) as stop, progress.shown(replicates.look, console):
        yield stop


@contextmanager
def _drawn(plan_file: Path | None, rows: Sequence[int], watch: Watch, campaign: Campaign) -> Iterator[None]:
    """Watch a campaign whose rows have their pictures drawn meanwhile."""
    directory = campaign.store.directory
    left = sorted(set(rows) - campaign.store.finished_rows())
    with watch(campaign), drawn_meanwhile(directory, plan_file, left):
        yield


def _print_dry_run(a: Namespace, work: Work, which: str, beads: int) -> int:
    """Print the expected cost, with ``beads`` in a DEM run; raises if the directory holds another study."""
    workers = running(a).slots
    # Calibrating costs more than the answers of an emulator.
    row_seconds = ROW_SECONDS if isinstance(work.tests[0].engine, EmulatorEngine) else None
    found = estimate(
        work,
        [test.engine.expected_seconds for test in work.tests],
        workers,
        cheap_seconds=sum(cheap.engine.expected_seconds for cheap in work.cheap),
        beads=beads,
        row_seconds=row_seconds,
        replicates=a.replicates or 0,
    )
    if a.json:
        print_json(_as_json(found, work.directory))
    else:
        _print_estimate(found, work.directory, which, workers)
    if other := work.other_study:
        raise other
    return 0


def _as_json(found: Estimate, directory: Path) -> dict[str, object]:
    return {
        "rows": found.rows,
        "rows_finished": found.rows_finished,
        "replicates": found.replicates,
        "runs_sampling": found.runs_sampling,
        "runs_optimisation_expected": round(found.runs_optimisation),
        "core_hours_expected": round(found.core_hours, 2),
        "elapsed_seconds_expected": round(found.elapsed_seconds),
        "bytes_stored_expected": round(found.bytes_stored),
        "bytes_scratch_expected": round(found.bytes_scratch),
        "study": str(directory),
    }


def _print_estimate(found: Estimate, directory: Path, which: str, workers: int) -> None:
    finished = f", {found.rows_finished} more are finished" if found.rows_finished else ""
    again = f", and {found.replicates} times as replicates," if found.replicates else ""
    results_console().print(
        f"{found.rows} row(s){again} {which} in {directory}{finished}: {found.runs_sampling} "
        f"sampling runs and about {found.runs_optimisation:.0f} of the second optimisation,\n"
        f"about {found.core_hours:.2f} core-hours, {duration(found.elapsed_seconds)} with {workers} "
        f"worker(s); {found.bytes_stored / 1e6:.1f} MB in the end, at most {found.bytes_scratch / 1e6:.1f} "
        "before. Nothing was run.",
        highlight=False,
        soft_wrap=True,
    )


def _print_outcome(a: Namespace, plan: Plan, work: Work, how: Running, summary: Summary) -> int:
    """Print the results of the rows; returns the exit code."""
    directory, settings = work.directory, work.settings
    study = read_study(directory, a.plan)
    chosen = study.calibrations[study.calibrations["row"].isin(work.rows)]
    lines = cast(Lines, chosen.to_dict("records"))
    if a.json:
        print_json(lines)
    else:
        out = results_console()
        report.print_results(out, lines, plan, settings)
        pictures = draw_rows(directory, study, summary.finished)
        found = failures(cast(Lines, study.evaluations.to_dict("records")))
        print_failures(out, directory, found, how.scratch_of(directory))
        tables = [directory / name for name in TABLES if name != "heaps" or not study.heaps.empty]
        print_paths(out, "Pictures:", pictures if len(pictures) <= 2 else [pictures[0].parent])
        print_paths(out, "Tables (pandas.read_parquet reads each):", tables)
        of_plan = f" --plan {shlex.quote(str(a.plan))}" if a.plan else ""
        print_paths(out, "Report:", [f"calstudy analyse {shlex.quote(str(directory))}{of_plan}"])
    if (chosen["outcome"] != "ok").any():
        return FAILED_ROWS
    return MISSED if any(report.missed(line, settings) for line in lines) else 0
