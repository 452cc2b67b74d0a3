"""A response under hyperparameters drawn from their posterior, so that predictions include their doubt.

At the most probable hyperparameters alone, a process fitted to a few dozen noisy runs promises too much. So
`MEMBERS` sets of them are drawn, or fewer where there are many runs: proposals from a multivariate t
distribution around the most probable set, with the curvature there for its precision, resampled by the
posterior density over the proposal's (Rubin, in Bayesian Statistics 3, 1988). Every prediction is the
mixture of the members'.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from calstudy.emulator.cokriging import CoKriging, posterior_mode, standardised
from calstudy.emulator.process import (
    TELLING,
    WIDE,
    Mask,
    Numbers,
    Observations,
    Prior,
    Settings,
    five_halves,
    mixing,
    negative_log_posterior,
    trend_covariance,
)
from calstudy.errors import NumericsError
from calstudy.parameters import Array

MEMBERS = 16
FEWEST_MEMBERS = 4
RUNS_OF_MEMBERS = 6400
"""Runs times members, above which there are fewer members: many runs leave little doubt."""
PROPOSALS = 400
FREEDOM = 5
"""Degrees of freedom of the proposals: tails heavier than the posterior's."""
LEAST_CURVATURE = 0.3
"""Of the posterior in prior standard deviations; where runs say nothing of a hyperparameter it is 1."""
STEP = 1e-3
"""Of the gradient's differences, in prior standard deviations."""


@dataclass(frozen=True)
class Ensemble:
    """A response conditioned on runs, with each of several hyperparameters; results are at the reference."""

    members: tuple[CoKriging, ...]

    @classmethod
    def fit(cls, data: Observations) -> Ensemble:
        """Draw the hyperparameters given `TELLING` runs of each fidelity, and condition on all runs.

        The same runs give the same members.
        """
        scaled, centre, scale = standardised(data)
        d = data.U.shape[1]
        prior, telling = Prior.of(d, data.levels), scaled.thinned(TELLING)
        members = max(FEWEST_MEMBERS, min(MEMBERS, RUNS_OF_MEMBERS // len(data.y)))
        mode = posterior_mode(telling, prior)
        drawn = posterior_sample(telling, prior, mode, np.random.default_rng(0), members)
        return cls.given(data, [Settings.of(theta, d) for theta in drawn], (centre, scale))

    @classmethod
    def given(
        cls, data: Observations, settings: Sequence[Settings], standard: tuple[float, float]
    ) -> Ensemble:
        """Condition on data at known hyperparameters; ``standard`` is the responses' centre and scale."""
        return cls(tuple(CoKriging(data, each, *standard) for each in settings))

    @property
    def data(self) -> Observations:
        """The runs."""
        return self.members[0].data

    def mean(self, U: Array) -> Array:
        """Expected noise-free response at ``U`` (m,d), shape (m,).

        All members at once: a calibration asks for one point after another.
        """
        of, data, first = self._stacked, self.data, self.members[0]
        squared = (U[:, None, :] - data.U) ** 2
        R = five_halves(squared @ of.squared_rates)
        K = of.factors[0] * (trend_covariance(U, data.U)[:, :, None] + of.variance * R)
        for k, (variance, squared_rate) in enumerate(of.offsets, 1):
            rows = data.level >= k
            R = five_halves(squared[:, rows].sum(axis=2)[:, :, None] * squared_rate)
            K[:, rows] += data.shape(U)[:, None, None] * of.factors[k, rows] * (WIDE**2 + variance * R)
        standard = np.einsum("mnk,nk->m", K, of.alpha) / len(self.members)
        return np.asarray(first.centre + first.scale * standard, float)

    @cached_property
    def _stacked(self) -> _Stacked:
        data, settings = self.data, [member.settings for member in self.members]
        shape = data.shape(data.U)
        return _Stacked(
            squared_rates=np.array([s.ranges for s in settings]).T ** -2.0,
            variance=np.array([s.variance for s in settings]),
            factors=np.stack(
                [mixing(data.level, shape, s.factors).T * s.factors[-1][:, None] for s in settings], -1
            ),
            offsets=[
                (np.array([o.variance for o in of]), np.array([o.range for o in of]) ** -2.0)
                for of in zip(*(s.offsets for s in settings), strict=True)
            ],
            alpha=np.column_stack([member.alpha for member in self.members]),
        )

    def mean_and_sd(self, U: Array) -> tuple[Array, Array]:
        """Expected noise-free response at ``U`` (m,d) and its standard deviation, each (m,)."""
        return _mixture([member.mean_and_sd(U) for member in self.members])

    def noise_sd(self, U: Array) -> Array:
        """Standard deviation of a reference run from seed to seed at ``U`` (m,d), shape (m,)."""
        return np.sqrt(np.mean([member.noise_sd(U) ** 2 for member in self.members], axis=0))

    def left_out(self, points: Numbers) -> tuple[Array, Array]:
        """Errors of all runs and their sds, each predicted without its point (see `CoKriging.left_out`)."""
        return _mixture([member.left_out(points) for member in self.members])

    def errors_elsewhere(self, data: Observations, chosen: Mask) -> tuple[Array, Array]:
        """Errors of runs that were not fitted (mask ``chosen`` of ``data``), and their sds."""
        return _mixture([member.errors_elsewhere(data, chosen) for member in self.members])

    def draw(self, rng: np.random.Generator) -> tuple[Callable[[Array], Array], Callable[[Array], Array]]:
        """One function from the posterior, and its noise: of one member (see `CoKriging.draw`)."""
        member = self.members[rng.integers(len(self.members))]
        return member.draw(rng), member.noise_sd


@dataclass(frozen=True, slots=True)
class _Stacked:
    """The members' numbers side by side: k members, n runs, d inputs."""

    squared_rates: Array
    """(d,k)."""
    variance: Array
    """(k,)."""
    factors: Array
    """Of m's and each delta's covariance between the reference and each run, (levels,n,k)."""
    offsets: list[tuple[Array, Array]]
    """Variance and squared rate of each delta, each (k,)."""
    alpha: Array
    """(n,k)."""


def posterior_sample(
    data: Observations, prior: Prior, mode: Array, rng: np.random.Generator, members: int = MEMBERS
) -> list[Array]:
    """Sets of hyperparameters from the posterior given standardised runs, by resampling."""
    k = len(mode)
    values, vectors = np.linalg.eigh(_curvature(data, prior, mode))
    spread = vectors / np.sqrt(np.maximum(values, LEAST_CURVATURE))
    normal = rng.standard_normal((PROPOSALS, k))
    shrink = np.sqrt(rng.chisquare(FREEDOM, PROPOSALS) / FREEDOM)
    steps = normal / shrink[:, None]
    proposals = mode + prior.sd * (steps @ spread.T)
    log_weights = 0.5 * (FREEDOM + k) * np.log1p((steps**2).sum(axis=1) / FREEDOM)
    for i, theta in enumerate(proposals):
        try:
            log_weights[i] -= negative_log_posterior(data, prior, theta)[0]
        except NumericsError:  # a covariance that is singular to rounding explains no runs
            log_weights[i] = -np.inf
    cumulated = np.cumsum(np.exp(log_weights - log_weights.max()))
    places = (rng.random() + np.arange(members)) / members * cumulated[-1]
    return list(proposals[np.minimum(np.searchsorted(cumulated, places), PROPOSALS - 1)])


def _curvature(data: Observations, prior: Prior, mode: Array) -> Array:
    """Second derivatives (k,k) of the negative log posterior, in prior standard deviations."""
    density = partial(negative_log_posterior, data, prior)
    rows = []
    for step in STEP * np.diag(prior.sd):
        (_, above), (_, below) = density(mode + step), density(mode - step)
        rows.append((above - below) / (2.0 * STEP) * prior.sd)
    H = np.array(rows)
    return 0.5 * (H + H.T)


def _mixture(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Mean and standard deviation of a mixture in equal shares of (mean, sd)."""
    means, deviations = (np.array(part) for part in zip(*parts, strict=True))
    return means.mean(axis=0), np.sqrt((deviations**2).mean(axis=0) + means.var(axis=0))
