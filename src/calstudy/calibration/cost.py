"""The cost of a parameter set: Eq. 9 for each desired response and Eq. 10 for the Rayleigh time-step.

Where the measurement's error is known, its residual is in standard errors instead, and where a scale was
chosen, in that: see `Cost.scale`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from calstudy.errors import InputError
from calstudy.parameters import Array, Space
from calstudy.rayleigh import Particles
from calstudy.records import Target


@dataclass(frozen=True, slots=True)
class Cost:
    """Residuals at points of a parameter space. Their sum of squares is the cost."""

    space: Space
    target: Target
    WRL: float
    """Weighting factor of the Rayleigh time-step (Eq. 10)."""
    particles: tuple[Particles, ...]
    """Particles of each DEM model. The smallest of their Rayleigh time-steps counts. Without particles the
    time-step is NaN, and WRL must be 0."""
    noise: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of one run, by response. It counts beside the measurement's error alone."""

    def __post_init__(self) -> None:
        if not self.target.values:
            raise InputError("no response has a target; give at least one")
        for name, value in self.target.values.items():
            if not np.isfinite(value):
                raise InputError(f"target {name} is {value:g}; give a finite number")
            if not self._base(name) > 0:
                raise InputError(
                    f"target {name} is 0, and Eq. 9 divides by it; give its scale: the deviation that counts "
                    "as much as another response that is 100 % off"
                )
        if not self.WRL >= 0:
            raise InputError(f"WRL is {self.WRL:g}; it must not be negative")
        both = self._rising & self._stiffnesses
        if both:
            raise InputError(f"{min(both)} is both a density and a Young's modulus; use two parameters")
        slowest, fastest = self.extreme_time_steps
        if self.WRL > 0 and not fastest > slowest:
            movers = " or ".join(sorted(self._rising) + sorted(self._stiffnesses))
            raise InputError(
                f"WRL is {self.WRL:g} but no calibrated parameter moves the Rayleigh time-step; "
                + (f"calibrate {movers}, or set WRL to 0" if movers else "set WRL to 0")
            )

    @property
    def responses(self) -> tuple[str, ...]:
        """Names of the desired responses, in the order of all arrays of them."""
        return tuple(self.target.values)

    @property
    def desired(self) -> Array:
        """Desired responses m_i, shape (m,)."""
        return np.array([self.target.values[name] for name in self.responses])

    @property
    def scale(self) -> Array:
        """What deviations are divided by, shape (m,), in the responses' units.

        It is the size of the target (Eq. 9); the chosen scale; or, where the measurement's error is known,
        the standard deviation of a run from the measured value, so that the squares are a chi-square. A
        weight w divides it by sqrt(w).
        """
        weight = self.target.weight
        return np.array([self._base(name) / math.sqrt(weight.get(name, 1.0)) for name in self.responses])

    def _base(self, name: str) -> float:
        if name in self.target.sd:
            return math.hypot(self.target.sd[name], self.noise.get(name, 0.0))
        return self.target.scale.get(name, abs(self.target.values[name]))

    def deviations(self, measured: ArrayLike) -> Array:
        """Responses (…, m) minus the desired ones; 0 for an objective that is below its value."""
        found = np.asarray(measured, float) - self.desired
        if not self.target.minimised:
            return found
        below = np.array([name in self.target.minimised for name in self.responses]) & (found < 0)
        return np.where(below, 0.0, found)

    def rayleigh_time_step(self, points: ArrayLike) -> Array:
        """Rayleigh time-steps (…) in s (Eq. 1) at points (…, d): the smallest of the models'."""
        points = np.asarray(points, float)
        if not self.particles:
            return np.full(points.shape[:-1], np.nan)
        named = {name: self.space.values(name, points) for name in self._rising | self._stiffnesses}
        steps = [np.broadcast_to(p.rayleigh_time_step(named), points.shape[:-1]) for p in self.particles]
        smallest: Array = np.min(steps, axis=0)
        return smallest

    def residuals(self, points: ArrayLike, measured: ArrayLike) -> Array:
        """Residuals (…, m + 1) at points (…, d) with measured responses (…, m).

        The first m are those of the responses: their deviations over the `scale` (Eq. 9). The last one is
        that of the time-step (Eq. 10); it is 0 if WRL is 0.
        """
        responses = self.deviations(measured) / self.scale  # Eq. 9
        slowest, fastest = self.extreme_time_steps
        if self.WRL == 0:
            time_step = np.zeros(responses.shape[:-1])
        else:
            time_step = self.WRL * (fastest - self.rayleigh_time_step(points)) / (fastest - slowest)  # Eq. 10
        return np.concatenate([responses, time_step[..., None]], axis=-1)

    @property
    def time_step_moves_with(self) -> list[str]:
        """Calibrated parameters that move the Rayleigh time-step."""
        return [name for name in self.space.box.names if name in self._rising | self._stiffnesses]

    @property
    def _rising(self) -> set[str]:
        """Parameters that are a density, radius or Poisson's ratio, with which a time-step rises."""
        given = (of for p in self.particles for of in (p.density, p.radius, p.poissons_ratio))
        return {of for of in given if isinstance(of, str)}

    @property
    def _stiffnesses(self) -> set[str]:
        """Parameters that are the Young's modulus of a model's particles."""
        return {p.youngs_modulus for p in self.particles if isinstance(p.youngs_modulus, str)}

    @property
    def extreme_time_steps(self) -> tuple[float, float]:
        """r_min and r_max of Eq. 10 in s, at the worst and the best corner of the calibrated intervals.

        Each model's time-step rises with density, radius and Poisson's ratio and falls with stiffness, and so
        does the smallest. Where one of them follows from other parameters, all corners are looked at.
        """
        box = self.space.box
        movers = self._rising | self._stiffnesses
        if any(p.formula is not None and p.name in movers for p in self.space.parameters):
            ends = itertools.product(*zip(box.lower, box.upper, strict=True))
            steps = self.rayleigh_time_step(np.array(list(ends)))
            return float(steps.min()), float(steps.max())
        rises = [name in self._rising for name in box.names]
        worst = np.where(rises, box.lower, box.upper)
        slowest, fastest = self.rayleigh_time_step(np.array([worst, np.where(rises, box.upper, box.lower)]))
        return float(slowest), float(fastest)
