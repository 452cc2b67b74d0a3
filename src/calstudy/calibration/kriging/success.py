"""How probable it is that a run gives responses, by the runs that did and those that did not.

A Gaussian process on the unit cube is squeezed into a probability by the logistic function; its posterior is
Laplace's approximation (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, algorithms 3.1
and 3.2). The process is a constant, a slope along each parameter, and bumps, with variances fixed beforehand:
a few failed runs cannot tell them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.distance import cdist
from scipy.special import expit

from calstudy.parameters import Array

CONSTANT, SLOPE, BUMPS = 2.0, 30.0, 4.0
"""Variances of the constant, of each slope over its interval, and of the bumps."""
RANGE = 0.25
"""Range of the bumps, as a share of the cube's diagonal."""
MOST_STEPS, REST = 50, 1e-10
"""Newton's method ends when no value of the process moves by more than REST."""
LIKELY = 0.5
"""Where a run is less likely to give responses than this, it is expected to fail."""


@dataclass(frozen=True, slots=True)
class Success:
    """Probability of responses at points of the unit cube."""

    runs: Array
    """Points (n, d) that were run."""
    usable: NDArray[np.bool_]
    """Which of them gave responses, (n,)."""
    gradient: Array
    """Of the log-likelihood at the mode, (n,)."""
    root: Array
    """Square roots (n,) of the likelihood's curvature there."""
    factor: Array
    """Lower Cholesky factor (n, n) of 1 + root K root."""

    @classmethod
    def of(cls, runs: Array, usable: NDArray[np.bool_]) -> Success | None:
        """By runs (n, d) in the unit cube; None if all gave responses, or none did."""
        if usable.all() or not usable.any():
            return None
        K, f = _covariance(runs, runs), np.zeros(len(runs))
        for _ in range(MOST_STEPS):
            p = expit(f)
            root = np.sqrt(p * (1.0 - p))
            factor, lower = cho_factor(np.eye(len(f)) + root[:, None] * K * root, lower=True)
            b = root**2 * f + usable - p
            moved = K @ (b - root * cho_solve((factor, lower), root * (K @ b)))
            still = float(np.abs(moved - f).max()) <= REST
            f = moved
            if still:
                break
        p = expit(f)
        root = np.sqrt(p * (1.0 - p))
        factor, _ = cho_factor(np.eye(len(f)) + root[:, None] * K * root, lower=True)
        return cls(runs, usable, usable - p, root, np.tril(factor))

    def __call__(self, unit: Array) -> Array:
        """Probabilities (k,) at points (k, d)."""
        k = _covariance(unit, self.runs)
        half = solve_triangular(self.factor, self.root[:, None] * k.T, lower=True)
        variance = _variance(unit) - np.einsum("nk,nk->k", half, half)
        # The mean of the logistic function of a normal variable (MacKay, Neural Comput. 4, 1992).
        return np.asarray(expit(k @ self.gradient / np.sqrt(1.0 + np.pi / 8.0 * np.maximum(variance, 0.0))))


def _covariance(one: Array, two: Array) -> Array:
    length = RANGE * np.sqrt(one.shape[1])
    bumps: Array = BUMPS * np.exp(-0.5 * cdist(one, two, "sqeuclidean") / length**2)
    return CONSTANT + SLOPE * (one - 0.5) @ (two - 0.5).T + bumps


def _variance(unit: Array) -> Array:
    return np.asarray(CONSTANT + BUMPS + SLOPE * np.sum((unit - 0.5) ** 2, axis=1))
