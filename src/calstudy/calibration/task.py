"""A calibration as data: its task, its DEM runs, and what comes out."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calstudy.calibration.constraints import Allowed
from calstudy.calibration.cost import Cost
from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.calibration.kriging.surrogates import Surrogates, values
from calstudy.calibration.kriging.universal import Diagnostics
from calstudy.calibration.modes import Mode
from calstudy.calibration.sampling import beyond
from calstudy.errors import InputError, NumericsError
from calstudy.parameters import Array, Grid, Space
from calstudy.plan import Plan, Row
from calstudy.records import OPTIMISATION, RAYLEIGH_TIME_STEP, Evaluation, Phase, Request, Run, Stop, Target


def cost_of(plan: Plan, row: Row, target: Target) -> Cost:
    """Cost of a row: its intervals, the targets of its tests, its WRL, the plan's particles."""
    if plan.tests:
        target = replace(target, values={name: target.values[name] for name in plan.aims(row)})
    return Cost(plan.space(row), target, row.WRL, (plan.fixed.particles,))


def tasks_of(
    plan: Plan,
    target: Target,
    mode: Mode,
    seed: int,
    share_samples: bool = False,
    noise: Mapping[str, float] | None = None,
) -> dict[int, Task]:
    """The task of each row of a plan, by row number.

    ``share_samples`` gives rows that differ only in WRL the same samples. ``noise`` has known standard
    deviations of responses from seed to seed, in their units.
    """
    return {
        row.run: Task(
            row=row.run,
            space=plan.space(row),
            samples=row.samples,
            cost=cost_of(plan, row, target),
            mode=mode,
            seed=seed,
            sampled_as=plan.sampled_as(row.run) if share_samples else row.run,
            noise=noise,
            tests=row.TESTS,
        )
        for row in plan.rows
    }


def truth_of(plan: Plan, seed: int) -> dict[str, float]:
    """Known parameters behind the targets of a replicate whose study has this seed: another set for each.

    They are drawn evenly from the middle eight tenths of each interval: the optimisations begin at the
    centre, so that truths near it would be found without any measurement.
    """
    generator = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_TRUTH,)))
    places = TRUTHS[0] + (TRUTHS[1] - TRUTHS[0]) * generator.random(len(plan.parameters))
    return {
        p.name: float(p.lower + place * (p.upper - p.lower))
        for p, place in zip(plan.parameters, places, strict=True)
    }


TRUTHS = (0.1, 0.9)
"""Shares of an interval between which truths lie."""
_TRUTH = 2**31  # no row has this number
_STREAM = {phase: 1 + k for k, phase in enumerate(Phase)}
_DESIGN = 0


def design_generator(study_seed: int, row: int) -> np.random.Generator:
    """Generator of a row's Latin hypercube."""
    return np.random.default_rng(np.random.SeedSequence(study_seed, spawn_key=(row, _DESIGN)))


def run_seed(study_seed: int, row: int, phase: Phase, index: int) -> int:
    """Seed of a single DEM run, a positive 31-bit integer."""
    return _draw(np.random.SeedSequence(study_seed, spawn_key=(row, _STREAM[phase], index)))


def study_run_seed(study_seed: int) -> int:
    """Seed that all DEM runs of a study share in mode ``paper``, as in the authors' decks."""
    return _draw(np.random.SeedSequence(study_seed))


def _draw(sequence: np.random.SeedSequence) -> int:
    return int(sequence.generate_state(1, np.uint32)[0] >> 1) + 1


Evaluate = Callable[[Sequence[Request]], Sequence[Evaluation]]
"""Answers requests, in their order. Requests do not depend on each other, so they may run at once."""

Announce = Callable[["Task", Surrogates, Array], None]
"""Receives the surrogates and their optimum (d,) before the second optimisation begins."""


@dataclass(frozen=True, slots=True)
class Stored:
    """A DEM run of an earlier calibration, which serves this one as a sample."""

    parameters: Mapping[str, float]
    """The full parameter set, inside the intervals."""
    seed: int


@dataclass(frozen=True, slots=True)
class Task:
    """One calibration: what is calibrated, against which cost, from how many samples."""

    row: int
    space: Space
    samples: int | None
    """S of Eq. 11; None leaves it to the mode."""
    cost: Cost
    mode: Mode
    seed: int
    """Seed of the study."""
    sampled_as: int
    """Row whose design and sampling seeds are used: its own, or the row that it shares them with."""
    noise: Mapping[str, float] | None = None
    """Known standard deviations from seed to seed, in the responses' units. Missing ones are estimated from
    the runs. Mode ``paper`` ignores them."""
    tolerances: Mapping[str, float] = field(default_factory=dict)
    """Deviation of each response from its target that is good enough, in the response's units. The second
    optimisation ends when every response is within its tolerance; the default, 0, is never met."""
    stored: tuple[Stored, ...] = ()
    """Runs of earlier calibrations. Each saves a sample."""
    allowed: Allowed | None = None
    """What constraints between parameters leave of the box; None without any."""
    cheap: Cheap | None = None
    """The cheap fidelity that the samples are run at; None for a calibration of one fidelity."""
    confirm: int = 0
    """DEM runs with fresh seeds at the optimum when it is found. If they contradict the surrogates, the
    search goes on from all runs, and its optimum is confirmed as well."""
    most: int | None = None
    """Most DEM runs of the second optimisation and its confirmations; None: the mode's budget, and two
    confirmations, or `UNTIL` of them."""
    until: float = 0.0
    """Confirmation ends where all responses are within tolerance with this probability; 0 asks for none."""
    tests: int | None = None
    """Number of the study's material tests, the first ones, that it needs; None: all of them."""

    def __post_init__(self) -> None:
        if self.samples is None and self.mode.samples is None:
            raise InputError(f"mode {self.mode.name} does not choose the number of samples; give it (Eq. 11)")
        if self.noise is not None:
            for name, sd in self.noise.items():
                if not sd > 0:
                    raise InputError(f"noise of {name} is {sd:g}; it must be above 0")

    def weighing(self, noise: Mapping[str, float]) -> Task:
        """The task with a cost that weighs one run's noise beside the measurements' errors, if any."""
        return replace(self, cost=replace(self.cost, noise=noise)) if self.cost.target.sd else self

    @property
    def grid(self) -> Grid:
        """Points at which the DEM model may be run."""
        return Grid(self.space.box, self.mode.grid, self.space.whole)

    @property
    def centre(self) -> Array:
        """Middle (d,) of the points that may be run."""
        return self.space.box.centre if self.allowed is None else self.allowed.centre

    def allows(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (…, d) keep the constraints."""
        if self.allowed is None:
            return np.ones(np.shape(points)[:-1], bool)
        return self.allowed.holds(points)

    def nearest(self, points: Array) -> Array:
        """Points (k, d) of the grid nearest to points (k, d) that keep the constraints, as they do."""
        if self.allowed is None:
            return self.grid.nearest(points)
        return self.allowed.nearest(points, self.grid)

    def usable(self, run: Run) -> bool:
        """Whether a run, of one model or of all, gave those of its responses that have a target."""
        return all(math.isfinite(run.responses.get(name, 0.0)) for name in self.cost.responses)

    def measured(self, run: Run) -> Array:
        """Measured responses (m,) that have a target; all NaN if one of them is missing."""
        return np.array([run.responses[name] if self.usable(run) else np.nan for name in self.cost.responses])

    def point(self, at: Array, responses: Array) -> Point:
        """A point (d,) as a full parameter set, with its responses (m,) and its cost."""
        residuals = self.cost.residuals(at, responses)
        named = dict(zip(self.cost.responses, map(float, responses), strict=True))
        named[RAYLEIGH_TIME_STEP] = float(self.cost.rayleigh_time_step(at))
        return Point(self.space.complete(at), named, float(residuals @ residuals))

    @property
    def checks(self) -> Array:
        """Points (k, d) of an earlier study that are run anew, to learn whether it is a guide.

        They are those where each response was least and greatest (what is left of it where it is proportional
        to a parameter): what goes another way here differs most between them. They are at most half of the
        task's samples, or of the mode's ``overview``.
        """
        assert self.cheap is not None and self.cheap.earlier is not None
        most = (self.samples or self.mode.overview(self.space.box.dimension)) // 2
        points, responses = self.cheap.earlier.points, self.cheap.earlier.responses
        kept = self.allows(points)
        points, responses = points[kept], responses[kept]
        ends: list[int] = []
        for name, response in zip(self.cost.responses, responses.T, strict=True):
            left = response / values(self.space, (self.mode.kriging.divisors or {}).get(name), points)
            ends += [int(np.argmin(left)), int(np.argmax(left))] if len(points) else []
        return self.nearest(points[list(dict.fromkeys(ends))[:most]])

    def within(self, residuals: Array) -> bool:
        """Whether residuals (m + 1,) put every response within its tolerance."""
        deviations = np.abs(residuals[: len(self.tolerated)]) * self.cost.scale
        return bool(np.all((deviations <= self.tolerated) & (self.tolerated > 0)))

    @property
    def tolerated(self) -> Array:
        """Tolerances of the responses (m,), 0 where there is none."""
        return np.array([self.tolerances.get(name, 0.0) for name in self.cost.responses])

    @property
    def good(self) -> tuple[Array, Array]:
        """Least and largest value of each response (m,) that is within its tolerance; NaN without one."""
        allowed = np.where(self.tolerated > 0, self.tolerated, np.nan)
        minimised = [name in self.cost.target.minimised for name in self.cost.responses]
        low = np.where(minimised, -np.inf, self.cost.desired - allowed)
        return np.where(np.isnan(allowed), np.nan, low), self.cost.desired + allowed


class Runs:
    """The DEM runs of one calibration: numbers and seeds the requests of each phase, keeps the answers."""

    def __init__(self, task: Task, evaluate: Evaluate) -> None:
        self.task, self.evaluate = task, evaluate
        self.answers: list[tuple[Array, Evaluation]] = []

    def sample(self, phase: Phase, number: int) -> None:
        """Run the points of a Latin hypercube (Eq. 2 to 5), scaled to the intervals, in a phase.

        After an earlier study they are those that check it. Runs that are there, and those of earlier
        calibrations, take the places of the points nearest to them.
        """
        task, box = self.task, self.task.space.box
        generator = design_generator(task.seed, task.sampled_as)
        if task.cheap is not None and task.cheap.earlier is not None:
            design = box.to_unit(task.checks)
        elif task.allowed is None:
            design = task.mode.design(number, box.dimension, generator)
        else:
            design = task.allowed.design(number, generator)
        self.take_over(phase, task.stored)
        taken, _, _ = self.data(phase)
        if phase is not Phase.CHEAP:  # expensive runs from before a cheap fidelity was given up; a point once
            others, _, _ = self.data(*(other for other in Phase if other not in (phase, Phase.CHEAP)))
            taken = np.vstack([taken, np.unique(others, axis=0)])
        if len(missing := beyond(design, box.to_unit(taken))):
            self(phase, task.nearest(box.from_unit(missing)))

    def __call__(self, phase: Phase, points: Array) -> Array:
        """Run the DEM model at points (k, d); returns residuals (k, m + 1), NaN where a run failed."""
        first = self.counts().get(phase, 0)
        seeds = [self._seed(phase, first + k) for k in range(len(points))]
        evaluations = self._ask(phase, points, [self.task.space.complete(point) for point in points], seeds)
        measured = [self.task.measured(e.run) for e in evaluations]
        return self.task.cost.residuals(points, np.array(measured))

    def take_over(self, phase: Phase, stored: Sequence[Stored]) -> None:
        """Count earlier DEM runs as samples, which a phase asks for."""
        points = np.array([self.task.space.point(run.parameters) for run in stored])
        points = points.reshape(-1, self.task.space.box.dimension)
        self._ask(phase, points, [run.parameters for run in stored], [run.seed for run in stored])

    def _ask(
        self, phase: Phase, points: Array, sets: Sequence[Mapping[str, float]], seeds: Sequence[int]
    ) -> list[Evaluation]:
        """Evaluations of parameter sets at points (k, d), which are kept as answers."""
        first = self.counts().get(phase, 0)
        requests = [
            Request(self.task.row, phase, first + k, parameters, seed)
            for k, (parameters, seed) in enumerate(zip(sets, seeds, strict=True))
        ]
        evaluations = list(self.evaluate(requests)) if requests else []
        self.answers += zip(points, evaluations, strict=True)
        return evaluations

    def _seed(self, phase: Phase, index: int) -> int:
        if self.task.mode.one_seed and phase is not Phase.CONFIRMATION:
            return study_run_seed(self.task.seed)
        row = self.task.sampled_as if phase in (Phase.SAMPLING, Phase.CHEAP) else self.task.row
        return run_seed(self.task.seed, row, phase, index)

    def counts(self) -> dict[Phase, int]:
        """Number of runs of each phase."""
        return dict(Counter(e.request.phase for _, e in self.answers))

    def data(self, *phases: Phase) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Points (n, d), measured responses (n, m) and usability (n,) of the phases.

        By default they are all but the cheap ones.
        """
        asked = phases or tuple(phase for phase in Phase if phase is not Phase.CHEAP)
        chosen = [(p, e) for p, e in self.answers if e.request.phase in asked]
        points = np.array([p for p, _ in chosen]).reshape(-1, self.task.space.box.dimension)
        responses = np.array([self.task.measured(e.run) for _, e in chosen])
        responses = responses.reshape(-1, len(self.task.cost.responses))
        return points, responses, np.isfinite(responses).all(axis=1)

    def failed(self, *phases: Phase) -> Array:
        """Points (n, d) of the unusable runs of the phases, by default all."""
        lost = [
            p
            for p, e in self.answers
            if (not phases or e.request.phase in phases) and not self.task.usable(e.run)
        ]
        return np.array(lost).reshape(-1, self.task.space.box.dimension)

    @property
    def share(self) -> float:
        """Time of a cheap run as a share of an expensive one's: as measured so far, or else as expected.

        A measured one is rounded to a power of two, so that another machine makes the same choices.
        """
        cheap = self.task.cheap
        assert cheap is not None
        times: dict[bool, list[float]] = {True: [], False: []}
        for _, e in self.answers:
            phase, index = e.request.phase, e.request.index
            times[phase is Phase.CHEAP].append(cheap.times.get((phase, index), e.run.cpu_time))
        if not (cheap.is_measured and times[False] and min(map(np.mean, times.values())) > 0):
            return cheap.share
        return float(2.0 ** np.rint(np.log2(np.mean(times[True]) / np.mean(times[False]))))

    def evaluation_at(self, point: Array) -> Evaluation:
        """Latest evaluation of the second optimisation at a point (d,), or else of its confirmation.

        NumericsError if there is none.
        """
        for phases in (OPTIMISATION, (Phase.CONFIRMATION,)):
            for p, evaluation in reversed(self.answers):
                if evaluation.request.phase in phases and np.array_equal(p, point):
                    return evaluation
        raise NumericsError(f"row {self.task.row}: no DEM run of the second optimisation at {point}")

    def point(self, evaluation: Evaluation) -> Point:
        """The point of an evaluation, with the responses of its DEM run."""
        at = self.task.space.point(evaluation.request.parameters)
        return self.task.point(at, self.task.measured(evaluation.run))


@dataclass(frozen=True, slots=True)
class Point:
    """A full parameter set, its responses (with the Rayleigh time-step) and its sum of squares."""

    parameters: Mapping[str, float]
    responses: Mapping[str, float]
    sum_of_squares: float


@dataclass(frozen=True, slots=True)
class Calibration:
    """What one calibration found."""

    kriging: Point
    """The surrogate's optimum, with the Kriging models' responses there."""
    kriging_stop: Stop
    diagnostics: Mapping[str, Diagnostics]
    """Of the surrogates that were fitted to the samples, by measured response."""
    reachable: Mapping[str, bool]
    """Whether each desired response is within reach of these surrogates (``solutions.reach``)."""
    dem: Point
    """The best point that the second optimisation ran, with the DEM model's responses there."""
    dem_stop: Stop
    dem_evaluation: Evaluation
    last: Point
    """The last point that the second optimisation tried."""
    iterations: int
    runs: Mapping[Phase, int]
    failed: int
    """Runs of all phases that gave no usable responses."""
    left_out: int
    """Samples left out of the surrogates' data because their run failed."""
    alone: str = ""
    """Why the expensive fidelity went on alone, where a cheap one was given; empty if it did not."""

    @property
    def sampled_range(self) -> dict[str, tuple[float, float]]:
        """Least and largest sampled value of each measured response."""
        return {name: d.data_range for name, d in self.diagnostics.items()}
