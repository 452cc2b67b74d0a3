"""The photograph with what was measured drawn over it, for the eye to check."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from calstudy.models.photograph.flanks import Line
from calstudy.models.photograph.photograph import Photographed, View
from calstudy.models.photograph.scale import Circle
from calstudy.models.photograph.segmentation import Colours, sized
from calstudy.parameters import Array

DRAWN_SIDE = 1600
"""Longer side in pixels of the picture that is drawn."""
OUTLINE, FLANK, BASE, SPHERE = (60, 200, 60), (40, 40, 230), (230, 140, 20), (200, 40, 200)
"""Colours, blue first."""


def drawn(photograph: Colours, found: Photographed, sphere: Circle | None, words: str) -> Colours:
    """Picture (rows, columns, 3) with the outline, both flanks, the base, the sphere, and words below."""
    picture = sized(photograph, DRAWN_SIDE).copy()
    factor = picture.shape[1] / photograph.shape[1]
    view = found.view
    thick = max(1, round(picture.shape[1] / 600))
    contours, _ = cv2.findContours(view.cut.heap.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for contour in contours:
        points = factor * _on_photograph(view, contour[:, 0].astype(float) + 0.5)
        cv2.polylines(picture, [_whole(points)], isClosed=True, color=OUTLINE, thickness=thick)
    columns = np.flatnonzero(view.cut.heap.any(axis=0))
    base = np.array([[columns[0], view.base_row], [columns[-1], view.base_row]], dtype=float)
    for ends, colour in (
        (_ends(view, view.flanks.left), FLANK),
        (_ends(view, view.flanks.right), FLANK),
        (_turned_back(view, base), BASE),
    ):
        points = factor * _on_photograph(view, ends)
        cv2.polylines(picture, [_whole(points)], isClosed=False, color=colour, thickness=2 * thick)
    if sphere is not None:
        middle = (round(factor * sphere.x), round(factor * sphere.y))
        cv2.circle(picture, middle, round(0.5 * factor * sphere.diameter), SPHERE, thick)
    size = picture.shape[1] / 1000
    strip = np.full((round(40 * size), picture.shape[1], 3), 255, np.uint8)
    at = (round(10 * size), round(28 * size))
    cv2.putText(strip, words, at, cv2.FONT_HERSHEY_SIMPLEX, 0.8 * size, (0, 0, 0), thick, cv2.LINE_AA)
    return np.vstack([picture, strip])


def _ends(view: View, line: Line) -> Array:
    """Ends (2, 2) of a flank, carried on to the base and to the apex, in the part of the photograph."""
    x = np.array([line.first, line.last])
    y = line.offset + line.slope * x
    return _turned_back(view, np.column_stack([x, view.base_row - y]))


def on_photograph(view: View, points: Array) -> Array:
    """Points (n, 2) of the levelled part, as column and row, on the whole photograph."""
    return _on_photograph(view, _turned_back(view, points))


def _turned_back(view: View, points: Array) -> Array:
    """Points (n, 2) of the levelled part in the part as it was photographed."""
    turn = math.radians(view.roll_deg)
    c, s = math.cos(turn), math.sin(turn)
    x, y = (points - view.middle).T
    return np.column_stack([x * c - y * s, x * s + y * c]) + view.middle


def _on_photograph(view: View, points: Array) -> Array:
    """Points (n, 2) of the part on the whole photograph."""
    return np.asarray(view.cut.corner + view.cut.scale * points)


def _whole(points: Array) -> NDArray[np.int32]:
    return points.round().astype(np.int32).reshape(-1, 1, 2)
