"""The command ``reread``: reads kept runs anew with a corrected reader or marker, and runs nothing."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

from calstudy.cli.terminal import messages_console, print_json, results_console, stop_on_signals
from calstudy.disk.ours import temporary
from calstudy.engines.choose import program_of
from calstudy.engines.engine import ProgramEngine
from calstudy.errors import RunError
from calstudy.report.terminal import Column, fitted
from calstudy.study.definition import read_definition
from calstudy.study.directory.begun import start_there
from calstudy.study.reread import KEPT, Reread, keeping, remember, reread
from calstudy.study.run.taking import take_over


def reread_runs(a: Namespace) -> int:
    """Read the project's kept runs with the models of a calibration's file as they are now."""
    directory = a.study or Path("studies") / a.file.stem
    definition = read_definition(a.file, a.models, a.force, start=start_there(directory), ranks=a.ranks)
    project = directory.parent
    programs = [
        ProgramEngine(model, program_of(model, a.liggghts), prefix) for model, prefix in definition.programs
    ]
    engines = [keeping(engine, project) for engine in programs]
    known = take_over(definition, engines, directory)[1].known
    with stop_on_signals(messages_console()) as stop, temporary() as scratch:
        found = reread(engines, project, (), scratch, stop)
    new = [of_model.but(known) for of_model in found]
    remember(new, project)
    if a.json:
        print_json({of_model.model.name: _as_json(of_model) for of_model in found})
    elif not found:
        results_console().print(
            f"{project / KEPT}: no kept run was made by the models of {a.file} as they are now; "
            "'try' and 'calibrate' keep what runs write.",
            highlight=False,
            soft_wrap=True,
        )
    else:
        for of_model in found:
            _print(of_model)
    if found and not any(of_model.read for of_model in found):
        raise RunError(f"no kept run gives a result: {found[0].reasons[0]}; correct model.toml or the reader")
    return 0


def _print(found: Reread) -> None:
    out = results_console()
    responses = found.model.responses
    values = [[e.run.responses[r.name] for e in found.read] for r in responses]
    columns = [
        Column("", [r.name for r in responses], False),
        Column("lowest", [f"{min(v):.6g}" if v else "-" for v in values], True),
        Column("highest", [f"{max(v):.6g}" if v else "-" for v in values], True),
        Column("unit", [r.unit for r in responses], False),
    ]
    for part in fitted(columns, out.width, found.model.name):
        out.print(part)
    out.print(f"{found.in_words}. No DEM run was made.", highlight=False, soft_wrap=True)


def _as_json(found: Reread) -> dict[str, object]:
    return {
        "runs": [
            {"parameters": dict(e.request.parameters), "seed": e.request.seed, **dict(e.run.responses)}
            for e in found.read
        ],
        "failed": len(found.evaluations) - len(found.read),
        "reasons": found.reasons,
    }
