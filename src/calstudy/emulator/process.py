"""One response at one or more fidelities as a Gaussian process, with noise that depends on the parameters.

The model of a run at the point u of the unit cube (autoregressive co-Kriging, Kennedy and O'Hagan,
Biometrika 87, 2000, with all hyperparameters estimated jointly) is, from the cheapest fidelity upwards,

    level 0:   y = m(u) + noise
    level k:   y = rho_k y_(k-1)(u) + h(u) delta_k(u) + noise

m is an affine trend plus a Matern process (nu = 5/2, one range for each input), delta a constant plus an
isotropic Matern process, and the noise is normal with log variance a + b'(u - 1/2), plus tau_k at level k.
h is 1, or the known shape of the offset (`Overlap`). The last level is the reference, whose responses are
predicted. Because all fidelities are one process, the designs need not be nested, repeats are ordinary
rows, and the noise is estimated from repeats and residuals at once. The trends' coefficients have a normal
prior so wide that it decides nothing; hyperparameters are those of largest posterior density under weak
priors (`Prior`), or drawn from it (``ensemble``). With one fidelity alone, rho, delta and tau are not there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.linalg.lapack import dpotri
from scipy.spatial.distance import cdist

from calstudy.calibration.kriging.covariance import matern_five_halves
from calstudy.calibration.kriging.predictor import cholesky
from calstudy.errors import NumericsError
from calstudy.parameters import Array

Mask = NDArray[np.bool_]
Numbers = NDArray[np.int64]

WIDE = 5.0
"""Prior standard deviation of a trend's coefficients, in standard deviations of the response."""
SEARCHED = 200
"""Runs of a fidelity among which the search for the hyperparameters begins, where there are more."""
TELLING = 600
"""Runs of a fidelity that decide the hyperparameters, where there are more; all decide what is predicted."""


@dataclass(frozen=True, slots=True)
class Overlap:
    """The offset between softened fidelities of a response that is divided by the density.

    It is proportional to (density / stiffness)^(2/3), as the overlaps of Hertzian contacts under their own
    weight are. The last input is stiffness / density, in the interval [lower; upper].
    """

    lower: float
    upper: float

    def shape(self, U: Array) -> Array:
        """Offset at points (m,d) of the unit cube over that at the middle of the interval, (m,)."""
        quotient = self.lower + (self.upper - self.lower) * U[:, -1]
        return np.asarray((quotient / (0.5 * (self.lower + self.upper))) ** (-2.0 / 3.0), float)


@dataclass(frozen=True, slots=True)
class Observations:
    """Runs of one response."""

    U: Array
    """Points of the unit cube, (n,d)."""
    y: Array
    """Responses, (n,)."""
    level: Numbers
    """Fidelity of each run, (n,), from 0, the cheapest."""
    levels: int = 1
    """Number of fidelities; the last one is the reference."""
    overlap: Overlap | None = None
    """Shape of the offset; None where it is not known."""

    def __post_init__(self) -> None:
        n, d = self.U.shape
        if self.y.shape != (n,) or self.level.shape != (n,):
            raise NumericsError(f"{n} points, responses {self.y.shape}, fidelities {self.level.shape}")
        if n < d + 3:
            raise NumericsError(f"{n} runs are too few for a trend of {d} inputs and a noise; run more")
        if not self.is_reference.any():
            raise NumericsError("no run has the reference fidelity; run some")
        if np.ptp(self.y) <= 1e-12 * np.abs(self.y).max():
            raise NumericsError("the response is the same in all runs; there is nothing to emulate")

    @property
    def is_reference(self) -> Mask:
        """Whether each run has the reference fidelity, (n,) bool."""
        return np.asarray(self.level == self.levels - 1)

    def shape(self, U: Array) -> Array:
        """Shape h of the offset at points (m,d), (m,)."""
        return np.ones(len(U)) if self.overlap is None else self.overlap.shape(U)

    def with_responses(self, y: Array) -> Observations:
        """The same runs with other responses (n,)."""
        return Observations(self.U, y, self.level, self.levels, self.overlap)

    def only(self, kept: Mask | Numbers) -> Observations:
        """The runs of a mask (n,), or of numbers."""
        return Observations(self.U[kept], self.y[kept], self.level[kept], self.levels, self.overlap)

    def without(self, left_out: Mask) -> Observations:
        """The runs but those of a mask (n,)."""
        return self.only(~left_out)

    def thinned(self, most: int) -> Observations:
        """At most ``most`` runs of each fidelity; the same runs give the same ones."""
        rng = np.random.default_rng(0)
        of = [np.flatnonzero(self.level == k) for k in range(self.levels)]
        kept = [rows if len(rows) <= most else rng.choice(rows, most, replace=False) for rows in of]
        return self.only(np.sort(np.concatenate(kept)))


@dataclass(frozen=True, slots=True)
class Offset:
    """From one fidelity to the next."""

    rho: float
    variance: float
    """Of delta's process."""
    range: float
    """Of delta's process."""
    noise: float
    """tau: log variance of a run's noise, less that of a run of the cheapest fidelity."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Hyperparameters, for a response that is centred and scaled to variance 1."""

    variance: float
    """sigma^2 of m's process."""
    ranges: tuple[float, ...]
    """Of m's process, in units of the inputs' intervals, with STK's convention (see ``covariance``)."""
    noise: float
    """Log variance of a run's noise at the cheapest fidelity, at the middle of the cube."""
    noise_slopes: tuple[float, ...]
    """b: change of the log variance over each input's interval."""
    offsets: tuple[Offset, ...] = ()
    """Of the fidelities above the cheapest, in their order."""

    @classmethod
    def of(cls, theta: Array, d: int) -> Settings:
        """Read a vector as `Prior` orders it."""
        ranges = tuple(map(float, np.exp(-theta[1 : d + 1])))
        slopes = tuple(map(float, theta[d + 2 : 2 * d + 2]))
        offsets = tuple(
            Offset(float(rho), float(np.exp(log_variance)), float(np.exp(-log_rate)), float(tau))
            for rho, log_variance, log_rate, tau in theta[2 * d + 2 :].reshape(-1, 4)
        )
        return cls(float(np.exp(theta[0])), ranges, float(theta[d + 1]), slopes, offsets)

    @property
    def factors(self) -> Array:
        """Factors (levels, levels) of m and of each delta in the noise-free response of each level."""
        of = np.eye(len(self.offsets) + 1)
        for k, offset in enumerate(self.offsets, 1):
            of[k] += offset.rho * of[k - 1]
        return of

    def factors_by_rho(self, k: int) -> Array:
        """Derivatives of `factors` with respect to rho of the k-th level, from 1."""
        by = np.zeros((len(self.offsets) + 1,) * 2)
        by[k] = self.factors[k - 1]
        for j in range(k + 1, len(by)):
            by[j] = self.offsets[j - 1].rho * by[j - 1]
        return by

    @property
    def noise_steps(self) -> Array:
        """tau of each level, (levels,); 0 of the cheapest."""
        return np.array([0.0, *(offset.noise for offset in self.offsets)])


@dataclass(frozen=True, slots=True)
class Prior:
    """Normal prior of theta, and the bounds of the search: five standard deviations to either side.

    theta = (log sigma^2, log 1/range_1 ... d, noise, noise slopes 1 ... d) and, for each fidelity above the
    cheapest, (rho, log sigma_delta^2, log 1/range_delta, tau). The centres are those of
    ``surrogate.robust_search`` where it has them. A slope's sd of 1 lets the noise's standard deviation
    change by a factor of 1.6 over an interval as a matter of course. All fidelities compute the same thing:
    rho is near 1, delta small.
    """

    centre: Array
    sd: Array

    @classmethod
    def of(cls, d: int, levels: int) -> Prior:
        """Prior for d inputs and a number of fidelities."""
        rate = -np.log(4.0 * np.sqrt(d))
        centre = [0.0, *(rate,) * d, np.log(0.1), *(0.0,) * d]
        sd = [2.0, *(1.0,) * d, 2.0, *(1.0,) * d]
        for _ in range(levels - 1):
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


def negative_log_posterior(data: Observations, prior: Prior, theta: Array) -> tuple[float, Array]:
    """Negative log density of theta given standardised responses, up to a constant, with its gradient.

    NumericsError where the covariance is singular to rounding. The time grows as n^3: 0.03 s with 600 runs.
    """
    d = data.U.shape[1]
    p = Settings.of(theta, d)
    C = mixing(data.level, data.shape(data.U), p.factors)
    scaled = data.U * np.exp(theta[1 : d + 1])
    R, by_h2 = matern_five_halves(cdist(scaled, scaled, "sqeuclidean"))
    base = trend_covariance(data.U, data.U) + p.variance * R
    v = noise_variance(data.U, data.level, p)
    K = np.outer(C[:, 0], C[:, 0]) * base + np.diag(v)
    offsets = []
    for k, offset in enumerate(p.offsets, 1):
        rows = np.flatnonzero(data.level >= k)
        h2 = cdist(data.U[rows], data.U[rows], "sqeuclidean") / offset.range**2
        R_k, by_h2_k = matern_five_halves(h2)
        base_k = WIDE**2 + offset.variance * R_k
        K[np.ix_(rows, rows)] += np.outer(C[rows, k], C[rows, k]) * base_k
        offsets.append((rows, base_k, R_k, by_h2_k * h2))
    L = cholesky(K)
    alpha = cho_solve((L, True), data.y)
    pull = (theta - prior.centre) / prior.sd
    value = 0.5 * data.y @ alpha + np.log(np.diag(L)).sum() + 0.5 * pull @ pull

    M = _inverse(L) - np.outer(alpha, alpha)
    Mc = M * np.outer(C[:, 0], C[:, 0])
    gradient = np.empty_like(theta)
    gradient[0] = 0.5 * p.variance * np.sum(Mc * R)
    W = Mc * by_h2  # sum of W_ij (s_i - s_j)^2 for each input s
    gradient[1 : d + 1] = 2.0 * p.variance * (W.sum(axis=1) @ scaled**2 - (scaled * (W @ scaled)).sum(axis=0))
    white = 0.5 * np.diag(M) * v
    gradient[d + 1] = white.sum()
    gradient[d + 2 : 2 * d + 2] = white @ (data.U - 0.5)
    by_offset = gradient[2 * d + 2 :].reshape(-1, 4)
    bases = [(np.arange(len(v)), base), *((rows, base_k) for rows, base_k, *_ in offsets)]
    for k, (rows, _, R_k, by_range) in enumerate(offsets, 1):
        D = mixing(data.level, data.shape(data.U), p.factors_by_rho(k))
        by_offset[k - 1, 0] = sum(
            D[at, j] @ (M[np.ix_(at, at)] * base_j) @ C[at, j] for j, (at, base_j) in enumerate(bases[:k])
        )
        Me = M[np.ix_(rows, rows)] * np.outer(C[rows, k], C[rows, k])
        variance = p.offsets[k - 1].variance
        by_offset[k - 1, 1] = 0.5 * variance * np.sum(Me * R_k)
        by_offset[k - 1, 2] = variance * np.sum(Me * by_range)
        by_offset[k - 1, 3] = white @ (data.level == k)
    return float(value), gradient + pull / prior.sd


def _inverse(L: Array) -> Array:
    """Inverse of L L'."""
    lower, _ = dpotri(L, lower=True)
    return np.asarray(np.tril(lower) + np.tril(lower, -1).T, float)


def trend_covariance(U: Array, V: Array) -> Array:
    """Covariance of the affine trend's prior between points (m,d) and (n,d), shape (m,n)."""
    K: Array = (U - 0.5) @ (V - 0.5).T
    K += 1.0
    K *= WIDE**2
    return K


def five_halves(h2: Array) -> Array:
    """R(h; 5/2) of `matern_five_halves` at squared scaled distances of any shape, in their place.

    Without its derivative and without arrays in between, which thousands of runs would make slow.
    """
    h2 *= 10.0
    t = np.sqrt(h2, out=h2)
    decay = np.exp(-t)
    square = t * t
    square /= 3.0
    t += 1.0
    t += square
    t *= decay
    return t


def mixing(level: Numbers, shape: Array, factors: Array) -> Array:
    """Factors of m and of each delta in the responses of runs (n,), whose offsets have shape h (n,).

    ``factors`` (levels, levels) are `Settings.factors`; (n, levels).
    """
    C = factors[level]
    C[:, 1:] *= shape[:, None]
    return np.asarray(C, float)


def noise_variance(U: Array, level: Numbers, p: Settings) -> Array:
    """Variance of runs at ``U`` (n,d) from seed to seed, for standardised responses, (n,)."""
    return np.asarray(np.exp(p.noise + (U - 0.5) @ np.array(p.noise_slopes) + p.noise_steps[level]), float)
