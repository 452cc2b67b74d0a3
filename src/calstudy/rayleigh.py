"""The Rayleigh time-step (Eq. 1), the third response; it needs no DEM run."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from calstudy.parameters import Array


def rayleigh_time_step(
    density: ArrayLike, youngs_modulus: ArrayLike, *, radius: float, poissons_ratio: float
) -> Array:
    """Rayleigh time-step in s (Eq. 1).

    ``density`` in kg/m3 and ``youngs_modulus`` in Pa may be arrays (they broadcast); ``radius`` of the
    smallest particle in m. The shear modulus is G = YM / (2 (1 + nu)).
    """
    shear_modulus = np.asarray(youngs_modulus, float) / (2.0 * (1.0 + poissons_ratio))
    wave_time = np.pi * radius * np.sqrt(np.asarray(density, float) / shear_modulus)
    return wave_time / (0.1631 * poissons_ratio + 0.8766)
