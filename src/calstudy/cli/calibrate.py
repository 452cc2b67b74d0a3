"""The command ``calibrate``: runs the calibration of a file, and prints its result."""

from __future__ import annotations

import logging
import threading
from argparse import Namespace
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from rich import table as rich_table

from calstudy.analysis.exhibit import Table
from calstudy.cli.options.choices import running
from calstudy.cli.terminal import (
    messages_console,
    print_json,
    print_paths,
    results_console,
    say,
    stop_on_signals,
)
from calstudy.disk.files import write_new
from calstudy.disk.ours import temporary
from calstudy.emulator.engine import EmulatorEngine, emulators_of
from calstudy.engines.choose import planned_engine
from calstudy.engines.interface import Engine
from calstudy.engines.queue import Executor
from calstudy.errors import FAILED_ROWS, MISSED, InputError, SetupError
from calstudy.report import progress
from calstudy.report import terminal as report
from calstudy.report.calibration import (
    lead,
    missed,
    parameters_table,
    responses_table,
    write_report,
)
from calstudy.report.solution_space import made_up_for_in_words, narrowing_table
from calstudy.report.terminal import print_failures
from calstudy.study.definition import Definition, example, example_of, read_definition
from calstudy.study.definition.advice import advice
from calstudy.study.directory.begun import begun_with
from calstudy.study.directory.session import duration
from calstudy.study.directory.store import read_lines
from calstudy.study.reading import Result
from calstudy.study.reread import keeping, reread
from calstudy.study.run.definition import calibrate_definition
from calstudy.study.run.estimate import estimate
from calstudy.study.run.refusal import refusal
from calstudy.study.run.taking import definition_work, settings_of, take_over
from calstudy.study.run.work import Running
from calstudy.study.settings import SETTINGS_FILE
from calstudy.study.status import failures

EXAMPLE_NAME = Path("calibration.toml")
log = logging.getLogger(__name__)


def calibrate(a: Namespace) -> int:
    """Calibrate what the file says, or write an example of such a file."""
    if a.init:
        return _write_example(a.file or EXAMPLE_NAME, a.tests)
    if a.tests is not None:
        raise InputError("--tests chooses the tests of a new file; give it with --init")
    if a.file is None:
        raise InputError("name the calibration's file, or write one with --init")
    directory, how = a.study or Path("studies") / a.file.stem, running(a)
    definition = read_definition(a.file, a.models, a.force, *begun_with(directory), a.ranks)
    if a.until is not None:
        definition = definition.reaching(a.until)
    console = messages_console()
    for line in advice(definition):
        say(console, line)
    if a.dry_run:
        return _print_dry_run(a, definition, directory, how.slots)
    with stop_on_signals(console) as stop:
        engines, executor = _engines(a, definition, how, stop)
        definition, result = calibrate_definition(
            definition,
            engines,
            executor,
            directory,
            how,
            stop,
            say=partial(say, console),
            watch=progress.watching(console),
        )
    return _print_outcome(a, definition, result, directory, how.scratch_of(directory))


def _engines(
    a: Namespace, definition: Definition, how: Running, stop: threading.Event
) -> tuple[Sequence[Engine], Executor]:
    """Engine of each model, and where its runs are made; emulators answer on this machine."""
    if a.emulator:
        return _emulators(a, definition), how.here(stop)
    return how.engines(definition.programs, stop)


def _emulators(a: Namespace, definition: Definition) -> list[EmulatorEngine]:
    if a.scheduler is not None:
        raise InputError("--emulator answers on this machine; leave --scheduler out")
    return emulators_of(definition.programs, a.emulator, definition.task.mode.grid is not None)


def _write_example(path: Path, tests: str | None) -> int:
    text = example() if tests is None else example_of([name.strip() for name in tests.split(",")])
    try:
        write_new(path, text.encode())
    except FileExistsError as error:
        raise InputError(f"{path} is there already; name another file") from error
    except OSError as error:
        raise SetupError(f"{path}: cannot be written: {error.strerror}; choose another name") from error
    print(f"{path} written; change it, then run: calstudy calibrate {path}")
    return 0


def _print_dry_run(a: Namespace, definition: Definition, directory: Path, workers: int) -> int:
    """Print the expected cost; raises if the directory holds another study."""
    task, programs = definition.task, definition.programs
    middle = task.space.complete(task.space.box.centre)
    seconds = [model.expected_seconds_at(middle) for model, _ in programs]
    engines: Sequence[Engine] = [planned_engine(model) for model, _ in programs]
    if a.emulator:
        engines = _emulators(a, definition)
        seconds = [engine.expected_seconds for engine in engines]
    definition, stored = take_over(definition, engines, directory)
    if not (directory / SETTINGS_FILE).exists():
        kept = [keeping(engine, directory.parent) for engine in engines]
        with temporary() as scratch:
            again = reread(kept, directory.parent, stored.known, scratch, threading.Event())
        definition, stored = take_over(definition, engines, directory, again)
    work = definition_work(definition, engines, directory, stored)
    models = len(definition.models)
    cheap = sum(seconds[models:]) / models
    found = estimate(work, seconds[:models], workers, cheap_seconds=cheap)
    if a.json:
        print_json(
            {
                "runs_sampling": found.runs_sampling,
                "runs_optimisation_expected": round(found.runs_optimisation),
                "runs_confirmation_expected": task.confirm * models,
                "runs_prior": 0 if definition.prior is None else len(definition.prior.runs),
                "core_hours_expected": round(found.core_hours, 2),
                "elapsed_seconds_expected": round(found.elapsed_seconds),
                "study": str(directory),
            }
        )
    else:
        results_console().print(
            f"{definition.path}: {found.runs_sampling} sampling runs and about "
            f"{found.runs_optimisation:.0f} of the second optimisation, "
            f"{task.confirm * models} of them to confirm its optimum, about "
            f"{found.core_hours:.2f} core-hours, {duration(found.elapsed_seconds)} with {workers} worker(s). "
            f"{'' if definition.prior is None else f'Prior: {definition.prior.in_words}. '}Nothing was run.",
            highlight=False,
            soft_wrap=True,
        )
    if other := refusal(definition, engines, work, workers, any_version=True):
        raise other
    return 0


def _print_outcome(
    a: Namespace, definition: Definition, result: Result | None, directory: Path, scratch: Path
) -> int:
    quantities = settings_of(definition, "").quantities
    if result is None:
        line = read_lines(directory, "calibrations", quantities)[0]
        if a.json:
            print_json(line)
        else:
            out = results_console()
            out.print(f"The calibration failed: {line['reason']}", style="bold red", highlight=False)
            evaluations = read_lines(directory, "evaluations", quantities)
            print_failures(out, directory, failures(evaluations), scratch)
        return FAILED_ROWS
    written = write_report(result, directory)
    code = MISSED if missed(result) else 0
    if a.json:
        print_json(_as_json(result) | {"report": str(written[0])})
        return code
    out = results_console()
    for table, shown in zip(
        (responses_table(result), parameters_table(result)), report.IN_SHORT, strict=True
    ):
        for part in _for_terminal(table, shown, out.width):
            out.print(part)
        for note in table.notes:
            out.print(note, highlight=False, soft_wrap=True)
    out.print(lead(result), highlight=False, soft_wrap=True)
    print_failures(out, directory, failures(read_lines(directory, "evaluations", quantities)), scratch)
    print_paths(out, "Report, other solutions, lines for a LIGGGHTS script:", written)
    return code


def _as_json(result: Result) -> dict[str, object]:
    solutions = result.solutions
    names = result.definition.task.space.box.names
    return {
        **result.line,
        "prior": _prior_as_json(result),
        "responses": responses_table(result).frame.to_dict("records"),
        "parameters": parameters_table(result).frame.to_dict("records"),
        "probability_all_within": None if result.confirmed is None else result.confirmed.all_within,
        "left_free": result.free,
        "in_the_way": result.bounds,
        "solutions": {
            "found": len(solutions.points),
            "share_of_box": solutions.share,
            "errors": solutions.errors,
            "correlations": dict(zip(names, map(list, solutions.correlations), strict=True)),
            "made_up_for": made_up_for_in_words(result),
            "narrowed": narrowing_table(result).frame.to_dict("records"),
        },
    }


def _prior_as_json(result: Result) -> dict[str, object] | None:
    """The earlier study that the calibration started from; None without one."""
    prior = result.definition.prior
    if prior is None:
        return None
    reason = result.line["reason"]
    told = {"place": prior.place, "study": prior.study, "of": prior.of, "runs": len(prior.runs)}
    return {**told, "agreed": not reason, "reason": reason}


def _for_terminal(table: Table, headings: Mapping[str, str], width: int) -> list[rich_table.Table]:
    """Some columns of a table as they are printed."""
    cells, names = table.cells(), [column.name for column in table.columns]
    columns = []
    for name, heading in headings.items():
        if name not in names:
            continue
        k = names.index(name)
        shown = [line[k] for line in cells]
        columns.append(
            report.Column(heading, shown, bool(table.columns[k].form), name in ("verdict", "remark"))
        )
    return report.fitted(columns, width, table.title)
