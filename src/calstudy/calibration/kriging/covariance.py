"""The anisotropic Matern correlation, exact with its derivatives, as a mixture of Gaussians.

With STK's convention t = 2 sqrt(nu) h, the Matern correlation is

    R(h; nu) = 2^(1-nu) / Gamma(nu) t^nu K_nu(t) = E[exp(-h^2 / g)],   g ~ Gamma(shape nu, rate nu),

(from the integral 10.32.10 of the Digital Library of Mathematical Functions for K_nu). On y = log g the
expectation is the integral of an analytic function that decays on both sides, so the trapezoidal rule
converges geometrically. One table of exponentials then gives R and its derivatives with respect to h^2
*and* nu, for every nu > 0, without Bessel functions and without difference quotients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PPoly, make_interp_spline
from scipy.spatial.distance import pdist, squareform
from scipy.special import gammaln, lambertw, psi

from calstudy.parameters import Array

NUGGET = 1e-11
"""Smallest noise-to-variance ratio of a fit. Below it the Cholesky factor of K is rounding error."""

DIGITS = 38.0
"""The quadrature's limits and step are such that its error is below exp(-DIGITS)."""

TABLE = (1e-8, 1e4)
"""Range of squared distances in the table of `matern_tabulated`."""

SMALLEST = 1e-200
"""At smaller squared distances R = 1 to the last digit."""


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Covariance parameters: sigma^2 and v in squared units of the response, rho in units of the inputs."""

    variance: float
    """Process variance sigma^2."""
    smoothness: float
    """nu of the Matern covariance, t = 2 sqrt(nu) h."""
    ranges: tuple[float, ...]
    """rho, one for each input."""
    noise_variance: float
    """Variance v of the white noise on the responses."""

    @classmethod
    def of(cls, theta: Array) -> Hyperparameters:
        """Read theta = (log sigma^2, log nu, log 1/rho_1 ... log 1/rho_d, log v), STK's order."""
        e = np.exp(theta)
        ranges = tuple(float(r) for r in 1.0 / e[2:-1])
        return cls(float(e[0]), float(e[1]), ranges, float(e[-1] + NUGGET * e[0]))

    @property
    def theta(self) -> Array:
        """Inverse of `of`, shape (d + 3,). A noise variance below the nugget comes back as the nugget."""
        noise = max(self.noise_variance - NUGGET * self.variance, NUGGET * self.variance)
        return np.log([self.variance, self.smoothness, *np.reciprocal(self.ranges), noise])

    def scaled(self, ranges: ArrayLike, response: float) -> Hyperparameters:
        """The same in other units: inputs multiplied by ``ranges`` (d,), the response by ``response``."""
        rho = np.multiply(self.ranges, ranges)
        return Hyperparameters(
            self.variance * response**2,
            self.smoothness,
            tuple(float(r) for r in rho),
            self.noise_variance * response**2,
        )


def covariance(U: Array, p: Hyperparameters) -> Array:
    """Covariance K = sigma^2 R + v I of the responses at ``U`` (n,d), shape (n,n)."""
    K: Array = squareform(p.variance * matern(pdist(U / p.ranges, "sqeuclidean"), p.smoothness))
    np.fill_diagonal(K, p.variance + p.noise_variance)
    return K


def matern(h2: Array, nu: float) -> Array:
    """Correlation R at squared scaled distances ``h2`` (any shape) for smoothness ``nu``; same shape."""
    return _mixture(h2, nu, derivatives=False)[0]


def matern_derivatives(h2: Array, nu: float) -> tuple[Array, Array, Array]:
    """Correlation R, dR/d(h^2) and dR/d(log nu) at squared scaled distances ``h2``; each of its shape.

    dR/d(h^2) at h = 0 is returned as 0: it is only ever multiplied by a squared distance, and for
    nu <= 1 it is infinite there.
    """
    return _mixture(h2, nu, derivatives=True)


def matern_tabulated(h2: Array, nu: float) -> Array:
    """`matern` for very many distances: a spline of degree 7 in log h^2, accurate to 1e-13.

    R(exp(x)) is analytic in the strip ``|Im x| < pi/2``, so a uniform table is accurate for every nu. R is
    computed at distances outside the table.
    """
    h2 = np.asarray(h2, float)
    inside = (h2 > TABLE[0]) & (h2 < TABLE[1])
    R = np.empty(h2.shape)
    R[inside] = _table(nu)(np.log(h2[inside]))
    if not inside.all():
        R[~inside] = matern(h2[~inside], nu)
    return R


@lru_cache(maxsize=128)
def _table(nu: float, spacing: float = 0.05) -> PPoly:
    """Spline of R in log h^2. It extends ten knots beyond TABLE: splines are inaccurate at their ends."""
    low, high = np.log(TABLE)
    knots = np.arange(low - 10.0 * spacing, high + 10.0 * spacing, spacing)
    return PPoly.from_spline(make_interp_spline(knots, matern(np.exp(knots), nu), k=7).tck)


def quadrature(nu: float, smallest_h2: float) -> tuple[Array, Array]:
    """Nodes g and weights of the Gamma(nu, rate nu) mixture, for squared distances from ``smallest_h2``.

    The density of y = log g is proportional to exp(nu (y - e^y + 1)); it is cut where that is exp(-DIGITS),
    and on the left also where exp(-h^2/g) is. On the line Im y = a the integrand grows by cos(a)^-nu and
    the error of step D is exp(-2 pi a / D) times that; the best a has tan(a) = tau = 2 pi / (D nu).
    """
    c = DIGITS / nu
    # y - e^y + 1 = -c has two roots, both written with Lambert's W of -exp(-1-c).
    argument = -np.exp(-1.0 - c)
    left = -1.0 - c - float(lambertw(argument, 0).real)
    right = -1.0 - c - float(lambertw(argument, -1).real)
    left = max(left, min(0.0, float(np.log(smallest_h2 / DIGITS))))
    tau = 1.0 + c + np.sqrt(2.0 * c)
    for _ in range(6):  # Newton on tau atan(tau) - log(1 + tau^2)/2 = c: convex, so it cannot leave
        angle = np.arctan(tau)
        tau -= (tau * angle - 0.5 * np.log1p(tau * tau) - c) / angle
    count = 2 + int((right - left) * nu * tau / (2.0 * np.pi))
    y, step = np.linspace(left, right, count, retstep=True)
    g = np.exp(y)
    weights = step * np.exp(nu * (np.log(nu) + y - g) - gammaln(nu))
    return g, weights


def _mixture(h2: Array, nu: float, derivatives: bool) -> tuple[Array, Array, Array]:
    """R and its derivatives as in `matern_derivatives`; zeros for derivatives that are not wanted."""
    h2 = np.asarray(h2, float)
    apart = h2 > SMALLEST
    R, by_h2, by_log_nu = np.ones(h2.shape), np.zeros(h2.shape), np.zeros(h2.shape)
    if not apart.any():
        return R, by_h2, by_log_nu
    distances = h2[apart]
    g, weights = quadrature(nu, float(distances.min()))
    gaussians = np.exp(-distances[:, None] / g)
    R[apart] = gaussians @ weights
    if derivatives:
        by_h2[apart] = gaussians @ (-weights / g)
        by_log_nu[apart] = gaussians @ (weights * nu * (np.log(nu) + 1.0 + np.log(g) - g - psi(nu)))
    return R, by_h2, by_log_nu


def matern_five_halves(h2: Array) -> tuple[Array, Array]:
    """R(h; 5/2) and dR/d(h^2) in closed form at squared scaled distances ``h2``; each of its shape."""
    t = np.sqrt(10.0 * np.asarray(h2, float))
    decay = np.exp(-t)
    return (1.0 + t + t * t / 3.0) * decay, -5.0 / 3.0 * (1.0 + t) * decay
