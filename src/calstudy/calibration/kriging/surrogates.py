"""The surrogates of a calibration: a Kriging model of each measured response (section 2.3.2).

A response that is proportional to a parameter may be divided by it before the fit, so that Kriging learns
only the rest: bulk density is DENS times the solid fraction. Two parameters that act through their quotient
alone may be one input of the fit. Responses that are the points of one curve have
a Kriging model of each principal component's score instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calstudy.calibration.kriging.averaged import AveragedKriging
from calstudy.calibration.kriging.components import principal
from calstudy.calibration.kriging.coordinates import Coordinates
from calstudy.calibration.kriging.covariance import Hyperparameters
from calstudy.calibration.kriging.predictor import Trend, least_points
from calstudy.calibration.kriging.success import LIKELY, Success
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
    ratios: Mapping[str, tuple[str, str]] | None = None
    """Two parameters that act on a response through their quotient alone, by response; on one that is divided
    before the fit, on what is left. None: each parameter is an input of its own."""
    curves: tuple[tuple[str, ...], ...] = ()
    """Responses that are the points of one curve, for each curve."""
    settled: bool = False
    """Whether the fit gives the same digits on every machine: see ``UniversalKriging``."""


@dataclass(frozen=True, slots=True)
class Surrogates:
    """Kriging models of m measured responses, over d calibrated parameters.

    There is one for each response, and of a curve one for each score. Without curves a response is its
    model's value, with them offset + mixing @ values.
    """

    space: Space
    names: tuple[str, ...]
    """Measured responses, in the order of all arrays."""
    models: tuple[UniversalKriging | AveragedKriging, ...]
    """l of them."""
    divisors: tuple[str | None, ...]
    """Parameter that each model's values are to be multiplied by, (l,)."""
    coordinates: tuple[Coordinates, ...]
    """Inputs of each model, (l,)."""
    diagnostics: Mapping[str, Diagnostics]
    """Of each response, in its own units."""
    offset: Array
    """Mean curves at their points, 0 elsewhere, (m,)."""
    mixing: Array | None
    """Share of each model's value in each response, (m, l); None without curves."""
    success: Success | None = None
    """Probability that a run gives responses; None while all do."""

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
        """Fit responses (n, m) at points (n, d). NaN marks failed runs, which tell `success` alone.

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
        success = Success.of(box.to_unit(points), usable)
        points, responses = points[usable], responses[usable]
        learnt = _learnt(settings, names, responses)
        models, divisors, coordinates, shown = [], [], [], []
        starts: list[Hyperparameters | None] = [None] * len(learnt.names)
        if before is not None and len(before.models) == len(starts):
            starts = [m.hyperparameters_ for m in before.models]
        for name, response, start in zip(learnt.names, learnt.values.T, starts, strict=True):
            divisor = (settings.divisors or {}).get(name)
            by = values(space, divisor, points)
            sd = float(noise[name] / by.mean()) if noise is not None and name in noise else None
            inputs = Coordinates.of(space, (settings.ratios or {}).get(name))
            model = UniversalKriging(
                inputs.box.lower,
                inputs.box.upper,
                parameter_names=inputs.box.names,
                mode=prior,
                trend=trend,
                noise_sd=sd,
                start=start,
                settled=settings.settled,
            ).fit(inputs(points), response / by)
            models.append(model)
            divisors.append(divisor)
            coordinates.append(inputs)
            shown.append(
                replace(
                    model.diagnostics_,
                    leave_one_out_rmse=float(np.sqrt(np.mean((model.leave_one_out_errors_ * by) ** 2))),
                    noise_sd=model.diagnostics_.noise_sd * float(by.mean()),
                    data_range=(float(response.min()), float(response.max())),
                )
            )
        diagnostics = dict(zip(names, shown, strict=False))
        if learnt.mixing is not None:
            diagnostics = {
                name: _mixed(shown, mix, left, response)
                for name, mix, left, response in zip(
                    names, learnt.mixing, learnt.left, responses.T, strict=True
                )
            }
        return cls(
            space,
            tuple(names),
            tuple(models),
            tuple(divisors),
            tuple(coordinates),
            diagnostics,
            offset=learnt.offset,
            mixing=learnt.mixing,
            success=success,
        )

    def likely_to_run(self, points: Array) -> NDArray[np.bool_]:
        """Whether runs at points (k, d) are expected to give responses."""
        if self.success is None:
            return np.ones(len(points), bool)
        return self.success(self.space.box.to_unit(points)) >= LIKELY

    def averaged(self, seed: int) -> Surrogates:
        """The same with each model averaged over plausible hyperparameters, whose doubts are wider."""
        models = (
            AveragedKriging.of(model, seed + k) if isinstance(model, UniversalKriging) else model
            for k, model in enumerate(self.models)
        )
        return replace(self, models=tuple(models))

    @property
    def noise(self) -> Array:
        """Standard deviations of a single run's noise (m,), known or estimated."""
        return np.array([self.diagnostics[name].noise_sd for name in self.names])

    def predict(self, points: Array) -> Array:
        """Responses (…, m) at points (…, d): means of the noise-free processes."""
        flat = np.atleast_2d(points)
        each = zip(self.models, self.coordinates, strict=True)
        found = np.array([model.predict(inputs(flat)) for model, inputs in each]) * self._factors(flat)
        if self.mixing is not None:
            found = self.offset[:, None] + self.mixing @ found
        return found.T.reshape(*np.shape(points)[:-1], len(found))

    def predict_with_deviations(self, points: Array) -> tuple[Array, Array]:
        """Means and standard deviations of the noise-free responses at points (k, d), each (k, m)."""
        each = zip(self.models, self.coordinates, strict=True)
        found = np.array([model.predict(inputs(points), return_std=True) for model, inputs in each])
        factors = self._factors(points)
        means, deviations = found[:, 0] * factors, found[:, 1] * factors
        if self.mixing is not None:
            means = self.offset[:, None] + self.mixing @ means
            deviations = np.sqrt(self.mixing**2 @ deviations**2)
        return means.T, deviations.T

    def _factors(self, points: Array) -> Array:
        """Factors (l, k) that undo the division by parameters at points (k, d)."""
        return np.array([values(self.space, divisor, points) for divisor in self.divisors])


@dataclass(frozen=True, slots=True)
class _Learnt:
    """What Kriging learns of m responses: l names with their values (n, l)."""

    names: tuple[str, ...]
    values: Array
    offset: Array
    mixing: Array | None
    left: Array
    """Root mean square (m,) of what the scores leave of each response."""


def _learnt(settings: Kriging, names: Sequence[str], responses: Array) -> _Learnt:
    """Each response (n, m) as it is, but a curve's points as scores."""
    count = len(names)
    if not settings.curves:
        return _Learnt(tuple(names), responses, np.zeros(count), None, np.zeros(count))
    in_curves = {name for curve in settings.curves for name in curve}
    learnt, values, columns = [], [], []
    offset, left = np.zeros(count), np.zeros(count)
    for k, name in enumerate(names):
        if name not in in_curves:
            learnt.append(name)
            values.append(responses[:, k])
            columns.append(np.eye(count)[k])
    for curve in settings.curves:
        at = [list(names).index(name) for name in curve]
        found = principal(responses[:, at])
        offset[at], left[at] = found.mean, found.left
        for number, (vector, scores) in enumerate(zip(found.vectors, found.scores.T, strict=True), start=1):
            learnt.append(f"score {number} of {curve[0]}")
            values.append(scores)
            columns.append(np.zeros(count))
            columns[-1][at] = vector
    return _Learnt(tuple(learnt), np.array(values).T, offset, np.array(columns).T, left)


def _mixed(shown: Sequence[Diagnostics], mix: Array, left: float, response: Array) -> Diagnostics:
    """Diagnostics of a response from those of the models (l,) that have a share in it."""
    part = [(d, weight) for d, weight in zip(shown, mix, strict=True) if weight != 0]
    at_bound = dict.fromkeys(name for d, _ in part for name in d.at_bound)

    def together(errors: Sequence[float]) -> float:
        return float(np.sqrt(left**2 + sum((w * e) ** 2 for (_, w), e in zip(part, errors, strict=True))))

    return Diagnostics(
        leave_one_out_rmse=together([d.leave_one_out_rmse for d, _ in part]),
        largest_standardised_residual=max(d.largest_standardised_residual for d, _ in part),
        noise_sd=together([d.noise_sd for d, _ in part]),
        at_bound=tuple(at_bound),
        converged=all(d.converged for d, _ in part),
        data_range=(float(response.min()), float(response.max())),
    )


def values(space: Space, name: str | None, points: Array) -> Array:
    """Values (n,) of a parameter, calibrated or not, at points (n, d); ones without a name."""
    if name is None:
        return np.ones(len(points))
    return space.values(name, points)
