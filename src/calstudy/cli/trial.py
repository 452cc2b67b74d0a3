"""The commands ``adopt`` and ``try``: a script becomes a model folder, a folder proves itself in two runs."""

from __future__ import annotations

import math
from argparse import Namespace
from functools import partial
from pathlib import Path
from typing import Any

from calstudy.cli.terminal import messages_console, print_json, results_console, say, stop_on_signals
from calstudy.disk.files import write_atomically
from calstudy.disk.ours import make_directory
from calstudy.engines.choose import program_of
from calstudy.engines.engine import ProgramEngine
from calstudy.errors import InputError, SetupError
from calstudy.models.find import BESIDE
from calstudy.models.folder import FolderModel
from calstudy.models.trial.adopt import adopt, included
from calstudy.models.trial.runs import Trial
from calstudy.report.terminal import Column, fitted
from calstudy.study.definition import read_definition
from calstudy.study.directory.begun import start_there
from calstudy.study.reread import keeping
from calstudy.study.run.trial import require_sound
from calstudy.study.run.trial import try_models as run_trials
from calstudy.written import text_of


def adopt_script(a: Namespace) -> None:
    """Make a model folder of a script, and show what was changed and what is left to be said."""
    out = a.out or Path(BESIDE) / (a.script.stem if a.script.suffix else a.script.name.removeprefix("in."))
    if out.exists():
        raise InputError(f"{out} is there already; name another folder with --out")
    texts = _texts(a.script)
    adopted = adopt(a.script.name, texts)
    try:
        out.mkdir(parents=True)
        for name, text in {**texts, **adopted.files}.items():
            make_directory((out / name).parent, out)
            write_atomically(out / name, text.encode(), out)
    except OSError as error:
        raise SetupError(f"{out}: cannot be written: {error.strerror}; choose another with --out") from error
    print(adopted.changes or "The script needs no change.")
    print(f"{out}: model.toml and {', '.join(texts)} written.")
    for question in adopted.questions:
        print(f"model.toml still asks for {question}.")
    print("Other files that the script reads must be copied there. Then name the folder in a calibration's")
    print("file and run: calstudy try FILE.toml")


def _texts(script: Path) -> dict[str, str]:
    """The script and what it includes that lies below its folder, by name; InputError where it is none."""
    texts = {script.name: text_of(script)}
    waiting = [script.name]
    while waiting:
        for name in included(texts[waiting.pop()]):
            path = script.parent / name
            inside = ".." not in Path(name).parts
            if inside and path.is_file():
                place = Path(name).name if Path(name).is_absolute() else name
                if place not in texts:
                    texts[place] = text_of(path)
                    waiting.append(place)
    return texts


def try_models(a: Namespace) -> None:
    """Try every model of one's own that a calibration's file names; RunError for what is wrong with one."""
    directory = a.study or Path("studies") / a.file.stem
    definition = read_definition(a.file, a.models, a.force, start=start_there(directory), ranks=a.ranks)
    own = [model for model, _ in definition.programs if isinstance(model, FolderModel)]
    if not own:
        results_console().print(f"{a.file}: names shipped models alone, which need no trial.", soft_wrap=True)
        return
    console = messages_console()
    with stop_on_signals(console) as stop:
        programs = [ProgramEngine(model, program_of(model, a.liggghts)) for model in own]
        engines = [keeping(engine, directory.parent) for engine in programs]
        trials = run_trials(
            definition, engines, directory.parent, directory / "runs", stop, partial(say, console)
        )
    if a.json:
        print_json({name: _as_json(trial) for name, trial in trials.items()})
    else:
        for model in own:
            _print(model, trials[model.name])
    require_sound(trials)
    if not a.json:
        results_console().print(f"Ready: calstudy calibrate {a.file}", highlight=False, soft_wrap=True)


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
