"""The Rayleigh time-step (Eq. 1), a response that needs no DEM run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calstudy.parameters import Array


def rayleigh_time_step(
    density: ArrayLike, youngs_modulus: ArrayLike, *, radius: ArrayLike, poissons_ratio: ArrayLike
) -> Array:
    """Rayleigh time-step in s (Eq. 1).

    ``density`` in kg/m3, ``youngs_modulus`` in Pa, ``radius`` (of the smallest particle) in m and
    ``poissons_ratio`` may be arrays, which broadcast. The shear modulus is G = YM / (2 (1 + nu)).
    """
    radius, poissons_ratio = np.asarray(radius, float), np.asarray(poissons_ratio, float)
    shear_modulus = np.asarray(youngs_modulus, float) / (2.0 * (1.0 + poissons_ratio))
    wave_time = np.pi * radius * np.sqrt(np.asarray(density, float) / shear_modulus)
    return wave_time / (0.1631 * poissons_ratio + 0.8766)


@dataclass(frozen=True, slots=True)
class Particles:
    """What Eq. 1 needs of a model's smallest particles, in SI units.

    Each is the name of the parameter that sets it, or its constant value.
    """

    radius: str | float
    poissons_ratio: str | float
    density: str | float = "DENS"
    youngs_modulus: str | float = "YM"

    @property
    def diameter(self) -> float:
        """Diameter in m; NaN where a parameter sets it."""
        return math.nan if isinstance(self.radius, str) else 2 * self.radius

    def rayleigh_time_step(self, parameters: Mapping[str, ArrayLike]) -> Array:
        """Eq. 1 for parameters by name, in s. Their values may be arrays, which broadcast."""
        density, youngs_modulus, radius, poissons_ratio = (
            parameters[given] if isinstance(given, str) else given
            for given in (self.density, self.youngs_modulus, self.radius, self.poissons_ratio)
        )
        return rayleigh_time_step(density, youngs_modulus, radius=radius, poissons_ratio=poissons_ratio)
