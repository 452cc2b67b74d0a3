"""Angle of repose from two pictures of a heap, by Appendix A step by step.

What the appendix leaves open and what is done here:

* Roundness of an object is the share that it fills of the smallest circle about its centroid: 1 for a
  disc, less for all else. It needs no perimeter, whose length on a pixel grid depends on direction.
* Height counts rows: last - first + 1. The bare difference of the two row numbers is the distance of the
  outer rows' centres and therefore one pixel short on average, at every resolution.
* A heap that rises less than half a particle above its bottom layer has no second layer: no heap, angle 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from calstudy.errors import InputError, MeasurementError
from calstudy.models.silhouette import (
    Picture,
    read_picture,
    require_picture,
    side_view,
    top_view,
    write_picture,
)
from calstudy.parameters import Array

__all__ = [
    "VERSION",
    "HeapMeasurement",
    "equal_area_radius",
    "measure",
    "measure_heap",
    "one_thread",
    "read_picture",
    "write_picture",
]

Mask = NDArray[np.bool_]

VERSION = "appendix-a/1"
"""Name of this definition of the measurement; stored results carry it, so change it with the numbers."""

MID_GREY = 128
ROUND = (0.95, 1.1)
"""Roundness of what counts as round; discs of 20 pixels and more, sampled at pixels, lie within 0.97-1.03."""
ROUND_MARGIN = 0.01
"""The rounder of two objects is taken for the sphere only if it leads by this much."""
MAX_ELONGATION, LEAST_WIDTH = 1.8, 0.7
"""Of a heap from above, length over width; of its side view, the width over the diameter from above."""
SAME_WIDTH = 0.8
"""Of two that are equally round from above, the heap is as wide on the side view, by this ratio."""
MIN_SPHERE_PIXELS = 20
"""Fewest pixels across the sphere; below, roundness and length scale are those of the grid."""
MAX_ZOOM = 4.0
"""Largest ratio of the sphere's sizes in the two pictures; beyond, one of them is another object."""
FEW_PARTICLES = 30
"""A heap's view has more particles than this; so small a heap is not guarded against a missing sphere."""


@dataclass(frozen=True, slots=True)
class HeapMeasurement:
    """What Appendix A says of a heap; ``angle_of_repose_deg`` is arctan(height / radius) (Eq. A.1)."""

    angle_of_repose_deg: float
    radius: float
    """r_f in m: equal-area circle of the top view after two rounds; NaN where there is no bead."""
    height: float
    """h_f in m, one particle diameter subtracted; 0 without a heap."""
    stands: bool
    """False where nothing stands above one layer of beads; the angle and the height are 0 then."""


@dataclass(frozen=True, slots=True)
class _Object:
    """One 8-connected black object: its pixels within its bounding box, whose corner is (row, column)."""

    mask: Mask
    row: int
    column: int
    area: int

    @property
    def across(self) -> float:
        """Diameter of the circle of equal area, in pixels."""
        return 2.0 * math.sqrt(self.area / math.pi)

    @property
    def roundness(self) -> float:
        """Share of the smallest circle about the centroid that the object fills; 0 for one pixel."""
        # The farthest pixel of a row is its first or its last one; empty rows have none.
        by_row, by_column = _squared_distances(self.mask)
        used = self.mask.any(axis=1)
        first = self.mask.argmax(axis=1)
        last = self.mask.shape[1] - 1 - self.mask[:, ::-1].argmax(axis=1)
        farthest = (by_row + np.maximum(by_column[first], by_column[last]))[used].max()
        return float(self.area / (math.pi * farthest)) if farthest else 0.0

    @property
    def is_round(self) -> bool:
        return self.across >= MIN_SPHERE_PIXELS and ROUND[0] <= self.roundness <= ROUND[1]


@dataclass(frozen=True, slots=True)
class _View:
    """The two objects of a picture."""

    sphere: _Object
    outline: _Object


def measure(
    top: Picture | str | Path,
    side: Picture | str | Path,
    *,
    sphere_diameter: float = 0.050,
    particle_diameter: float = 0.005,
) -> HeapMeasurement:
    """Angle of repose, radius and height of the heap on a top and a side view (Appendix A).

    The views are 2-D uint8 arrays, black on white, first row on top, or files of such pictures; each has
    its own scale, given by its reference sphere. Diameters in m. Raises MeasurementError, naming the
    picture and the remedy, for pictures on which sphere and heap cannot be told, InputError for diameters
    that are none.
    """
    _require_diameters(sphere_diameter, particle_diameter)
    with one_thread():
        views = _tell_apart_by_both(
            _load(top, "top"), _load(side, "side"), sphere_diameter / particle_diameter
        )
        _refuse_a_particle_as_sphere(*views, sphere_diameter / particle_diameter)
        _refuse_views_of_two_things(*views, particle_diameter / sphere_diameter)
        return _measurement(*views, sphere_diameter, particle_diameter)


def measure_heap(
    centres: ArrayLike,
    bead_diameter: float,
    *,
    radii: ArrayLike | None = None,
    pixels_per_mm: float = 4.0,
    sphere_diameter: float = 0.050,
) -> HeapMeasurement:
    """Draw both views of a simulated heap and measure them; ``centres`` (n, 3) and diameters in m.

    Beads of several sizes have ``radii`` (n,) in m; ``bead_diameter`` is then what Appendix A subtracts.

    No heap is an outcome: where nothing stands above one layer, ``heap`` is False and the angle 0; without
    any bead the radius is NaN. Raises InputError for arguments that cannot be drawn, MeasurementError for
    beads spread too far or a resolution too low for the sphere.
    """
    check_drawing(bead_diameter, pixels_per_mm, sphere_diameter)
    drawn = 0.5 * bead_diameter if radii is None else radii
    pictures = (
        top_view(centres, drawn, pixels_per_mm=pixels_per_mm, sphere_diameter=sphere_diameter),
        side_view(centres, drawn, pixels_per_mm=pixels_per_mm, sphere_diameter=sphere_diameter),
    )
    if not np.size(centres):
        return HeapMeasurement(0.0, math.nan, 0.0, stands=False)
    with one_thread():
        views = _tell_apart(*pictures, sphere_diameter / bead_diameter)
    return _measurement(*views, sphere_diameter, bead_diameter)


def check_drawing(bead_diameter: float, pixels_per_mm: float, sphere_diameter: float) -> None:
    """InputError where a heap cannot be drawn so; diameters in m."""
    _require_diameters(sphere_diameter, bead_diameter)
    for name, diameter, least in (("bead", bead_diameter, 2), ("sphere", sphere_diameter, MIN_SPHERE_PIXELS)):
        if not 1e3 * diameter * pixels_per_mm >= least:
            raise InputError(
                f"{pixels_per_mm} pixels per mm are too few: the {name} must be {least} pixels across or "
                f"more; give {least / (1e3 * diameter):.3g}"
            )


def _require_diameters(sphere_diameter: float, particle_diameter: float) -> None:
    for name, value in (("sphere", sphere_diameter), ("particle", particle_diameter)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} diameter must be finite and above 0 m, not {value}")
    if particle_diameter >= sphere_diameter:
        raise InputError(
            f"reference sphere ({sphere_diameter} m) must be larger than a particle ({particle_diameter} m)"
        )


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV to the caller's core, since runs are measured side by side; then as it was before."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _load(picture: Picture | str | Path, name: str) -> Picture:
    """Step 1 of both parts."""
    if not isinstance(picture, str | Path):
        return picture
    try:
        return read_picture(picture)
    except MeasurementError as error:
        raise MeasurementError(f"{name} picture {error}") from error


def _tell_apart(top: Picture, side: Picture, spheres_per_particle: float) -> tuple[_View, _View]:
    return _view(top, "top", spheres_per_particle), _view(side, "side", spheres_per_particle)


def _tell_apart_by_both(top: Picture, side: Picture, spheres_per_particle: float) -> tuple[_View, _View]:
    """As ``_tell_apart``; of two objects equally round from above, the width on the side view decides."""
    beside = _view(side, "side", spheres_per_particle)
    try:
        return _view(top, "top", spheres_per_particle), beside
    except _EquallyRoundError:
        views = [_view(top, "top", spheres_per_particle, sphere) for sphere in (0, 1)]
        fitting = [v for v in views if SAME_WIDTH < _width_over_diameter(v, beside) < 1.0 / SAME_WIDTH]
        if len(fitting) != 1:
            raise
        return fitting[0], beside


def _width_over_diameter(top: _View, side: _View) -> float:
    """Width of the heap on the side view over its diameter from above."""
    width = side.outline.mask.shape[1] / side.sphere.across
    return width / (2 * equal_area_radius(top.outline.mask) / top.sphere.across)


class _EquallyRoundError(MeasurementError):
    """Which object is the sphere cannot be told from this picture alone."""


def _view(picture: Picture, name: str, spheres_per_particle: float, which: int | None = None) -> _View:
    """Step 2 of both parts: find the sphere and the heap, leave out all other objects.

    ``which`` of the objects by size is the sphere; None tells it by its roundness.
    """
    require_picture(picture, f"{name} picture")
    black = picture < MID_GREY
    if black.all() or not black.any():
        shade = "black" if black.any() else "white"
        raise MeasurementError(f"{name} picture is blank (all {shade}); draw heap and sphere black on white")
    border = np.concatenate([black[0], black[-1], black[1:-1, 0], black[1:-1, -1]])
    if border.mean() > 0.5:
        raise MeasurementError(f"{name} picture has a black background; invert it to black on white")
    objects = _objects(black)
    if len(objects) < 2:
        raise MeasurementError(
            f"{name} picture shows one object instead of two; "
            "draw heap and reference sphere, neither touching the other"
        )
    sphere = _sphere(objects, name, spheres_per_particle) if which is None else objects[which]
    heap = next(thing for thing in objects if thing is not sphere)
    for what, thing in (("sphere", sphere), ("heap", heap)):
        far_corner = np.add((thing.row, thing.column), thing.mask.shape)
        if min(thing.row, thing.column) == 0 or (far_corner == black.shape).any():
            raise MeasurementError(f"{name} picture: the {what} is cut by the border; leave a white margin")
    return _View(sphere, heap)


def _objects(black: Mask) -> list[_Object]:
    """8-connected black objects, largest first; of equal ones the higher one first, then the left one."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(black.view(np.uint8), connectivity=8)
    left, top, width, height, area = stats[1:].T  # label 0 is the white background
    return [
        _Object(
            mask=labels[top[k] : top[k] + height[k], left[k] : left[k] + width[k]] == k + 1,
            row=int(top[k]),
            column=int(left[k]),
            area=int(area[k]),
        )
        for k in np.lexsort((left, top, -area))
    ]


def _sphere(objects: list[_Object], name: str, spheres_per_particle: float) -> _Object:
    """Tell the sphere by its roundness: a heap's view may be smaller, larger or as large.

    Among the two largest objects, that is. Only where neither is round (a heap in two large pieces) the
    next largest round object is taken.
    """
    first, second = objects[:2]
    if first.is_round and second.is_round:
        # A loose particle is as round as the sphere and is what remains to measure when everything has
        # rolled away; it is known by being as much smaller than the sphere as particles are.
        if second.area <= 1.5 * first.area / spheres_per_particle**2:
            return first
        lead = first.roundness - second.roundness
        if abs(lead) < ROUND_MARGIN:
            raise _EquallyRoundError(
                f"{name} picture: the two largest objects are equally round, so the sphere cannot be told "
                "from the heap; draw one reference sphere that does not touch the heap"
            )
        return first if lead > 0 else second
    for thing in objects:
        if thing.is_round:
            return thing
    raise MeasurementError(
        f"{name} picture: no object is round, so the sphere is missing, touches the heap, is distorted or "
        f"less than {MIN_SPHERE_PIXELS} pixels across; draw it with a white gap to the heap"
    )


def _refuse_a_particle_as_sphere(top: _View, side: _View, spheres_per_particle: float) -> None:
    """Refuse where a loose particle stands in for a sphere that is missing or is one with the heap.

    It is round too, and nothing in Appendix A would notice: lengths would come out wrong by the ratio of
    the diameters.
    """
    for name, view in (("top", top), ("side", side)):
        # A heap that has swallowed the sphere is as large as the sphere and its own particles.
        if view.outline.area > view.sphere.area * (spheres_per_particle**2 + FEW_PARTICLES):
            raise MeasurementError(
                f"{name} picture: beside the heap the sphere is as small as a loose particle; "
                "draw a sphere that does not touch the heap, a larger one for a very large heap"
            )
    zoom = top.sphere.across / side.sphere.across
    if not 1.0 / MAX_ZOOM < zoom < MAX_ZOOM:
        name = "top" if zoom < 1 else "side"
        raise MeasurementError(
            f"{name} picture: the sphere is {max(zoom, 1 / zoom):.1f} times smaller than in the other one; "
            "draw both at the same scale, with a sphere that does not touch the heap"
        )


def _refuse_views_of_two_things(top: _View, side: _View, particles_per_sphere: float) -> None:
    """Refuse photographs that cannot be of one heap: swapped, turned, or with another thing as the heap."""
    for name, view in (("top", top), ("side", side)):
        if view.outline.area < 0.5 * view.sphere.area * particles_per_sphere**2:
            raise MeasurementError(
                f"{name} picture: beside the largest round object is nothing as large as a particle; "
                "draw the reference sphere in both pictures"
            )
    rows, columns = top.outline.mask.shape
    if max(rows, columns) > MAX_ELONGATION * min(rows, columns):
        raise MeasurementError(
            f"top picture: the heap is {columns} pixels wide and {rows} deep, which no heap is from above; "
            "give the top view first and the side view second, with heap and sphere alone in them"
        )
    share = _width_over_diameter(top, side)
    if share < LEAST_WIDTH:
        raise MeasurementError(
            f"side picture: the heap is {share:.2f} times as wide as it is across from above; give both "
            "views of one heap, upright"
        )


def _measurement(
    top: _View, side: _View, sphere_diameter: float, particle_diameter: float
) -> HeapMeasurement:
    """Steps 3 to 7 of the first part, 3 to 6 of the second, Eq. A.1; the sphere's shadow is a circle."""
    radius = equal_area_radius(top.outline.mask) * sphere_diameter / top.sphere.across
    rows = side.outline.mask.shape[0]
    height = rows * sphere_diameter / side.sphere.across - particle_diameter
    if height < 0.5 * particle_diameter:
        return HeapMeasurement(0.0, radius, 0.0, stands=False)
    return HeapMeasurement(math.degrees(math.atan(height / radius)), radius, height, stands=True)


def equal_area_radius(heap: Mask) -> float:
    """Radius r_t in pixels: steps 4 to 6 of the first part.

    The second round's step 4 gives r_t; its step 5 would only remove pixels that nothing looks at again.
    """
    by_row, by_column = _squared_distances(heap)
    within = by_row[:, None] + by_column <= np.count_nonzero(heap) / math.pi
    return math.sqrt(np.count_nonzero(within & heap) / math.pi)


def _squared_distances(mask: Mask) -> tuple[Array, Array]:
    """Squared distances in pixels of each row and of each column from the centroid."""
    squared = []
    for axis in (1, 0):
        count = np.count_nonzero(mask, axis=axis)
        place = np.arange(len(count))
        squared.append((place - place @ count / count.sum()) ** 2)
    return squared[0], squared[1]
