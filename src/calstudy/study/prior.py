"""Runs of an earlier study, of another material perhaps, as the prior of a calibration.

They tell how the responses go over the box, as those of a cheap fidelity do. What the materials differ by is
learnt from the calibration's own runs, and so is whether the earlier ones are a guide at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calstudy.calibration.fidelities.surrogates import FidelityRuns
from calstudy.calibration.kriging.coordinates import Coordinates
from calstudy.calibration.kriging.surrogates import Kriging
from calstudy.calibration.modes import Mode
from calstudy.calibration.sampling import LEAST_SPREAD
from calstudy.errors import InputError, StoreError
from calstudy.parameters import Parameter, Space, constant_of
from calstudy.records import Evaluation, Phase
from calstudy.study.settings import read_settings
from calstudy.study.stored import SAMPLES_PER_PARAMETER, evaluations_of, spread
from calstudy.tomlfile import Section


@dataclass(frozen=True, slots=True)
class EarlierRun:
    """A run of the earlier study as a run of this calibration."""

    run_id: str
    """Of the run as it was made; those of several models are joined by +."""
    parameters: Mapping[str, float]
    """The full parameter set of this calibration that it stands at."""
    responses: Mapping[str, float]
    """Those that have a target, at that parameter set."""


@dataclass(frozen=True, slots=True)
class Prior:
    """What a calibration takes from an earlier study."""

    place: str
    """The study's directory, as the calibration's file names it."""
    study: str
    """The study's identity."""
    of: str
    """What was run, in words."""
    runs: tuple[EarlierRun, ...]

    @property
    def content(self) -> dict[str, Any]:
        """What a study stores of it, so that it can do without the earlier one, wherever that is now."""
        runs = [[run.run_id, dict(run.parameters), dict(run.responses)] for run in self.runs]
        return {"study": self.study, "of": self.of, "runs": runs}

    @classmethod
    def of_content(cls, content: Mapping[str, Any], place: str) -> Prior:
        """The prior that a study has stored."""
        runs = tuple(EarlierRun(*run) for run in content["runs"])
        return cls(place, content["study"], content["of"], runs)

    def knows(self, space: Space, responses: Iterable[str]) -> bool:
        """Whether its runs have all that a calibration is about."""
        names = {p.name for p in space.parameters}
        return all(names <= {*run.parameters} and {*responses} <= {*run.responses} for run in self.runs)

    def data(self, space: Space, responses: tuple[str, ...]) -> FidelityRuns:
        """Points (n, d) and responses (n, m) of the runs."""
        return FidelityRuns(
            np.array([space.point(run.parameters) for run in self.runs]),
            np.array([[run.responses[name] for name in responses] for run in self.runs]),
        )

    @property
    def in_words(self) -> str:
        """How many runs of which study it has."""
        return f"{len(self.runs)} runs of the earlier study {self.place} ({self.of}; {self.study})"

    def verdict(self, reason: str) -> str:
        """The same with whether it agreed; ``reason`` says why it was given up, or is empty."""
        found = f"was given up: {reason}" if reason else "agreed"
        return f"{self.in_words}, which {found}"


def prior_of(
    top: Section,
    space: Space,
    units: Mapping[str, str],
    mode: Mode,
    has_cheap: bool,
    stored: Mapping[str, Any] | None = None,
) -> Prior | None:
    """Prior that a calibration's file asks for by ``start``; None without one.

    ``units`` as in `read_prior`. What the study that goes on has ``stored`` of the earlier one counts, unless
    another study lies there now. InputError: with the line, why it can be no prior.
    """
    if "start" not in top:
        return None
    named = top.get("start", "text")
    place = top.path.parent / named
    for holds, why in (
        (mode.samples is None, f"mode {mode.name} begins with samples of its own; take mode robust, or"),
        (has_cheap, "a cheap fidelity tells already how the responses go;"),
        (bool(mode.kriging.curves), "a measured curve is calibrated to without an earlier study;"),
    ):
        if holds:
            raise top.wrong(f"{why} leave start out", "start")
    if stored is not None and _identity_at(place) in (None, stored["study"]):
        prior = Prior.of_content(stored, named)
        if prior.knows(space, units):
            return prior
    try:
        return read_prior(place, named, space, units, mode.kriging, mode.overview(space.box.dimension))
    except InputError as error:
        raise top.wrong(str(error), "start") from error


def _identity_at(place: Path) -> str | None:
    """Identity of the study in a directory; None where there is none that can be read."""
    try:
        return read_settings(place).id
    except StoreError:
        return None


def read_prior(
    place: Path, named: str, space: Space, units: Mapping[str, str], kriging: Kriging, least: int
) -> Prior:
    """Prior of a calibration from the study in a directory, which the calibration's file calls ``named``.

    ``units`` has the unit of each response that has a target; ``least`` is the number of runs that are
    needed. Of a study with two fidelities the one with more usable runs is taken, and of many runs those that
    fill the box best. InputError: it holds no study, or one that tells too little of this calibration.
    """
    try:
        settings = read_settings(place)
        evaluations = list(evaluations_of(place, settings))
    except StoreError as error:
        raise InputError(f"{error}, or leave start out") from error
    there = settings.quantities
    for name, unit, known in (
        *((p.name, p.unit, dict(there.parameters)) for p in space.free),
        *((name, unit, there.measured) for name, unit in units.items()),
    ):
        if known.get(name) != unit:
            has = f"has it in {known[name]}" if name in known else "has no such quantity"
            raise InputError(f"{named} {has}: {name} in {unit}; take another study, or leave start out")
    levels: dict[bool, dict[str, EarlierRun]] = {False: {}, True: {}}
    for (_, phase, _), parts in sorted(_requests(evaluations).items()):
        run = _as_here(parts, space, tuple(units), kriging)
        if run is not None:
            levels[phase is Phase.CHEAP][run.run_id] = run
    runs = [*max(levels.values(), key=len).values()]
    if len(runs) < least:
        raise InputError(
            f"{named} has {len(runs)} usable run(s) inside the intervals, and {least} are needed; take "
            "another study, or leave start out"
        )
    found = Prior(named, settings.id, f"{settings.at}, {settings.engine}", tuple(runs))
    points = found.data(space, tuple(units)).points
    for name in units:
        inputs = Coordinates.of(space, (kriging.ratios or {}).get(name))
        for flat in np.flatnonzero(np.ptp(inputs.to_unit(points), axis=0) < LEAST_SPREAD):
            raise InputError(
                f"{named} tells nothing of {inputs.box.names[flat]}, which hardly varies among its "
                f"{len(runs)} runs inside the intervals; fix it, take another study, or leave start out"
            )
    taken = spread(space.box.to_unit(points), SAMPLES_PER_PARAMETER * space.box.dimension)
    return Prior(named, found.study, found.of, tuple(runs[k] for k in taken))


def _requests(evaluations: Iterable[Evaluation]) -> dict[tuple[int, Phase, int], list[Evaluation]]:
    """Runs of all models by what asked for them."""
    found: dict[tuple[int, Phase, int], list[Evaluation]] = {}
    for evaluation in evaluations:
        request = evaluation.request
        found.setdefault((request.row, request.phase, request.index), []).append(evaluation)
    return found


def _as_here(
    parts: list[Evaluation], space: Space, names: tuple[str, ...], kriging: Kriging
) -> EarlierRun | None:
    """An earlier parameter set's runs as a run of this space; None where it is outside, or gave not all.

    What was varied there and is fixed here counts as scatter. A parameter that a response is proportional to
    is moved to the nearest value that it has here, which changes that response in proportion. What else it
    does is left to the offset.
    """
    was = parts[0].request.parameters
    moved = {
        p.name: min(max(was[p.name], p.lower), p.upper) if p.name in space.calibrated else constant_of(p)
        for p in space.parameters
        if p.name in (kriging.divisors or {}).values() and was.get(p.name) and _is_plain(p)
    }
    factors = {name: to / was[name] for name, to in moved.items()}
    at = {**was, **moved}
    if not all(p.takes(at[p.name]) for p in space.free):
        return None
    responses = {}
    for name in names:
        value = max((part.run.responses.get(name, np.nan) for part in parts), key=np.isfinite)
        responses[name] = float(value) * factors.get((kriging.divisors or {}).get(name, ""), 1.0)
    if not np.isfinite([*responses.values()]).all():
        return None
    ids = "+".join(sorted({part.run_id for part in parts}))
    return EarlierRun(ids, space.complete(space.point(at)), responses)


def _is_plain(p: Parameter) -> bool:
    """Whether its value may be any of an interval, and follows from nothing."""
    return p.formula is None and not p.values and not p.is_whole
