"""Universal Kriging at given hyperparameters (section 2.3.2): likelihood, prediction, leave-one-out.

The model of the responses z (n,) at the points U (n,d) is z = P beta + f(U) + noise with P = [1, U]
(affine trend) or P = [1] (constant trend), cov f = sigma^2 R(h; nu), h = ||(u - u') / rho||, and white noise
of variance v. Everything is computed from the contrasts W'z, where the columns of W are an orthonormal basis
of the complement of P's columns: G = W'KW with K = sigma^2 R + v I is the one matrix that is factorised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dpocon, dpotrs
from scipy.spatial.distance import cdist, squareform

from calstudy.calibration.kriging.covariance import (
    NUGGET,
    Hyperparameters,
    covariance,
    matern,
    matern_derivatives,
    matern_tabulated,
)
from calstudy.errors import NumericsError
from calstudy.parameters import Array

Trend = Literal["affine", "constant"]

MANY = 200
"""With more distances than this, tabulating the correlation is faster than computing it at each."""


@dataclass(frozen=True, slots=True)
class Contrasts:
    """QR of the trend matrix P = Q T, and W that completes Q to an orthonormal basis."""

    U: Array
    """Points, (n,d)."""
    Q: Array
    """Basis of the trend, (n,q) with q = d + 1 (affine) or 1 (constant)."""
    T: Array
    """Triangle of the trend, (q,q)."""
    W: Array
    """Basis of the contrasts, (n,n-q): W'P = 0, W'W = I."""

    @classmethod
    def of(cls, U: Array, names: Sequence[str] | None = None, kind: Trend = "affine") -> Contrasts:
        """Factorise the trend at ``U`` (n,d); NumericsError: no contrast is left, or P is rank-deficient."""
        n, d = U.shape
        needed = least_points(d, kind)
        if n < needed:
            raise NumericsError(
                f"{n} points are too few for a trend ({kind}) of {d} parameters and a covariance; "
                f"give at least {needed}"
            )
        spread = np.ptp(U, axis=0)
        for k in range(d):
            if spread[k] <= 1e-10 * max(1.0, float(np.abs(U[:, k]).max())):
                raise NumericsError(
                    f"{column_name(k, names)} has the same value at all {n} points, so its trend cannot be "
                    "estimated; leave it out of the model or vary it"
                )
        full: Array
        T: Array
        full, T = np.linalg.qr(trend(U, kind), mode="complete")
        q = T.shape[1]
        if kind == "constant":
            return cls(U, full[:, :q], T[:q], full[:, q:])
        length = np.linalg.norm(U - U.mean(axis=0), axis=0)
        for k in range(d):
            if abs(T[k + 1, k + 1]) <= 1e-10 * length[k]:
                raise NumericsError(
                    f"{column_name(k, names)} is a linear combination of the parameters before it at all {n} "
                    "points, so the trend cannot be estimated; leave it out of the model or vary it freely"
                )
        return cls(U, full[:, :q], T[:q], full[:, q:])

    def trend(self, U: Array) -> Array:
        """Trend P at other points (m,d), shape (m,q)."""
        return trend(U, "constant" if self.Q.shape[1] == 1 else "affine")


def trend(U: Array, kind: Trend = "affine") -> Array:
    """Trend P at points (m,d): [1, U], shape (m,d+1), or [1], shape (m,1)."""
    one = np.ones((len(U), 1))
    return np.hstack([one, U]) if kind == "affine" else one


def least_points(d: int, kind: Trend = "affine") -> int:
    """Smallest number of points for a trend of d parameters and one contrast."""
    return d + 2 if kind == "affine" else 2


def negative_log_restricted_likelihood(c: Contrasts, z: Array, p: Hyperparameters) -> float:
    """Return -log of the density of the contrasts W'z (ReML; [26] of the paper, p. 170), constants included.

    ``z`` (n,) responses, ``p`` in the units of ``z`` and ``c.U``. NumericsError: G is singular.
    """
    y = c.W.T @ z
    L = cholesky(c.W.T @ covariance(c.U, p) @ c.W)
    half = solve_triangular(L, y, lower=True)
    return float(0.5 * (len(y) * np.log(2.0 * np.pi) + half @ half) + np.log(np.diag(L)).sum())


def likelihood_gradient(c: Contrasts, z: Array, theta: Array) -> tuple[float, Array]:
    """Return the negative log restricted likelihood and its exact gradient by theta (`Hyperparameters.of`).

    With M = W (G^-1 - a a') W', a = G^-1 W'z, the derivative by any hyperparameter is tr(M dK) / 2.
    """
    p = Hyperparameters.of(theta)
    d = len(p.ranges)
    i, j = np.triu_indices(len(z), 1)
    steps = ((c.U[i] - c.U[j]) / p.ranges) ** 2
    R, by_h2, by_log_nu = matern_derivatives(steps.sum(axis=1), p.smoothness)
    K: Array = squareform(p.variance * R)
    np.fill_diagonal(K, p.variance + p.noise_variance)

    y = c.W.T @ z
    L = cholesky(c.W.T @ K @ c.W)
    # LAPACK directly: scipy's wrappers take longer than solving so few equations.
    a, _ = dpotrs(L, y, lower=True)
    inverse, _ = dpotrs(L, np.eye(len(y)), lower=True)
    value = 0.5 * (len(y) * np.log(2.0 * np.pi) + y @ a) + np.log(np.diag(L)).sum()

    M = c.W @ (inverse - np.outer(a, a)) @ c.W.T
    pairs = M[i, j]  # each pair stands twice in the trace, which cancels the factor 1/2
    white = 0.5 * np.trace(M)
    gradient = np.empty(d + 3)
    gradient[0] = p.variance * (pairs @ R + (1.0 + NUGGET) * white)
    gradient[1] = p.variance * (pairs @ by_log_nu)
    gradient[2:-1] = p.variance * ((pairs * by_h2) @ (2.0 * steps))
    gradient[-1] = np.exp(theta[-1]) * white
    return float(value), gradient


@dataclass(frozen=True, slots=True)
class Predictor:
    """Best linear unbiased prediction of the noise-free process at given hyperparameters."""

    contrasts: Contrasts
    parameters: Hyperparameters
    beta: Array
    """Generalised least squares coefficients of the trend, (q,)."""
    alpha: Array
    """Weights of the covariances, alpha = W G^-1 W'z, (n,)."""
    half: Array
    """L^-1 W' with the lower Cholesky factor L of G, (n-q,n)."""
    weights: Array
    """T^-1 Q', (q,n): P times this is the responses' weights that reproduce the trend."""
    KW: Array
    """K times the transposed weights, (n,q)."""

    @classmethod
    def of(cls, c: Contrasts, z: Array, p: Hyperparameters) -> Predictor:
        """Factorise once; ``z`` (n,), ``p`` in the units of ``z`` and ``c.U``."""
        K = covariance(c.U, p)
        L = cholesky(c.W.T @ K @ c.W)
        alpha = c.W @ cho_solve((L, True), c.W.T @ z)
        beta = solve_triangular(c.T, c.Q.T @ (z - K @ alpha))
        half = solve_triangular(L, c.W.T, lower=True)
        weights = solve_triangular(c.T, c.Q.T)
        return cls(c, p, beta, alpha, half, weights, K @ weights.T)

    def mean(self, U: Array) -> Array:
        """Posterior mean of the noise-free process at ``U`` (m,d), shape (m,)."""
        return self.contrasts.trend(U) @ self.beta + self._covariances(U) @ self.alpha

    def mean_and_variance(self, U: Array) -> tuple[Array, Array]:
        """Posterior mean and variance of the noise-free process at ``U`` (m,d), each (m,).

        The responses' weights are w + W gamma: w reproduces the trend, gamma minimises the variance.
        """
        p = self.parameters
        k = p.variance * matern_tabulated(self._squared_distances(U), p.smoothness)
        P = self.contrasts.trend(U)
        w = P @ self.weights
        error = k - P @ self.KW.T
        gain = error @ self.half.T
        variance = p.variance - np.einsum("mn,mn->m", k + error, w) - np.einsum("mn,mn->m", gain, gain)
        # At a data point without noise the variance is 0, and rounding may make it negative.
        return P @ self.beta + k @ self.alpha, np.maximum(variance, 0.0)

    def leave_one_out(self) -> tuple[Array, Array]:
        """Errors z_i - prediction without point i, and the variances of these errors, each (n,).

        Closed form: with B = W G^-1 W' they are (B z)_i / B_ii and 1 / B_ii (the noise of z_i included).
        NaN where the other points do not determine the trend.
        """
        precision = np.einsum("kn,kn->n", self.half, self.half)
        undetermined = np.einsum("nk,nk->n", self.contrasts.W, self.contrasts.W) < 1e-12
        precision = np.where(undetermined, np.nan, precision)
        return self.alpha / precision, 1.0 / precision

    def _covariances(self, U: Array) -> Array:
        """Covariances (m,n) of the process at ``U`` (m,d) with the data."""
        p, h2 = self.parameters, self._squared_distances(U)
        return p.variance * (matern_tabulated if h2.size > MANY else matern)(h2, p.smoothness)

    def _squared_distances(self, U: Array) -> Array:
        """Squared distances (m,n) of ``U`` (m,d) from the data, in units of the ranges."""
        ranges = self.parameters.ranges
        return cdist(U / ranges, self.contrasts.U / ranges, "sqeuclidean")


def cholesky(G: Array) -> Array:
    """Lower Cholesky factor of G (k,k). NumericsError: G is singular to rounding."""
    singular = NumericsError(
        "the covariance of the responses is singular to rounding: points repeat without noise, or the "
        "ranges are far larger than the points' distances; give a larger noise variance"
    )
    try:
        L: Array = np.asarray(np.linalg.cholesky(G), float)
    except np.linalg.LinAlgError as error:
        raise singular from error
    # Rounding can also leave a positive pivot where there should be none.
    condition, _ = dpocon(L, np.abs(G).sum(axis=0).max(), uplo="L")
    if condition <= 4.0 * np.finfo(float).eps:
        raise singular
    return L


def column_name(k: int, names: Sequence[str] | None) -> str:
    """Name of the k-th input in messages."""
    return f"column {k}" if names is None else str(names[k])
