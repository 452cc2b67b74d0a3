"""One response at two fidelities, conditioned on the runs of both.

The model of a run at the point u of the unit cube (Kennedy and O'Hagan, Biometrika 87, 2000, with scale 1) is

    cheap        y = beta + f(u) + noise
    expensive    y = beta + f(u) + c s(u) + t g(u) + noise

f is the Matern process that Kriging fits to the cheap runs. s is the known form of the offset and c its size,
another coefficient of the trend. Nothing is known of it beforehand, or what earlier runs measured (mean and
standard deviation). So the runs decide the offset, and its doubt is part of every prediction. g is a process
like f: t tells how much of the response's own variation the offset has, and 1 / sqrt(1 + t^2) is the
correlation of the fidelities. t is 0 unless the restricted likelihood says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.spatial.distance import cdist

from calstudy.calibration.kriging.covariance import Hyperparameters, matern, matern_tabulated
from calstudy.calibration.kriging.predictor import MANY, cholesky
from calstudy.parameters import Array

VARYING = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6)
"""Values of t that are tried."""
CLEARLY = 2.0
"""The smallest t is taken whose log restricted likelihood is within this of the largest."""


@dataclass(frozen=True, slots=True)
class Places:
    """Where a response is asked for, and at which fidelity."""

    U: Array
    """Points of the unit cube, (n, d)."""
    shape: Array
    """s at them where the fidelity is the expensive one, 0 where it is the cheap one, (n,)."""
    expensive: NDArray[np.float64]
    """1 or 0, (n,)."""

    @classmethod
    def of(cls, U: Array, shape: Array, is_expensive: NDArray[np.bool_] | bool) -> Places:
        """Points (n, d) with the values (n,) that s has there."""
        expensive = np.where(np.broadcast_to(is_expensive, len(U)), 1.0, 0.0)
        return cls(U, shape * expensive, expensive)


@dataclass(frozen=True, slots=True)
class TwoLevels:
    """A response conditioned on runs of both fidelities."""

    runs: Places
    y: Array
    """Responses (n,)."""
    noise: Array
    """Their noise variances (n,)."""
    known: tuple[float, float] | None
    """Mean and standard deviation of c as measured before; None: nothing is known."""
    parameters: Hyperparameters
    """Of f, in units of the response and of the unit cube."""
    varying: float
    """t."""
    likelihoods: tuple[float, ...]
    """Log restricted likelihood at each of VARYING; only their differences mean something."""
    L: Array
    """Lower Cholesky factor of the responses' covariance, (n, n)."""
    LP: Array
    """L^-1 P with the trend P = [1, s], or [1] where nothing is known of the offset, (n, q)."""
    doubt: Array
    """Covariance of the trend's coefficients, (q, q)."""
    beta: Array
    """The coefficients, (q,): the level and the offset."""
    alpha: Array
    """K^-1 (y - P beta), (n,)."""

    @classmethod
    def given(
        cls,
        runs: Places,
        y: Array,
        noise: Array,
        p: Hyperparameters,
        known: tuple[float, float] | None = None,
    ) -> TwoLevels:
        """Condition on responses (n,) with noise variances (n,). NumericsError: they are singular."""
        found = [cls._at(runs, y, noise, p, t, known) for t in VARYING if t == 0 or runs.expensive.sum() > 1]
        likelihoods = tuple(value for _, value in found)
        enough = max(likelihoods) - CLEARLY
        chosen = next(level for level, value in found if value >= enough)
        return replace(chosen, likelihoods=likelihoods)

    def at(self, p: Hyperparameters) -> TwoLevels:
        """The same runs at other hyperparameters, whose noise is that of the cheap ones."""
        noise = np.where(self.runs.expensive > 0, self.noise, p.noise_variance)
        return TwoLevels.given(self.runs, self.y, noise, p, self.known)

    @classmethod
    def _at(
        cls,
        runs: Places,
        y: Array,
        noise: Array,
        p: Hyperparameters,
        varying: float,
        known: tuple[float, float] | None = None,
    ) -> tuple[TwoLevels, float]:
        """The same at a known t, with its log restricted likelihood."""
        K = covariances(runs, runs, p, varying) + np.diag(noise)
        L = cholesky(K)
        P = trend(runs) if known or runs.expensive.any() else trend(runs)[:, :1]
        LP, Ly = (solve_triangular(L, right, lower=True) for right in (P, y))
        # What is known of c counts as one more run that measured it.
        rows, right = (np.array([[0.0, 1.0]]), known[0]) if known else (np.zeros((0, P.shape[1])), 0.0)
        sd = known[1] if known else 1.0
        whole, measured = np.vstack([LP, rows / sd]), np.append(Ly, [right / sd] * len(rows))
        R = np.linalg.qr(whole, mode="r")
        doubt = cho_solve((R, False), np.eye(len(R)))
        beta = doubt @ (whole.T @ measured)
        rest = measured - whole @ beta
        alpha = solve_triangular(L, rest[: len(y)], lower=True, trans="T")
        value = -0.5 * rest @ rest - np.log(np.diag(L)).sum() - np.log(np.abs(np.diag(R))).sum()
        return cls(runs, y, noise, known, p, varying, (), L, LP, doubt, beta, alpha), float(value)

    def mean(self, at: Places) -> Array:
        """Expected noise-free responses (k,)."""
        return trend(at)[:, : len(self.beta)] @ self.beta + self._covariances(at) @ self.alpha

    def covariance(self, at: Places, other: Places) -> Array:
        """Posterior covariances (k,) of the noise-free responses at k places with those at k others."""
        prior = self.parameters.variance * (1.0 + self.varying**2 * at.expensive * other.expensive)
        if at is not other:
            h2 = (((at.U - other.U) / self.parameters.ranges) ** 2).sum(axis=1)
            prior = prior * matern(h2, self.parameters.smoothness)
        (a, r), (b, s) = (self._known(p, self._covariances(p)) for p in (at, other))
        found: Array = prior - np.einsum("nk,nk->k", a, b) + np.einsum("qk,qr,rk->k", r, self.doubt, s)
        return found

    def variance(self, at: Places) -> Array:
        """Posterior variances (k,) of the noise-free responses."""
        return self.mean_and_variance(at)[1]

    def mean_and_variance(self, at: Places) -> tuple[Array, Array]:
        """Expected noise-free responses (k,) and their posterior variances (k,)."""
        k = self._covariances(at)
        a, r = self._known(at, k)
        prior = self.parameters.variance * (1.0 + self.varying**2 * at.expensive**2)
        variance = prior - np.einsum("nk,nk->k", a, a) + np.einsum("qk,qr,rk->k", r, self.doubt, r)
        return trend(at)[:, : len(self.beta)] @ self.beta + k @ self.alpha, np.maximum(variance, 0.0)

    def _covariances(self, at: Places) -> Array:
        """Prior covariances (k, n) of places with the runs."""
        return covariances(at, self.runs, self.parameters, self.varying)

    def _known(self, at: Places, k: Array) -> tuple[Array, Array]:
        """What the runs tell of each place (n, k), and what they leave to the trend (q, k)."""
        told = solve_triangular(self.L, k.T, lower=True)
        return told, trend(at)[:, : len(self.beta)].T - self.LP.T @ told


def trend(at: Places) -> Array:
    """Trend [1, s] at places, (n, 2)."""
    return np.column_stack([np.ones(len(at.U)), at.shape])


def covariances(at: Places, other: Places, p: Hyperparameters, varying: float) -> Array:
    """Prior covariances (k, n) of f + t g at places."""
    h2 = cdist(at.U / p.ranges, other.U / p.ranges, "sqeuclidean")
    R = (matern_tabulated if h2.size > MANY else matern)(h2, p.smoothness)
    found: Array = p.variance * R * (1.0 + varying**2 * np.outer(at.expensive, other.expensive))
    return found
