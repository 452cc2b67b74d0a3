"""What a rotating drum gives: the slope of the bed's surface as a camera before the pane sees it, frame by frame.

The functions of arrays come first; those that model.toml names read a run's directory.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from calstudy.engines.liggghts import LOG, markers

CENTRE = 0.5
"""Share of the drum's radius to both sides of its axis in which the surface is looked at: the middle of the
chord, where the surface is straight also when it is S-shaped as a whole."""
STEADY = 0.5
"""Share of the frames, from the first, in which the motion becomes steady; they do not count."""
BED = 3, 1.2
"""A bead is of the bed if it has as many others within as many diameters of its centre; one that flies has not."""
LEAST_COLUMNS = 5


def silhouette(x: np.ndarray, z: np.ndarray, radius: float, columns: np.ndarray) -> np.ndarray:
    """Upper edge (m) of beads with centres x, z (n,) in each column; NaN where there is none."""
    distance = np.abs(x[:, None] - columns[None, :])
    edge = np.where(distance < radius, z[:, None] + np.sqrt(np.maximum(radius**2 - distance**2, 0.0)), -np.inf)
    top = edge.max(axis=0, initial=-np.inf)
    return np.where(np.isfinite(top), top, np.nan)


def bed(points: np.ndarray, diameter: float) -> np.ndarray:
    """The beads (m, 3) among ``points`` (n, 3) that lie in the bed, without those that the ribs throw."""
    least, reach = BED
    found = cKDTree(points)
    others = found.query_ball_point(points, reach * diameter, return_length=True) - 1
    return points[others >= least]


def surface_angle_deg(points: np.ndarray, bead_diameter: float, drum_radius: float) -> float:
    """Slope in deg of the bed's silhouette over the drum's middle, least squares; positive if it falls with x.

    ``points`` (n, 3) are centres in m from the drum's axis, y along it. ValueError where hardly any bead lies
    there.
    """
    columns = np.linspace(-CENTRE * drum_radius, CENTRE * drum_radius, 121)
    lying = bed(points, bead_diameter)
    top = silhouette(lying[:, 0], lying[:, 2], bead_diameter / 2, columns)
    there = np.isfinite(top)
    if there.sum() < LEAST_COLUMNS:
        raise ValueError("too few beads lie in the drum's middle to tell a slope")
    return -math.degrees(math.atan(np.polyfit(columns[there], top[there], 1)[0]))


def frames(path: Path) -> list[np.ndarray]:
    """Positions (n, 3) in m in each frame of a dump of id, x, y and z."""
    found = []
    for text in path.read_text().split("ITEM: TIMESTEP")[1:]:
        _, _, body = text.partition("ITEM: ATOMS id x y z")
        found.append(np.array(body.split(), float).reshape(-1, 4)[:, 1:])
    return found


def angles(directory: Path, dump: str) -> np.ndarray:
    """Angle in deg in each frame of the steady part of a dump."""
    of = {name: float(text) for name, text in markers(directory / LOG).items() if text}
    seen = frames(directory / dump)
    steady = seen[math.floor(STEADY * len(seen)) :]
    return np.array([surface_angle_deg(one, of["bead_diameter"], of["drum_radius"]) for one in steady])


def slow_angle_deg(directory: Path) -> float:
    """Mean over the frames."""
    return abs(float(angles(directory, "slow.dump").mean()))


def slow_fluctuation_deg(directory: Path) -> float:
    """Standard deviation from frame to frame."""
    return float(angles(directory, "slow.dump").std(ddof=1))


def fast_angle_deg(directory: Path) -> float:
    """Mean over the frames."""
    return abs(float(angles(directory, "fast.dump").mean()))


def fast_fluctuation_deg(directory: Path) -> float:
    """Standard deviation from frame to frame."""
    return float(angles(directory, "fast.dump").std(ddof=1))
