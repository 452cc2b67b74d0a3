"""The Rayleigh time-step (Eq. 1), a response that needs no DEM run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from calstudy.parameters import Array


def rayleigh_time_step(
    density: ArrayLike, youngs_modulus: ArrayLike, *, radius: float, poissons_ratio: float
) -> Array:
    """Rayleigh time-step in s (Eq. 1).

    ``density`` in kg/m3 and ``youngs_modulus`` in Pa may be arrays, which broadcast. ``radius`` is that of
    the smallest particle, in m. The shear modulus is G = YM / (2 (1 + nu)).
    """
    shear_modulus = np.asarray(youngs_modulus, float) / (2.0 * (1.0 + poissons_ratio))
    wave_time = np.pi * radius * np.sqrt(np.asarray(density, float) / shear_modulus)
    return wave_time / (0.1631 * poissons_ratio + 0.8766)


@dataclass(frozen=True, slots=True)
class Particles:
    """What Eq. 1 needs of a model's smallest particles, in SI units."""

    radius: float
    poissons_ratio: float
    density: str | float = "DENS"
    """Name of the parameter that sets it, or its constant value."""
    youngs_modulus: str | float = "YM"

    def rayleigh_time_step(self, parameters: Mapping[str, ArrayLike]) -> Array:
        """Eq. 1 for parameters by name, in s. Their values may be arrays, which broadcast."""
        density, youngs_modulus = (
            parameters[given] if isinstance(given, str) else given
            for given in (self.density, self.youngs_modulus)
        )
        return rayleigh_time_step(
            density, youngs_modulus, radius=self.radius, poissons_ratio=self.poissons_ratio
        )
