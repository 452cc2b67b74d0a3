"""The surrogate of one response (section 2.3.2): universal Kriging with estimated hyperparameters.

The two modes search for the hyperparameters in different ways: see `paper_search` and `robust_search`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular
from scipy.optimize import minimize
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted

from calstudy.calibration.kriging.covariance import Hyperparameters, covariance
from calstudy.calibration.kriging.newton import at_rest
from calstudy.calibration.kriging.predictor import (
    Contrasts,
    Predictor,
    Trend,
    cholesky,
    column_name,
    likelihood_gradient,
    negative_log_restricted_likelihood,
)
from calstudy.errors import InputError
from calstudy.parameters import Array

EQUAL = 1e-9
"""Log-likelihoods that differ by less are equal but for rounding. Of such starts a settled fit takes the
first."""

DECIMALS = 6
"""Decimals to which a settled fit rounds theta, the logarithms of the hyperparameters."""

ModeName = Literal["paper", "robust"]


@dataclass(frozen=True, slots=True)
class Diagnostics:
    """What a user should look at before trusting a fitted surrogate."""

    leave_one_out_rmse: float
    """Root mean square of the leave-one-out errors, in units of the response; NaN if the trend is
    undetermined without one of the points."""
    largest_standardised_residual: float
    """Largest leave-one-out error divided by its predicted standard deviation; above 3 is suspicious."""
    noise_sd: float
    """Estimated standard deviation of the noise, in units of the response."""
    at_bound: tuple[str, ...]
    """Hyperparameters that ended at a bound: 'variance', 'smoothness', 'range of <parameter>', 'noise'."""
    converged: bool
    """Whether the search for the hyperparameters met its tolerance."""
    data_range: tuple[float, float]
    """Smallest and largest fitted response, in units of the response."""


@dataclass(frozen=True, slots=True)
class Search:
    """How a mode searches for hyperparameters: starts, bounds and a Gaussian prior of theta (d + 3,)."""

    starts: tuple[Array, ...]
    """The search begins at the start with the smallest objective."""
    lower: Array
    upper: Array
    centre: Array
    precision: Array
    """1 / sd^2 of the prior of each element of theta; 0 is no prior."""
    tolerance: float = 1e-10
    """The search ends when the objective changes by less; 1 is a factor e in the likelihood."""
    settled: bool = False
    """Whether its end is brought to rest (see ``newton``) and rounded to DECIMALS."""

    def minimise(self, c: Contrasts, z: Array) -> tuple[Array, bool]:
        """Return theta (d + 3,) at the end of the search, and whether the search converged.

        It is one run of bounded sequential quadratic programming with the exact gradient, the kind of
        solver that STK uses (Octave's `sqp`). With a prior, theta is measured in the prior's standard
        deviations, so that the solver begins with the prior's curvature.
        """
        unit = np.where(self.precision > 0, np.sqrt(self.precision), 1.0)

        def objective(t: Array) -> tuple[float, Array]:
            theta = self.centre + t / unit
            value, gradient = likelihood_gradient(c, z, theta)
            return value + self.penalty(theta), (gradient + self.precision * (theta - self.centre)) / unit

        found = minimize(
            objective,
            unit * (self._best_start(c, z) - self.centre),
            jac=True,
            method="SLSQP",
            bounds=list(
                zip(unit * (self.lower - self.centre), unit * (self.upper - self.centre), strict=True)
            ),
            options={"ftol": self.tolerance, "maxiter": 500},
        )
        t = np.asarray(found.x, float)
        if not self.settled:
            return self.centre + t / unit, bool(found.success)
        t = at_rest(objective, t, unit * (self.lower - self.centre), unit * (self.upper - self.centre))
        return np.round(self.centre + t / unit, DECIMALS), bool(found.success)

    def _best_start(self, c: Contrasts, z: Array) -> Array:
        """Start (d + 3,) with the smallest objective."""
        if len(self.starts) == 1:
            return self.starts[0]

        def objective(theta: Array) -> float:
            return negative_log_restricted_likelihood(c, z, Hyperparameters.of(theta)) + self.penalty(theta)

        return min(self.starts, key=objective)

    def penalty(self, theta: Array) -> float:
        """Negative log of the prior, up to a constant."""
        return 0.5 * float(self.precision * (theta - self.centre) @ (theta - self.centre))


def _first_of_least(found: Sequence[tuple[float, Array]], settled: bool) -> Array:
    """Start (d + 3,) with the smallest objective; if settled, the first within EQUAL of it."""
    most = min(value for value, _ in found) + (EQUAL if settled else 0.0)
    return next(start for value, start in found if value <= most)


def stk_starts(c: Contrasts, z: Array) -> list[tuple[float, Array]]:
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
            L = cholesky(projected + ratio * np.eye(len(y)))
            half = solve_triangular(L, y, lower=True)
            sigma2 = float(half @ half) / len(y)
            value = 0.5 * len(y) * (np.log(2.0 * np.pi * sigma2) + 1.0) + np.log(np.diag(L)).sum()
            theta = np.log([sigma2, nu, *(1.0 / rho,) * d, ratio * sigma2])
            starts.append((float(value), theta))
    return starts


def smoothness_bounds(d: int) -> tuple[float, float]:
    """Interval of the smoothness nu for d inputs (STK)."""
    return 0.5, min(50.0, 10.0 * d)


def paper_search(c: Contrasts, z: Array, noise: float | None = None, settled: bool = False) -> Search:
    """STK 2.3.4's single start and bounds for a standardised response (empirical variance 1).

    STK's smallest noise variance is the machine epsilon in squared units of the response. Here it is in
    units of the empirical variance, so that the response's unit does not matter. There is no prior, and a
    known ``noise`` variance is ignored.
    """
    d = c.U.shape[1]
    start = _first_of_least(stk_starts(c, z), settled)
    nu = np.log(smoothness_bounds(d))
    lower = np.array([min(-5.0, start[0]), nu[0], *(start[2:-1] - 5.0), 0.0])
    upper = np.array([max(5.0, start[0]), nu[1], *(start[2:-1] + 5.0), 0.0])
    lower[-1] = min(np.log(np.finfo(float).eps), start[-1] - 0.5)
    upper[-1] = max(0.5, start[-1] + 0.5)
    none = np.zeros(d + 3)
    return Search((start,), lower, upper, none, none, settled=settled)


def robust_search(c: Contrasts, z: Array, noise: float | None = None, settled: bool = False) -> Search:
    """Weak log-normal priors and a few starts, for a standardised response.

    With 10 to 50 noisy points the restricted likelihood is flat and has several maxima. The highest often
    mistakes noise for short-range structure, or the reverse; ``paper`` avoids it only by its single start.
    A prior decides where the data do not. With it, the highest maximum is also the best one to have.

    Centres of the prior: ranges of four diagonals of the cube, because responses usually bend gently;
    sigma^2 = 1 with an affine trend and 10 with a constant one, where the process must make the slopes too;
    noise a tenth of the response's variance, or the known ``noise`` variance; nu = 2.5, the customary
    smoothness. One sd is a factor e for a range, e^2 for sigma^2 and the noise (e^0.3 if it is known),
    e^0.5 for nu. ``settled`` is not needed: with the prior no direction is flat, and the ends on two
    processors differed by 1e-11 at most.
    """
    d = c.U.shape[1]
    diagonal = np.sqrt(d)
    variance = 1.0 if c.Q.shape[1] > 1 else 10.0
    known = noise is not None and noise > 0
    level = float(noise) if noise is not None and noise > 0 else 0.1
    centre = np.log([variance, 2.5, *(1.0 / (4.0 * diagonal),) * d, level])
    sd = np.array([2.0, 0.5, *(1.0,) * d, 0.3 if known else 2.0])
    starts = tuple(
        np.log([variance, 2.5, *(1.0 / (rho * diagonal),) * d, start])
        for rho, start in itertools.product((0.5, 2.0), (level,) if known else (1e-3, 1e-1))
    )
    return Search(starts, centre - 5.0 * sd, centre + 5.0 * sd, centre, 1.0 / sd**2, tolerance=1e-6)


SEARCHES: dict[str, Callable[[Contrasts, Array, float | None, bool], Search]] = {
    "paper": paper_search,
    "robust": robust_search,
}


@dataclass(frozen=True, slots=True)
class Standardised:
    """Data of a fit, with inputs in the unit cube and responses of mean 0 and standard deviation 1."""

    contrasts: Contrasts
    responses: Array
    """(n,)."""
    noise_variance: float | None
    """Known variance of the noise."""
    centre: float
    scale: float
    """Mean and standard deviation of the responses in their units."""


class UniversalKriging(RegressorMixin, BaseEstimator):
    """Surrogate of one response, as a scikit-learn estimator.

    Parameters
    ----------
    lower, upper : (d,) intervals of the parameters, in their own units. Inputs are scaled to [0, 1] by
        them. None: the range of the data.
    parameter_names : names for messages and diagnostics. None: "column 0" and so on.
    mode : "paper" is what the authors did (`paper_search`), "robust" what we recommend (`robust_search`).
    trend : "affine", which is [1, x], or "constant". With a constant trend the process makes the slopes,
        too. They are shrunk where the data say little, and fewer points are enough.
    noise_sd : known standard deviation of the noise, in units of the response. "robust" centres a narrow
        prior on it; "paper" ignores it. None: estimated from the data.
    start : a further start for "robust", such as `hyperparameters_` of a fit to part of the data. It is
        taken if it is more likely than the mode's own starts.
    settled : whether the hyperparameters come out the same on every machine. The end of the search is
        brought to rest (see ``newton``), and rounding does not choose the start.

    Attributes
    ----------
    hyperparameters_ : after `fit`, on the unit cube, variances in squared units of the response.
    diagnostics_ : `Diagnostics`.
    leave_one_out_errors_ : (n,) each response minus its prediction from the others, in closed form.
    standardised_ : `Standardised` data; None where the trend explains them to the last digit.
    n_features_in_ : d.
    """

    def __init__(
        self,
        lower: ArrayLike | None = None,
        upper: ArrayLike | None = None,
        *,
        parameter_names: Sequence[str] | None = None,
        mode: ModeName = "paper",
        trend: Trend = "affine",
        noise_sd: float | None = None,
        start: Hyperparameters | None = None,
        settled: bool = False,
    ) -> None:
        self.lower = lower
        self.upper = upper
        self.parameter_names = parameter_names
        self.mode = mode
        self.trend = trend
        self.noise_sd = noise_sd
        self.start = start
        self.settled = settled

    def fit(self, X: ArrayLike, y: ArrayLike) -> UniversalKriging:
        """Estimate the hyperparameters from points ``X`` (n,d) and responses ``y`` (n,).

        n >= d + 2 for an affine trend, n >= 2 for a constant one.

        InputError: shapes that do not fit, NaN or infinite values, an empty interval, an
        unknown mode or trend. NumericsError: too few points, a constant or linearly dependent column.
        """
        if self.mode not in SEARCHES:
            raise InputError(f"mode {self.mode!r} is unknown; use {' or '.join(map(repr, SEARCHES))}")
        if self.trend not in get_args(Trend):
            raise InputError(f"trend {self.trend!r} is unknown; use 'affine' or 'constant'")
        points, responses = _finite(X, "X"), _finite(y, "y")
        if points.ndim != 2 or responses.shape != points.shape[:1]:
            raise InputError(f"X {points.shape} and y {responses.shape} must have shapes (n,d) and (n,)")
        self.n_features_in_ = points.shape[1]
        self._set_box(points)
        if self.start is not None and len(self.start.ranges) != points.shape[1]:
            raise InputError(
                f"start has {len(self.start.ranges)} ranges, but X has {points.shape[1]} columns"
            )
        c = Contrasts.of(self.to_unit(points), self.parameter_names, self.trend)

        self._centre = float(responses.mean())
        deviations = responses - self._centre
        self._scale = float(deviations.std(ddof=1))
        self.standardised_: Standardised | None = None
        rounding = 1e-12 * float(np.abs(responses).max())
        if np.linalg.norm(c.W.T @ deviations) <= rounding * np.sqrt(len(responses)):
            return self._fit_exact_trend(c, deviations, responses)

        z = deviations / self._scale
        noise = None if self.noise_sd is None else (self.noise_sd / self._scale) ** 2
        search = SEARCHES[self.mode](c, z, noise, self.settled)
        if self.start is not None and self.start.variance > 0 and self.mode != "paper":
            start = self.start.scaled(1.0, 1.0 / self._scale).theta
            search = replace(search, starts=(*search.starts, np.clip(start, search.lower, search.upper)))
        theta, converged = search.minimise(c, z)
        self.standardised_ = Standardised(c, z, noise, self._centre, self._scale)
        standardised = Hyperparameters.of(theta)
        self._predictor = Predictor.of(c, z, standardised)
        self.hyperparameters_ = standardised.scaled(1.0, self._scale)
        error, variance = self._predictor.leave_one_out()
        self.leave_one_out_errors_ = self._scale * error
        self.diagnostics_ = Diagnostics(
            leave_one_out_rmse=float(np.sqrt(np.mean(self.leave_one_out_errors_**2))),
            largest_standardised_residual=float(np.max(np.abs(error) / np.sqrt(variance))),
            noise_sd=float(np.sqrt(self.hyperparameters_.noise_variance)),
            at_bound=self._at_bound(theta, search),
            converged=converged,
            data_range=(float(responses.min()), float(responses.max())),
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
        unit = self.to_unit(points)
        if not return_std:
            return self._centre + self._scale * self._predictor.mean(unit)
        mean, variance = self._predictor.mean_and_variance(unit)
        return self._centre + self._scale * mean, self._scale * np.sqrt(variance)

    def _fit_exact_trend(self, c: Contrasts, deviations: Array, responses: Array) -> UniversalKriging:
        """Fit a response that the trend reproduces to the last digit: the trend predicts it, with sd 0."""
        n, q = c.Q.shape
        none = np.zeros((q, n))
        p = Hyperparameters(0.0, 2.5, (1.0,) * c.U.shape[1], 0.0)
        beta = solve_triangular(c.T, c.Q.T @ deviations)
        self._scale = 1.0
        self._predictor = Predictor(c, p, beta, np.zeros(n), np.zeros((n - q, n)), none, none.T)
        self.hyperparameters_ = p
        self.leave_one_out_errors_ = np.zeros(n)
        spread = float(responses.min()), float(responses.max())
        self.diagnostics_ = Diagnostics(0.0, 0.0, 0.0, (), True, spread)
        return self

    def _set_box(self, points: Array) -> None:
        """Set the intervals (d,) that inputs are scaled by; InputError if they do not fit points (n,d)."""
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
                    f"{column_name(k, self.parameter_names)}: "
                    f"interval [{lower[k]}; {upper[k]}] must go upwards"
                )
        self._lower = lower
        # A constant column without a given interval is reported by Contrasts.of, by its name.
        self._width = np.where(upper > lower, upper - lower, 1.0)

    def to_unit(self, points: Array) -> Array:
        """Points (n,d) scaled to [0, 1] by the intervals."""
        return (points - self._lower) / self._width

    def _at_bound(self, theta: Array, search: Search) -> tuple[str, ...]:
        """Names of the elements of theta (d + 3,) that ended at a bound."""
        d = self.n_features_in_
        ranges = (f"range of {column_name(k, self.parameter_names)}" for k in range(d))
        names = ("variance", "smoothness", *ranges, "noise")
        margin = 1e-6 * (search.upper - search.lower)
        hit = (theta <= search.lower + margin) | (theta >= search.upper - margin)
        return tuple(name for name, at in zip(names, hit, strict=True) if at)


def _finite(values: ArrayLike, what: str) -> Array:
    """Values of any shape as floats. InputError: one is not finite."""
    array = np.asarray(values, float)
    if not np.isfinite(array).all():
        raise InputError(f"{what} contains NaN or infinite values; leave failed runs out of the data")
    return array
