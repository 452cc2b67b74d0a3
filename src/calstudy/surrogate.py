"""Universal Kriging of one response (section 2.3.2): affine trend, anisotropic Matern, ReML, noise.

The model of the responses z (n,) at the points U (n,d) is z = P beta + f(U) + noise with P = [1, U],
cov f = sigma^2 R(h; nu), h = ||(u - u') / rho||, and white noise of variance v. Everything is computed
from the contrasts W'z, where the columns of W are an orthonormal basis of the complement of P's columns:
G = W'KW with K = sigma^2 R + v I is the one matrix that is factorised.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dpocon
from scipy.optimize import minimize
from scipy.spatial.distance import cdist, squareform
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from calstudy.covariance import (
    NUGGET,
    Hyperparameters,
    covariance,
    matern,
    matern_derivatives,
    matern_tabulated,
)
from calstudy.errors import InputError, NumericsError
from calstudy.parameters import Array

Mode = Literal["paper", "robust"]

MANY = 20_000
"""Number of distances from which tabulating the correlation costs less than computing it."""


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What a user should look at before trusting a fitted surrogate."""

    leave_one_out_rmse: float
    """Root mean square of the leave-one-out errors, in units of the response; NaN when leaving out some
    point would leave the trend undetermined."""
    largest_standardised_residual: float
    """Largest leave-one-out error divided by its predicted standard deviation; above 3 is suspicious."""
    noise_sd: float
    """Estimated standard deviation of the noise, in units of the response."""
    at_bound: tuple[str, ...]
    """Hyperparameters that ended at a bound: 'variance', 'smoothness', 'range of <parameter>', 'noise'."""
    converged: bool
    """Whether the search for the hyperparameters met its tolerance."""


@dataclass(frozen=True, slots=True)
class Contrasts:
    """QR of the trend matrix P = [1, U] = Q T, and W that completes Q to an orthonormal basis."""

    U: Array
    """Points, (n,d)."""
    Q: Array
    """Basis of the trend, (n,q) with q = d + 1."""
    T: Array
    """Triangle of the trend, (q,q)."""
    W: Array
    """Basis of the contrasts, (n,n-q): W'P = 0, W'W = I."""

    @classmethod
    def of(cls, U: Array, names: Sequence[str] | None = None) -> Contrasts:
        """Factorise the trend at ``U`` (n,d); NumericsError when there is no contrast or P lacks rank."""
        n, d = U.shape
        if n < d + 2:
            raise NumericsError(
                f"{n} points are too few for an affine trend of {d} parameters and a covariance; "
                f"give at least {d + 2}"
            )
        spread = np.ptp(U, axis=0)
        for k in range(d):
            if spread[k] <= 1e-10 * max(1.0, float(np.abs(U[:, k]).max())):
                raise NumericsError(
                    f"{_name(k, names)} has the same value at all {n} points, so its trend cannot be "
                    "estimated; leave it out of the model or vary it"
                )
        full: Array
        T: Array
        full, T = np.linalg.qr(trend(U), mode="complete")
        length = np.linalg.norm(U - U.mean(axis=0), axis=0)
        for k in range(d):
            if abs(T[k + 1, k + 1]) <= 1e-10 * length[k]:
                raise NumericsError(
                    f"{_name(k, names)} is a linear combination of the parameters before it at all {n} "
                    "points, so the trend cannot be estimated; leave it out of the model or vary it freely"
                )
        return cls(U, full[:, : d + 1], T[: d + 1], full[:, d + 1 :])


def trend(U: Array) -> Array:
    """Affine trend P = [1, U] at points (m,d), shape (m,d+1)."""
    return np.column_stack([np.ones(len(U)), U])


def negative_log_restricted_likelihood(c: Contrasts, z: Array, p: Hyperparameters) -> float:
    """Return -log of the density of the contrasts W'z (ReML; [26] of the paper, p. 170), constants included.

    ``z`` (n,) responses, ``p`` in the units of ``z`` and ``c.U``. NumericsError when G is not positive.
    """
    y = c.W.T @ z
    L = _cholesky(c.W.T @ covariance(c.U, p) @ c.W)
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
    L = _cholesky(c.W.T @ K @ c.W)
    a = cho_solve((L, True), y)
    value = 0.5 * (len(y) * np.log(2.0 * np.pi) + y @ a) + np.log(np.diag(L)).sum()

    M = c.W @ (cho_solve((L, True), np.eye(len(y))) - np.outer(a, a)) @ c.W.T
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
    L: Array
    """Lower Cholesky factor of G, (n-q,n-q)."""
    KQ: Array
    """K Q, (n,q)."""

    @classmethod
    def of(cls, c: Contrasts, z: Array, p: Hyperparameters) -> Predictor:
        """Factorise once; ``z`` (n,), ``p`` in the units of ``z`` and ``c.U``."""
        K = covariance(c.U, p)
        L = _cholesky(c.W.T @ K @ c.W)
        alpha = c.W @ cho_solve((L, True), c.W.T @ z)
        beta = solve_triangular(c.T, c.Q.T @ (z - K @ alpha))
        return cls(c, p, beta, alpha, L, K @ c.Q)

    def mean(self, U: Array) -> Array:
        """Posterior mean of the noise-free process at ``U`` (m,d), shape (m,)."""
        return trend(U) @ self.beta + self._covariances(U) @ self.alpha

    def mean_and_variance(self, U: Array) -> tuple[Array, Array]:
        """Posterior mean and variance of the noise-free process at ``U`` (m,d), each (m,).

        The prediction's weights are Q b + W gamma: b reproduces the trend, gamma minimises the variance.
        """
        c, p = self.contrasts, self.parameters
        k = self._covariances(U)
        P = trend(U)
        b = solve_triangular(c.T, P.T, trans="T")
        error = k - (self.KQ @ b).T
        unadjusted = p.variance - np.einsum("mn,nm->m", k + error, c.Q @ b)
        gain = solve_triangular(self.L, c.W.T @ error.T, lower=True)
        variance = unadjusted - np.einsum("nm,nm->m", gain, gain)
        # On a data point without noise the true value is 0, and rounding can fall on either side of it.
        return P @ self.beta + k @ self.alpha, np.maximum(variance, 0.0)

    def leave_one_out(self) -> tuple[Array, Array]:
        """Errors z_i - prediction without point i, and the variances of these errors, each (n,).

        Closed form: with B = W G^-1 W' they are (B z)_i / B_ii and 1 / B_ii (the noise of z_i included).
        NaN where the other points do not determine the trend.
        """
        half = solve_triangular(self.L, self.contrasts.W.T, lower=True)
        precision = np.einsum("kn,kn->n", half, half)
        undetermined = np.einsum("nk,nk->n", self.contrasts.W, self.contrasts.W) < 1e-12
        precision = np.where(undetermined, np.nan, precision)
        return self.alpha / precision, 1.0 / precision

    def _covariances(self, U: Array) -> Array:
        p = self.parameters
        h2 = cdist(U / p.ranges, self.contrasts.U / p.ranges, "sqeuclidean")
        return p.variance * (matern_tabulated if h2.size > MANY else matern)(h2, p.smoothness)


@dataclass(frozen=True, slots=True)
class Search:
    """Where a mode looks for hyperparameters: starts and bounds for theta, and a Gaussian prior on it."""

    starts: tuple[Array, ...]
    lower: Array
    upper: Array
    centre: Array
    precision: Array
    """1 / sd^2 of the prior of each element of theta; 0 is no prior."""

    def minimise(self, c: Contrasts, z: Array) -> tuple[Array, bool]:
        """Return the best theta over the starts, and whether its run converged.

        From each start one run of sequential quadratic programming, bounded, with the exact gradient: the
        same kind of solver as Octave's `sqp` that STK runs.
        """

        def objective(theta: Array) -> tuple[float, Array]:
            value, gradient = likelihood_gradient(c, z, theta)
            pull = self.precision * (theta - self.centre)
            return value + 0.5 * float(pull @ (theta - self.centre)), gradient + pull

        bounds = np.column_stack([self.lower, self.upper])
        options = {"ftol": 1e-10, "maxiter": 500}
        settings: dict[str, Any] = {"jac": True, "method": "SLSQP", "bounds": bounds, "options": options}
        runs = [minimize(objective, start, **settings) for start in self.starts]
        best = min(runs, key=lambda run: float(run.fun))
        return np.asarray(best.x, float), bool(best.success)


def grid(c: Contrasts, z: Array) -> list[tuple[float, Array]]:
    """STK 2.3.4's 15 starts with their negative log restricted likelihoods, in the units of ``z``.

    Isotropic ranges on the unit cube times noise-to-variance ratios; sigma^2 is the generalised least
    squares estimate (n-q degrees of freedom) with the model's own affine trend; nu = 5d/2.
    """
    d = c.U.shape[1]
    y = c.W.T @ z
    nu = float(np.clip(2.5 * d, *smoothness_bounds(d)))
    starts = []
    for rho in np.geomspace(np.sqrt(d) / 50.0, 2.0 * np.sqrt(d), 5):
        correlation = Hyperparameters(1.0, nu, (float(rho),) * d, 0.0)
        projected = c.W.T @ covariance(c.U, correlation) @ c.W
        for ratio in (1e-6, 1e-3, 1.0):
            L = _cholesky(projected + ratio * np.eye(len(y)))
            half = solve_triangular(L, y, lower=True)
            sigma2 = float(half @ half) / len(y)
            value = 0.5 * len(y) * (np.log(2.0 * np.pi * sigma2) + 1.0) + np.log(np.diag(L)).sum()
            theta = np.log([sigma2, nu, *(1.0 / rho,) * d, ratio * sigma2])
            starts.append((float(value), theta))
    return starts


def smoothness_bounds(d: int) -> tuple[float, float]:
    """Interval of the smoothness nu for d inputs (STK)."""
    return 0.5, min(50.0, 10.0 * d)


def paper_search(c: Contrasts, z: Array) -> Search:
    """STK 2.3.4's single start and bounds for a standardised response (empirical variance 1).

    Its least noise variance, the machine epsilon in squared units of the response, is taken here in units
    of the empirical variance, so that the response's unit does not matter. There is no prior.
    """
    d = c.U.shape[1]
    _, start = min(grid(c, z), key=lambda s: s[0])
    nu = np.log(smoothness_bounds(d))
    lower = np.array([min(-5.0, start[0]), nu[0], *(start[2:-1] - 5.0), 0.0])
    upper = np.array([max(5.0, start[0]), nu[1], *(start[2:-1] + 5.0), 0.0])
    lower[-1] = min(np.log(np.finfo(float).eps), start[-1] - 0.5)
    upper[-1] = max(0.5, start[-1] + 0.5)
    none = np.zeros(d + 3)
    return Search((start,), lower, upper, none, none)


def robust_search(c: Contrasts, z: Array) -> Search:
    """Weak log-normal priors and four starts, for a standardised response.

    With 10 to 50 noisy points the restricted likelihood is flat and has several optima; the highest ones
    often take noise for short-ranged structure, or the reverse, and `paper` escapes that only by its one
    start. A prior decides where the data do not, after which the best of several starts is also the one
    to have. Its centres: ranges of four diagonals of the cube, because what remains of a response after its
    affine trend is usually bent gently; noise a tenth of the response's variance; nu = 2.5, the
    customary smoothness. One sd is a factor e for a range, e^2 for sigma^2 and the noise, e^0.5 for nu.
    """
    d = c.U.shape[1]
    diagonal = np.sqrt(d)
    centre = np.log([1.0, 2.5, *(1.0 / (4.0 * diagonal),) * d, 0.1])
    sd = np.array([2.0, 0.5, *(1.0,) * d, 2.0])
    starts = tuple(
        np.log([1.0, 2.5, *(1.0 / (rho * diagonal),) * d, noise])
        for rho, noise in itertools.product((0.5, 2.0), (1e-3, 1e-1))
    )
    return Search(starts, centre - 5.0 * sd, centre + 5.0 * sd, centre, 1.0 / sd**2)


SEARCHES: dict[str, Callable[[Contrasts, Array], Search]] = {"paper": paper_search, "robust": robust_search}


class UniversalKriging(RegressorMixin, BaseEstimator):
    """Surrogate of one response, with scikit-learn's manners.

    Parameters
    ----------
    lower, upper : (d,) intervals of the parameters, in their own units; inputs are scaled to [0, 1] by
        them. None takes the data's range.
    parameter_names : names for messages and diagnostics; None calls them "column 0" and so on.
    mode : "paper" is what the authors did (`paper_search`), "robust" what we advise (`robust_search`).

    Attributes after `fit`
    ----------------------
    hyperparameters_ : on the unit cube, variances in squared units of the response.
    diagnostics_ : `Diagnostics`.
    negative_log_likelihood_ : restricted, of the responses in their own units.
    n_features_in_ : d.
    """

    def __init__(
        self,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        *,
        parameter_names: Sequence[str] | None = None,
        mode: Mode = "paper",
    ) -> None:
        self.lower = lower
        self.upper = upper
        self.parameter_names = parameter_names
        self.mode = mode

    def fit(self, X: ArrayLike, y: ArrayLike) -> UniversalKriging:
        """Estimate the hyperparameters from points ``X`` (n,d) and responses ``y`` (n,), n >= d + 2.

        InputError: shapes that do not fit, NaN or infinite values, an interval that is none, an unknown
        mode. NumericsError: too few points, a constant or linearly dependent column.
        """
        if self.mode not in SEARCHES:
            raise InputError(f"mode {self.mode!r} is unknown; use {' or '.join(map(repr, SEARCHES))}")
        points, responses = _finite(X, "X"), _finite(y, "y")
        if points.ndim != 2 or responses.shape != points.shape[:1]:
            raise InputError(f"X {points.shape} and y {responses.shape} must have shapes (n,d) and (n,)")
        self.n_features_in_ = points.shape[1]
        self._set_box(points)
        c = Contrasts.of(self._to_unit(points), self.parameter_names)

        self._centre = float(responses.mean())
        deviations = responses - self._centre
        self._scale = float(deviations.std(ddof=1))
        rounding = 1e-12 * float(np.abs(responses).max())
        if np.linalg.norm(c.W.T @ deviations) <= rounding * np.sqrt(len(responses)):
            return self._fit_exact_trend(c, deviations)

        z = deviations / self._scale
        search = SEARCHES[self.mode](c, z)
        theta, converged = search.minimise(c, z)
        standardised = Hyperparameters.of(theta)
        self._predictor = Predictor.of(c, z, standardised)
        self.hyperparameters_ = standardised.scaled(1.0, self._scale)
        self.negative_log_likelihood_ = negative_log_restricted_likelihood(c, z, standardised) + c.W.shape[
            1
        ] * np.log(self._scale)
        error, variance = self._predictor.leave_one_out()
        self.diagnostics_ = Diagnostics(
            leave_one_out_rmse=self._scale * float(np.sqrt(np.mean(error**2))),
            largest_standardised_residual=float(np.max(np.abs(error) / np.sqrt(variance))),
            noise_sd=float(np.sqrt(self.hyperparameters_.noise_variance)),
            at_bound=self._at_bound(theta, search),
            converged=converged,
        )
        return self

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Array: ...

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Array, Array]: ...

    def predict(self, X: ArrayLike, return_std: bool = False) -> Array | tuple[Array, Array]:
        """Posterior mean of the noise-free process at ``X`` (m,d), in units of the response, shape (m,).

        With ``return_std`` also its standard deviation (m,). InputError for a wrong shape or NaN.
        """
        check_is_fitted(self)
        points = _finite(X, "X")
        if points.ndim != 2 or points.shape[1] != self.n_features_in_:
            raise InputError(f"X {points.shape} must have shape (m,{self.n_features_in_})")
        unit = self._to_unit(points)
        if not return_std:
            return self._centre + self._scale * self._predictor.mean(unit)
        mean, variance = self._predictor.mean_and_variance(unit)
        return self._centre + self._scale * mean, self._scale * np.sqrt(variance)

    def _fit_exact_trend(self, c: Contrasts, deviations: Array) -> UniversalKriging:
        """A response that is constant or affine to the last digit: the trend is the answer, with sd 0."""
        n, q = c.Q.shape
        p = Hyperparameters(0.0, 2.5, (1.0,) * (q - 1), 0.0)
        beta = solve_triangular(c.T, c.Q.T @ deviations)
        self._scale = 1.0
        self._predictor = Predictor(c, p, beta, np.zeros(n), np.eye(n - q), np.zeros((n, q)))
        self.hyperparameters_ = p
        self.negative_log_likelihood_ = -np.inf
        self.diagnostics_ = Diagnostics(0.0, 0.0, 0.0, (), True)
        return self

    def _set_box(self, points: Array) -> None:
        d = points.shape[1]
        lower = points.min(axis=0) if self.lower is None else _finite(self.lower, "lower")
        upper = points.max(axis=0) if self.upper is None else _finite(self.upper, "upper")
        if lower.shape != (d,) or upper.shape != (d,):
            raise InputError(f"lower {lower.shape} and upper {upper.shape} must have shape ({d},) as X has")
        if self.parameter_names is not None and len(self.parameter_names) != d:
            raise InputError(f"{len(self.parameter_names)} parameter names were given for {d} columns of X")
        for k in range(d):
            if lower[k] > upper[k] or (lower[k] == upper[k] and self.lower is not None):
                raise InputError(
                    f"{_name(k, self.parameter_names)}: interval [{lower[k]}; {upper[k]}] must go upwards"
                )
        self._lower = lower
        # A constant column without a given interval is reported by Contrasts.of, by its name.
        self._width = np.where(upper > lower, upper - lower, 1.0)

    def _to_unit(self, points: Array) -> Array:
        return (points - self._lower) / self._width

    def _at_bound(self, theta: Array, search: Search) -> tuple[str, ...]:
        d = self.n_features_in_
        ranges = (f"range of {_name(k, self.parameter_names)}" for k in range(d))
        names = ("variance", "smoothness", *ranges, "noise")
        margin = 1e-6 * (search.upper - search.lower)
        hit = (theta <= search.lower + margin) | (theta >= search.upper - margin)
        return tuple(name for name, at in zip(names, hit, strict=True) if at)


def _cholesky(G: Array) -> Array:
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


def _finite(values: ArrayLike, what: str) -> Array:
    array = np.asarray(values, float)
    if not np.isfinite(array).all():
        raise InputError(f"{what} contains NaN or infinite values; leave failed runs out of the data")
    return array


def _name(k: int, names: Sequence[str] | None) -> str:
    return f"column {k}" if names is None else str(names[k])
