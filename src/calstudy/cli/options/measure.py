"""Options of ``calstudy measure``."""

from __future__ import annotations

import math
from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path

from calstudy.cli.options.shared import json_option
from calstudy.errors import InputError
from calstudy.written import number_in, shortened


def measure_options(parser: ArgumentParser) -> None:
    """Declare the options of ``measure``."""
    parser.add_argument("top", type=Path, metavar="TOP.png", nargs="?", help="silhouette from above")
    parser.add_argument("side", type=Path, metavar="SIDE.png", nargs="?", help="silhouette from the side")
    parser.add_argument(
        "--photo",
        type=Path,
        nargs="+",
        metavar="PHOTO",
        help="photographs from the side, of one heap or of repeats; the angle needs no scale",
    )
    parser.add_argument(
        "--beads",
        type=Path,
        metavar="FILE.parquet",
        help="positions x, y, z of beads in m, as simulate --out keeps them: the angle by every rule",
    )
    parser.add_argument(
        "--scale",
        type=_metres_per_pixel,
        metavar="S",
        help="scale of the photographs: mm for one pixel, or X1,Y1,X2,Y2,MM: two points and their distance",
    )
    parser.add_argument(
        "--top-photo", type=Path, metavar="PHOTO", help="photograph of the heap from above, for Appendix A"
    )
    parser.add_argument(
        "--top-scale", type=_metres_per_pixel, metavar="S", help="scale of the photograph from above"
    )
    parser.add_argument(
        "--region",
        type=_region,
        metavar="X,Y,WIDTH,HEIGHT",
        help="part of the photographs to look at, in pixels from their upper left corner",
    )
    parser.add_argument(
        "--sphere-diameter-mm",
        type=_millimetres,
        metavar="D",
        help="of the reference sphere; without it 50 for silhouettes, and no sphere in photographs",
    )
    parser.add_argument(
        "--particle-diameter-mm",
        type=_millimetres,
        metavar="D",
        help="Appendix A subtracts it from the height; without it 5 for silhouettes, 0 for photographs",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path(),
        metavar="DIR",
        help="where the photographs go with what was measured drawn over them; default: here",
    )
    json_option(parser)


def _metres_per_pixel(text: str) -> float:
    parts = _numbers(text, "S", (1, 5))
    if len(parts) == 1:
        scale = parts[0]
    else:
        distance = math.hypot(parts[2] - parts[0], parts[3] - parts[1])
        if not distance:
            raise ArgumentTypeError(f"{shortened(text)}: both points are the same; give two that are apart")
        scale = parts[4] / distance
    if scale <= 0:
        raise ArgumentTypeError(f"{shortened(text)} is not positive; give mm for one pixel")
    return 1e-3 * scale


def _region(text: str) -> tuple[int, int, int, int]:
    left, top, width, height = (round(part) for part in _numbers(text, "X,Y,WIDTH,HEIGHT", (4,)))
    if min(left, top) < 0 or min(width, height) < 1:
        raise ArgumentTypeError(f"{shortened(text)}: X and Y must be 0 or more, WIDTH and HEIGHT 1 or more")
    return left, top, width, height


def _numbers(text: str, form: str, counts: tuple[int, ...]) -> list[float]:
    parts = text.split(",")
    if len(parts) not in counts:
        wanted = " or ".join(map(str, counts))
        raise ArgumentTypeError(
            f"{shortened(text)}: {form} is {wanted} numbers with commas, not {len(parts)}"
        )
    try:
        return [number_in(part) for part in parts]
    except InputError as error:
        raise ArgumentTypeError(str(error)) from error


def _millimetres(text: str) -> float:
    try:
        number = number_in(text)
    except InputError as error:
        raise ArgumentTypeError(str(error)) from error
    if number <= 0:
        raise ArgumentTypeError(f"{shortened(text)} is not positive; give a length in mm")
    return number
