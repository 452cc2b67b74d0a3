"""A heap's outline as a few points above its base, as it was found or as it was corrected by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calstudy.errors import MeasurementError
from calstudy.models.photograph.drawing import on_photograph
from calstudy.models.photograph.flanks import Flanks, Line, fit_flanks, upper_outline
from calstudy.models.photograph.photograph import Photographed, levelled
from calstudy.parameters import Array

HANDLES = 15
"""Points of an outline between its feet."""
GROUPS = 4
"""The doubt of an outline by hand is the scatter of the angle with every fourth of its points left out."""


@dataclass(frozen=True, slots=True)
class Outlined:
    """What an outline by hand measures; as ``Photographed``, without a segmentation."""

    left_deg: float
    right_deg: float
    doubt_deg: float
    """Standard deviation of the angle with parts of the points left out."""
    width: float
    height: float
    """In pixels of the photograph: distance of the feet, and of the highest point from the base."""
    flanks: Array
    """Ends (2, 2, 2) of both flanks' lines in pixels of the photograph: flank, end, column and row."""

    @property
    def angle_deg(self) -> float:
        """Mean of both flanks."""
        return 0.5 * (self.left_deg + self.right_deg)


def outline_of(found: Photographed) -> Array:
    """Outline (HANDLES + 2, 2) of a heap that was found, in pixels of the photograph.

    Its first and last points are the feet, on the base.
    """
    view = found.view
    x, y = upper_outline(levelled(view)[: round(view.base_row)])
    there = np.flatnonzero(y > 0)
    first, last = x[there[0]], x[there[-1]]
    at = np.linspace(first, last, HANDLES + 2)
    half = 0.25 * (at[1] - at[0])
    heights = [float(np.median(y[np.abs(x - place) <= half])) for place in at[1:-1]]
    rows = view.base_row - np.array([0.0, *heights, 0.0])
    return on_photograph(view, np.column_stack([at, rows]))


def measure_outline(points: Array) -> Outlined:
    """Flanks of an outline (n, 2) in pixels of the photograph, from its left foot to its right one.

    The base is the straight line between the feet, so that a camera that is turned does not count.
    MeasurementError where no flank can be fitted.
    """
    feet = points[0], points[-1]
    along = feet[1] - feet[0]
    width = float(np.hypot(*along))
    if not along[0] > 0:
        raise MeasurementError("the left foot lies to the right of the right one; drag them apart")
    axis = along / width
    upwards = np.array([axis[1], -axis[0]])
    placed = np.column_stack([(points - feet[0]) @ axis, (points - feet[0]) @ upwards])
    both = _flanks(placed)
    parts = [
        _flanks(placed[[0, *(k for k in range(1, len(placed) - 1) if k % GROUPS != group), -1]])
        for group in range(GROUPS)
    ]
    return Outlined(
        left_deg=both.left_deg,
        right_deg=both.right_deg,
        doubt_deg=float(np.std([part.mean_deg for part in parts], ddof=1)),
        width=width,
        height=both.height,
        flanks=np.array([_ends(line, feet[0], axis, upwards) for line in (both.left, both.right)]),
    )


def _flanks(placed: Array) -> Flanks:
    """Flanks of an outline (n, 2) of places along the base and heights above it, at each pixel."""
    order = np.argsort(placed[:, 0])
    x = np.arange(0.5, placed[order[-1], 0], 1.0)
    return fit_flanks(x, np.maximum(np.interp(x, placed[order, 0], placed[order, 1]), 0.0))


def _ends(line: Line, foot: Array, axis: Array, upwards: Array) -> Array:
    """Ends (2, 2) of a line, in pixels of the photograph."""
    x = np.array([line.first, line.last])
    return np.asarray(foot + x[:, None] * axis + (line.offset + line.slope * x)[:, None] * upwards)
