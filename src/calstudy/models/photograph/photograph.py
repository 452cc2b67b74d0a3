"""Angle of repose on a side-view photograph: by its flanks, and by height and radius.

The camera may be turned about its axis (roll), which the heap's own base shows and which is taken off. It may
look down a little (pitch), which shows in how far the front of the base bulges below its ends: other
particles make the outline then, and a photograph from too high is refused. Nothing is corrected for it: a
cone's flanks would look flatter, those of stored heaps do not by more than 0.1 deg below the limit.

The heap is cut out several times with other sizes of the picture and other sensitivities; how much the angle
differs between them is the doubt of the segmentation, and a photograph on which it differs much is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from calstudy.errors import MeasurementError
from calstudy.models.photograph.flanks import Flanks, fit_flanks, robust_fit, upper_outline
from calstudy.models.photograph.segmentation import (
    Colours,
    Cut,
    Mask,
    blurred_lab,
    colour_distance,
    cut_out,
    difference,
)
from calstudy.parameters import Array

CUTS = ((700, 1.0), (550, 1.0), (600, 0.8), (600, 1.25))
"""Longer side of the heap's part in pixels, and sensitivity, of each segmentation; the first one is drawn."""
MAX_ROLL_DEG, MAX_PITCH_DEG = 12.0, 4.0
MAX_DOUBT_DEG = 0.3
"""Largest standard deviation of the angle over the segmentations."""
MOST_UNLIKE_DEG = 10.0
"""Largest difference of the two flanks."""
LEAST_EDGE = 1.3
"""How much more the picture must change at the outline than in the background beside it."""
LEAST_WIDTH = 320
"""Width in pixels of the photograph below which the particles at the outline are lost."""
MAX_ROUGHNESS = 0.12
"""Deviation of a flank from its line as a share of the heap's height."""


@dataclass(frozen=True, slots=True)
class View:
    """What one segmentation of a photograph gives."""

    cut: Cut
    flanks: Flanks
    """In pixels, in the levelled picture; x to the right from its left border, y upwards from the feet."""
    middle: tuple[float, float]
    """Column and row about which the picture was levelled."""
    base_row: float
    """Row of the feet in the levelled picture."""
    roll_deg: float
    """How far the picture was turned to be level, clockwise."""
    pitch_deg: float
    """How far the camera looks down."""
    edge: float
    """How much more the picture changes at the outline than in the background beside it."""

    @property
    def angle_deg(self) -> float:
        """Mean of both flanks."""
        return self.flanks.mean_deg


@dataclass(frozen=True, slots=True)
class Photographed:
    """What was measured on one photograph."""

    view: View
    """The first segmentation, which is the one to draw."""
    left_deg: float
    right_deg: float
    """Angles of the flanks in degrees, means over the segmentations."""
    doubt_deg: float
    """Standard deviation of the angle over the segmentations."""
    width: float
    height: float
    """Of the heap in pixels of the photograph: distance of the feet, and of the highest point from them."""

    @property
    def angle_deg(self) -> float:
        """Mean of both flanks."""
        return 0.5 * (self.left_deg + self.right_deg)


def measure_photograph(photograph: Colours) -> Photographed:
    """Measure the heap on a photograph (rows, columns, 3), blue first.

    MeasurementError where no heap is found, or what is found is not measured well enough.
    """
    differs = difference(photograph)
    views = [_view(photograph, differs, size, sensitivity) for size, sensitivity in CUTS]
    angles = [view.angle_deg for view in views]
    doubt = float(np.std(angles, ddof=1))
    if doubt > MAX_DOUBT_DEG:
        raise MeasurementError(
            f"the heap's outline is unsure: the angle differs by {np.ptp(angles):.1f} deg with how it is cut "
            "out; put a plain sheet of another colour behind and below the heap"
        )
    factors = [view.cut.scale for view in views]
    return Photographed(
        view=views[0],
        left_deg=float(np.mean([view.flanks.left_deg for view in views])),
        right_deg=float(np.mean([view.flanks.right_deg for view in views])),
        doubt_deg=doubt,
        width=float(np.mean([f * view.flanks.width for f, view in zip(factors, views, strict=True)])),
        height=float(np.mean([f * view.flanks.height for f, view in zip(factors, views, strict=True)])),
    )


def _view(photograph: Colours, differs: Array, longer_side: int, sensitivity: float) -> View:
    cut = cut_out(photograph, differs, longer_side, sensitivity)
    heap = cut.heap
    roll = 0.0
    for _ in range(2):
        level, middle = _turned(heap, roll)
        base = _base(level)
        roll += base.slope_deg
    level, middle = _turned(heap, roll)
    base = _base(level)
    if abs(roll) > MAX_ROLL_DEG:
        raise MeasurementError(f"the picture is turned by {roll:.0f} deg; hold the camera level")
    if base.pitch_deg > MAX_PITCH_DEG:
        raise MeasurementError(
            f"the camera looks down by {base.pitch_deg:.0f} deg, or the outline holds what the heap stands "
            "on; bring the camera to the height of the foot"
        )
    x, y = upper_outline(level[: max(1, round(base.row))])
    flanks = fit_flanks(x, y)
    view = View(
        cut=cut,
        flanks=flanks,
        middle=middle,
        base_row=float(max(1, round(base.row))),
        roll_deg=roll,
        pitch_deg=base.pitch_deg,
        edge=_edge(cut.picture, heap),
    )
    _refuse_what_is_no_heap(view)
    return view


def _refuse_what_is_no_heap(view: View) -> None:
    flanks = view.flanks
    wide = view.cut.scale * flanks.width
    if wide < LEAST_WIDTH:
        raise MeasurementError(
            f"the heap is {wide:.0f} pixels wide, less than {LEAST_WIDTH}; take it from nearer"
        )
    rough = max(flanks.left.deviation, flanks.right.deviation) / flanks.height
    if rough > MAX_ROUGHNESS:
        raise MeasurementError(
            "the flanks are not straight: the outline holds something besides the heap, or the heap is small"
        )
    if abs(flanks.left_deg - flanks.right_deg) > MOST_UNLIKE_DEG:
        raise MeasurementError(
            f"the flanks rise by {flanks.left_deg:.0f} and {flanks.right_deg:.0f} deg: the outline holds "
            "something besides the heap, or it has slid to one side"
        )
    if view.edge < LEAST_EDGE:
        raise MeasurementError(
            "the heap hardly differs from its background; put a plain sheet of another colour behind it"
        )


@dataclass(frozen=True, slots=True)
class _Base:
    """Lower edge of a heap."""

    row: float
    """Row of its ends."""
    slope_deg: float
    """How far the right end is lower than the left one."""
    pitch_deg: float
    """How far the camera looks down, from how far the front bulges below the ends."""


def _base(heap: Mask) -> _Base:
    """The lower edge as the front half of an ellipse: the base of a cone seen from above."""
    columns = np.flatnonzero(heap.any(axis=0))
    middle, radius = 0.5 * (columns[0] + columns[-1]), 0.5 * (columns[-1] - columns[0] + 1)
    x = (columns - middle) / radius
    used = np.abs(x) < 0.95
    lowest = heap.shape[0] - heap[::-1].argmax(axis=0)[columns]
    bulge = np.sqrt(np.maximum(1 - x**2, 0.0))
    design = np.column_stack([np.ones_like(x), x, bulge])[used]
    (row, slope, depth), _ = robust_fit(design, lowest[used].astype(float))
    pitch = math.asin(min(1.0, max(0.0, depth / radius)))
    if depth < 0:
        row = float(np.median(lowest[used]))
    return _Base(float(row), math.degrees(math.atan(slope / radius)), math.degrees(pitch))


def levelled(view: View) -> Mask:
    """The heap's pixels (rows, columns), turned so that its base is level."""
    return _turned(view.cut.heap, view.roll_deg)[0]


def _turned(heap: Mask, roll_deg: float) -> tuple[Mask, tuple[float, float]]:
    """The mask turned about its middle, so that its base is level, and that middle as column and row."""
    rows, columns = heap.shape
    middle = (0.5 * columns, 0.5 * rows)
    turn = cv2.getRotationMatrix2D(middle, roll_deg, 1.0)
    soft = cv2.warpAffine(255 * heap.astype(np.uint8), turn, (columns, rows), flags=cv2.INTER_LINEAR)
    return soft > 127, middle


def _edge(picture: Colours, heap: Mask) -> float:
    """How much more the picture changes at the heap's upper outline than in the background beside it.

    Differences of colour (CIELAB) between both sides of the outline, of which four in five are larger, over
    those between places of the background as far from each other, of which one in ten is larger.
    """
    lab = blurred_lab(picture, 1.2)
    columns = np.flatnonzero(heap.any(axis=0))
    inner = columns[round(0.05 * len(columns)) : round(0.95 * len(columns))]
    top = heap.argmax(axis=0)[inner]
    step = max(3, round(0.012 * len(columns)))
    above, below = np.maximum(top - step, 0), np.minimum(top + step, heap.shape[0] - 1)
    far = np.maximum(top - 3 * step, 0)
    across = colour_distance(lab[above, inner], lab[below, inner])
    outside = colour_distance(lab[far, inner], lab[above, inner])
    return float(np.quantile(across, 0.2) / max(1.0, float(np.quantile(outside, 0.9))))


class Angles(Protocol):
    """Angles of a heap on one photograph in degrees, however they were measured."""

    @property
    def left_deg(self) -> float:
        """Of the left flank."""

    @property
    def right_deg(self) -> float:
        """Of the right flank."""

    @property
    def angle_deg(self) -> float:
        """Mean of both flanks."""

    @property
    def doubt_deg(self) -> float:
        """Standard deviation of the mean by how the heap was cut out."""


def combined(values: Sequence[Angles], floor_deg: float) -> tuple[float, float]:
    """Mean angle and its standard deviation in degrees over photographs.

    All flanks are repeats of each other; the photographs are, too, and the larger scatter counts. The doubt
    of the segmentation and the method's own error are added to it.
    """
    angles = np.array([value.angle_deg for value in values])
    flanks = np.array([(value.left_deg, value.right_deg) for value in values]).ravel()
    scatter = flanks.std(ddof=1) / math.sqrt(len(flanks))
    if len(angles) > 1:
        scatter = max(scatter, angles.std(ddof=1) / math.sqrt(len(angles)))
    doubt = math.sqrt(np.mean([value.doubt_deg**2 for value in values]) / len(angles))
    return float(angles.mean()), float(np.sqrt(scatter**2 + doubt**2 + floor_deg**2))
