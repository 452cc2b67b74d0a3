"""What a laboratory has: photographs of one material's heaps from the side, perhaps one from above, a
scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from calstudy.errors import MeasurementError
from calstudy.models.measurement import equal_area_radius, one_thread
from calstudy.models.photograph.photograph import Photographed, combined, measure_photograph
from calstudy.models.photograph.scale import Circle, find_sphere
from calstudy.models.photograph.segmentation import Colours, Cut, cut_out, difference, is_heap_from_above
from calstudy.models.silhouette import picture_data

METHOD_ERROR_DEG = 0.2
"""Error of the angle of one photograph in degrees: root mean square over rendered ones, to the level view of
the same beads (benchmarks/photographs.py). It is part of every standard deviation."""
ABOVE_SIDE = 1000
"""Longer side in pixels at which a heap is cut out of a photograph from above."""


@dataclass(frozen=True, slots=True)
class Reference:
    """How a photograph's scale is known: one of both, or neither."""

    scale: float | None = None
    """m for one pixel."""
    sphere_diameter: float | None = None
    """m; the sphere is looked for."""

    def scale_of(self, photograph: Colours, heap: Cut) -> tuple[float | None, Circle | None]:
        """m for one pixel, and the sphere if it gave it; MeasurementError where no sphere is found."""
        if self.sphere_diameter is None:
            return self.scale, None
        sphere = find_sphere(photograph, _box(heap))
        return self.sphere_diameter / sphere.diameter, sphere


@dataclass(frozen=True, slots=True)
class OneOf:
    """One photograph with what was measured on it."""

    path: Path
    photograph: Colours
    found: Photographed
    scale: float | None
    """m for one pixel."""
    sphere: Circle | None


@dataclass(frozen=True, slots=True)
class Measured:
    """All photographs together; lengths in m, None without a scale."""

    each: tuple[OneOf, ...]
    flank_deg: float
    flank_sd_deg: float
    height_radius_deg: float
    """arctan of height over half the width of the base, mean over the photographs."""
    height: float | None
    radius: float | None
    """Mean height, and half the mean width of the base."""
    appendix_a_deg: float | None
    """Eq. A.1 with the radius from the photograph from above; None without one."""


def measure_photographs(
    sides: Sequence[Path],
    reference: Reference,
    *,
    region: tuple[int, int, int, int] | None = None,
    top: tuple[Path, Reference] | None = None,
    particle_diameter: float = 0.0,
) -> Measured:
    """Measure side views of one material's heaps, and with ``top`` a view from above, too.

    ``region`` is the part of each side view to look at: left, top, width, height in pixels. Appendix A
    subtracts ``particle_diameter``, in m, from the height. MeasurementError, naming the photograph, where
    one cannot be measured.
    """
    with one_thread():
        each = tuple(_one(path, reference, region) for path in sides)
        mean, sd = combined([one.found for one in each], METHOD_ERROR_DEG)
        heights = [one.found.height * one.scale for one in each if one.scale is not None]
        radii = [0.5 * one.found.width * one.scale for one in each if one.scale is not None]
        height = float(np.mean(heights)) if heights else None
        return Measured(
            each=each,
            flank_deg=mean,
            flank_sd_deg=sd,
            height_radius_deg=float(np.mean([_by_height(one.found) for one in each])),
            height=height,
            radius=float(np.mean(radii)) if radii else None,
            appendix_a_deg=None if top is None else _appendix_a(height, particle_diameter, *top),
        )


def target_text(flank_deg: float, sd_deg: float) -> str:
    """The target of a calibration's file for an angle by the flanks and its error."""
    return f"{{ value = {flank_deg:.2f}, sd = {sd_deg:.2f} }}"


def read_photograph(path: Path) -> Colours:
    """Photograph (rows, columns, 3), blue first, upright as its file says; MeasurementError as
    read_picture."""
    try:
        photograph = cv2.imdecode(picture_data(path), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise MeasurementError(f"{path}: too large a picture; make it smaller") from error
    if photograph is None:
        raise MeasurementError(f"{path}: not a picture that can be read; give a JPEG or PNG file")
    return np.asarray(photograph, dtype=np.uint8)


def _one(path: Path, reference: Reference, region: tuple[int, int, int, int] | None) -> OneOf:
    photograph = read_photograph(path)
    if region is not None:
        left, top, width, height = region
        photograph = photograph[top : top + height, left : left + width]
        if not photograph.size:
            raise MeasurementError(f"{path}: the region lies outside the picture")
    try:
        found = measure_photograph(photograph)
        return OneOf(path, photograph, found, *reference.scale_of(photograph, found.view.cut))
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error


def _by_height(found: Photographed) -> float:
    return math.degrees(math.atan(found.height / (0.5 * found.width)))


def _appendix_a(height: float | None, particle_diameter: float, path: Path, reference: Reference) -> float:
    photograph = read_photograph(path)
    try:
        cut = cut_out(photograph, difference(photograph), ABOVE_SIDE, like=is_heap_from_above)
        scale, _ = reference.scale_of(photograph, cut)
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error
    if height is None or scale is None:
        raise MeasurementError(f"{path}: Appendix A needs the scale of the side view and of this picture")
    radius = equal_area_radius(cut.heap) * cut.scale * scale
    return math.degrees(math.atan(max(0.0, height - particle_diameter) / radius))


def _box(cut: Cut) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of a heap in pixels of the photograph."""
    rows, columns = np.flatnonzero(cut.heap.any(axis=1)), np.flatnonzero(cut.heap.any(axis=0))
    (left, top), scale = cut.corner, cut.scale
    return (
        left + scale * columns[0],
        top + scale * rows[0],
        left + scale * (columns[-1] + 1),
        top + scale * (rows[-1] + 1),
    )
