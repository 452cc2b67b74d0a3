"""What a uniaxial compression gives: the strain at the largest stress, and the moduli on the way there and back.

The functions of arrays come first; those that model.toml names read a run's directory.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

LOADING = (0.5, 1.0)
"""Shares of the largest stress between which the modulus is taken while the stress grows."""
UNLOADING = (0.7, 1.0)
"""The same on the way back, where the stiffness falls off faster."""


def strain(height: np.ndarray, seated_height: float) -> np.ndarray:
    """Compressive strain (n,) of a bed from its height when the lid was seated."""
    return 1.0 - height / seated_height


def modulus(strains: np.ndarray, stress: np.ndarray, shares: tuple[float, float]) -> float:
    """Constrained modulus in Pa: slope of stress (n,) over strain (n,) between two shares of the largest stress.

    Least squares; ValueError for fewer than three points between them.
    """
    largest = stress.max()
    part = (stress >= shares[0] * largest) & (stress <= shares[1] * largest)
    if part.sum() < 3:
        raise ValueError("too few points of the curve lie there to tell a modulus")
    return float(np.polyfit(strains[part], stress[part], 1)[0])


def curves(directory: Path) -> tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Strain and stress (Pa) of loading and unloading."""
    found = [np.loadtxt(directory / f"{name}.txt", ndmin=2).T for name in ("loading", "unloading")]
    seated = float(found[0][0][0])
    (up, up_stress), (down, down_stress) = found
    return (strain(up, seated), up_stress), (strain(down, seated), down_stress)


def largest_strain(directory: Path) -> float:
    """At the largest stress."""
    return float(curves(directory)[0][0].max())


def loading_modulus(directory: Path) -> float:
    """In Pa, over the upper half of the stress."""
    return modulus(*curves(directory)[0], LOADING)


def unloading_modulus(directory: Path) -> float:
    """In Pa, from the largest stress to 0.7 of it."""
    return modulus(*curves(directory)[1], UNLOADING)


def remaining_strain(directory: Path) -> float:
    """When the stress is back at that of the seated lid: what does not spring back."""
    return float(curves(directory)[1][0][-1])
