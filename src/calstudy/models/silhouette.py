"""Bead positions to the two pictures that Appendix A measures: black silhouettes on white.

Both views are orthographic and show the reference sphere beside the heap. The pixel grid is fixed in
space: its lines lie at whole multiples of the pixel size, so x = 0, y = 0 and the plate (z = 0) are lines
of the grid, and the same beads give the same picture whatever else is in it.
"""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from calstudy.disk.files import write_atomically
from calstudy.errors import InputError, MeasurementError
from calstudy.parameters import Array

Picture = NDArray[np.uint8]

BLACK, WHITE = 0, 255
MAX_PIXELS = 100_000_000
"""Largest picture that is drawn or read; a bead thrown far away would otherwise ask for all memory."""
UNREADABLE = "not a picture that can be read; give a PNG, JPEG, BMP or TIFF file"

STARTS_AND_ENDS = ((b"\x89PNG", b"IEND"), (b"\xff\xd8", b"\xff\xd9"))
"""First bytes of a PNG and of a JPEG file, and what a complete one contains at its end."""


def top_view(
    centres: ArrayLike,
    radii: ArrayLike,
    *,
    pixels_per_mm: float = 4.0,
    sphere_diameter: float = 0.050,
) -> Picture:
    """Picture of beads and reference sphere seen from above (Figure 9a): x to the right, y upwards.

    ``centres`` (n, 3) and ``radii`` (one number or n) in m; n may be 0. A pixel is black (0) when its centre
    lies in a disc, its edge included, else white (255). Raises InputError for positions, radii, resolution
    or sphere that are no such numbers, MeasurementError when the beads spread too far for a picture.
    """
    positions, r = _beads(centres, radii)
    sphere = _sphere_centre(positions, r, pixels_per_mm, sphere_diameter)
    return _draw(positions[:, :2], r, sphere[:2], pixels_per_mm, sphere_diameter)


def side_view(
    centres: ArrayLike,
    radii: ArrayLike,
    *,
    pixels_per_mm: float = 4.0,
    sphere_diameter: float = 0.050,
) -> Picture:
    """Picture of beads and reference sphere seen along y (Figure 9b): x to the right, first row on top.

    Arguments, pixel rule and errors as for :func:`top_view`. The sphere rests on the plate, z = 0.
    """
    positions, r = _beads(centres, radii)
    sphere = _sphere_centre(positions, r, pixels_per_mm, sphere_diameter)
    return _draw(positions[:, ::2], r, sphere[::2], pixels_per_mm, sphere_diameter)


def read_picture(path: str | Path) -> Picture:
    """Grey picture (rows, columns) from a file that OpenCV reads; what is transparent counts as white.

    Raises MeasurementError where there is no such file, it is not a picture, or it is too large.
    """
    data = picture_data(path)
    try:
        picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        layers = None if picture is None else cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise MeasurementError(f"{path}: too large a picture; make it smaller") from error
    if picture is None:
        raise MeasurementError(f"{path}: {UNREADABLE}")
    if layers is not None and layers.ndim == 3 and layers.shape[2] == 4:
        # What the file says of its orientation is heeded in the one and not in the other.
        if layers.shape[:2] != picture.shape:
            raise MeasurementError(f"{path}: is stored turned; save it upright, or without transparency")
        opacity = layers[:, :, 3]
        opaque = opacity > 0.5 * opacity.max()
        picture = np.where(opaque, picture, np.uint8(255))
    return np.asarray(picture, dtype=np.uint8)


def picture_data(path: str | Path) -> Picture:
    """Content (n,) of a picture's file, whose size its header gives; nothing is decoded.

    Raises MeasurementError where there is no such file, it is not a picture, is cut short, or has more than
    MAX_PIXELS pixels: a file of a few kilobytes can hold a picture of gigabytes.
    """
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError as error:
        raise MeasurementError(f"{path}: no such file") from error
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read ({error.strerror})") from error
    # Truncated pictures are told here, because OpenCV prints warnings of its own or fills up with grey;
    # for the same reason it is not left to open the file.
    if any(content.startswith(start) and end not in content for start, end in STARTS_AND_ENDS):
        raise MeasurementError(f"{path}: {UNREADABLE}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            width, height = Image.open(io.BytesIO(content)).size
    except Image.DecompressionBombError:
        width = height = MAX_PIXELS
    except (OSError, ValueError, SyntaxError) as error:
        raise MeasurementError(f"{path}: {UNREADABLE}") from error
    if width * height > MAX_PIXELS:
        raise MeasurementError(
            f"{path}: the picture has more than {MAX_PIXELS // 1_000_000} million pixels; make it smaller"
        )
    return np.frombuffer(content, dtype=np.uint8)


def write_picture(path: str | Path, picture: Picture) -> None:
    """Write a picture (rows, columns) as PNG; raises MeasurementError where that cannot be done."""
    require_picture(picture, "cannot be written")
    encoded, data = cv2.imencode(".png", picture)
    if not encoded:
        raise MeasurementError(f"{path}: the picture cannot be written as PNG")
    try:
        write_atomically(Path(path), data.tobytes())
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be written ({error.strerror})") from error


def require_picture(picture: object, what: str) -> None:
    """Raise MeasurementError, starting with ``what``, unless this is a 2-D array of uint8."""
    if not (isinstance(picture, np.ndarray) and picture.ndim == 2 and picture.dtype == np.uint8):
        found = (
            f"{picture.dtype} {picture.shape}" if isinstance(picture, np.ndarray) else type(picture).__name__
        )
        raise MeasurementError(f"{what}: not a picture but {found}; give a 2-D array of uint8, 0 = black")


def _beads(centres: ArrayLike, radii: ArrayLike) -> tuple[Array, Array]:
    positions = np.asarray(centres, float)
    if positions.size == 0:
        positions = positions.reshape(0, 3)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise InputError(f"bead centres must have shape (n, 3), not {positions.shape}")
    r = np.asarray(radii, float)
    if r.ndim and r.shape != (len(positions),):
        raise InputError(f"bead radii must be one number or {len(positions)}, not shape {r.shape}")
    if not np.isfinite(positions).all():
        raise InputError("bead centres must be finite numbers")
    if not (np.isfinite(r).all() and (r > 0).all()):
        raise InputError("bead radii must be finite and above 0 m")
    return positions, np.broadcast_to(r, (len(positions),))


def _gap(pixels_per_mm: float, sphere_diameter: float) -> float:
    """White space in m round each object: wide enough to be seen as a gap at any resolution."""
    return max(0.2 * sphere_diameter, 4e-3 / pixels_per_mm)


def _sphere_centre(centres: Array, radii: Array, pixels_per_mm: float, sphere_diameter: float) -> Array:
    """Place the sphere beyond the last bead in x, so that it is free of all beads in both views."""
    for name, value in (("pixels per mm", pixels_per_mm), ("sphere diameter", sphere_diameter)):
        if not (math.isfinite(value) and value > 0):
            raise InputError(f"{name} must be finite and above 0, not {value}")
    radius = 0.5 * sphere_diameter
    if not len(centres):
        return np.array([0.0, 0.0, radius])
    x = (centres[:, 0] + radii).max() + _gap(pixels_per_mm, sphere_diameter) + radius
    y = 0.5 * ((centres[:, 1] - radii).min() + (centres[:, 1] + radii).max())
    # On a corner of the grid the sphere always covers the same pixels, so that its own rounding does not
    # add scatter to the length scale from heap to heap.
    per_m = 1e3 * pixels_per_mm
    return np.array([math.ceil(x * per_m) / per_m, round(y * per_m) / per_m, radius])


def _draw(
    centres: Array, radii: Array, sphere: Array, pixels_per_mm: float, sphere_diameter: float
) -> Picture:
    """Draw discs (n, 2) and the sphere's disc; second coordinate upwards."""
    per_m = 1e3 * pixels_per_mm
    discs = np.vstack([centres, sphere]) * per_m
    r = np.append(radii, 0.5 * sphere_diameter) * per_m
    margin = _gap(pixels_per_mm, sphere_diameter) * per_m
    left, bottom = np.floor((discs - r[:, None]).min(axis=0) - margin)
    right, top = np.ceil((discs + r[:, None]).max(axis=0) + margin)
    width, height = right - left, top - bottom
    if width * height > MAX_PIXELS:
        raise MeasurementError(
            f"beads spread over {width / per_m:.3g} m x {height / per_m:.3g} m, too far for a picture at "
            f"{pixels_per_mm:g} pixels per mm; leave out lost beads or lower the resolution"
        )
    return _discs(discs[:, 0] - left, top - discs[:, 1], r, int(height), int(width))


def _discs(x: Array, y: Array, r: Array, height: int, width: int) -> Picture:
    """Union of discs, sampled at the pixels' centres; x, y (downwards), r in pixels, all inside.

    Each disc covers one run of pixels in each row that it reaches. Counting +1 where a run starts and -1
    behind its end, the running sum along the rows is the number of discs over each pixel: the cost is one
    entry a disc and row, instead of one a disc and pixel.
    """
    first = np.ceil(y - r - 0.5).astype(np.intp)
    rows_of_disc = np.maximum(np.floor(y + r - 0.5).astype(np.intp) - first + 1, 0)
    disc = np.repeat(np.arange(len(r)), rows_of_disc)
    row = np.arange(len(disc)) - np.repeat(np.cumsum(rows_of_disc) - rows_of_disc - first, rows_of_disc)
    half = np.sqrt(np.maximum(r[disc] ** 2 - (row + 0.5 - y[disc]) ** 2, 0.0))
    start = np.ceil(x[disc] - half - 0.5).astype(np.intp)
    stop = np.floor(x[disc] + half - 0.5).astype(np.intp) + 1  # == start where a run misses every centre
    stride = width + 1  # one column more, for runs that end with the row
    change = np.zeros(height * stride, dtype=np.int32)
    one = np.int32(1)  # of the array's own type: NumPy is many times slower otherwise
    np.add.at(change, row * stride + start, one)
    np.add.at(change, row * stride + stop, -one)
    covered = np.cumsum(change, out=change).reshape(height, stride)[:, :width] > 0
    return np.where(covered, np.uint8(BLACK), np.uint8(WHITE))
