"""Parameters given the targets: how probable each point is by the surrogates, and points drawn from it.

Everything is a function of arrays in the unit cube of the intervals. The prior is uniform over the allowed
part of the cube. A measured value y is normal about the response f at the true parameters. By the surrogates
f is normal, too, with a mean and a doubt at each point, so that

    p(y | point) = N(y; mean, error^2 + doubt^2).

That is exact for a Gaussian process, whatever the runs were chosen by: the runs are given, and only f at the
point matters. Where the surrogates know little nothing is excluded.

The points are drawn by tempering (Del Moral, Doucet and Jasra, J. R. Stat. Soc. B 68, 2006): from points of
the prior, the likelihood's power grows to 1 by steps that each leave half of the points effective; after each
the points are drawn anew and moved by differences of other points (ter Braak, Stat. Comput. 16, 2006).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from calstudy.parameters import Array

LogDensity = Callable[[Array], Array]
"""Logarithms (k,) of a density at points (k, d) of the unit cube, without its constant factor."""

POINTS = 2000
"""Points that are drawn."""
EFFECTIVE = 0.5
"""Share of the points that stays effective in a step of the tempering."""
LEAST_RISE = 1.01
"""A step multiplies the temperature by this at least, so that the tempering ends for any likelihood."""
MOVES, LAST_MOVES = 12, 48
"""Moves of all points after each step, and after the last one."""
JUMP = 0.1
"""Share of the moves that take a whole difference, which leads from one mode to another."""
ACCEPTED = 0.25
"""Share of the moves that the length of the differences is steered to."""
JITTER = 1e-4
"""Standard deviation that is added to each difference, so that the moves reach every point."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """Points drawn from a posterior."""

    unit: Array
    """Points (n, d) in the unit cube."""
    weight: Array
    """Weights (n,), which add up to 1."""
    log_evidence: float
    """Logarithm of the mean likelihood over the prior."""
    information: float
    """Nats by which the targets narrow the prior: the Kullback-Leibler divergence of the posterior."""


def chi_square(deviations: Array, doubts: Array, errors: Array) -> Array:
    """Squares (k,) of the deviations, in standard deviations, summed over the responses.

    ``deviations`` (k, m) are the surrogates' means minus the measured values, ``doubts`` (k, m) the standard
    deviations of these means, ``errors`` (m,) those of the measured values.
    """
    squares: Array = np.sum(deviations**2 / (errors**2 + doubts**2), axis=1)
    return squares


def log_likelihood(deviations: Array, doubts: Array, errors: Array) -> Array:
    """Logarithms (k,) of the density of the measured values at k points, without its constant factor.

    Arguments as of `chi_square`.
    """
    volume = np.log1p((doubts / errors) ** 2).sum(axis=1)
    return -0.5 * (chi_square(deviations, doubts, errors) + volume)


def draw(
    log_prior: LogDensity, log_likelihood: LogDensity, first: Array, seed: int, n: int = POINTS
) -> Drawn:
    """Draw n points from the density that is proportional to prior times likelihood.

    ``first`` (k, d) are points spread evenly over the unit cube or an allowed part of it, of which some have
    a finite prior. The same seed gives the same points.
    """
    rng = np.random.default_rng(seed)
    before = log_prior(first)
    evenly = drawn_anew(before, n, rng)
    x, prior = first[evenly], before[evenly]
    likelihood = log_likelihood(x)
    temperature, log_evidence, length = 0.0, 0.0, 2.38 / np.sqrt(2.0 * x.shape[1])

    def moved(length: float) -> float:
        """Move all points once, each half by differences of the other; returns the next length."""
        shuffled = rng.permutation(n)
        accepted = 0
        for half, other in (
            (shuffled[: n // 2], shuffled[n // 2 :]),
            (shuffled[n // 2 :], shuffled[: n // 2]),
        ):
            there = _proposals(x[half], x[other], length, rng)
            inside = np.all((there >= 0.0) & (there <= 1.0), axis=1)
            there = np.where(inside[:, None], there, x[half])
            prior_there, likelihood_there = log_prior(there), log_likelihood(there)
            gain = prior_there - prior[half] + temperature * (likelihood_there - likelihood[half])
            better = inside & (np.log(rng.random(len(half))) < gain)
            at = half[better]
            x[at], prior[at], likelihood[at] = there[better], prior_there[better], likelihood_there[better]
            accepted += int(better.sum())
        return float(np.clip(length * np.exp(accepted / n - ACCEPTED), 1e-3, 2.0))

    while temperature < 1.0:
        rise = _rise(likelihood, 1.0 - temperature)
        log_evidence += float(logsumexp(rise * likelihood) - np.log(n))
        chosen = drawn_anew(rise * likelihood, n, rng)
        x, prior, likelihood = x[chosen], prior[chosen], likelihood[chosen]
        temperature = min(max(temperature + rise, LEAST_RISE * temperature), 1.0)
        for _ in range(MOVES if temperature < 1.0 else LAST_MOVES):
            length = moved(length)
    return Drawn(x, np.full(n, 1.0 / n), log_evidence, float(likelihood.mean()) - log_evidence)


def _proposals(x: Array, others: Array, length: float, rng: np.random.Generator) -> Array:
    """Points (k, d) moved by differences of two others each; some leave the cube."""
    k, d = x.shape
    one = rng.integers(len(others), size=k)
    two = (one + rng.integers(1, len(others), size=k)) % len(others)
    lengths = np.where(rng.random(k) < JUMP, 1.0, length)[:, None]
    there: Array = x + lengths * (others[one] - others[two]) + JITTER * rng.standard_normal((k, d))
    return there


def _rise(likelihood: Array, most: float) -> float:
    """Step of the temperature, up to ``most``, that leaves EFFECTIVE of the points effective."""

    def effective(rise: float) -> float:
        weight = rise * likelihood
        return float(np.exp(2.0 * logsumexp(weight) - logsumexp(2.0 * weight))) / len(likelihood)

    if effective(most) >= EFFECTIVE:
        return most
    low, high = 0.0, most
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= EFFECTIVE else (low, middle)
    return high


def drawn_anew(log_weight: Array, n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Numbers (n,) of points drawn by their weights, with one random number for all (systematic)."""
    cumulated = np.cumsum(np.exp(log_weight - logsumexp(log_weight)))
    places = (rng.random() + np.arange(n)) / n
    return np.minimum(np.searchsorted(cumulated, places), len(log_weight) - 1)
