"""Models of one's own are tried before their first sample; the runs of the trial are kept in the project."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from calstudy.disk.files import Journal, cannot_write
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Engine
from calstudy.errors import RunError
from calstudy.models.folder import FolderModel
from calstudy.models.trial.runs import Trial, try_model
from calstudy.records import RAYLEIGH_TIME_STEP
from calstudy.study.definition import Definition
from calstudy.study.directory.journal import encode
from calstudy.study.run.work import Say, silent
from calstudy.study.stored import TRIALS, StoredRuns


def try_models(
    definition: Definition,
    engines: Sequence[Engine],
    project: Path,
    scratch: Path,
    stop: threading.Event,
    say: Say = silent,
    known: StoredRuns | None = None,
) -> Mapping[str, Trial]:
    """Try each model of one's own that this machine runs; by its name.

    A model that runs of the project prove already (``known``) needs no trial.
    """
    space, seed = definition.task.space, definition.task.seed
    ends = space.complete(space.box.lower), space.complete(space.box.upper)
    trials = {}
    for engine in engines:
        if not isinstance(engine, ProgramEngine) or not isinstance(engine.model, FolderModel):
            continue
        model = engine.model
        if known is not None and _proven(known, model.hash):
            continue
        say(f"Trial of {model.name}: two runs, about {model.expected_seconds:.0f} s each")
        plain = ProgramEngine(model, engine.program, kept=engine.kept)  # names as the model has them
        trials[model.name] = try_model(plain, ends, seed, scratch, stop)
        _keep(trials[model.name], project)
    return trials


def require_sound(trials: Mapping[str, Trial]) -> None:
    """RunError with what is wrong with a model, and what is likely to be done."""
    for name, trial in trials.items():
        if trial.faults:
            raise RunError(f"trial of {name}: {'; '.join(trial.faults)}")


def _proven(known: StoredRuns, model_hash: str) -> bool:
    """Whether each response of a model took two values in stored runs."""
    usable = [run.responses for run in known.runs.get(model_hash, {}).values() if run.usable]
    names = [name for name in (usable or [{}])[0] if name != RAYLEIGH_TIME_STEP]
    return len(usable) > 1 and all(len({run[name] for run in usable}) > 1 for name in names)


def _keep(trial: Trial, project: Path) -> None:
    """Keep the runs of a trial for the calibrations of the project; a broken one proves nothing."""
    try:
        project.mkdir(parents=True, exist_ok=True)
        journal = Journal(project / TRIALS, project)
        for evaluation in trial.evaluations:
            if not evaluation.run.broke and not trial.faults:
                journal.append(encode(evaluation))
    except OSError as error:
        raise cannot_write(project / TRIALS, error) from error
