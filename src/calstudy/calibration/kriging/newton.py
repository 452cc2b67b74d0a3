"""Newton's method from the end of a search, so that every machine finds the same minimum.

A quasi-Newton search ends somewhere near the minimum. Rounding changes its path, so that two processors end
at points that differ by more than rounding. Newton's method takes these ends to one point, except along
directions in which the function is flat: there the result does not depend on the point.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from calstudy.parameters import Array

DIFFERENCE = 1e-4
"""Difference step of the gradient, from which the second derivatives are taken."""
FLAT = 1e-6
"""A direction with less curvature is flat. The point is not moved along it."""
LONGEST = 0.5
"""Longest move of a step along an eigenvector of the second derivatives."""
REST = 1e-6
"""A step that moves no coordinate by more is the last. The error left is of the order of its square."""
MOST_STEPS = 30
HAIR = 1e-9
"""A coordinate closer than this to a bound is on the bound."""

Function = Callable[[Array], tuple[float, Array]]
"""Value and gradient (k,) at a point (k,)."""


def at_rest(function: Function, end: Array, lower: Array, upper: Array) -> Array:
    """Return the point (k,) inside the bounds where Newton's method from ``end`` (k,) comes to rest.

    A coordinate stays on a bound that the gradient pushes it against. The method also ends if a step does
    not reduce the gradient's pull. Function values are not compared: where they are smallest, a
    gradient made of differences is not quite zero.
    """
    t = np.where(end - lower < HAIR, lower, np.where(upper - end < HAIR, upper, end))
    gradient = function(t)[1]
    for _ in range(MOST_STEPS):
        free = np.flatnonzero(~(((t <= lower) & (gradient > 0.0)) | ((t >= upper) & (gradient < 0.0))))
        step = np.zeros(len(t))
        step[free] = _newton_step(_curvature(function, t, free), gradient[free])
        there = np.clip(t + step, lower, upper)
        gradient_there = function(there)[1]
        if _pull(there, gradient_there, lower, upper) >= _pull(t, gradient, lower, upper):
            break
        moved = float(np.max(np.abs(there - t), initial=0.0))
        t, gradient = there, gradient_there
        if moved <= REST:
            break
    return t


def _pull(t: Array, gradient: Array, lower: Array, upper: Array) -> float:
    """Distance that a unit step down the gradient moves a point inside the bounds."""
    return float(np.linalg.norm(np.clip(t - gradient, lower, upper) - t))


def _curvature(function: Function, t: Array, free: NDArray[np.intp]) -> Array:
    """Second derivatives (f, f) by the free coordinates: central differences of the gradient."""
    rows = []
    for k in free:
        side = np.zeros(len(t))
        side[k] = DIFFERENCE
        rows.append((function(t + side)[1] - function(t - side)[1])[free] / (2.0 * DIFFERENCE))
    H = np.array(rows).reshape(len(free), len(free))
    return 0.5 * (H + H.T)


def _newton_step(H: Array, gradient: Array) -> Array:
    """Step (f,) along the directions that are curved upwards."""
    curvatures, directions = np.linalg.eigh(H)
    along = directions.T @ gradient
    curved = curvatures > FLAT
    moves = np.where(curved, -along / np.where(curved, curvatures, 1.0), 0.0)
    return np.asarray(directions @ np.clip(moves, -LONGEST, LONGEST), float)
