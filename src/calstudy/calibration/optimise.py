"""Bounded least squares on a residual vector: the optimisers of the procedure (section 2.3.3).

`levenberg_marquardt` is the algorithm of the authors' tool chain, newly written: central differences,
damped steps from a scaled singular value decomposition, a ladder of dampings. Three things are added. The
best point seen is the result, a budget is kept, and a failed evaluation is a rejected trial.
`sequential_quadratic` is what mode ``robust`` runs on the surrogates.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import LinearConstraint, minimize, nnls

from calstudy.calibration.constraints import Allowed
from calstudy.calibration.kriging.newton import at_rest
from calstudy.errors import InputError
from calstudy.parameters import Array, Box, Grid
from calstudy.records import Phase, Stop

ResidualsAt = Callable[[Phase, Array], Array]
"""Residuals (k, m) at points (k, d), which may be evaluated in parallel; NaN where an evaluation failed."""

Enough = Callable[[Array], bool]
"""Whether residuals (m,) are good enough to end the optimisation."""

SLACK = 1e-4
"""An end nearer to a constraint, as a share of its range over the box, is not brought to rest: Newton's
method knows bounds alone."""

HAIR = 1e-12
"""A parameter that is closer to a bound than this share of its interval is on the bound."""


@dataclass(frozen=True, slots=True)
class LevenbergMarquardt:
    """Settings of `levenberg_marquardt`. The defaults are the authors'."""

    tolerance: float = 0.02
    """Least relative improvement of the sum of squares between iterations (section 2.3.3)."""
    relative_step: float = 0.001
    least_magnitude: float = 1e-4
    """Difference step: ``relative_step * max(|p|, least_magnitude)``, ..."""
    least_share: float = 0.0
    """... but at least this share of the parameter's interval, and one step of the grid."""
    ladder: tuple[float, ...] = (0.1, 1.0, 1e2, 1e4, 1e6)
    """Dampings of an iteration's trials, as multiples of the last accepted damping."""
    first_damping: float = 1.0
    least_damping: float = 1e-7
    together: int = 1
    """Trials run at once. The first acceptable trial in the ladder's order is taken, and those after it are
    ignored. On idle cores this gives the same result sooner, at the price of more runs, unless a budget or
    tolerances end the optimisation."""
    most_iterations: int = 20
    budget: int | None = None
    """Largest number of evaluations; None for no limit."""


@dataclass(frozen=True, slots=True)
class SequentialQuadratic:
    """Settings of `sequential_quadratic`."""

    tolerance: float = 1e-8
    """It ends when the sum of squares changes by less than this share of its value at the start."""
    difference: float = 1e-6
    """Difference step, as a share of each interval."""
    settled: bool = False
    """Whether differences are central, and the end is brought to rest (see ``newton``)."""


@dataclass(frozen=True, slots=True)
class Optimum:
    """Result of an optimisation: the best point seen and the last point tried (d,), with residuals (m,)."""

    best: Array
    best_residuals: Array
    last: Array
    last_residuals: Array
    iterations: int
    evaluations: int
    stop: Stop

    @property
    def sum_of_squares(self) -> float:
        """Sum of squared residuals at the best point."""
        return float(self.best_residuals @ self.best_residuals)


class _Budget(Exception):
    """The budget does not allow the next evaluations."""


class _Enough(Exception):
    """A point is good enough. It is the watch's best point."""


class _Watch:
    """Counts evaluations and remembers the best and the last point."""

    def __init__(self, evaluate: ResidualsAt, budget: int | None, enough: Enough | None) -> None:
        self.evaluate, self.budget, self.enough = evaluate, budget, enough
        self.count = 0
        self.best: tuple[float, Array, Array] | None = None
        self.last: tuple[Array, Array] | None = None

    def left(self) -> int:
        """Evaluations that the budget still allows."""
        return sys.maxsize if self.budget is None else self.budget - self.count

    def __call__(self, phase: Phase, points: Array, goal: float = -np.inf) -> Array:
        """Residuals (k, m) at points (k, d). Those after the first below the goal are not remembered."""
        if self.budget is not None and self.count + len(points) > self.budget:
            raise _Budget
        residuals = self.evaluate(phase, points)
        self.count += len(points)
        if self.enough is not None:
            good = [k for k, row in enumerate(residuals) if self.enough(row)]
            if good:
                k = min(good, key=lambda k: float(residuals[k] @ residuals[k]))
                self.last = (points[k].copy(), residuals[k].copy())
                self.best = (float(residuals[k] @ residuals[k]), *self.last)
                raise _Enough
        for point, row in zip(points, residuals, strict=True):
            total = float(row @ row)
            if np.isfinite(total) and (self.best is None or total < self.best[0]):
                self.best = (total, point.copy(), row.copy())
            if phase is not Phase.JACOBIAN:
                self.last = (point.copy(), row.copy())
            if total < goal:
                break
        return residuals


def levenberg_marquardt(
    evaluate: ResidualsAt,
    start: Array,
    box: Box,
    settings: LevenbergMarquardt | None = None,
    enough: Enough | None = None,
    steps: int | None = None,
) -> Optimum:
    """Minimise the sum of squared residuals over the box, from ``start`` (d,).

    The 2 d points of a Jacobian are evaluated in one call, trials ``together`` at a time. If one point of a
    difference fails, the difference is one-sided; if both fail, the parameter does not move in that
    iteration. The optimisation ends with the first point whose residuals are ``enough``.

    With ``steps``, every point is on the box's `Grid`, and a trial that is rounded to the current point or
    to the trial before it is skipped. InputError: the budget is below 1.
    """
    settings = settings or LevenbergMarquardt()
    if settings.budget is not None and settings.budget < 1:
        raise InputError(f"a budget of {settings.budget} runs allows no evaluation; give at least 1")
    watch, grid = _Watch(evaluate, settings.budget, enough), Grid(box, steps)
    lower, upper = np.asarray(box.lower, float), np.asarray(box.upper, float)
    p = grid.nearest(_into_box(np.asarray(start, float), lower, upper))
    r = np.array([np.nan])
    damping, iterations, stop = settings.first_damping, 0, Stop.ITERATIONS
    try:
        r = watch(Phase.START, p[None])[0]
        if not np.isfinite(r).all():
            return _optimum(watch, p, r, iterations, Stop.START_FAILED)
        while iterations < settings.most_iterations:
            if not r @ r > np.finfo(float).eps:
                stop = Stop.EXACT
                break
            jacobian = _central_differences(watch, p, r, grid, settings)
            iterations += 1
            accepted = None
            goal = (1 - settings.tolerance) * (r @ r)
            trials = list(_ladder(jacobian, p, r, damping, grid, settings))
            while trials and accepted is None:
                at_once = max(1, min(settings.together, watch.left()))
                wave, trials = trials[:at_once], trials[at_once:]
                found = watch(Phase.TRIAL, np.array([point for _, point in wave]), goal)
                for (trial_damping, trial), trial_r in zip(wave, found, strict=True):
                    if trial_r @ trial_r < goal:
                        accepted = trial, trial_r, trial_damping
                        break
            if accepted is None:
                stop = Stop.IMPROVEMENT if jacobian.any() else Stop.FLAT
                break
            p, r, damping = accepted
    except _Budget:
        stop = Stop.BUDGET
    except _Enough:
        stop = Stop.TOLERANCE
    return _optimum(watch, p, r, iterations, stop)


def sequential_quadratic(
    residuals: Callable[[Array], Array],
    start: Array,
    box: Box,
    settings: SequentialQuadratic,
    allowed: Allowed | None = None,
) -> Optimum:
    """Minimise the sum of squares of smooth ``residuals`` (k, m) at points (k, d) over the allowed box.

    This is scipy's SLSQP in the unit cube. Unlike the authors' algorithm, it does not stop early if a
    parameter has little effect or if bounds are active. It needs many evaluations, so it is for surrogates
    and not for a DEM model. A point and its difference steps are evaluated in one call.
    """

    def totals(u: Array) -> Array:
        found = residuals(box.from_unit(u))
        return np.asarray(np.einsum("km,km->k", found, found), float)

    def at(u: Array) -> tuple[float, Array]:
        if settings.settled:
            high, low = np.minimum(u + settings.difference, 1.0), np.maximum(u - settings.difference, 0.0)
            around = totals(np.vstack([u, u + np.diag(high - u), u + np.diag(low - u)])) / scale
            forward, backward = around[1:].reshape(2, -1)
            return float(around[0]), (forward - backward) / (high - low)
        sides = np.where(u + settings.difference > 1.0, -settings.difference, settings.difference)
        around = totals(np.vstack([u, u + np.diag(sides)])) / scale
        return float(around[0]), (around[1:] - around[0]) / sides

    first = np.clip(box.to_unit(start), 0.0, 1.0)
    scale = float(totals(first[None])[0]) or 1.0
    found = minimize(
        at,
        first,
        jac=True,
        method="SLSQP",
        bounds=[(0.0, 1.0)] * box.dimension,
        constraints=[] if allowed is None else [LinearConstraint(allowed.unit[0], ub=allowed.unit[1])],
        options={"ftol": settings.tolerance, "maxiter": 100},
    )
    end = np.asarray(found.x, float)
    if settings.settled and (allowed is None or allowed.slack(box.from_unit(end)).min() > SLACK):
        end = at_rest(at, end, np.zeros(box.dimension), np.ones(box.dimension))
    best = box.from_unit(end)
    if allowed is not None:
        best = allowed.pulled_in(best)
    best_residuals = residuals(best[None])[0]
    stop = Stop.IMPROVEMENT if found.success else Stop.ITERATIONS
    return Optimum(best, best_residuals, best, best_residuals, int(found.nit), int(found.nfev), stop)


def _optimum(watch: _Watch, p: Array, r: Array, iterations: int, stop: Stop) -> Optimum:
    """The watch's best and last points as a result; p (d,) and r (m,) if it has none."""
    best = watch.best[1:] if watch.best is not None else (p, r)
    last = watch.last if watch.last is not None else (p, r)
    return Optimum(*best, *last, iterations=iterations, evaluations=watch.count, stop=stop)


def _into_box(point: Array, lower: Array, upper: Array) -> Array:
    """Clip a point (d,) to the box, and put coordinates that are a hair off a bound on the bound.

    A coordinate just inside a bound would shorten every later step to almost nothing.
    """
    hair = HAIR * (upper - lower)
    return np.where(point - lower <= hair, lower, np.where(upper - point <= hair, upper, point))


def _central_differences(
    watch: _Watch, p: Array, r: Array, grid: Grid, settings: LevenbergMarquardt
) -> Array:
    """Jacobian (m, d) at p (d,). Steps end at the bounds; on a bound, p and r (m,) are one side."""
    box = grid.box
    step = settings.relative_step * np.maximum(np.abs(p), settings.least_magnitude)
    step = np.maximum(step, np.maximum(settings.least_share * box.width, grid.step))
    forward = grid.nearest(np.minimum(p + step, box.upper))
    backward = grid.nearest(np.maximum(p - step, box.lower))
    points, owners = [], []
    for k in range(len(p)):
        for side in (forward, backward):
            if side[k] != p[k]:
                point = p.copy()
                point[k] = side[k]
                points.append(point)
                owners.append((k, side is forward))
    residuals = watch(Phase.JACOBIAN, np.array(points))
    ends = {(k, is_forward): (p[k], r) for k in range(len(p)) for is_forward in (True, False)}
    for (k, is_forward), point, row in zip(owners, points, residuals, strict=True):
        if np.isfinite(row).all():
            ends[k, is_forward] = (point[k], row)
    jacobian = np.zeros((len(r), len(p)))
    for k in range(len(p)):
        (high, r_high), (low, r_low) = ends[k, True], ends[k, False]
        if high > low:
            jacobian[:, k] = (r_high - r_low) / (high - low)
    return jacobian


def _ladder(
    jacobian: Array,
    p: Array,
    r: Array,
    damping: float,
    grid: Grid,
    settings: LevenbergMarquardt,
) -> Iterator[tuple[float, Array]]:
    """Damping and point (d,) of each trial of an iteration. Steps of length zero are skipped."""
    lower, upper = np.asarray(grid.box.lower, float), np.asarray(grid.box.upper, float)
    before = p
    for factor in settings.ladder:
        trial_damping = max(damping * factor, settings.least_damping)
        step = _damped_step(jacobian, r, trial_damping, p, lower, upper)
        if not step.any():
            continue
        trial = grid.nearest(_into_box(p + step, lower, upper))
        if grid.steps and (np.array_equal(trial, p) or np.array_equal(trial, before)):
            continue
        before = trial
        yield trial_damping, trial


def _damped_step(jacobian: Array, r: Array, damping: float, p: Array, lower: Array, upper: Array) -> Array:
    """Step (d,) that stays in the box: -V (U'r) / sqrt(s^2 + damping) on columns of unit norm.

    Bounds that the point sits on are kept as Bard (Nonlinear Parameter Estimation, 1974, p. 147) does: the
    step is the nearest one that leaves none of them, in the metric B B' whose square root B = V / sqrt(s^2 +
    damping) also makes the free step, B g with g = -U'r. In terms of the bounds' multipliers that
    is a problem of non-negative least squares. A step over another bound is shortened as a whole.
    """
    step = np.zeros(len(p))
    norms = np.linalg.norm(jacobian, axis=0)
    used = norms > 0
    if not used.any():
        return step
    u, s, vt = np.linalg.svd(jacobian[:, used] / norms[used], full_matrices=False)
    root = vt.T / np.sqrt(s**2 + damping)
    inward = np.where(p <= lower, 1.0, np.where(p >= upper, -1.0, 0.0))[used]
    active = inward != 0
    normals = inward[active, None] * root[active]
    g = -(u.T @ r)
    if active.any():
        multipliers, _ = nnls(normals.T, -g)
        g = g + normals.T @ multipliers
    scaled = root @ g
    # On a bound the step is zero except for rounding, which must not lead out of the box.
    scaled[active] = np.where(inward[active] * scaled[active] > HAIR, scaled[active], 0.0)
    step[used] = scaled / norms[used]
    moving = step != 0
    if not moving.any():
        return step
    room = np.where(step > 0, upper - p, p - lower)
    return step * min(1.0, float(np.min(room[moving] / np.abs(step[moving]))))
