"""The command ``calibrate``: builds the parts of one's own calibration, runs it, prints what comes out."""

from __future__ import annotations

import logging
from argparse import Namespace
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from rich import table as rich_table

from calstudy.analysis.exhibit import Table
from calstudy.calibration.task import (
    expected_batches,
    expected_optimisation_runs,
    least_waves,
    number_of_samples,
)
from calstudy.cli.terminal import messages_console, print_json, results_console, say, stop_on_signals
from calstudy.engines.choose import engines_and_executor, planned_engine
from calstudy.engines.queue import cores
from calstudy.errors import FAILED_ROWS, InputError, SetupError
from calstudy.report import progress
from calstudy.report import terminal as report
from calstudy.report.calibration import (
    lead,
    missed,
    parameters_table,
    responses_table,
    write_report,
)
from calstudy.report.terminal import print_failures
from calstudy.study.definition import ROW, Definition, example, read_definition
from calstudy.study.reading import Result
from calstudy.study.run import MISSED, Running, print_paths, run_calibration, settings_of
from calstudy.study.session import duration
from calstudy.study.status import failures
from calstudy.study.store import finished_rows, grid_there, mismatch, read_lines, version_there

EXAMPLE_NAME = Path("calibration.toml")
ON_TERMINAL: tuple[Mapping[str, str], Mapping[str, str]] = (
    {
        "response": "",
        "target": "target",
        "tolerance": "tolerance",
        "optimum": "optimum",
        "noise": "noise",
        "unit": "unit",
        "verdict": "",
    },
    {
        "parameter": "",
        "interval": "interval",
        "optimum": "optimum",
        "solutions_low": "others\nfrom",
        "solutions_high": "\nto",
        "unit": "unit",
        "remark": "",
    },
)
"""Columns of the tables of responses and parameters, with their headings."""
log = logging.getLogger(__name__)


def calibrate(a: Namespace) -> int:
    """Calibrate what the file says, or write an example of such a file."""
    if a.init:
        return _write_example(a.file or EXAMPLE_NAME)
    if a.file is None:
        raise InputError("name the calibration's file, or write one with --init")
    directory = a.study or Path("studies") / a.file.stem
    definition = read_definition(a.file, a.models, a.force, grid_there(directory))
    scratch = a.scratch or directory / "runs"
    scratch = scratch.absolute() if a.scheduler else scratch  # workers work elsewhere
    if a.dry_run:
        planned = planned_engine(definition.programs[0][0])
        settings = settings_of(definition, planned.identity, version_there(directory))
        other = mismatch(directory, settings, any_version=True)
        _print_estimate(a, definition, directory, is_done=not other and ROW in finished_rows(directory))
        if other:
            raise other
        return 0
    console = messages_console()
    how = Running(a.workers, a.time_limit, scratch, a.keep_runs, a.retry_failed)
    with stop_on_signals(console) as stop:
        engines, executor = engines_and_executor(a, definition.programs, stop)
        result = run_calibration(
            definition,
            engines,
            directory,
            executor,
            how,
            stop,
            say=partial(say, console),
            watch=lambda campaign: progress.shown(partial(progress.look_at, campaign), console),
        )
    return _print_outcome(a, definition, result, directory, scratch)


def _write_example(path: Path) -> int:
    try:
        with path.open("x") as file:
            file.write(example())
    except FileExistsError as error:
        raise InputError(f"{path} is there already; name another file") from error
    except OSError as error:
        raise SetupError(f"{path}: cannot be written: {error.strerror}; choose another name") from error
    print(f"{path} written; change it, then run: calstudy calibrate {path}")
    return 0


def _print_estimate(a: Namespace, definition: Definition, directory: Path, is_done: bool) -> None:
    task, models = definition.task, definition.models
    sets = (0, 0) if is_done else (number_of_samples(task), expected_optimisation_runs(task))
    middle = task.space.complete(task.space.box.centre)
    seconds = sum(chosen.model.expected_seconds_at(middle) for chosen in models)
    waves = least_waves(expected_batches(task), len(models), a.workers or cores())
    elapsed = 0.0 if is_done else waves * seconds / len(models)
    estimate = {
        "runs_sampling": sets[0] * len(models),
        "runs_optimisation_expected": round(sets[1] * len(models)),
        "core_hours_expected": round(sum(sets) * seconds / 3600, 2),
        "elapsed_seconds_expected": round(elapsed),
        "study": str(directory),
    }
    if a.json:
        print_json(estimate)
        return
    results_console().print(
        f"{definition.path}: {estimate['runs_sampling']} sampling runs and about "
        f"{estimate['runs_optimisation_expected']} of the second optimisation, about "
        f"{estimate['core_hours_expected']} core-hours, "
        f"{duration(elapsed)} with "
        f"{a.workers or cores()} worker(s). Nothing was run.",
        highlight=False,
        soft_wrap=True,
    )


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
    for table, shown in zip((responses_table(result), parameters_table(result)), ON_TERMINAL, strict=True):
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
        "responses": responses_table(result).frame.to_dict("records"),
        "parameters": parameters_table(result).frame.to_dict("records"),
        "left_free": result.free,
        "in_the_way": result.bounds,
        "solutions": {
            "found": len(solutions.points),
            "drawn": solutions.drawn,
            "correlations": dict(zip(names, map(list, solutions.correlations), strict=True)),
        },
    }


def _for_terminal(table: Table, headings: Mapping[str, str], width: int) -> list[rich_table.Table]:
    """Some columns of a table as they are printed."""
    cells, names = table.cells(), [column.name for column in table.columns]
    columns = []
    for name, heading in headings.items():
        k = names.index(name)
        shown = [line[k] for line in cells]
        columns.append(
            report.Column(heading, shown, bool(table.columns[k].form), name in ("verdict", "remark"))
        )
    return report.fitted(columns, width, table.title)
