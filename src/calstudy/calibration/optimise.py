"""Bounded Levenberg-Marquardt on a residual vector, as both optimisations of the procedure use it.

The algorithm is the one that the authors' tool chain runs (central differences, damped steps of a
scaled singular value decomposition, a ladder of dampings), written anew, with what it lacks: the best
point seen is the result, a budget is kept, and a failed evaluation is a rejected trial.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize, nnls

from calstudy.calibration.newton import at_rest
from calstudy.errors import InputError
from calstudy.parameters import Array, Box, Grid
from calstudy.records import Phase, Stop

Evaluate = Callable[[Phase, Array], Array]
"""Residuals (k, m) of points (k, d) that may be computed in parallel; NaN where an evaluation failed."""


Enough = Callable[[Array], bool]
"""Whether residuals (m,) are so small that nothing better is looked for."""

HAIR = 1e-12
"""A parameter closer to a bound than this share of its interval is on the bound."""


@dataclass(frozen=True, slots=True)
class LevenbergMarquardt:
    """Settings; the defaults are the authors'."""

    tolerance: float = 0.02
    """Least relative improvement of the sum of squares between iterations (section 2.3.3)."""
    relative_step: float = 0.001
    least_magnitude: float = 1e-4
    """Difference step: ``relative_step * max(|p|, least_magnitude)``, ..."""
    least_share: float = 0.0
    """... but no less than this share of the parameter's interval, nor than a step of the grid."""
    ladder: tuple[float, ...] = (0.1, 1.0, 1e2, 1e4, 1e6)
    """Damping of an iteration's trials over that of the last accepted one."""
    first_damping: float = 1.0
    least_damping: float = 1e-7
    together: int = 1
    """Trials of the ladder that are run at once. The first acceptable one in the ladder's order is taken and
    those behind it are forgotten: the same result sooner, if there are idle cores, for more runs, unless a
    budget or tolerances end it."""
    most_iterations: int = 20
    budget: int | None = None
    """Most evaluations; None for no limit."""


@dataclass(frozen=True, slots=True)
class SequentialQuadratic:
    """Settings of `sequential_quadratic`."""

    tolerance: float = 1e-8
    """Change of the sum of squares at which it ends, as a share of that at the start."""
    difference: float = 1e-6
    """Difference step, as a share of each interval."""
    settled: bool = False
    """Whether differences are taken to both sides, and the end is brought to rest: see ``newton``."""


@dataclass(frozen=True, slots=True)
class Optimum:
    """Result of an optimisation: the best point seen, and the last one tried."""

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
    """A point is good enough; it is the watch's best one."""


class _Watch:
    """Counts evaluations and remembers the best and the last point."""

    def __init__(self, evaluate: Evaluate, budget: int | None, enough: Enough | None) -> None:
        self.evaluate, self.budget, self.enough = evaluate, budget, enough
        self.count = 0
        self.best: tuple[float, Array, Array] | None = None
        self.last: tuple[Array, Array] | None = None

    def left(self) -> int:
        """Evaluations that the budget still allows."""
        return sys.maxsize if self.budget is None else self.budget - self.count

    def __call__(self, phase: Phase, points: Array, goal: float = -np.inf) -> Array:
        """Evaluate points; those behind the first one below the goal are counted, but not remembered."""
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
    evaluate: Evaluate,
    start: Array,
    box: Box,
    settings: LevenbergMarquardt | None = None,
    enough: Enough | None = None,
    steps: int | None = None,
) -> Optimum:
    """Minimise the sum of squared residuals over the box, from ``start`` (d,).

    The 2 d runs of a Jacobian go out in one call of ``evaluate``, trials as ``together`` says. A Jacobian
    point that failed makes its difference one-sided; where both failed the parameter stays put in
    that iteration. It ends with the first point whose residuals are ``enough``.

    With ``steps`` every point is one of the box's `Grid` of so many steps. A trial that is the point itself
    there, or the trial before it, is left out: it would tell nothing.
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
    residuals: Callable[[Array], Array], start: Array, box: Box, settings: SequentialQuadratic
) -> Optimum:
    """Minimise the sum of squares of smooth ``residuals`` (k, m) of points (k, d) over the box.

    scipy's sequential quadratic programming in the unit cube: unlike the authors' algorithm it does not stop
    early where a parameter hardly acts or where bounds are active. For functions that cost
    nothing: a surrogate, not a DEM model. A point and its difference steps are evaluated in one call.
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
        options={"ftol": settings.tolerance, "maxiter": 100},
    )
    end = np.asarray(found.x, float)
    if settings.settled:
        end = at_rest(at, end, np.zeros(box.dimension), np.ones(box.dimension))
    best = box.from_unit(end)
    best_residuals = residuals(best[None])[0]
    stop = Stop.IMPROVEMENT if found.success else Stop.ITERATIONS
    return Optimum(best, best_residuals, best, best_residuals, int(found.nit), int(found.nfev), stop)


def _optimum(watch: _Watch, p: Array, r: Array, iterations: int, stop: Stop) -> Optimum:
    best = watch.best[1:] if watch.best is not None else (p, r)
    last = watch.last if watch.last is not None else (p, r)
    return Optimum(*best, *last, iterations=iterations, evaluations=watch.count, stop=stop)


def _into_box(point: Array, lower: Array, upper: Array) -> Array:
    """Clip a point (d,) into the box; what rounding left a hair off a bound is put on it.

    Only there is it seen to be on the bound: a hair inside it would shorten every next step to nothing.
    """
    hair = HAIR * (upper - lower)
    return np.where(point - lower <= hair, lower, np.where(upper - point <= hair, upper, point))


def _central_differences(
    watch: _Watch, p: Array, r: Array, grid: Grid, settings: LevenbergMarquardt
) -> Array:
    """Jacobian (m, d): steps are clipped at the bounds, where the residuals at p serve instead."""
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
    """Dampings of an iteration's trials with their points (d,); a step of no length is left out."""
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
    # What is left on a bound is zero but for rounding, which must not lead out of the box.
    scaled[active] = np.where(inward[active] * scaled[active] > HAIR, scaled[active], 0.0)
    step[used] = scaled / norms[used]
    moving = step != 0
    if not moving.any():
        return step
    room = np.where(step > 0, upper - p, p - lower)
    return step * min(1.0, float(np.min(room[moving] / np.abs(step[moving]))))
