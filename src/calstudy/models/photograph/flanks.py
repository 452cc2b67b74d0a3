"""Angle of repose from the flanks of a side view: a straight line to the left and one to the right.

Apex and foot are left out: the apex of a heap is round or a single particle, and its foot runs out or stands
against a rim. Each line is fitted robustly, so that a loose particle does not turn it. A camera that is
turned about its axis adds to one flank what it takes from the other: the mean of both does not feel it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calstudy.errors import MeasurementError
from calstudy.parameters import Array

RULE = "flanks/1"
"""Name of this rule; what is stored of it carries the name, so change it with the numbers."""
FLANK = (0.10, 0.90)
"""Part of the way from foot to apex that a line is fitted to."""
FOOT = 0.08
"""Share of the height at which a flank begins: what is lower is a shadow, or a layer that ran out."""
BULK = 0.5
"""The apex is the middle of what rises above this share of the height: one high particle does not move it."""
LEAST_COLUMNS = 8
HUBER = 3.0
"""Residuals beyond this many robust deviations lose weight: the bumps of an outline of particles do not."""
ROUNDS = 30


@dataclass(frozen=True, slots=True)
class Line:
    """Straight line y = offset + slope x, fitted robustly; lengths in the unit of x and y."""

    offset: float
    slope: float
    first: float
    last: float
    """Range of x that it was fitted to."""
    deviation: float
    """Robust standard deviation of the points from it."""


@dataclass(frozen=True, slots=True)
class Flanks:
    """Both flanks of a side view, in the coordinates of its profile, y upwards."""

    left: Line
    right: Line
    width: float
    """Of the whole outline above the base."""
    height: float
    """Of the highest point above the base."""

    @property
    def left_deg(self) -> float:
        """Angle of the left flank in degrees, positive where it rises towards the apex."""
        return math.degrees(math.atan(self.left.slope))

    @property
    def right_deg(self) -> float:
        """Angle of the right flank in degrees, positive where it rises towards the apex."""
        return math.degrees(math.atan(-self.right.slope))

    @property
    def mean_deg(self) -> float:
        """Mean of both."""
        return 0.5 * (self.left_deg + self.right_deg)


def fit_flanks(x: Array, y: Array) -> Flanks:
    """Both flanks of an upper outline: heights y (n,) above the base at places x (n,), which increase.

    MeasurementError where nothing rises, or a flank has too few points.
    """
    height = float(y.max()) if len(y) else 0.0
    if not height > 0:
        raise MeasurementError("nothing rises above the base")
    rising = np.flatnonzero(y > FOOT * height)
    feet = x[rising[0]], x[rising[-1]]
    upper = np.maximum(y - BULK * height, 0.0)
    apex = float(x @ upper / upper.sum())
    lines = []
    for foot in feet:
        along = (x - foot) / (apex - foot) if apex != foot else np.zeros_like(x)
        used = (along > FLANK[0]) & (along < FLANK[1])
        if np.count_nonzero(used) < LEAST_COLUMNS:
            raise MeasurementError("a flank is too short for a line; take the picture from nearer")
        lines.append(fit_line(x[used], y[used]))
    whole = x[y > 0]
    return Flanks(lines[0], lines[1], float(whole[-1] - whole[0]), height)


def fit_line(x: Array, y: Array) -> Line:
    """Straight line through points x, y (n,) by Huber's weights."""
    design = np.column_stack([np.ones_like(x), x])
    coefficients, deviation = robust_fit(design, y)
    return Line(float(coefficients[0]), float(coefficients[1]), float(x[0]), float(x[-1]), deviation)


def robust_fit(design: Array, y: Array) -> tuple[Array, float]:
    """Coefficients (k,) of ``design`` (n, k) for y (n,) by Huber's weights, and the robust deviation."""
    weights = np.ones_like(y)
    coefficients: Array = np.zeros(design.shape[1])
    scale = 0.0
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        before = coefficients
        coefficients = np.asarray(np.linalg.lstsq(design * root[:, None], y * root, rcond=None)[0], float)
        residuals = np.abs(y - design @ coefficients)
        scale = 1.4826 * float(np.median(residuals))
        if scale == 0 or np.allclose(coefficients, before, rtol=1e-9, atol=0):
            break
        weights = np.minimum(1.0, HUBER * scale / np.maximum(residuals, 1e-300))
    return coefficients, scale


def upper_outline(mask: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Places x (n,) and heights y (n,) of the highest pixel in each column of a mask (rows, columns).

    Heights are from the mask's lower edge; columns without a pixel are 0 high.
    """
    rows = mask.shape[0]
    there = mask.any(axis=0)
    y = np.where(there, rows - mask.argmax(axis=0), 0)
    return np.asarray(np.arange(mask.shape[1]) + 0.5, dtype=float), np.asarray(y, dtype=float)


def bead_outline(centres: Array, radii: Array, azimuth: float, step: float) -> tuple[Array, Array]:
    """Places and heights (n,) in m of the upper outline of beads (n, 3), seen along y turned by ``azimuth``.

    Heights are above z = 0, the plate; ``azimuth`` in rad, ``step`` in m.
    """
    across = centres[:, 0] * math.cos(azimuth) + centres[:, 1] * math.sin(azimuth)
    order = np.argsort(across)
    across, z, r = across[order], centres[order, 2], np.broadcast_to(radii, len(centres))[order]
    x = np.arange((across - r).min() + 0.5 * step, (across + r).max(), step)
    half = np.sqrt(np.maximum(r[None, :] ** 2 - (x[:, None] - across[None, :]) ** 2, 0.0))
    heights = np.where(half > 0, z[None, :] + half, 0.0).max(axis=1)
    return np.asarray(x, dtype=float), np.asarray(heights, dtype=float)
