"""The command ``try``: runs each model of one's own twice before any sample, and shows what was read."""

from __future__ import annotations

import math
import tempfile
import threading
from argparse import Namespace
from pathlib import Path
from typing import Any

from calstudy.cli.terminal import messages_console, print_json, results_console, say, stop_on_signals
from calstudy.engines.choose import profile_of
from calstudy.engines.engine import ProgramEngine
from calstudy.errors import RunError
from calstudy.models.folder import FolderModel
from calstudy.models.trial.runs import Trial, try_model
from calstudy.report.terminal import Column, fitted
from calstudy.study.definition import Definition, read_definition


def try_models(a: Namespace) -> None:
    """Try every model of one's own that a calibration's file names; RunError for what is wrong with one."""
    definition = read_definition(a.file, a.models, a.force)
    own = [model for model, _ in definition.programs if isinstance(model, FolderModel)]
    if not own:
        results_console().print(f"{a.file}: names shipped models alone, which need no trial.", soft_wrap=True)
        return
    program = profile_of().find(a.liggghts)
    console = messages_console()
    with stop_on_signals(console) as stop, tempfile.TemporaryDirectory(prefix="calstudy-") as scratch:
        trials = {}
        for model in own:
            say(console, f"{model.name}: two runs, {model.expected_seconds:.0f} s each are expected")
            engine = ProgramEngine(model, program)
            trials[model.name] = _try(engine, definition, Path(scratch), stop)
    if a.json:
        print_json({name: _as_json(trial) for name, trial in trials.items()})
    else:
        for model in own:
            _print(model, trials[model.name])
    for name, trial in trials.items():
        if trial.faults:
            raise RunError(f"{name}: {'; '.join(trial.faults)}")
    if not a.json:
        results_console().print(f"Ready: calstudy calibrate {a.file}", highlight=False, soft_wrap=True)


def _try(
    engine: ProgramEngine[FolderModel], definition: Definition, scratch: Path, stop: threading.Event
) -> Trial:
    space = definition.task.space
    ends = space.complete(space.box.lower), space.complete(space.box.upper)
    return try_model(engine, ends, definition.task.seed, scratch, stop)


def _print(model: FolderModel, trial: Trial) -> None:
    out = results_console()
    ends = ("lower", "upper")[: len(trial.runs)]
    units = {response.name: response.unit for response in model.responses}
    columns = [
        Column("", list(units), False),
        *(
            Column(f"{end} ends", [_number(run.responses[name]) for name in units], True)
            for end, run in zip(ends, trial.runs, strict=True)
        ),
        Column("unit", list(units.values()), False),
        Column("read in", [trial.shown.get(name, "") for name in units], False, True),
    ]
    for part in fitted(columns, out.width, model.name):
        out.print(part)
    if math.isfinite(trial.seconds):
        out.print(
            f"A run took {trial.seconds:.1f} s; model.toml expects {model.expected_seconds:g} s.",
            highlight=False,
        )


def _as_json(trial: Trial) -> dict[str, Any]:
    return {
        "responses": [dict(run.responses) for run in trial.runs],
        "read_in": dict(trial.shown),
        "seconds": trial.seconds,
        "faults": list(trial.faults),
    }


def _number(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else "-"
