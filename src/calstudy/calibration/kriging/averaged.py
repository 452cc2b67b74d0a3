"""Kriging averaged over the hyperparameters that its data leave plausible.

At ten to twenty noisy runs many sets of hyperparameters explain the responses. The doubt of the most probable
set alone leaves out that another may be true. Here some sets are drawn from the posterior of the
hyperparameters: proposals of a t distribution about the mode, with its curvature, are drawn anew by their
posterior density.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calstudy.calibration.kriging.covariance import Hyperparameters
from calstudy.calibration.kriging.predictor import (
    Contrasts,
    Predictor,
    likelihood_gradient,
    negative_log_restricted_likelihood,
)
from calstudy.calibration.kriging.universal import SEARCHES, Search, UniversalKriging
from calstudy.errors import NumericsError
from calstudy.parameters import Array

MEMBERS, PROPOSALS = 8, 400
"""Sets of hyperparameters, and proposals that they are drawn from."""
FREEDOM = 5
"""Degrees of freedom of the proposals."""
STEP = 1e-3
"""Step of the second derivatives, in standard deviations of the prior."""
LEAST_CURVATURE = 0.3
"""A smaller curvature, in units of the prior's, is replaced, so that proposals stay plausible."""


@dataclass(frozen=True, slots=True)
class AveragedKriging:
    """A surrogate of one response in the place of the most probable one."""

    most_probable: UniversalKriging
    members: tuple[Predictor, ...]
    """Empty where the trend explains the responses to the last digit."""

    @classmethod
    def of(cls, model: UniversalKriging, seed: int) -> AveragedKriging:
        """Average of a fitted model, by the prior of mode ``robust``; equal seeds give equal members."""
        data = model.standardised_
        if data is None:
            return cls(model, ())
        c, z = data.contrasts, data.responses
        search = SEARCHES["robust"](c, z, data.noise_variance, True)
        mode = model.hyperparameters_.scaled(1.0, 1.0 / data.scale).theta
        drawn = _drawn(c, z, search, np.clip(mode, search.lower, search.upper), np.random.default_rng(seed))
        return cls(model, tuple(Predictor.of(c, z, Hyperparameters.of(theta)) for theta in drawn))

    @property
    def plausible(self) -> tuple[Hyperparameters, ...]:
        """The members' hyperparameters, in units as `hyperparameters_`."""
        data = self.most_probable.standardised_
        return () if data is None else tuple(m.parameters.scaled(1.0, data.scale) for m in self.members)

    @property
    def hyperparameters_(self) -> Hyperparameters:
        """The most probable ones."""
        return self.most_probable.hyperparameters_

    def predict(self, points: Array, return_std: bool = False) -> Array | tuple[Array, Array]:
        """Means (k,) of the response at points (k, d); with ``return_std`` also standard deviations."""
        data = self.most_probable.standardised_
        if data is None:
            known = self.most_probable
            return known.predict(points, return_std=True) if return_std else known.predict(points)
        unit = self.most_probable.to_unit(points)
        if not return_std:
            return data.centre + data.scale * np.mean([one.mean(unit) for one in self.members], axis=0)
        parts = np.array([one.mean_and_variance(unit) for one in self.members])
        sd = np.sqrt(parts[:, 1].mean(axis=0) + parts[:, 0].var(axis=0))
        return data.centre + data.scale * parts[:, 0].mean(axis=0), data.scale * sd


def _drawn(c: Contrasts, z: Array, search: Search, mode: Array, rng: np.random.Generator) -> Array:
    """Hyperparameters theta (MEMBERS, d + 3) from their posterior given responses z (n,)."""
    sd = 1.0 / np.sqrt(search.precision)

    def slope(theta: Array) -> Array:
        return sd * (likelihood_gradient(c, z, theta)[1] + search.precision * (theta - search.centre))

    curvature = np.array([slope(mode + step) - slope(mode - step) for step in STEP * np.diag(sd)]) / (
        2.0 * STEP
    )
    lengths, axes = np.linalg.eigh(0.5 * (curvature + curvature.T))
    spread = sd[:, None] * axes / np.sqrt(np.maximum(lengths, LEAST_CURVATURE))
    steps = rng.standard_normal((PROPOSALS, len(mode)))
    steps /= np.sqrt(rng.chisquare(FREEDOM, PROPOSALS) / FREEDOM)[:, None]
    proposals = mode + steps @ spread.T
    log_weight = 0.5 * (FREEDOM + len(mode)) * np.log1p(np.sum(steps**2, axis=1) / FREEDOM)
    for i, theta in enumerate(proposals):
        log_weight[i] -= _negative_log_posterior(c, z, search, theta)
    cumulated = np.cumsum(np.exp(log_weight - log_weight.max()))
    places = (rng.random() + np.arange(MEMBERS)) / MEMBERS * cumulated[-1]
    return np.asarray(proposals[np.minimum(np.searchsorted(cumulated, places), PROPOSALS - 1)])


def _negative_log_posterior(c: Contrasts, z: Array, search: Search, theta: Array) -> float:
    """Up to a constant; infinite outside the search's bounds, and where the covariance is singular."""
    if np.any(theta < search.lower) or np.any(theta > search.upper):
        return np.inf
    try:
        likelihood = negative_log_restricted_likelihood(c, z, Hyperparameters.of(theta))
    except NumericsError:
        return np.inf
    return likelihood + search.penalty(theta)
