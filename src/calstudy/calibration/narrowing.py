"""What a solution space says: which changes make up for each other, profiles, and what would narrow it.

Everything is a function of points drawn from the posterior, in the unit cube of the intervals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calstudy.calibration.posterior import LogDensity
from calstudy.parameters import Array

TIED = 0.7
"""A parameter is tied to others if its standard deviation at given values of these is below this share of
what it is without."""
FREE = 0.25
"""A direction of tied parameters is free if the standard deviation along it is this share of the prior's."""
PART = 0.5
"""A parameter is part of a direction if its correlation with the place along it is this large."""
GRID = 25
"""Values of each parameter in a profile."""
STARTS, KEPT, ROUNDS, TRIED = 64, 6, 10, 8
"""A profile's search at each value: starts, how many are kept, rounds, and trials of each kept one."""
WIDEST, NARROWER, NARROWEST = 0.2, 0.05, 0.003
"""Standard deviation of the trials in the first round, in that from a neighbour, and in the last."""
HALVED = 500
"""Points that stand for what a further measurement might give."""


def made_up_for(unit: Array) -> list[Array]:
    """Directions (d,) along which changes of several parameters make up for each other, longest first.

    ``unit`` (n, d) are points of the posterior. A direction's length is the standard deviation along it;
    parameters that are not part of it are 0.
    """
    covariance = np.atleast_2d(np.cov(unit, rowvar=False))
    spread = np.sqrt(np.diag(covariance))
    given_others = 1.0 / np.sqrt(np.diag(np.linalg.pinv(covariance)))
    tied = np.flatnonzero(given_others < TIED * spread)
    if len(tied) < 2:
        return []
    spread = spread[tied]
    lengths, axes = np.linalg.eigh(covariance[np.ix_(tied, tied)] / np.outer(spread, spread))
    found = []
    for length, axis in zip(lengths[::-1], axes.T[::-1], strict=True):
        loadings = np.sqrt(max(length, 0.0)) * axis
        parts = np.where(np.abs(loadings) >= PART, loadings * spread, 0.0)
        if length > 1.0 and np.count_nonzero(parts) > 1 and np.linalg.norm(parts) >= FREE / np.sqrt(12.0):
            direction = np.zeros(unit.shape[1])
            direction[tied] = parts * np.sign(parts[np.abs(parts).argmax()])
            found.append(direction)
    return found


def in_words(direction: Array, width: Array, names: Sequence[str]) -> str:
    """A direction (d,) of the unit cube in words: "MU_PP up 0.05 is made up for by RF_PP down 0.012"."""
    order = [k for k in np.argsort(-np.abs(direction)) if direction[k]]
    first, *others = [
        f"{names[k]} {'up' if direction[k] > 0 else 'down'} {abs(direction[k]) * width[k]:.2g}" for k in order
    ]
    return f"{first} is made up for by {' and '.join(others)}"


@dataclass(frozen=True, slots=True)
class Profile:
    """Of one parameter: the best that the others can do at each of its values."""

    unit: Array
    """Values (g,), in shares of the interval."""
    likelihood: Array
    """Largest posterior density (g,) at each, relative to the largest of all."""


def profiles(density: LogDensity, drawn: Array, elsewhere: Array, seed: int) -> list[Profile]:
    """Profile of each parameter under a density.

    The search at each value begins at the nearest points of the posterior, ``drawn`` (n, d), and of those
    spread over the cube, ``elsewhere`` (k, d), and tries points at random around the best.
    """
    rng, d = np.random.default_rng(seed), drawn.shape[1]
    grid = np.linspace(0.0, 1.0, GRID)
    best = np.array([_profile(density, k, grid, drawn, elsewhere, rng) for k in range(d)])
    return [Profile(grid, line) for line in np.exp(best - best.max())]


def _profile(
    density: LogDensity, k: int, grid: Array, drawn: Array, elsewhere: Array, rng: np.random.Generator
) -> Array:
    """Largest logarithms (g,) of the density at values (g,) of parameter k.

    After a search at each value, it begins again at the best point of the value before, and of the one after.
    """
    points, found = np.empty((len(grid), drawn.shape[1])), np.empty(len(grid))
    for g, value in enumerate(grid):
        nearest = [x[np.argsort(np.abs(x[:, k] - value))[:STARTS]] for x in (drawn, elsewhere)]
        points[g], found[g] = _best(density, k, value, np.concatenate(nearest), WIDEST, rng)
    numbers = range(len(grid))
    for g, other in [
        *zip(numbers[1:], numbers, strict=False),
        *zip(numbers[-2::-1], numbers[:0:-1], strict=True),
    ]:
        point, better = _best(density, k, grid[g], points[other, None].copy(), NARROWER, rng)
        if better > found[g]:
            points[g], found[g] = point, better
    return found


def _best(
    density: LogDensity, k: int, value: float, x: Array, widest: float, rng: np.random.Generator
) -> tuple[Array, float]:
    """Best point (d,) and its logarithm where parameter k has a value, by trials around starts x (s, d)."""
    x[:, k] = value
    found = density(x)
    for sd in np.geomspace(widest, NARROWEST, ROUNDS):
        kept = np.argsort(-found)[:KEPT]
        x, found = x[kept], found[kept]
        there = np.repeat(x, TRIED, axis=0)
        there = np.clip(there + sd * rng.standard_normal(there.shape), 0.0, 1.0)
        there[:, k] = value
        x, found = np.concatenate([x, there]), np.concatenate([found, density(there)])
    best = int(np.argmax(found))
    return x[best], float(found[best])


def narrowed(unit: Array, responses: Array, doubts: Array, errors: Array, seed: int) -> Array:
    """Standard deviations (m, d) of the parameters to be expected if a response's error were halved.

    They are shares of those there are. Each is the mean over what the further measurement, whose error
    is errors / sqrt(3), might give, by the posterior itself: ``unit`` (n, d) are its points, ``responses``
    and ``doubts`` (n, m) the surrogates there.
    """
    rng = np.random.default_rng(seed)
    kept = np.arange(len(unit))[:: max(1, len(unit) // HALVED)]
    x, f, doubt = unit[kept], responses[kept], doubts[kept]
    now = x.std(axis=0)
    found = []
    for i, error in enumerate(errors / np.sqrt(3.0)):
        sd = np.hypot(error, doubt[:, i])
        measured = f[:, i] + sd * rng.standard_normal(len(f))
        z = (measured[:, None] - f[None, :, i]) / sd
        weight = np.exp(-0.5 * z**2) / sd
        weight /= weight.sum(axis=1, keepdims=True)
        variance = weight @ x**2 - (weight @ x) ** 2
        found.append(np.sqrt(np.maximum(variance.mean(axis=0), 0.0)) / now)
    return np.array(found)


KERNEL = 0.025
"""Standard deviation, as a share of the interval, within which points count as having a value."""


def held(unit: Array, weights: Array, values: Mapping[int, float]) -> tuple[Array, float]:
    """Weights (n,) of points where some parameters are held at values, and how many points count then.

    ``unit`` (n, d) are points of the posterior with ``weights`` (n,), ``values`` shares of the interval by
    the number of the parameter. What the others must do is read off the points with these weights: it is
    the posterior given the values, smoothed by a normal kernel. The number is (sum w)^2 / sum w^2.
    """
    distance = np.zeros(len(unit))
    for k, value in values.items():
        distance += ((unit[:, k] - value) / KERNEL) ** 2
    near = weights * np.exp(-0.5 * (distance - distance.min()))
    near /= near.sum()
    # Far from all points the nearest ones would be taken; they must not count as being there.
    there = float(np.exp(-0.5 * distance.min()))
    return near, there / float(np.sum(near**2))


def weighted_quantiles(values: Array, weights: Array, shares: Sequence[float]) -> Array:
    """Quantiles of values (n,) with weights (n,) that add up to 1."""
    order = np.argsort(values)
    below = np.cumsum(weights[order]) - 0.5 * weights[order]
    return np.interp(shares, below, values[order])
