"""Scale of a photograph in m for one pixel: two points of a known distance, or a sphere beside the heap."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from calstudy.errors import MeasurementError
from calstudy.models.photograph.segmentation import Colours, sized
from calstudy.parameters import Array

FINDING_SIDE = 900
"""Longer side in pixels of the picture on which the sphere is looked for."""
RADII = (0.02, 0.25)
"""Smallest and largest radius of a sphere, as shares of the picture's width."""
LEAST_EDGE = 0.7
"""Share of a circle's rim along which the picture has an edge across it."""
RIM = 120
"""Places of the rim that are looked at."""
CANDIDATES = 12


@dataclass(frozen=True, slots=True)
class Circle:
    """A round object: column, row and diameter in pixels of the photograph."""

    x: float
    y: float
    diameter: float


def find_sphere(photograph: Colours, around: tuple[float, float, float, float]) -> Circle:
    """The reference sphere on a photograph (rows, columns, 3).

    ``around`` is the heap's box, left, top, right, bottom, in which none is looked for. MeasurementError
    where no round object is found.
    """
    picture = sized(photograph, FINDING_SIDE)
    factor = photograph.shape[1] / picture.shape[1]
    grey = cv2.medianBlur(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), 5)
    least, most = (round(share * picture.shape[1]) for share in RADII)
    circles = cv2.HoughCircles(
        grey, cv2.HOUGH_GRADIENT_ALT, 1.5, least, param1=120, param2=0.6, minRadius=least, maxRadius=most
    )
    left, top, right, bottom = (end / factor for end in around)
    gradient = _gradient(picture)
    best, share = None, 0.0
    for x, y, r in [] if circles is None else circles[0, :CANDIDATES].astype(float):
        if left < x < right and top < y < bottom:
            continue
        x, y, r, edge = _refined(gradient, x, y, r)
        if edge > share:
            best, share = Circle(factor * (x + 0.5), factor * (y + 0.5), factor * 2 * r), edge
    if best is None or share < LEAST_EDGE:
        raise MeasurementError(
            "no sphere is found beside the heap: all of it must be seen before another colour, free of the "
            "heap; or give the scale by two points with --scale"
        )
    return best


def _gradient(picture: Colours) -> Array:
    """Change of the lightness along columns and rows (rows, columns, 2), smoothed."""
    grey = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), (0, 0), 1.5)
    parts = [cv2.Scharr(grey, cv2.CV_64F, *order) / 32 for order in ((1, 0), (0, 1))]
    return np.stack(parts, axis=-1)


def _refined(gradient: Array, x: float, y: float, r: float) -> tuple[float, float, float, float]:
    """Circle near a first guess with the strongest edge all along, and the share of its rim that has one."""
    turn = 2 * math.pi * np.arange(RIM) / RIM
    outwards = np.column_stack([np.cos(turn), np.sin(turn)])
    level = max(1.5, 2 * float(np.median(np.hypot(gradient[..., 0], gradient[..., 1]))))

    def across(x: float, y: float, r: float) -> Array:
        at = (np.array([x, y]) + r * outwards).astype(np.float32)
        seen = cv2.remap(gradient, at[:, :1], at[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        return np.abs((seen[:, 0] * outwards).sum(axis=1))

    step = 0.04 * r
    best = float(np.minimum(across(x, y, r), 4 * level).mean())
    while step > 0.1:
        moves = itertools.product((-step, 0.0, step), repeat=3)
        found = [
            (float(np.minimum(across(x + a, y + b, r + c), 4 * level).mean()), a, b, c) for a, b, c in moves
        ]
        score, a, b, c = max(found)
        if score > best:
            best, x, y, r = score, x + a, y + b, r + c
        else:
            step /= 2
    return x, y, r, float((across(x, y, r) > level).mean())
