"""A calibration as its directory shows it while it runs, after a pause, and when it is finished.

No engine is opened and nothing is locked, so that any number of readers may look.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from calstudy.errors import StoreError
from calstudy.records import Evaluation, Phase
from calstudy.study.definition import Definition, read_definition
from calstudy.study.directory.begun import begun_with, difference, version_there
from calstudy.study.directory.store import finished_rows
from calstudy.study.reading import Result, read_result
from calstudy.study.run.taking import settings_of
from calstudy.study.schema import evaluation_line
from calstudy.study.settings import SETTINGS_FILE, read_settings
from calstudy.study.stored import evaluations_of, stored_in


def definition_there(
    file: Path, directory: Path, models: Sequence[Path] = (), insist: bool = False
) -> Definition:
    """The calibration of a file, with the samples that its study took over when it was begun.

    InputError as ``read_definition``; StoreError where the study there was begun with other settings.
    """
    definition = read_definition(file, models, insist, *begun_with(directory))
    if not (directory / SETTINGS_FILE).exists():
        return definition
    there = read_settings(directory)
    taken = definition.taking_over(stored_in(there))
    now = settings_of(taken, there.engine, version_there(directory))
    if changed := difference(directory, now):
        raise StoreError(f"{directory} was begun with other settings: {'; '.join(changed)}")
    return taken


def read_finished(definition: Definition, directory: Path) -> Result | None:
    """Result of a calibration; None while it is not finished, or where it failed."""
    if not finished_rows(directory):
        return None
    return read_result(directory, definition, read_settings(directory))


def evaluations_there(directory: Path) -> list[Evaluation]:
    """DEM runs of a study so far, in the order in which they ended; empty before it is begun."""
    if not (directory / SETTINGS_FILE).exists():
        return []
    return list(evaluations_of(directory, read_settings(directory)))


def so_far(definition: Definition, directory: Path, evaluations: Sequence[Evaluation]) -> Result | None:
    """What the runs of a calibration under way tell, the best of them in the optimum's place.

    Its heap is that of the latest run which left one. None while no run gave all responses. Its surrogates
    raise NumericsError while the runs are too few.
    """
    settings, task = read_settings(directory), definition.task
    frame = pd.DataFrame(
        [settings.provenance_of(one.model_hash) | evaluation_line(one) for one in evaluations]
    )
    frame = frame.reindex(columns=[*frame.columns, *(set(settings.quantities.given) - {*frame.columns})])
    found = Result(definition, settings, {}, frame, pd.DataFrame())
    usable = found.runs(frame["phase"] != Phase.CHEAP).usable if len(frame) else None
    if usable is None or not len(usable.points):
        return None
    squares = np.sum(task.cost.residuals(usable.points, usable.responses) ** 2, axis=1)
    best = int(np.argmin(squares))
    parameters = task.space.complete(usable.points[best])
    same = np.all([np.isclose(frame[n], parameters[n], rtol=1e-12) for n in task.space.box.names], axis=0)
    line: dict[str, Any] = {
        "reason": "",
        "dem_run_id": "+".join(frame["run_id"][same]),
        "target_kind": settings.target.kind,
        **{f"target_{name}": value for name, value in settings.target.values.items()},
        **{f"dem_{name}": value for name, value in parameters.items()},
        **dict(
            zip((f"dem_{n}" for n in task.cost.responses), map(float, usable.responses[best]), strict=True)
        ),
    }
    return Result(definition, settings, line, frame, _latest_heap(definition, evaluations))


def _latest_heap(definition: Definition, evaluations: Sequence[Evaluation]) -> pd.DataFrame:
    """Lines of the table of heaps of the last run that left beads; empty without any."""
    diameters = {model.hash: model.particle_diameter for model, _ in definition.programs}
    for one in reversed(evaluations):
        if one.run.positions is not None and one.model_hash in diameters:
            beads = pd.DataFrame(one.run.positions, columns=["x", "y", "z"])
            return beads.assign(run_id=one.run_id, particle_diameter=diameters[one.model_hash])
    return pd.DataFrame(columns=["x", "y", "z", "run_id", "particle_diameter"])
