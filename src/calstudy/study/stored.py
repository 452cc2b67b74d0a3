"""DEM runs of a project's other studies, which a calibration of the same models does not run again.

A project is the directory that holds the study. A run is the same if its model, engine, parameters and seed
are: its target, intervals, budget and number of samples were not part of it. A run with other parameters or
another seed cannot answer a request, but inside the intervals it is as good as a sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calstudy.calibration.expected import number_of_samples
from calstudy.calibration.task import Stored, Task
from calstudy.engines.interface import Described
from calstudy.errors import StoreError
from calstudy.parameters import Array, Space
from calstudy.records import RAYLEIGH_TIME_STEP, Beads, Evaluation, Outcome, Phase, Request, Run
from calstudy.study.directory.journal import read_journal
from calstudy.study.directory.store import read_lines
from calstudy.study.reread import REREAD, Reread
from calstudy.study.schema import BEAD_COUNTS
from calstudy.study.settings import SETTINGS_FILE, StudySettings, read_settings

TRIALS = "trials.jsonl"
"""Journal of a project's trial runs, beside its studies."""
SAMPLES_PER_PARAMETER = 10
"""Stored runs that serve as samples, at most: as many as Kriging has a use for (SPP of the paper's plan)."""


@dataclass(frozen=True, slots=True)
class Part:
    """One model of a calibration, as far as its runs can be told."""

    model: Described
    engine: str
    """Identity of the engine that runs it."""
    prefix: str
    """Of its responses' names in this calibration."""


@dataclass(frozen=True, slots=True)
class StoredRuns:
    """What a project has of a calibration's runs."""

    runs: Mapping[str, Mapping[str, Run]]
    """By model hash and run id."""
    samples: tuple[Stored, ...]
    """Parameter sets inside the intervals whose runs gave what has a target: those that fill them best."""
    places: tuple[Path, ...]
    """Where the runs lie."""

    @property
    def known(self) -> dict[str, Run]:
        """All runs by run id."""
        return {run_id: run for of_model in self.runs.values() for run_id, run in of_model.items()}


def stored_runs(
    directory: Path, task: Task, parts: Sequence[Part], again: Sequence[Reread] = ()
) -> StoredRuns:
    """Runs of the models in the studies beside ``directory``, in trials, and read anew (now: ``again``).

    Damaged studies are passed over, and so are broken runs: what broke them may be mended.
    """
    runs: dict[str, dict[str, Run]] = {part.model.hash: {} for part in parts}
    sets: dict[tuple[float, ...], Stored] = {}
    models_at: dict[tuple[float, ...], set[str]] = {}
    places: dict[Path, None] = {}
    for place, evaluation, labels in _told(directory, set(runs), again):
        for part in parts:
            run = _answer(evaluation, part, labels)
            if run is None or run.broke:
                continue
            places[place] = None
            model = part.model.hash
            runs[model].setdefault(evaluation.run_id, run)
            point = _inside(evaluation.request.parameters, task.space)
            if point is not None and task.usable(run) and task.allows(task.space.point(point)):
                at = (*point.values(), evaluation.request.seed)
                sets[at] = Stored(point, evaluation.request.seed)
                models_at.setdefault(at, set()).add(model)
    if not task.mode.takes_noise:  # its surrogates pass through every run, and its design is the paper's
        return StoredRuns(runs, (), tuple(places))
    whole = [sets[at] for at in sorted(sets) if len(models_at[at]) == len(parts)]
    partly = [sets[at] for at in sorted(sets) if len(models_at[at]) < len(parts)]
    samples = number_of_samples(task)
    taken = _spread(whole, task, max(SAMPLES_PER_PARAMETER * task.space.box.dimension, samples))
    taken += _spread(partly, task, samples - len(taken))
    return StoredRuns(runs, tuple(taken), tuple(places))


def _told(
    directory: Path, hashes: set[str], again: Sequence[Reread]
) -> Iterator[tuple[Path, Evaluation, Mapping[str, str]]]:
    """Runs of the project with the place of each, and the model hash by the label of its responses."""
    for name in (TRIALS, REREAD):
        journal = directory.absolute().parent / name
        for evaluation in _journal(journal):
            yield journal, evaluation, {}
    for evaluation in (e for of_model in again for e in of_model.read):
        yield directory.absolute().parent / REREAD, evaluation, {}
    for study, settings in _studies_beside(directory, hashes):
        labels = {} if settings.case is None else settings.case.definition["models"]
        for evaluation in evaluations_of(study, settings):
            yield study, evaluation, labels


def _studies_beside(directory: Path, hashes: set[str]) -> Iterator[tuple[Path, StudySettings]]:
    """Other studies of the project that ran one of the models."""
    own = directory.absolute()
    for path in sorted(own.parent.glob(f"*/{SETTINGS_FILE}")):
        if path.parent == own:
            continue
        try:
            settings = read_settings(path.parent)
        except StoreError:
            continue
        models = {settings.model_hash, *(settings.case.models if settings.case else ())}
        if hashes & {*models, *(settings.cheap or ())}:
            yield path.parent, settings


def evaluations_of(study: Path, settings: StudySettings) -> Iterator[Evaluation]:
    """Runs of a study: those in its journals, with their beads, and those in its tables."""
    seen = set()
    for path in sorted((study / "journal").glob("row-*.jsonl")):
        for evaluation in _journal(path):
            seen.add(evaluation.run_id)
            yield evaluation
    try:
        lines = read_lines(study, "evaluations", settings.quantities)
    except StoreError:
        return
    yield from (_evaluation(line, settings) for line in lines if line["run_id"] not in seen)


def _journal(path: Path) -> list[Evaluation]:
    """Sound lines of a journal; empty if the file does not exist."""
    return list(read_journal(path).evaluations)


def _evaluation(line: Mapping[str, Any], settings: StudySettings) -> Evaluation:
    """A line of the table of evaluations as the evaluation that it tells of, without its beads."""

    def number(name: str) -> float:
        return math.nan if line[name] is None else float(line[name])

    counts = {name: line[f"beads_{stored}"] for stored, name in BEAD_COUNTS.items()}
    parameters = {name: number(name) for name, _ in settings.quantities.parameters}
    run = Run(
        outcome=Outcome(line["outcome"]),
        reason=line["reason"],
        responses={name: number(name) for name in settings.quantities.given},
        wall_time=number("wall_time"),
        cpu_time=number("cpu_time"),
        radius=number("heap_radius"),
        height=number("heap_height"),
        beads=None if None in counts.values() else Beads(**counts),
        engine_time_step=number("engine_time_step"),
        simulated_time=number("simulated_time"),
        host=line["host"],
        finished_at=line["finished_at"],
    )
    request = Request(line["row"], Phase(line["phase"]), line["index"], parameters, line["seed"])
    return Evaluation(request, line["run_id"], run, line["model_hash"])


def _answer(evaluation: Evaluation, part: Part, labels: Mapping[str, str]) -> Run | None:
    """The run, with its responses as this calibration calls them; None where another model ran."""
    request, model = evaluation.request, part.model
    if not set(model.parameters) <= set(request.parameters):
        return None
    own = replace(request, parameters={name: request.parameters[name] for name in model.parameters})
    if own.run_id(model.hash, part.engine) != evaluation.run_id:
        return None
    label = next((label for label, model_hash in labels.items() if model_hash == model.hash), "")
    there = evaluation.run.responses
    responses = {
        f"{part.prefix}{r.name}": there.get(f"{label}_{r.name}", there.get(r.name, math.nan))
        for r in model.responses
    }
    step = {RAYLEIGH_TIME_STEP: there[RAYLEIGH_TIME_STEP]} if RAYLEIGH_TIME_STEP in there else {}
    return replace(evaluation.run, responses=responses | step)


def _inside(parameters: Mapping[str, float], space: Space) -> dict[str, float] | None:
    """The full parameter set of a stored run in this space; None where it lies elsewhere."""
    point = space.filled(parameters)
    return point if space.takes(point) else None


def _spread(stored: Sequence[Stored], task: Task, most: int) -> list[Stored]:
    """Of many runs those that fill the box best."""
    if len(stored) <= (most := max(most, 0)):
        return list(stored)
    points = task.space.box.to_unit(np.array([task.space.point(run.parameters) for run in stored]))
    return [stored[k] for k in spread(points, most)]


def spread(points: Array, most: int) -> list[int]:
    """Which of many points (n, d) of the unit cube fill it best: each is the farthest from all before it."""
    if len(points) <= most:
        return list(range(len(points)))
    nearest = np.linalg.norm(points - 0.5, axis=1)  # the first is the one farthest from the centre
    taken: list[int] = []
    for _ in range(most):
        taken.append(int(np.argmax(nearest)))
        distances = np.linalg.norm(points - points[taken[-1]], axis=1)
        nearest = distances if len(taken) == 1 else np.minimum(nearest, distances)
    return sorted(taken)


def stored_in(settings: StudySettings) -> tuple[Stored, ...]:
    """The samples that a study took over when it was begun."""
    told = () if settings.case is None else settings.case.definition.get("stored", ())
    return tuple(Stored(dict(parameters), seed) for parameters, seed in told)
