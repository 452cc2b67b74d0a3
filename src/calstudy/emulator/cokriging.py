"""One response at one or two fidelities as a Gaussian process, with noise that depends on the parameters.

The model of a run at the point u of the unit cube (autoregressive co-Kriging, Kennedy and O'Hagan,
Biometrika 87, 2000, with all hyperparameters estimated jointly) is

    cheap fidelity:      y = m(u) + noise
    reference fidelity:  y = rho m(u) + delta(u) + noise

m is an affine trend plus a Matern process (nu = 5/2, one range for each input), delta a constant plus an
isotropic Matern process, and the noise is normal with log variance a + b'(u - 1/2), plus tau at the
reference. Because both fidelities are one process, the designs need not be nested, repeats are ordinary
rows, and the noise is estimated from repeats and residuals at once. The trends' coefficients have a normal
prior so wide that it decides nothing; hyperparameters are those of largest posterior density under weak
priors (`Prior`), or drawn from it (``ensemble``). With one fidelity alone, rho, delta and tau are not there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from calstudy.calibration.kriging.covariance import matern_five_halves
from calstudy.calibration.kriging.predictor import cholesky
from calstudy.errors import NumericsError
from calstudy.parameters import Array

Mask = NDArray[np.bool_]
Numbers = NDArray[np.int64]

WIDE = 5.0
"""Prior standard deviation of a trend's coefficients, in standard deviations of the response."""
FEATURES = 1024
"""Random features of a draw's prior part; their error is a few hundredths of the prior's variance."""


@dataclass(frozen=True, slots=True)
class Observations:
    """Runs of one response."""

    U: Array
    """Points of the unit cube, (n,d)."""
    y: Array
    """Responses, (n,)."""
    is_reference: Mask
    """Whether each run has the reference fidelity, (n,) bool."""

    def __post_init__(self) -> None:
        n, d = self.U.shape
        if self.y.shape != (n,) or self.is_reference.shape != (n,):
            raise NumericsError(f"{n} points, responses {self.y.shape}, fidelities {self.is_reference.shape}")
        if n < d + 3:
            raise NumericsError(f"{n} runs are too few for a trend of {d} inputs and a noise; run more")
        if not self.is_reference.any():
            raise NumericsError("no run has the reference fidelity; run some")
        if np.ptp(self.y) <= 1e-12 * np.abs(self.y).max():
            raise NumericsError("the response is the same in all runs; there is nothing to emulate")

    @property
    def has_two_fidelities(self) -> bool:
        """Whether there are runs of a cheap fidelity, too."""
        return not bool(self.is_reference.all())

    def without(self, left_out: Mask) -> Observations:
        """The runs but those of a mask (n,)."""
        return Observations(self.U[~left_out], self.y[~left_out], self.is_reference[~left_out])


@dataclass(frozen=True, slots=True)
class Settings:
    """Hyperparameters, for a response that is centred and scaled to variance 1."""

    variance: float
    """sigma^2 of m's process."""
    ranges: tuple[float, ...]
    """Of m's process, in units of the inputs' intervals, with STK's convention (see ``covariance``)."""
    noise: float
    """Log variance of a cheap run's noise at the middle of the cube (of the only fidelity's)."""
    noise_slopes: tuple[float, ...]
    """b: change of the log variance over each input's interval."""
    rho: float = 1.0
    delta_variance: float = 0.0
    delta_range: float = 1.0
    reference_noise: float = 0.0
    """tau."""

    @classmethod
    def of(cls, theta: Array, d: int) -> Settings:
        """Read a vector as `Prior` orders it."""
        ranges = tuple(map(float, np.exp(-theta[1 : d + 1])))
        slopes = tuple(map(float, theta[d + 2 : 2 * d + 2]))
        first = (float(np.exp(theta[0])), ranges, float(theta[d + 1]), slopes)
        if len(theta) == 2 * d + 2:
            return cls(*first)
        rho, log_variance, log_rate, tau = map(float, theta[2 * d + 2 :])
        return cls(*first, rho, float(np.exp(log_variance)), float(np.exp(-log_rate)), tau)


@dataclass(frozen=True, slots=True)
class Prior:
    """Normal prior of theta, and the bounds of the search: five standard deviations to either side.

    theta = (log sigma^2, log 1/range_1 ... d, noise, noise slopes 1 ... d) and, with two fidelities,
    (rho, log sigma_delta^2, log 1/range_delta, tau). The centres are those of ``surrogate.robust_search``
    where it has them. A slope's sd of 1 lets the noise's standard deviation change by a factor of 1.6 over
    an interval as a matter of course. Both fidelities compute the same thing: rho is near 1, delta small.
    """

    centre: Array
    sd: Array

    @classmethod
    def of(cls, d: int, has_two_fidelities: bool) -> Prior:
        """Prior for d inputs."""
        rate = -np.log(4.0 * np.sqrt(d))
        centre = [0.0, *(rate,) * d, np.log(0.1), *(0.0,) * d]
        sd = [2.0, *(1.0,) * d, 2.0, *(1.0,) * d]
        if has_two_fidelities:
            centre += [1.0, np.log(0.03), rate, 0.0]
            sd += [0.2, 1.5, 1.0, 0.7]
        return cls(np.array(centre), np.array(sd))

    def starts(self, d: int) -> list[Array]:
        """Where the search begins: long and short ranges, with little and much noise."""
        found = []
        for shorter in (-0.7, 1.5):
            for noisier in (-2.0, 0.0):
                start = self.centre.copy()
                start[1 : d + 1] += shorter
                start[d + 1] += noisier
                found.append(start)
        return found


REFUSED = 1e10
"""Stands for the negative log posterior where the covariance is singular to rounding."""


def negative_log_posterior(data: Observations, prior: Prior, theta: Array) -> tuple[float, Array]:
    """Negative log density of theta given standardised responses, up to a constant, with its gradient.

    NumericsError where the covariance is singular to rounding.
    """
    d = data.U.shape[1]
    p = Settings.of(theta, d)
    c, e = _levels(data.is_reference, p.rho, data.has_two_fidelities)
    steps = (data.U[:, None, :] - data.U) ** 2 * np.exp(2.0 * theta[1 : d + 1])
    R, by_h2 = matern_five_halves(steps.sum(axis=2))
    base = trend_covariance(data.U, data.U) + p.variance * R
    v = _noise_variance(data.U, p, e)
    K = np.outer(c, c) * base + np.diag(v)
    if data.has_two_fidelities:
        rate2 = np.exp(2.0 * theta[-2])
        h2 = ((data.U[:, None, :] - data.U) ** 2).sum(axis=2) * rate2
        R_delta, delta_by_h2 = matern_five_halves(h2)
        K += np.outer(e, e) * (WIDE**2 + p.delta_variance * R_delta)
    L = cholesky(K)
    alpha = cho_solve((L, True), data.y)
    pull = (theta - prior.centre) / prior.sd
    value = 0.5 * data.y @ alpha + np.log(np.diag(L)).sum() + 0.5 * pull @ pull

    M = cho_solve((L, True), np.eye(len(v))) - np.outer(alpha, alpha)
    Mc = M * np.outer(c, c)
    gradient = np.empty_like(theta)
    gradient[0] = 0.5 * p.variance * np.sum(Mc * R)
    gradient[1 : d + 1] = p.variance * np.einsum("ij,ijk->k", Mc * by_h2, steps)
    white = 0.5 * np.diag(M) * v
    gradient[d + 1] = white.sum()
    gradient[d + 2 : 2 * d + 2] = white @ (data.U - 0.5)
    if data.has_two_fidelities:
        Me = M * np.outer(e, e)
        gradient[-4] = e @ (M * base) @ c
        gradient[-3] = 0.5 * p.delta_variance * np.sum(Me * R_delta)
        gradient[-2] = p.delta_variance * np.sum(Me * delta_by_h2 * h2)
        gradient[-1] = white @ e
    return float(value), gradient + pull / prior.sd


def standardised(data: Observations) -> tuple[Observations, float, float]:
    """Runs with responses of mean 0 and variance 1, and what was taken off and divided by."""
    centre, scale = float(data.y.mean()), float(data.y.std(ddof=1))
    return Observations(data.U, (data.y - centre) / scale, data.is_reference), centre, scale


def posterior_mode(data: Observations, prior: Prior) -> Array:
    """Most probable theta given standardised runs: the best of several quasi-Newton searches."""
    bounds = np.column_stack([prior.centre - 5.0 * prior.sd, prior.centre + 5.0 * prior.sd])
    settings: dict[str, Any] = {"jac": True, "method": "L-BFGS-B", "bounds": bounds}

    def objective(theta: Array) -> tuple[float, Array]:
        try:
            return negative_log_posterior(data, prior, theta)
        except NumericsError:  # a corner that a line search tries: it turns back
            return REFUSED, np.zeros_like(theta)

    runs = [minimize(objective, start, **settings) for start in prior.starts(data.U.shape[1])]
    return np.asarray(min(runs, key=lambda run: float(run.fun)).x, float)


@dataclass(frozen=True, slots=True)
class CoKriging:
    """A response conditioned on runs, at given hyperparameters. Results are at the reference fidelity."""

    data: Observations
    settings: Settings
    centre: float
    """What was taken from the responses before they were divided by ``scale``."""
    scale: float
    L: Array
    """Lower Cholesky factor of the standardised responses' covariance, (n,n)."""
    alpha: Array
    """Its inverse times the standardised responses, (n,)."""

    @classmethod
    def fit(cls, data: Observations) -> CoKriging:
        """Condition at the most probable hyperparameters."""
        d = data.U.shape[1]
        scaled, centre, scale = standardised(data)
        theta = posterior_mode(scaled, Prior.of(d, data.has_two_fidelities))
        return cls.given(data, Settings.of(theta, d), (centre, scale))

    @classmethod
    def given(cls, data: Observations, settings: Settings, standard: tuple[float, float]) -> CoKriging:
        """Condition on data at known hyperparameters; ``standard`` is the responses' centre and scale."""
        centre, scale = standard
        c, e = _levels(data.is_reference, settings.rho, data.has_two_fidelities)
        K = _covariance(data.U, c, e, data.U, c, e, settings)
        L = cholesky(K + np.diag(_noise_variance(data.U, settings, e)))
        return cls(data, settings, centre, scale, L, cho_solve((L, True), (data.y - centre) / scale))

    def mean(self, U: Array) -> Array:
        """Expected noise-free response at ``U`` (m,d), shape (m,)."""
        return self.centre + self.scale * (self._to_data(U) @ self.alpha)

    def mean_and_sd(self, U: Array) -> tuple[Array, Array]:
        """Expected noise-free response at ``U`` (m,d) and its standard deviation, each (m,)."""
        k = self._to_data(U)
        half = solve_triangular(self.L, k.T, lower=True)
        variance = np.maximum(
            self._prior_variance(U, *self._here(U)) - np.einsum("nm,nm->m", half, half), 0.0
        )
        return self.centre + self.scale * (k @ self.alpha), self.scale * np.sqrt(variance)

    def noise_sd(self, U: Array) -> Array:
        """Standard deviation of a reference run from seed to seed at ``U`` (m,d), shape (m,)."""
        return self.scale * np.sqrt(_noise_variance(U, self.settings, self._here(U)[1]))

    def left_out(self, points: Numbers) -> tuple[Array, Array]:
        """Errors of all runs, and the errors' standard deviations, each predicted without its point; (n,).

        ``points`` (n,) numbers the points that runs share: all runs of a point are left out together, so
        that a repeat does not tell its twin. Hyperparameters stay. The noise of the run is part of the
        standard deviation. Block form of the formula of Dubrule (Math. Geol. 15, 1983).
        """
        inverse = cho_solve((self.L, True), np.eye(len(points)))
        error, variance = np.empty(len(points)), np.empty(len(points))
        for point in np.unique(points):
            rows = np.flatnonzero(points == point)
            covariance = np.linalg.inv(inverse[np.ix_(rows, rows)])
            error[rows] = covariance @ self.alpha[rows]
            variance[rows] = np.diag(covariance)
        return self.scale * error, self.scale * np.sqrt(variance)

    def errors_elsewhere(self, data: Observations, chosen: Mask) -> tuple[Array, Array]:
        """Errors of runs that were not fitted (mask ``chosen`` of ``data``), and their sds."""
        c, e = _levels(data.is_reference[chosen], self.settings.rho, self.data.has_two_fidelities)
        U, p = data.U[chosen], self.settings
        k = self._to_data(U, c, e)
        half = solve_triangular(self.L, k.T, lower=True)
        variance = (
            self._prior_variance(U, c, e) - np.einsum("nm,nm->m", half, half) + _noise_variance(U, p, e)
        )
        return data.y[chosen] - self.centre - self.scale * (k @ self.alpha), self.scale * np.sqrt(variance)

    def draw(self, rng: np.random.Generator) -> Callable[[Array], Array]:
        """One function from the posterior: a map of points (m,d) to noise-free responses (m,).

        Pathwise conditioning (Wilson et al., J. Mach. Learn. Res. 22, 2021): a prior function made of random
        features, corrected by what the data say against it. The same generator state gives the same
        function, and the function the same value wherever and whenever it is asked.
        """
        p, data = self.settings, self.data
        d = data.U.shape[1]
        c, e = _levels(data.is_reference, p.rho, data.has_two_fidelities)
        m = _prior_path(rng, np.array(p.ranges), p.variance, WIDE * rng.standard_normal(d + 1))
        offset = np.zeros(d + 1)
        offset[0] = WIDE * rng.standard_normal()
        delta = _prior_path(rng, np.full(d, p.delta_range), p.delta_variance, offset)
        noise = rng.standard_normal(len(c)) * np.sqrt(_noise_variance(data.U, p, e))
        seen = c * m(data.U) + e * delta(data.U) + noise
        weights = cho_solve((self.L, True), (data.y - self.centre) / self.scale - seen)

        def path(U: Array) -> Array:
            c, e = self._here(U)
            prior = c * m(U) + e * delta(U)
            return np.asarray(self.centre + self.scale * (prior + self._to_data(U) @ weights), float)

        return path

    def _here(self, U: Array) -> tuple[Array, Array]:
        """Factors of m and delta in the noise-free reference response at ``U`` (m,d), each (m,)."""
        one = np.ones(len(U))
        return (self.settings.rho * one, one) if self.data.has_two_fidelities else (one, 0.0 * one)

    def _to_data(self, U: Array, c: Array | None = None, e: Array | None = None) -> Array:
        """Covariances (m,n) with the data of responses at ``U`` (m,d), by default of the reference."""
        if c is None or e is None:
            c, e = self._here(U)
        data, p = self.data, self.settings
        return _covariance(U, c, e, data.U, *_levels(data.is_reference, p.rho, data.has_two_fidelities), p)

    def _prior_variance(self, U: Array, c: Array, e: Array) -> Array:
        p = self.settings
        trend = WIDE**2 * (1.0 + ((U - 0.5) ** 2).sum(axis=1))
        return np.asarray(c**2 * (trend + p.variance) + e * (WIDE**2 + p.delta_variance), float)


def _levels(is_reference: Mask, rho: float, has_two_fidelities: bool) -> tuple[Array, Array]:
    """Factors of m and of delta in each run, each (n,)."""
    if not has_two_fidelities:
        return np.ones(len(is_reference)), np.zeros(len(is_reference))
    return np.where(is_reference, rho, 1.0), is_reference.astype(float)


def trend_covariance(U: Array, V: Array) -> Array:
    """Covariance of the affine trend's prior between points (m,d) and (n,d), shape (m,n)."""
    return np.asarray(WIDE**2 * (1.0 + (U - 0.5) @ (V - 0.5).T), float)


def _covariance(U: Array, c: Array, e: Array, V: Array, c_v: Array, e_v: Array, p: Settings) -> Array:
    """Covariance of noise-free responses between runs at ``U`` (m,d) and at ``V`` (n,d), shape (m,n)."""
    R, _ = matern_five_halves(cdist(U / p.ranges, V / p.ranges, "sqeuclidean"))
    K = np.outer(c, c_v) * (trend_covariance(U, V) + p.variance * R)
    if e.any() and e_v.any():
        R, _ = matern_five_halves(cdist(U / p.delta_range, V / p.delta_range, "sqeuclidean"))
        K += np.outer(e, e_v) * (WIDE**2 + p.delta_variance * R)
    return np.asarray(K, float)


def _noise_variance(U: Array, p: Settings, e: Array) -> Array:
    return np.asarray(np.exp(p.noise + (U - 0.5) @ np.array(p.noise_slopes) + p.reference_noise * e), float)


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
