"""A photograph with the points that a user may drag: its outline, from foot to foot, and its scale."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from calstudy.disk.files import content_of
from calstudy.errors import MeasurementError, StoreError
from calstudy.models.photograph.outline import HANDLES, measure_outline, outline_of
from calstudy.models.photograph.photograph import Angles, Photographed, measure_photograph
from calstudy.models.photograph.photographs import read_photograph
from calstudy.parameters import Array
from calstudy.written import json_of

LARGEST = 10_000_000
"""Bytes of a file of marks."""


@dataclass
class Marked:
    """A photograph with its outline and scale, in pixels."""

    width: float
    points: Array
    """Outline, from foot to foot, then both ends of the scale (n + 2, 2)."""
    found: Photographed | None
    why: str = ""
    """Why no heap was found."""
    by_hand: bool = False
    mm: float | None = None
    """Distance of the ends of the scale."""
    answer: Angles | None = field(init=False)
    flanks: Array | None = field(init=False)

    def __post_init__(self) -> None:
        self.measure()

    def measure(self) -> None:
        """Angles as they were found or, once the outline was changed, by hand."""
        try:
            outlined = measure_outline(self.points[:-2])
            self.answer, self.flanks = outlined, outlined.flanks
        except MeasurementError as error:
            self.answer, self.flanks, self.why = None, None, str(error)
        if self.found is not None and not self.by_hand:
            self.answer = self.found

    @property
    def marks(self) -> dict[str, Any]:
        """What a user changed, in JSON's types."""
        return {"points": self.points.tolist(), "by_hand": self.by_hand, "mm": self.mm}

    def with_marks(self, marks: Mapping[str, Any]) -> Marked:
        """The same photograph with what a user changed; as it was found where nothing was."""
        changed = marks["by_hand"] or marks["mm"]
        points = np.array(marks["points"], float) if changed else self.points
        return Marked(self.width, points, self.found, self.why, bool(marks["by_hand"]), marks["mm"])

    def copy(self) -> Marked:
        """One that may be changed."""
        return Marked(self.width, self.points.copy(), self.found, self.why, self.by_hand, self.mm)

    def drag(self, handle: int, to: Array) -> None:
        """Move a point; of the outline, that is a correction by hand."""
        self.points[handle] = to
        self.by_hand = self.by_hand or handle < len(self.points) - 2
        self.measure()

    @property
    def size_mm(self) -> tuple[float, float]:
        """Height and radius of the base; NaN without a scale or an outline."""
        if self.flanks is None:
            return math.nan, math.nan
        outlined = measure_outline(self.points[:-2])
        return outlined.height * self.scale, 0.5 * outlined.width * self.scale

    @property
    def scale(self) -> float:
        """mm for one pixel; NaN without a scale."""
        pixels = float(np.hypot(*(self.points[-1] - self.points[-2])))
        return self.mm / pixels if self.mm and pixels else math.nan


def marked(path: Path) -> Marked:
    """A photograph as it is found, with a triangle to drag where no heap is. MeasurementError: no picture."""
    return _marked(path, path.stat().st_mtime_ns).copy()


@lru_cache(maxsize=100)
def _marked(path: Path, _: int) -> Marked:
    photograph = read_photograph(path)
    rows, columns = photograph.shape[:2]
    scale = np.array([[0.1 * columns, 0.93 * rows], [0.4 * columns, 0.93 * rows]])
    try:
        found = measure_photograph(photograph)
        return Marked(columns, np.vstack([outline_of(found), scale]), found)
    except MeasurementError as error:
        x = np.linspace(0.2, 0.8, HANDLES + 2)
        y = 0.8 - 0.8 * np.minimum(x - 0.2, 0.8 - x)
        points = np.vstack([np.column_stack([x * columns, y * rows]), scale])
        return Marked(columns, points, None, str(error))


def as_svg(one: Marked, chosen: int) -> str:
    """Outline, base, flanks, scale and handles over the photograph, as SVG; one of them is chosen."""
    thick = one.width / 400

    def line(points: Array, colour: str) -> str:
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{thick:.1f}"/>'

    outline, scale = one.points[:-2], one.points[-2:]
    parts = [line(outline, "#3cc83c"), line(outline[[0, -1]], "#148ce6"), line(scale, "#c828c8")]
    parts += [line(flank, "#e62828") for flank in (() if one.flanks is None else one.flanks)]
    for k, (x, y) in enumerate(one.points):
        colour = "#c828c8" if k >= len(outline) else "#148ce6" if k in (0, len(outline) - 1) else "#3cc83c"
        width, fill = (2 * thick, "#fff") if k == chosen else (thick, "none")
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{4 * thick:.1f}" stroke="{colour}" '
            f'stroke-width="{width:.1f}" fill="{fill}" fill-opacity="0.6"/>'
        )
    return "".join(parts)


def read_marks(path: Path) -> dict[str, dict[str, Any]]:
    """`Marked.marks` of each photograph in a file; none where there is no file.

    StoreError: the file is damaged.
    """
    try:
        said = json_of(content_of(path, LARGEST))
        return {name: _checked(**marks) for name, marks in said.items()}
    except FileNotFoundError:
        return {}
    except (OSError, AttributeError, TypeError, ValueError) as error:
        raise StoreError(
            f"{path} is damaged; delete it: outlines are found again, those that were dragged are lost"
        ) from error


def _checked(points: object, by_hand: object, mm: object) -> dict[str, Any]:
    """Marks of one photograph; TypeError, ValueError: they are none."""
    places = np.array(points, float)
    if places.ndim != 2 or places.shape[0] < 4 or places.shape[1] != 2 or not np.isfinite(places).all():
        raise ValueError("no outline and scale")
    if not isinstance(by_hand, bool):
        raise TypeError("neither by hand nor found")
    if mm is not None and not (isinstance(mm, int | float) and math.isfinite(mm) and mm > 0.0):
        raise ValueError("no distance")
    return {"points": places.tolist(), "by_hand": by_hand, "mm": mm}
