"""The surrogates of a calibration with two fidelities: `Surrogates` of the expensive one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from calstudy.calibration.fidelities.levels import VARYING, Places, TwoLevels
from calstudy.calibration.kriging.averaged import AveragedKriging
from calstudy.calibration.kriging.surrogates import Kriging, Surrogates, values
from calstudy.calibration.kriging.universal import UniversalKriging
from calstudy.parameters import Array, Space
from calstudy.records import Phase

AGREE = 0.4
"""Fidelities agree if the offset varies by this share of the response's own variation at most: correlation
0.93."""
SURE = 3.0
"""They do not if the log restricted likelihood of a larger share is larger by this."""


@dataclass(frozen=True, slots=True)
class FidelityRuns:
    """Runs of one fidelity."""

    points: Array
    """(n, d)."""
    responses: Array
    """(n, m); NaN where a run gave none."""

    @property
    def usable(self) -> FidelityRuns:
        """Those that gave all responses."""
        good = np.isfinite(self.responses).all(axis=1)
        return FidelityRuns(self.points[good], self.responses[good])


@dataclass(frozen=True, slots=True)
class Cheap:
    """The cheap fidelity of a calibration, or the earlier study whose runs stand in for it."""

    share: float
    """Time of a cheap run as a share of that of an expensive one, as it is expected."""
    is_measured: bool = True
    """Whether the runs' own times replace it; those of an emulator's answers say nothing."""
    noise: Mapping[str, float] | None = None
    """Known standard deviations of cheap runs from seed to seed, in the responses' units."""
    overlaps: tuple[str, str] | None = None
    """A stiffness and a density. Then the offset of a response that is divided by the density is proportional
    to (density / stiffness)^(2/3), as overlaps of Hertzian contacts under their own weight are."""
    offsets: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Mean and standard deviation of responses' offsets, expensive less cheap, where earlier runs measured
    them, in the responses' units."""
    measured_at: Mapping[str, float] = field(default_factory=dict)
    """Parameters at which they were measured."""
    times: Mapping[tuple[Phase, int], float] = field(default_factory=dict)
    """Times in s that the runs took, by phase and number, where a calibration is done again: so it makes the
    same choices on a machine of another speed."""
    earlier: FidelityRuns | None = None
    """Runs of an earlier study, of another material perhaps, in place of cheap ones, none of which is made.
    None: there is a cheap fidelity, and its runs are made."""

    @classmethod
    def of_earlier(cls, runs: FidelityRuns) -> Cheap:
        """An earlier study in place of a cheap fidelity: its runs cost nothing, and no more can be had."""
        return cls(0.0, is_measured=False, earlier=runs)

    @property
    def offset_in_words(self) -> str:
        """What the expensive runs differ by."""
        return f"the offset {'between the fidelities' if self.earlier is None else 'from the earlier study'}"

    @property
    def given_up(self) -> str:
        """What happens where it is no guide, in words."""
        if self.earlier is None:
            return "the cheap fidelity is given up, the expensive one goes on alone"
        return "the earlier study is given up, the calibration goes on without it"


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoSurrogates(Surrogates):
    """Surrogates of the expensive fidelity. Its ``models`` are the cheap runs' own Kriging models."""

    cheap: Cheap
    levels: tuple[TwoLevels, ...]
    members: tuple[tuple[TwoLevels, ...], ...]
    """Of each response the levels that its predictions are averaged over: the one, or more if `averaged`."""
    run_noise: Array
    """Standard deviations of an expensive run (m,), in the responses' units."""

    @classmethod
    def of(
        cls,
        settings: Kriging,
        space: Space,
        names: tuple[str, ...],
        cheap: Cheap,
        runs: tuple[FidelityRuns, FidelityRuns],
        noise: Mapping[str, float] | None,
        before: Surrogates | None = None,
    ) -> TwoSurrogates:
        """Fit cheap and expensive ``runs``; ``noise`` is that of an expensive run, where it is known.

        Known noise of an expensive fidelity is mostly that of a few runs. So its variance is averaged with
        that of the cheap one, but not with that of an earlier study, whose runs may scatter for other
        reasons. Where it is not known it is that of the cheap runs. NumericsError: too few cheap runs.
        """
        base = Surrogates.fit(settings, space, names, runs[0].points, runs[0].responses, cheap.noise, before)
        low, high = (of.usable for of in runs)
        points = np.vstack([low.points, high.points])
        is_expensive = np.arange(len(points)) >= len(low.points)
        levels, run_noise = [], []
        for k, name in enumerate(names):
            by = values(space, base.divisors[k], points)
            model = base.models[k]
            cheap_sd = base.diagnostics[name].noise_sd
            sd = (noise or {}).get(name, cheap_sd)
            if cheap.earlier is None:
                sd = float(np.sqrt((sd**2 + cheap_sd**2) / 2))
            variances = np.where(is_expensive, (sd / by) ** 2, model.hyperparameters_.noise_variance)
            shape = offset_shape(space, base.divisors[k], cheap, points)
            places = Places.of(base.coordinates[k].to_unit(points), shape, is_expensive)
            y = np.concatenate([low.responses[:, k], high.responses[:, k]]) / by
            size = known_size(space, base.divisors[k], cheap, name)
            levels.append(TwoLevels.given(places, y, variances, model.hyperparameters_, size))
            run_noise.append(sd)
        return cls(
            base.space,
            base.names,
            base.models,
            base.divisors,
            base.coordinates,
            base.diagnostics,
            base.offset,
            base.mixing,
            base.success,
            cheap=cheap,
            levels=tuple(levels),
            members=tuple((level,) for level in levels),
            run_noise=np.array(run_noise),
        )

    def averaged(self, seed: int) -> Surrogates:
        """The same averaged over hyperparameters that the cheap runs leave plausible, with wider doubts."""
        members = []
        for k, (level, model) in enumerate(zip(self.levels, self.models, strict=True)):
            assert isinstance(model, UniversalKriging)
            plausible = AveragedKriging.of(model, seed + k).plausible
            members.append(tuple(level.at(p) for p in plausible) or (level,))
        return replace(self, members=tuple(members))

    @property
    def noise(self) -> Array:
        """Standard deviations of an expensive run's noise (m,), known or estimated."""
        return self.run_noise

    def predict(self, points: Array) -> Array:
        """Responses (…, m) at points (…, d): means of the noise-free processes."""
        flat = np.atleast_2d(points)
        found = [
            np.mean([level.mean(at) for level in members], axis=0)
            for members, (_, at) in zip(self.members, self._places(flat, True), strict=True)
        ]
        scaled = np.array(found) * self._factors(flat)
        return scaled.T.reshape(*np.shape(points)[:-1], len(found))

    def predict_with_deviations(self, points: Array) -> tuple[Array, Array]:
        """Means and standard deviations of the noise-free responses at points (k, d), each (k, m)."""
        found = []
        for members, (_, at) in zip(self.members, self._places(points, True), strict=True):
            means, variances = np.array([level.mean_and_variance(at) for level in members]).swapaxes(0, 1)
            found.append((means.mean(axis=0), np.sqrt(variances.mean(axis=0) + means.var(axis=0))))
        means, deviations = np.swapaxes(found, 0, 1) * self._factors(points)
        return means.T, deviations.T

    def gains(self, point: Array) -> tuple[Array, Array]:
        """What a cheap and an expensive run at a point (d,) would take off the variances, each (m,).

        In squared units of the responses, at the expensive fidelity and at that point.
        """
        at, factors = point[None], self._factors(point[None])[:, 0]
        gains = []
        for is_expensive in (False, True):
            noise = np.array([self.diagnostics[name].noise_sd for name in self.names])
            noise = (self.run_noise if is_expensive else noise) / factors
            taken = []
            for (level, here), (_, there), sd in zip(
                self._places(at, True), self._places(at, is_expensive), noise, strict=True
            ):
                together = level.covariance(here, here if is_expensive else there)[0]
                taken.append(together**2 / (level.variance(there)[0] + sd**2))
            gains.append(np.array(taken) * factors**2)
        return gains[0], gains[1]

    def _places(self, points: Array, is_expensive: bool) -> list[tuple[TwoLevels, Places]]:
        """Each response's level with the points (k, d) as it sees them."""
        found = []
        for level, inputs, divisor in zip(self.levels, self.coordinates, self.divisors, strict=True):
            shape = offset_shape(self.space, divisor, self.cheap, points)
            found.append((level, Places.of(inputs.to_unit(points), shape, is_expensive)))
        return found

    @property
    def offsets(self) -> dict[str, tuple[float, float]]:
        """Size of each response's offset, expensive less cheap, with its standard deviation.

        At the centre of the box, in the response's units; NaN without an expensive run.
        """
        found = {}
        centre = self.space.box.centre[None]
        for name, divisor, level in zip(self.names, self.divisors, self.levels, strict=True):
            factor = float(values(self.space, divisor, centre)[0])
            factor *= float(offset_shape(self.space, divisor, self.cheap, centre)[0])
            known = len(level.beta) > 1
            size, sd = (level.beta[1], np.sqrt(level.doubt[1, 1])) if known else (np.nan, np.nan)
            found[name] = (float(size) * factor, float(sd) * factor)
        return found

    @property
    def disagreement(self) -> str:
        """Why the cheap runs do not tell what the expensive ones give; empty where they do."""
        told = []
        for name, level in zip(self.names, self.levels, strict=True):
            known = dict(zip(VARYING, level.likelihoods, strict=False))
            agreeing = max(value for t, value in known.items() if t <= AGREE)
            most = max(known, key=lambda t: known[t])
            if most > AGREE and known[most] > agreeing + SURE:
                told.append(
                    f"{name}: {self.cheap.offset_in_words} varies by {most:g} of the response's own "
                    f"variation, so that they correlate by {1 / np.hypot(1.0, most):.2f} only"
                )
        return "; ".join(told)


def known_size(space: Space, divisor: str | None, cheap: Cheap, name: str) -> tuple[float, float] | None:
    """What was measured of the size c of a response's offset: mean and standard deviation, or None."""
    if name not in cheap.offsets:
        return None
    at, factor = cheap.measured_at, 1.0 if divisor is None else cheap.measured_at[divisor]
    if cheap.overlaps is not None and divisor == cheap.overlaps[1]:
        middle = space.complete(space.box.centre)
        stiffness, density = (at[p] / middle[p] for p in cheap.overlaps)
        factor *= (density / stiffness) ** (2.0 / 3.0)
    mean, sd = cheap.offsets[name]
    return mean / factor, sd / factor


def offset_shape(space: Space, divisor: str | None, cheap: Cheap, points: Array) -> Array:
    """Form s of the offset of a response that is divided by ``divisor``, at points (n, d): shape (n,)."""
    if cheap.overlaps is None or divisor != cheap.overlaps[1]:
        return np.ones(len(points))
    middle = space.complete(space.box.centre)
    stiffness, density = (values(space, name, points) / middle[name] for name in cheap.overlaps)
    shape: Array = (density / stiffness) ** (2.0 / 3.0)
    return shape
