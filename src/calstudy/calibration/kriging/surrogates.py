"""The surrogates of a calibration: a Kriging model of each measured response (section 2.3.2).

A response that is proportional to a parameter may be divided by it before the fit, so that Kriging learns
only the rest: bulk density is DENS times the solid fraction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calstudy.calibration.kriging.predictor import Trend, least_points
from calstudy.calibration.kriging.universal import Diagnostics, ModeName, UniversalKriging
from calstudy.errors import NumericsError
from calstudy.parameters import Array, Space


@dataclass(frozen=True, slots=True)
class Kriging:
    """How responses are modelled. The defaults are the authors'."""

    hyperparameters: ModeName = "paper"
    """Start, bounds and prior of the fit: see ``universal``."""
    trend: Trend = "affine"
    divisors: Mapping[str, str] | None = None
    """Parameter that a response is divided by before the fit, by response. None: never divide."""
    settled: bool = False
    """Whether the fit gives the same digits on every machine: see ``UniversalKriging``."""


@dataclass(frozen=True, slots=True)
class Surrogates:
    """One Kriging model for each of m measured responses, over d calibrated parameters."""

    space: Space
    names: tuple[str, ...]
    """Measured responses, in the order of all arrays."""
    models: tuple[UniversalKriging, ...]
    divisors: tuple[str | None, ...]
    diagnostics: Mapping[str, Diagnostics]
    """Of each response, in its own units."""

    @classmethod
    def fit(
        cls,
        settings: Kriging,
        space: Space,
        names: Sequence[str],
        points: Array,
        responses: Array,
        noise: Mapping[str, float] | None = None,
        before: Surrogates | None = None,
    ) -> Surrogates:
        """Fit responses (n, m) at points (n, d). NaN marks failed runs, which are left out.

        ``noise``: known standard deviations from seed to seed, in the responses' units; the fit estimates
        missing ones. ``before``: a fit to part of the runs, whose hyperparameters are further starts.
        NumericsError: too few runs are usable.
        """
        box, prior, trend = space.box, settings.hyperparameters, settings.trend
        usable = np.all(np.isfinite(responses), axis=1)
        needed = max(least_points(box.dimension, trend), 3)
        if usable.sum() < needed:
            raise NumericsError(
                f"only {usable.sum()} of {len(points)} sampling runs are usable; "
                f"Kriging of {box.dimension} parameters needs {needed}"
            )
        points, responses = points[usable], responses[usable]
        models, divisors, diagnostics = [], [], {}
        starts = [None] * len(names) if before is None else [m.hyperparameters_ for m in before.models]
        for name, response, start in zip(names, responses.T, starts, strict=True):
            divisor = (settings.divisors or {}).get(name)
            by = _values(space, divisor, points)
            sd = float(noise[name] / by.mean()) if noise is not None and name in noise else None
            model = UniversalKriging(
                box.lower,
                box.upper,
                parameter_names=box.names,
                mode=prior,
                trend=trend,
                noise_sd=sd,
                start=start,
                settled=settings.settled,
            ).fit(points, response / by)
            models.append(model)
            divisors.append(divisor)
            diagnostics[name] = replace(
                model.diagnostics_,
                leave_one_out_rmse=float(np.sqrt(np.mean((model.leave_one_out_errors_ * by) ** 2))),
                noise_sd=model.diagnostics_.noise_sd * float(by.mean()),
                data_range=(float(response.min()), float(response.max())),
            )
        return cls(space, tuple(names), tuple(models), tuple(divisors), diagnostics)

    @property
    def noise(self) -> Array:
        """Standard deviations of a single run's noise (m,), known or estimated."""
        return np.array([self.diagnostics[name].noise_sd for name in self.names])

    def predict(self, points: Array) -> Array:
        """Responses (…, m) at points (…, d): means of the noise-free processes."""
        flat = np.atleast_2d(points)
        found = np.array([model.predict(flat) for model in self.models]) * self._factors(flat)
        return found.T.reshape(*np.shape(points)[:-1], len(found))

    def predict_with_deviations(self, points: Array) -> tuple[Array, Array]:
        """Means and standard deviations of the noise-free responses at points (k, d), each (k, m)."""
        found = np.array([model.predict(points, return_std=True) for model in self.models])
        factors = self._factors(points)
        return (found[:, 0] * factors).T, (found[:, 1] * factors).T

    def _factors(self, points: Array) -> Array:
        """Factors (m, k) that undo the division by parameters at points (k, d)."""
        return np.array([_values(self.space, divisor, points) for divisor in self.divisors])


def _values(space: Space, name: str | None, points: Array) -> Array:
    """Values (n,) of a parameter, calibrated or not, at points (n, d); ones without a name."""
    if name is None:
        return np.ones(len(points))
    if name in space.box.names:
        return points[:, space.box.names.index(name)]
    return np.full(len(points), space.complete(space.box.centre)[name])
