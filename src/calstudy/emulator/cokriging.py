"""A response conditioned on runs of one or more fidelities: what it is expected to be, and draws of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from calstudy.calibration.kriging.predictor import cholesky
from calstudy.emulator.process import (
    SEARCHED,
    TELLING,
    WIDE,
    Mask,
    Numbers,
    Observations,
    Offset,
    Prior,
    Settings,
    five_halves,
    mixing,
    negative_log_posterior,
    noise_variance,
    trend_covariance,
)
from calstudy.errors import NumericsError
from calstudy.parameters import Array

FEATURES = 1024
"""Random features of a draw's prior part; their error is a few hundredths of the prior's variance."""
REFUSED = 1e10
"""Stands for the negative log posterior where the covariance is singular to rounding."""


def standardised(data: Observations) -> tuple[Observations, float, float]:
    """Runs with responses of mean 0 and variance 1, and what was taken off and divided by."""
    centre, scale = float(data.y.mean()), float(data.y.std(ddof=1))
    return data.with_responses((data.y - centre) / scale), centre, scale


def posterior_mode(data: Observations, prior: Prior) -> Array:
    """Most probable theta given standardised runs: the best of several quasi-Newton searches.

    With many runs the searches are made among some of them, and the best is brought to its end among all.
    """
    bounds = np.column_stack([prior.centre - 5.0 * prior.sd, prior.centre + 5.0 * prior.sd])
    settings: dict[str, Any] = {"jac": True, "method": "L-BFGS-B", "bounds": bounds}

    def search(of: Observations, start: Array) -> tuple[float, Array]:
        def objective(theta: Array) -> tuple[float, Array]:
            try:
                return negative_log_posterior(of, prior, theta)
            except NumericsError:  # a corner that a line search tries: it turns back
                return REFUSED, np.zeros_like(theta)

        run = minimize(objective, start, **settings)
        return float(run.fun), np.asarray(run.x, float)

    some = data.thinned(SEARCHED)
    best = min((search(some, start) for start in prior.starts(data.U.shape[1])), key=lambda run: run[0])[1]
    return best if len(some.y) == len(data.y) else search(data, best)[1]


@dataclass(frozen=True)
class CoKriging:
    """A response conditioned on runs, at given hyperparameters. Results are at the reference fidelity.

    It is conditioned when it is first asked: of a study's draws each asks only one of the members.
    """

    data: Observations
    settings: Settings
    centre: float
    """What was taken from the responses before they were divided by ``scale``."""
    scale: float

    @classmethod
    def fit(cls, data: Observations) -> CoKriging:
        """Condition at the hyperparameters that are most probable given `TELLING` runs of each fidelity."""
        d = data.U.shape[1]
        scaled, centre, scale = standardised(data)
        theta = posterior_mode(scaled.thinned(TELLING), Prior.of(d, data.levels))
        return cls(data, Settings.of(theta, d), centre, scale)

    @cached_property
    def L(self) -> Array:
        """Lower Cholesky factor of the standardised responses' covariance, (n,n).

        NumericsError where it is singular. On several threads the last digits would be others, and of a
        calibration on it every digit.
        """
        data, p = self.data, self.settings
        C = mixing(data.level, data.shape(data.U), p.factors)
        with threadpool_limits(1):
            K = _covariance(data.U, C, data.U, C, p)
            return cholesky(K + np.diag(noise_variance(data.U, data.level, p)))

    @cached_property
    def alpha(self) -> Array:
        """The inverse of that covariance times the standardised responses, (n,)."""
        L = self.L
        with threadpool_limits(1):
            return np.asarray(cho_solve((L, True), (self.data.y - self.centre) / self.scale), float)

    def mean(self, U: Array) -> Array:
        """Expected noise-free response at ``U`` (m,d), shape (m,)."""
        return self.centre + self.scale * (self._to_data(U, self._here(U)) @ self.alpha)

    def mean_and_sd(self, U: Array) -> tuple[Array, Array]:
        """Expected noise-free response at ``U`` (m,d) and its standard deviation, each (m,)."""
        mean, variance = self._predicted(U, self._reference(U))
        return mean, self.scale * np.sqrt(np.maximum(variance, 0.0))

    def noise_sd(self, U: Array) -> Array:
        """Standard deviation of a reference run from seed to seed at ``U`` (m,d), shape (m,)."""
        return self.scale * np.sqrt(noise_variance(U, self._reference(U), self.settings))

    def left_out(self, points: Numbers) -> tuple[Array, Array]:
        """Errors of all runs, and the errors' standard deviations, each predicted without its point; (n,).

        ``points`` (n,) numbers the points that runs share: all runs of a point are left out together, so
        that a repeat does not tell its twin. Hyperparameters stay. The noise of the run is part of the
        standard deviation. Block form of the formula of Dubrule (Math. Geol. 15, 1983).
        """
        inverse = cho_solve((self.L, True), np.eye(len(points)))
        error, variance = np.empty(len(points)), np.empty(len(points))
        _, counts = np.unique(points, return_counts=True)
        for rows in np.split(np.argsort(points, kind="stable"), np.cumsum(counts)[:-1]):
            covariance = np.linalg.inv(inverse[np.ix_(rows, rows)])
            error[rows] = covariance @ self.alpha[rows]
            variance[rows] = np.diag(covariance)
        return self.scale * error, self.scale * np.sqrt(variance)

    def errors_elsewhere(self, data: Observations, chosen: Mask) -> tuple[Array, Array]:
        """Errors of runs that were not fitted (mask ``chosen`` of ``data``), and their sds."""
        U, level = data.U[chosen], data.level[chosen]
        mean, variance = self._predicted(U, level)
        noise = noise_variance(U, level, self.settings)
        return data.y[chosen] - mean, self.scale * np.sqrt(variance + noise)

    def draw(self, rng: np.random.Generator) -> Callable[[Array], Array]:
        """One function from the posterior: a map of points (m,d) to noise-free responses (m,).

        Pathwise conditioning (Wilson et al., J. Mach. Learn. Res. 22, 2021): a prior function made of random
        features, corrected by what the data say against it. The same generator state gives the same
        function, and the function the same value wherever and whenever it is asked.
        """
        p, data = self.settings, self.data
        d = data.U.shape[1]
        parts = [_prior_path(rng, np.array(p.ranges), p.variance, WIDE * rng.standard_normal(d + 1))]
        for offset in p.offsets or (Offset(1.0, 0.0, 1.0, 0.0),):
            constant = np.zeros(d + 1)
            constant[0] = WIDE * rng.standard_normal()
            parts.append(_prior_path(rng, np.full(d, offset.range), offset.variance, constant))
        if not p.offsets:
            parts.pop()  # drawn in vain, so that a number draws what it drew before

        def prior(U: Array, C: Array) -> Array:
            return np.asarray(sum(C[:, k] * part(U) for k, part in enumerate(parts)), float)

        noise = rng.standard_normal(len(data.y)) * np.sqrt(noise_variance(data.U, data.level, p))
        seen = prior(data.U, mixing(data.level, data.shape(data.U), p.factors)) + noise
        weights = cho_solve((self.L, True), (data.y - self.centre) / self.scale - seen)

        def path(U: Array) -> Array:
            C = self._here(U)
            return np.asarray(self.centre + self.scale * (prior(U, C) + self._to_data(U, C) @ weights), float)

        return path

    def _reference(self, U: Array) -> Numbers:
        return np.full(len(U), self.data.levels - 1)

    def _here(self, U: Array) -> Array:
        """Factors of m and of each delta in the noise-free reference response at ``U``, (m, levels)."""
        return mixing(self._reference(U), self.data.shape(U), self.settings.factors)

    def _to_data(self, U: Array, C: Array) -> Array:
        """Covariances (m,n) of responses at ``U`` (m,d), of factors ``C`` (m, levels), with the data."""
        data, p = self.data, self.settings
        return _covariance(U, C, data.U, mixing(data.level, data.shape(data.U), p.factors), p)

    def _predicted(self, U: Array, level: Numbers) -> tuple[Array, Array]:
        """Noise-free responses of runs at ``U`` (m,d), and their variances for standardised ones; (m,)."""
        p = self.settings
        C = mixing(level, self.data.shape(U), p.factors)
        k = self._to_data(U, C)
        half = solve_triangular(self.L, k.T, lower=True)
        prior = C[:, 0] ** 2 * (WIDE**2 * (1.0 + ((U - 0.5) ** 2).sum(axis=1)) + p.variance)
        prior += C[:, 1:] ** 2 @ np.array([WIDE**2 + offset.variance for offset in p.offsets])
        mean = self.centre + self.scale * (k @ self.alpha)
        return mean, prior - np.einsum("nm,nm->m", half, half)


def _covariance(U: Array, C: Array, V: Array, C_v: Array, p: Settings) -> Array:
    """Covariance of noise-free responses between runs at ``U`` (m,d) and at ``V`` (n,d), shape (m,n).

    ``C`` (m, levels) and ``C_v`` (n, levels) are the runs' factors of m and of each delta (`mixing`).
    """
    K = five_halves(cdist(U / p.ranges, V / p.ranges, "sqeuclidean"))
    K *= p.variance
    K += trend_covariance(U, V)
    K *= np.outer(C[:, 0], C_v[:, 0])
    for k, offset in enumerate(p.offsets, 1):
        rows, columns = np.flatnonzero(C[:, k]), np.flatnonzero(C_v[:, k])
        R = five_halves(cdist(U[rows] / offset.range, V[columns] / offset.range, "sqeuclidean"))
        K[np.ix_(rows, columns)] += np.outer(C[rows, k], C_v[columns, k]) * (WIDE**2 + offset.variance * R)
    return np.asarray(K, float)


def _prior_path(
    rng: np.random.Generator, ranges: Array, variance: float, coefficients: Array
) -> Callable[[Array], Array]:
    """A function from the prior of an affine trend of given coefficients plus a Matern 5/2 process.

    R(h) = E[exp(-h^2/g)], g ~ Gamma(5/2, rate 5/2) (``covariance``), and exp(-h^2/g) is the characteristic
    function of a normal frequency of variance 2/g: so the process's frequencies are drawn.
    """
    g = rng.gamma(2.5, 1.0 / 2.5, FEATURES)
    frequencies = rng.standard_normal((FEATURES, len(ranges))) * np.sqrt(2.0 / g)[:, None] / ranges
    phases = rng.uniform(0.0, 2.0 * np.pi, FEATURES)
    weights = rng.standard_normal(FEATURES) * np.sqrt(2.0 * variance / FEATURES)

    def path(U: Array) -> Array:
        trend = coefficients[0] + (U - 0.5) @ coefficients[1:]
        return np.asarray(trend + np.cos(U @ frequencies.T + phases) @ weights, float)

    return path
