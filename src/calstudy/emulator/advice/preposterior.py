"""Pre-posterior analysis: how much measurements that nobody has made yet would narrow the parameters.

Everything is a function of arrays. A sample of n points of the unit cube, with weights, stands for what is
known of the parameters now. A surrogate knows a response at each point up to its doubt, so a value that is
measured where the parameters are those of point i is normal about its mean there, with the variance
error^2 + doubt^2. Such values are drawn, and the sample is weighed anew by the likelihood of each (importance
sampling). The means over many of them are what is to be expected (Lindley, Ann. Math. Stat. 27, 1956).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from calstudy.calibration.posterior import log_likelihood
from calstudy.parameters import Array

LEAST = 1.5
"""Effective points that a covariance is corrected for at least; with fewer it is a guess anyway."""


@dataclass(frozen=True, slots=True)
class After:
    """What is known after each of j sets of measured values."""

    covariance: Array
    """Of the parameters, (j, d, d)."""
    information: Array
    """Nats (j,) by which the values narrow what was known before: a Kullback-Leibler divergence."""
    effective: Array
    """Number of points (j,) that are as good as the weighted sample."""


def hypothetical(means: Array, doubts: Array, errors: Array, n: int, rng: np.random.Generator) -> Array:
    """Values (n, m) that may be measured at a point where surrogates have ``means`` and ``doubts`` (m,)."""
    drawn: Array = means + np.hypot(errors, doubts) * rng.standard_normal((n, len(errors)))
    return drawn


def log_likelihoods(measured: Array, means: Array, doubts: Array, error: float) -> Array:
    """Logarithms (j, n) of the density of j measured values of one response at n points.

    ``means`` and ``doubts`` (n,) are the surrogate's, ``error`` is the measurement's.
    """
    sd = np.array([error])
    return np.array([log_likelihood(means[:, None] - y, doubts[:, None], sd) for y in measured])


def after(unit: Array, log_likelihood: Array, log_before: Array | None = None) -> After:
    """What is known after j measurements.

    ``unit`` (n, d) are points, ``log_before`` (n,) the logarithms of their weights now (None: equal ones),
    ``log_likelihood`` (j, n) those of what was measured.
    """
    n, d = unit.shape
    before = np.zeros(n) if log_before is None else log_before
    before = before - logsumexp(before)
    log_weights = before + log_likelihood
    log_weights = log_weights - logsumexp(log_weights, axis=1, keepdims=True)
    weights = np.exp(log_weights)
    with np.errstate(invalid="ignore"):
        gained = np.where(weights > 0.0, weights * (log_weights - before), 0.0)
    effective = 1.0 / np.sum(weights**2, axis=1)
    products = (unit[:, :, None] * unit[:, None, :]).reshape(n, d * d)
    mean = weights @ unit
    covariance = (weights @ products).reshape(-1, d, d) - mean[:, :, None] * mean[:, None, :]
    # As of a sample of so many points with their own mean: n - 1 in the place of n.
    covariance = covariance / (1.0 - 1.0 / np.maximum(effective, LEAST))[:, None, None]
    return After(covariance, gained.sum(axis=1), effective)


def spread(covariance: Array, directions: Array) -> Array:
    """Standard deviations (k,) along directions (k, d) of a covariance (d, d)."""
    length: Array = np.linalg.norm(directions, axis=1)
    squared = np.einsum("ki,ij,kj->k", directions, covariance, directions)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)) / length, float)
