"""What a draw-down gives: rate and duration of the discharge, the slopes of the heap and of the crater.

The functions of arrays come first; those that model.toml names read a run's directory.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from calstudy.engines.liggghts import LOG, markers, read_positions

FLOW = (0.1, 0.5)
"""Shares of the discharged mass between which the rate is taken: neither the onset nor the emptying."""
PASSED = 0.95
"""Share of the discharged mass whose passage is the discharge's duration; the last beads trickle."""


def rate(time: np.ndarray, mass: np.ndarray, shares: tuple[float, float] = FLOW) -> float:
    """Slope in kg/s of the discharged mass (n,) over time (n,) between two shares of its end; least squares."""
    part = (mass >= shares[0] * mass[-1]) & (mass <= shares[1] * mass[-1])
    if mass[-1] <= 0 or part.sum() < 3:
        raise ValueError("too few beads flowed out to tell a rate")
    return float(np.polyfit(time[part], mass[part], 1)[0])


def duration(time: np.ndarray, mass: np.ndarray, share: float = PASSED) -> float:
    """Time in s at which a share of the discharged mass has passed."""
    if mass[-1] <= 0:
        raise ValueError("no bead flowed out")
    return float(time[np.argmax(mass >= share * mass[-1])])


def surface(points: np.ndarray, diameter: float, inner: float, outer: float) -> tuple[np.ndarray, np.ndarray]:
    """Radii and heights (m) of the highest bead in each cell of a bead's size between two radii.

    ``points`` (n, 3) are centres in m; a cell is a diameter deep in radius and about as long in its arc.
    """
    radius, angle = np.hypot(points[:, 0], points[:, 1]), np.arctan2(points[:, 1], points[:, 0])
    radii, heights = [], []
    for k in range(max(1, int((outer - inner) / diameter))):
        low = inner + k * diameter
        ring = (radius >= low) & (radius < low + diameter)
        cells = max(1, round(2 * math.pi * (low + diameter / 2) / diameter))
        cell = np.floor((angle[ring] / (2 * math.pi) + 0.5) * cells).astype(int) % cells
        for one in np.unique(cell):
            there = np.flatnonzero(ring)[cell == one]
            highest = there[np.argmax(points[there, 2])]
            radii.append(radius[highest])
            heights.append(points[highest, 2])
    return np.array(radii), np.array(heights)


def slope_deg(points: np.ndarray, diameter: float, inner: float, outer: float) -> float:
    """Slope in deg, upwards with the radius, of the surface between two radii; least squares.

    ValueError where the surface covers fewer than three cells.
    """
    radii, heights = surface(points, diameter, inner, outer)
    if len(radii) < 3 or np.ptp(radii) == 0:
        raise ValueError("too few beads lie there to tell a slope")
    return math.degrees(math.atan(np.polyfit(radii, heights, 1)[0]))


def _discharge(directory: Path) -> tuple[np.ndarray, np.ndarray]:
    time, mass = np.loadtxt(directory / "discharge.txt", ndmin=2).T
    return time, mass


def _end(directory: Path) -> tuple[np.ndarray, dict[str, float]]:
    numbers = {name: float(text) for name, text in markers(directory / LOG).items() if text}
    return read_positions(directory / "end.dump"), numbers


def discharge_rate(directory: Path) -> float:
    """In kg/s."""
    return rate(*_discharge(directory))


def discharge_time(directory: Path) -> float:
    """In s."""
    return duration(*_discharge(directory))


def crater_angle_deg(directory: Path) -> float:
    """Of what stays on the floor, from the lip to a bead off the wall."""
    points, of = _end(directory)
    diameter = of["bead_diameter"]
    left = points[points[:, 2] > 0]
    return slope_deg(left, diameter, of["opening_radius"], of["cylinder_radius"] - diameter)


def heap_angle_deg(directory: Path) -> float:
    """Of the heap on the plate, from where the stream ends, which flattens it, to a bead off the rim."""
    points, of = _end(directory)
    diameter = of["bead_diameter"]
    heap = points[points[:, 2] < 0]
    return -slope_deg(heap, diameter, of["opening_radius"], of["plate_radius"] - diameter)
