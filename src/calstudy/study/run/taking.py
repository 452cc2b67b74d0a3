"""A calibration with its engines, what the project has of its runs, and its study, before anything is run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calstudy import __version__
from calstudy.engines.interface import Engine
from calstudy.errors import InputError
from calstudy.study.answers import MaterialTest
from calstudy.study.definition import ROW, Definition
from calstudy.study.directory.begun import version_there
from calstudy.study.fidelities import labels_of, run_by
from calstudy.study.prior import Prior
from calstudy.study.reread import Reread
from calstudy.study.run.work import Work
from calstudy.study.settings import SETTINGS_FILE, StudySettings, read_settings
from calstudy.study.stored import Part, StoredRuns, stored_in, stored_runs


def take_over(
    definition: Definition, engines: Sequence[Engine], directory: Path, again: Sequence[Reread] = ()
) -> tuple[Definition, StoredRuns]:
    """What the project has of a calibration's runs, and the calibration with its samples among them.

    ``again`` are kept runs that were read anew and are not on disk yet. A study that was begun keeps
    those with which it was begun.
    """
    parts = [
        Part(model, engine.identity, prefix)
        for engine, (model, prefix) in zip(engines, definition.programs, strict=True)
    ]
    both = (parts[: len(definition.models)], parts[len(definition.models) :])
    found = [stored_runs(directory, definition.task, part, again) for part in both if part]
    # Samples are those of the cheap fidelity, if there is one.
    stored = replace(
        found[-1],
        runs={model: runs for one in found for model, runs in one.runs.items()},
        places=tuple(dict.fromkeys(place for one in found for place in one.places)),
    )
    if (directory / SETTINGS_FILE).exists():
        return definition.taking_over(stored_in(read_settings(directory))), stored
    if definition.prior is not None:
        _require_others(definition.path, definition.prior, stored)
    return definition.taking_over(stored.samples), stored


def _require_others(file: Path, prior: Prior, stored: StoredRuns) -> None:
    """InputError where runs would count twice: as samples, and as those of the earlier study."""
    known, samples = stored.known, [dict(sample.parameters) for sample in stored.samples]
    same = sum({*run.run_id.split("+")} <= {*known} and dict(run.parameters) in samples for run in prior.runs)
    if same:
        raise InputError(
            f"{file}: start: {same} run(s) of {prior.place} are of this very model and serve as samples "
            "without it; leave start out"
        )


def definition_work(
    definition: Definition, engines: Sequence[Engine], directory: Path, stored: StoredRuns | None = None
) -> Work:
    """A definition with its engines, one for each model, and its study."""
    identity = "+".join(dict.fromkeys(engine.identity for engine in engines))
    tests = [
        MaterialTest(engine, tuple(model.parameters))
        for engine, (model, _) in zip(engines, definition.programs, strict=True)
    ]
    settings = settings_of(definition, identity, version_there(directory))
    task, models = run_by(definition.task, engines[0]), len(definition.models)
    return Work(
        {ROW: task},
        [ROW],
        tests[:models],
        settings,
        directory,
        stored=stored,
        models=definition.told,
        cheap=tests[models:],
        prior=definition.prior,
    )


def settings_of(definition: Definition, engine: str, calstudy: str = __version__) -> StudySettings:
    """Settings that identify a calibration; ``calstudy`` is the version that began its study."""
    task, models = definition.task, definition.models
    one = models[0] if len(models) == 1 else None
    return StudySettings(
        plan=f"calibration {definition.path.stem}",
        plan_hash=definition.hash,
        model="+".join(chosen.label for chosen in models),
        deck=one.model.deck if one else 0,
        model_hash="+".join(chosen.model.hash for chosen in models),
        fidelity="+".join(dict.fromkeys(chosen.fidelity for chosen in models if chosen.fidelity)),
        variant="+".join(dict.fromkeys(chosen.variant for chosen in models if chosen.variant)),
        engine=engine,
        calstudy=calstudy,
        mode=task.mode.name,
        budget=task.mode.second_optimisation.budget,
        seed=task.seed,
        target=task.cost.target,
        case=definition.case,
        grid=task.mode.grid,
        cheap={cheap.hash: labels_of(cheap) for _, cheap in definition.pairs} or None,
        confirm=task.confirm,
        procedure=task.mode.procedure,
    )
