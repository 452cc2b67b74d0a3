"""The cost of a parameter set: Eq. 9 for each measured response and Eq. 10 for the Rayleigh time-step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calstudy.errors import InputError
from calstudy.parameters import Array, Space
from calstudy.rayleigh import rayleigh_time_step
from calstudy.records import MEASURED, Target


@dataclass(frozen=True, slots=True)
class Cost:
    """Residual vector of points of a space; its sum of squares is what both optimisations minimise."""

    space: Space
    target: Target
    WRL: float
    """Weighting factor of the Rayleigh time-step (Eq. 10)."""
    radius: float
    """Particle radius of Eq. 1 in m."""
    poissons_ratio: float

    def __post_init__(self) -> None:
        for name in MEASURED:
            value = self.target.values.get(name, float("nan"))
            if not value > 0 or not np.isfinite(value):
                raise InputError(f"target {name} is {value:g}; Eq. 9 needs a positive number")
        if not self.WRL >= 0:
            raise InputError(f"WRL is {self.WRL:g}; it must not be negative")
        slowest, fastest = self._extreme_time_steps()
        if self.WRL > 0 and not fastest > slowest:
            raise InputError(
                f"WRL is {self.WRL:g} but no calibrated parameter moves the Rayleigh time-step; "
                "calibrate DENS or YM, or set WRL to 0"
            )

    @property
    def desired(self) -> Array:
        """Desired responses m_i, shape (2,)."""
        return np.array([self.target.values[name] for name in MEASURED])

    def rayleigh_time_step(self, points: ArrayLike) -> Array:
        """Rayleigh time-steps in s (Eq. 1) of points (…, d), nominal bead and stiffness."""
        points = np.asarray(points, float)
        density, youngs_modulus = (self._values(points, name) for name in ("DENS", "YM"))
        return rayleigh_time_step(
            density, youngs_modulus, radius=self.radius, poissons_ratio=self.poissons_ratio
        )

    def residuals(self, points: ArrayLike, measured: ArrayLike) -> Array:
        """Residuals (…, 3) of points (…, d) with measured responses (…, 2).

        The last one, of the time-step, is 0 throughout when WRL is 0.
        """
        responses = (np.asarray(measured, float) - self.desired) / self.desired
        slowest, fastest = self._extreme_time_steps()
        if self.WRL == 0:
            time_step = np.zeros(responses.shape[:-1])
        else:
            time_step = self.WRL * (fastest - self.rayleigh_time_step(points)) / (fastest - slowest)
        return np.concatenate([responses, time_step[..., None]], axis=-1)

    def _values(self, points: Array, name: str) -> Array:
        names = self.space.box.names
        if name in names:
            return points[..., names.index(name)]
        return np.full(points.shape[:-1], self.space.complete(self.space.box.centre)[name])

    def _extreme_time_steps(self) -> tuple[float, float]:
        """r_min and r_max of Eq. 10: at the worst and the best corner of the calibrated intervals."""
        box = self.space.box
        ends = {name: (low, high) for name, low, high in zip(box.names, box.lower, box.upper, strict=True)}
        worst = [ends[n][0 if n == "DENS" else 1] for n in box.names]
        best = [ends[n][1 if n == "DENS" else 0] for n in box.names]
        slowest, fastest = self.rayleigh_time_step(np.array([worst, best]))
        return float(slowest), float(fastest)
