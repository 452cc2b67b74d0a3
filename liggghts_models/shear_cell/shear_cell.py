"""What a shear cell gives: stresses in steady state and at the peak, the yield locus, the density under load.

The functions of arrays come first; those that model.toml names read a run's directory.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from calstudy.engines.liggghts import LOG, markers, read_positions

PRESHEAR, FIRST, AGAIN, SECOND, WALL = 0, 1, 2, 3, 4
"""Stages of the script; -1 is the way back between them."""
STEADY = 0.5
"""Share of a stage, from its end, that counts as steady."""
SMOOTHED = 5
"""Windows of the script, a fiftieth of a bead each, over which a peak is averaged."""
MARGIN = 1.0
"""Bead diameters that the slab of the bulk density keeps from base and lid."""


def angle_deg(normal: np.ndarray, shear: np.ndarray) -> float:
    """Friction angle in deg of the mean stresses over the steady part of a stage; n windows each."""
    part = slice(len(shear) - max(1, round(STEADY * len(shear))), None)
    return math.degrees(math.atan2(float(shear[part].mean()), float(normal[part].mean())))


def peak(shear: np.ndarray) -> float:
    """Largest shear stress of a stage, averaged over neighbouring windows; ValueError for a stage too short."""
    if len(shear) < SMOOTHED:
        raise ValueError("the stage is too short to have a peak")
    return float(np.convolve(shear, np.full(SMOOTHED, 1 / SMOOTHED), "valid").max())


def locus(normal: tuple[float, float], shear: tuple[float, float]) -> tuple[float, float]:
    """Angle in deg and intercept in Pa (cohesion) of the line through two points of the yield locus."""
    slope = (shear[1] - shear[0]) / (normal[1] - normal[0])
    return math.degrees(math.atan(slope)), shear[0] - slope * normal[0]


def slab_fraction(z: np.ndarray, diameter: float, low: float, high: float, area: float) -> float:
    """Solid fraction between two heights in m of spheres with centres at z (n,), cut at both; area in m2."""
    radius = diameter / 2

    def below(height: float) -> np.ndarray:
        cap = np.clip(height - z + radius, 0.0, diameter)
        return np.pi * cap**2 * (3 * radius - cap) / 3

    return float((below(high) - below(low)).sum() / (area * (high - low)))


def _stage(directory: Path, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Normal and shear stress in Pa, window by window."""
    _, stage, _, normal, shear, _ = np.loadtxt(directory / "shear.txt", ndmin=2).T
    there = stage == number
    return normal[there], shear[there]


def _peaks(directory: Path) -> tuple[tuple[float, float], tuple[float, float]]:
    of = markers(directory / LOG)
    stresses = float(of["shear_stress_1"]), float(of["shear_stress_2"])
    return stresses, (peak(_stage(directory, FIRST)[1]), peak(_stage(directory, SECOND)[1]))


def steady_state_angle_deg(directory: Path) -> float:
    """Mean of both preshears."""
    return (angle_deg(*_stage(directory, PRESHEAR)) + angle_deg(*_stage(directory, AGAIN))) / 2


def peak_shear_stress(directory: Path) -> float:
    """In Pa, under the first of the lower normal stresses."""
    return _peaks(directory)[1][0]


def yield_locus_angle_deg(directory: Path) -> float:
    """Of the line through both peaks."""
    return locus(*_peaks(directory))[0]


def cohesion(directory: Path) -> float:
    """In Pa, where that line meets the axis."""
    return locus(*_peaks(directory))[1]


def wall_friction_angle_deg(directory: Path) -> float:
    """Of the bed on the smooth wall."""
    return angle_deg(*_stage(directory, WALL))


def solid_fraction(directory: Path) -> float:
    """Of the sheared bed at the end of the first preshear."""
    of = {name: float(text) for name, text in markers(directory / LOG).items() if text}
    z, diameter = read_positions(directory / "preshear.dump")[:, 2], of["bead_diameter"]
    high = of["lid_height"] - (MARGIN + 0.5) * diameter
    return slab_fraction(z, diameter, (MARGIN + 0.5) * diameter, high, of["area"])


def bulk_density(directory: Path) -> float:
    """In kg/m3, of the sheared bed at the end of the first preshear."""
    of = {name: float(text) for name, text in markers(directory / LOG).items() if text}
    return solid_fraction(directory) * of["bead_mass"] / (math.pi / 6 * of["bead_diameter"] ** 3)
