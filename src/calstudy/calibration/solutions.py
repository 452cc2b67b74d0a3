"""What the surrogates tell about a calibration: the reach of each target, bounds in the way, other solutions.

The paper's point is that many parameter sets reach the same responses. They are drawn here from the posterior
of the parameters, given the targets, their errors and the runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.posterior import POINTS, LogDensity, chi_square, draw, log_likelihood
from calstudy.calibration.sampling import sobol
from calstudy.calibration.task import Task
from calstudy.parameters import Array

LOOKED_AT = 2**10
"""Number of points that show what the surrogates reach."""
STRETCHED = 1.5
"""These points are spread over a box this many times as wide, and clipped to the bounds, where most ranges
end."""
SURE = 1.0
"""If a target is this many standard deviations of the surrogate from an end of the range, it is sure on which
side of the end the target lies."""
FIRST = 2**13
"""Number of points of the prior that the solution space is drawn from."""
NOISE_FACTOR = 2.0
"""Without a tolerance, a deviation of this many standard deviations is good enough: a run's noise, with the
measurement's error where it is known."""
LEAST_SHARE = 1e-3
"""Without tolerance, noise and error, a deviation of this share of what counts as a residual of 1 is."""
QUANTILES = (0.05, 0.95)
FREE = 0.8
"""A parameter is left free if the middle 90 % of its solutions span this share of 90 % of its interval."""
BEYOND = 0.1
"""A bound is in the way if going this share of the interval beyond it lowers the responses' squares ..."""
WORTH, WORTH_OF_ERRORS = 1e-4, 1.0
"""... by more than this: a hundredth of a target, or one standard error where errors are known, squared."""
STEP, NEAR = 0.01, 1e-6
"""Step of the slopes at a bound, and how near to it counts as on it; shares of the interval."""


@dataclass(frozen=True, slots=True)
class Reach:
    """Range of a response that the surrogates reach inside the intervals, in its units."""

    response: str
    target: float
    low: float
    high: float
    """Range of the surrogate's mean over the intervals, without noise."""
    low_sd: float
    high_sd: float
    """Standard deviation of the surrogate's mean at either end."""
    nearness: float
    """Deviation that is good enough: see `nearness`."""
    tolerance: float = 0.0
    """Deviation that the user allows."""
    is_minimised: bool = False
    """Whether it is an objective, which need not reach its value."""

    @property
    def reachable(self) -> bool:
        """Whether the target is in the range, or outside it by no more than the user allows."""
        inside = self.low - self.tolerance <= self.target <= self.high + self.tolerance
        return self.is_minimised or inside

    @property
    def is_sure(self) -> bool:
        """Whether the target is further from both ends than the surrogate may be wrong there."""
        ends = ((self.low - self.tolerance, self.low_sd), (self.high + self.tolerance, self.high_sd))
        return self.is_minimised or all(abs(self.target - end) >= SURE * sd for end, sd in ends)

    def __str__(self) -> str:
        return f"mean from {self.low:.5g} (sd {self.low_sd:.2g}) to {self.high:.5g} (sd {self.high_sd:.2g})"


@dataclass(frozen=True, slots=True)
class InTheWay:
    """A bound beyond which the surrogates expect to come nearer the targets."""

    parameter: str
    end: str
    """``lower`` or ``upper``."""
    bound: float

    def __str__(self) -> str:
        return f"the {self.end} bound of {self.parameter}, {self.bound:g}, is in the way of the targets"


@dataclass(frozen=True, slots=True)
class Solutions:
    """Parameter sets drawn from the posterior, given the targets and the runs: the solution space."""

    points: Array
    """Parameter sets (n, d), in the box's order."""
    weights: Array
    """Weights (n,), which add up to 1."""
    responses: Array
    """Means (n, m) of the surrogates."""
    doubts: Array
    """Standard deviations (n, m) of these means."""
    errors: Mapping[str, float]
    """Standard deviation of each target that was assumed: see `errors_of`."""
    share: float
    """Share of the box that is left: e^-information, by the posterior's divergence from the prior."""

    def interval(self, k: int) -> tuple[float, float]:
        """Interval of the middle 90 % of the values of parameter k."""
        low, high = np.quantile(self.points[:, k], QUANTILES)
        return float(low), float(high)

    @property
    def correlations(self) -> Array:
        """Correlations (d, d) of the parameters."""
        found: Array = np.atleast_2d(np.corrcoef(self.points, rowvar=False))
        return found


def nearness(task: Task, noise: Mapping[str, float]) -> dict[str, float]:
    """Deviation from each target that is good enough: the tolerance, or what noise and errors hide."""
    errors = task.cost.target.sd
    return {
        name: task.tolerances.get(name, 0.0)
        or max(NOISE_FACTOR * math.hypot(noise.get(name, 0.0), errors.get(name, 0.0)), LEAST_SHARE * scale)
        for name, scale in zip(task.cost.responses, map(float, task.cost.scale), strict=True)
    }


def reach(task: Task, surrogates: Surrogates) -> list[Reach]:
    """Range of each response that the surrogates reach inside the intervals, whatever the others do.

    Points that constraints exclude, or where runs are expected to fail, take no part in it.

    It is a range of the mean response. A run that came near a target only by its noise did not reach it.
    """
    box = task.space.box
    spread = sobol(LOOKED_AT, box.dimension)
    unit = np.clip(0.5 + STRETCHED * (spread - 0.5), 0.0, 1.0)
    if task.allowed is not None:
        inside = task.allowed.spread(LOOKED_AT, np.random.default_rng(0))
        unit = np.vstack([unit[task.allows(box.from_unit(unit))], inside])
    points = task.space.snapped(box.from_unit(unit))
    likely = surrogates.likely_to_run(points)
    means, deviations = surrogates.predict_with_deviations(points[likely] if likely.any() else points)
    near = nearness(task, noise_of(task, surrogates))
    found = []
    for k, name in enumerate(task.cost.responses):
        least, most = int(means[:, k].argmin()), int(means[:, k].argmax())
        found.append(
            Reach(
                name,
                task.cost.target.values[name],
                low=float(means[least, k]),
                high=float(means[most, k]),
                low_sd=float(deviations[least, k]),
                high_sd=float(deviations[most, k]),
                nearness=near[name],
                tolerance=task.tolerances.get(name, 0.0),
                is_minimised=name in task.cost.target.minimised,
            )
        )
    return found


def in_the_way(task: Task, surrogates: Surrogates, optimum: Array) -> list[InTheWay]:
    """Bounds that an optimum (d,) lies on, beyond which the surrogates expect to come nearer the targets."""
    box = task.space.box
    u = box.to_unit(optimum)
    worth = WORTH_OF_ERRORS if task.cost.target.sd else WORTH
    found = []
    for k, name in enumerate(box.names):
        for end, at, bound in (("lower", 0.0, box.lower[k]), ("upper", 1.0, box.upper[k])):
            if abs(u[k] - at) > NEAR:
                continue
            steps = np.tile(u, (3, 1))
            steps[:, k] = np.abs(at - STEP * np.arange(3))
            points = box.from_unit(steps)
            residuals = task.cost.residuals(points, surrogates.predict(points))[:, :-1]
            here, one, two = (residuals**2).sum(axis=1)
            # What a step inwards costs to first order, one outwards saves.
            slope = (4 * one - two - 3 * here) / (2 * STEP)
            if slope * BEYOND > worth:
                value = float(task.space.values(name, np.where(np.arange(len(u)) == k, bound, u)))
                found.append(InTheWay(name, end, value))
    return found


def constraints_in_the_way(task: Task, surrogates: Surrogates, optimum: Array) -> list[str]:
    """Lines about constraints that an optimum (d,) lies on, beyond which it would come nearer the targets."""
    if task.allowed is None:
        return []
    box, worth = task.space.box, WORTH_OF_ERRORS if task.cost.target.sd else WORTH
    lines = []
    for text, normal, slack in zip(
        task.allowed.texts, task.allowed.unit[0], task.allowed.slack(optimum), strict=True
    ):
        if slack > STEP:
            continue
        inwards = box.to_unit(optimum) - STEP * np.arange(3)[:, None] * normal / np.linalg.norm(normal)
        points = box.from_unit(np.clip(inwards, 0.0, 1.0))
        here, one, two = np.sum(task.cost.residuals(points, surrogates.predict(points))[:, :-1] ** 2, axis=1)
        if (4 * one - two - 3 * here) / (2 * STEP) * BEYOND > worth:
            lines.append(f"the constraint {text} is in the way of the targets")
    return lines


def errors_of(task: Task, noise: Mapping[str, float]) -> dict[str, float]:
    """Standard deviation of each measured value, in its unit.

    It is the one that was given. Without one, a value is taken to scatter as one run of the model does, or by
    half of the deviation that is good enough, whichever is more. A weight w divides it by sqrt(w).
    """
    target, scales = task.cost.target, map(float, task.cost.scale)
    return {
        name: (
            target.sd.get(name)
            or max(noise.get(name, 0.0), task.tolerances.get(name, 0.0) / 2, LEAST_SHARE * scale)
        )
        / math.sqrt(target.weight.get(name, 1.0))
        for name, scale in zip(task.cost.responses, scales, strict=True)
    }


@dataclass(frozen=True, slots=True)
class Density:
    """The posterior's density over the unit cube of the intervals, as its two logarithms."""

    prior: LogDensity
    likelihood: LogDensity
    fit: LogDensity
    """Minus half the chi-square: the likelihood without its factor that falls where the doubt is large."""
    first: Array
    """Points (k, d) spread evenly over the prior."""


def density_of(task: Task, surrogates: Surrogates, errors: Mapping[str, float]) -> Density:
    """Posterior density, by the surrogates and the errors of the measured values."""
    box, sds = task.space.box, np.array([errors[name] for name in task.cost.responses])

    def by(of: Callable[[Array, Array, Array], Array], unit: Array) -> Array:
        means, doubts = surrogates.predict_with_deviations(task.space.snapped(box.from_unit(unit)))
        return of(task.cost.deviations(means), doubts, sds)

    if task.allowed is None:
        first = sobol(FIRST, box.dimension)
    else:
        first = task.allowed.spread(FIRST, np.random.default_rng(0))
    likely = surrogates.likely_to_run(box.from_unit(first))
    first = first[likely] if likely.any() else first

    def prior(unit: Array) -> Array:
        points = box.from_unit(unit)
        inside = task.allows(points) & (surrogates.likely_to_run(points) | ~likely.any())
        return np.where(inside, 0.0, -np.inf)

    return Density(
        prior=prior,
        likelihood=lambda unit: by(log_likelihood, unit),
        fit=lambda unit: -0.5 * by(chi_square, unit),
        first=first,
    )


def solve(task: Task, surrogates: Surrogates, errors: Mapping[str, float], n: int = POINTS) -> Solutions:
    """Draw n points of the solution space; the same for the same fit and seed of the study."""
    density = density_of(task, surrogates, errors)
    drawn = draw(density.prior, density.likelihood, density.first, task.seed, n)
    points = task.space.snapped(task.space.box.from_unit(drawn.unit))
    means, doubts = surrogates.predict_with_deviations(points)
    return Solutions(points, drawn.weight, means, doubts, errors, float(np.exp(-drawn.information)))


def failing_share(task: Task, surrogates: Surrogates) -> float:
    """Share of the allowed box in which runs are expected to fail; 0 while none has."""
    if surrogates.success is None:
        return 0.0
    points = task.space.box.from_unit(sobol(LOOKED_AT, task.space.box.dimension))
    return float(np.mean(~surrogates.likely_to_run(points[task.allows(points)])))


def left_free(task: Task, solutions: Solutions) -> list[str]:
    """Parameters that the targets do not determine: they may be nearly anywhere in their interval."""
    box = task.space.box
    free = []
    for k, name in enumerate(box.names):
        low, high = solutions.interval(k)
        if high - low >= FREE * (QUANTILES[1] - QUANTILES[0]) * box.width[k]:
            free.append(name)
    return free


def forecast(task: Task, surrogates: Surrogates, optimum: Array, units: Mapping[str, str]) -> list[str]:
    """Lines about the surrogates' optimum (d,) to print before the second optimisation begins."""
    lines = []
    predicted = surrogates.predict(optimum[None])[0]
    reaches = reach(task, surrogates)
    for one, value in zip(reaches, predicted, strict=True):
        unit = units[one.response]
        if one.is_minimised:
            lines.append(f"{one.response}: to be minimised, {one}; the surrogates expect {value:.5g} {unit}")
        elif not one.is_sure:
            lines.append(
                f"{one.response}: {one.target:.5g} {unit} is AT THE EDGE of what the intervals reach, {one}; "
                f"the surrogates expect {value:.5g}"
            )
        elif one.reachable:
            lines.append(
                f"{one.response}: {one.target:.5g} {unit} is within reach; the surrogates expect {value:.5g}"
            )
        else:
            lines.append(
                f"WARNING {one.response}: {one.target:.5g} {unit} is OUT OF REACH inside the intervals, "
                f"{one}; widen them, or interrupt now"
            )
    for name, sd in noise_of(task, surrogates).items():
        if 0 < (tolerance := task.tolerances.get(name, 0.0)) < sd:
            lines.append(
                f"WARNING {name}: the tolerance, {tolerance:.3g} {units[name]}, is below the noise of a run, "
                f"{sd:.3g}: it is chance whether a run is within; allow more, or take a model with less noise"
            )
    apart = [
        one.response
        for one, value in zip(reaches, predicted, strict=True)
        if abs(value - one.target) > one.nearness and not one.is_minimised
    ]
    if apart and all(one.reachable for one in reaches):
        lines.append(f"WARNING not all at once: at the surrogates' optimum {' and '.join(apart)} is missed")
    if failing := failing_share(task, surrogates):
        lines.append(f"runs are expected to fail in {failing:.0%} of the box, which is left out")
    lines += [str(bound) for bound in in_the_way(task, surrogates, optimum)]
    return lines + constraints_in_the_way(task, surrogates, optimum)


def noise_of(task: Task, surrogates: Surrogates) -> dict[str, float]:
    """Standard deviation of each response from run to run: the known one, or Kriging's estimate."""
    return {name: d.noise_sd for name, d in surrogates.diagnostics.items()} | dict(task.noise or {})
