"""Further angles of repose of a simulated heap, read from its beads: less noisy, or as on a photograph.

Appendix A takes the height of the highest bead, which one bead decides. The mean height of the highest beads
scatters half as much from seed to seed. The flanks of a side view are what is measured on a photograph: by
symmetry each view of a simulated heap is as good as another, so several are taken, and their mean has the
expectation of one.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calstudy.disk.parquet import open_parquet
from calstudy.errors import MeasurementError
from calstudy.models.measurement import HeapMeasurement
from calstudy.models.photograph.flanks import RULE, bead_outline, fit_flanks
from calstudy.parameters import Array
from calstudy.records import Response

HIGHEST = 30
"""Beads whose mean height stands for that of the highest one."""
VIEWS = 6
"""Side views of a simulated heap, turned by equal steps over half a turn."""
STEPS_PER_BEAD = 20
"""Places of an outline across a bead."""


@dataclass(frozen=True, slots=True)
class Rule:
    """How an angle of repose is read from a heap."""

    version: str
    """Name of the definition; it is part of the model's hash where the response is asked for."""
    short: str
    angle: Callable[[Array, Array, HeapMeasurement], float]
    """Angle in degrees of bead centres (n, 3) and radii (n,) in m, and what Appendix A says of them."""


def by_highest(centres: Array, radii: Array, measured: HeapMeasurement) -> float:
    """Eq. A.1 with the mean height of the highest beads in place of the highest one's."""
    tops = np.sort(centres[:, 2] + radii)
    # What Appendix A takes off its height is what stays off.
    height = measured.height - float(tops[-1] - tops[-HIGHEST:].mean())
    return math.degrees(math.atan(max(0.0, height) / measured.radius))


def by_flanks(centres: Array, radii: Array, measured: HeapMeasurement) -> float:
    """Mean of the flanks over side views; MeasurementError where a flank has no line."""
    turns = np.pi * np.arange(VIEWS) / VIEWS
    step = 2 * float(radii.min()) / STEPS_PER_BEAD
    outlines = (bead_outline(centres, radii, turn, step) for turn in turns)
    return float(np.mean([fit_flanks(*outline).mean_deg for outline in outlines]))


RULES: Mapping[str, Rule] = {
    "angle_of_repose_top30_deg": Rule(f"highest-{HIGHEST}/1", "top30", by_highest),
    "angle_of_repose_flank_deg": Rule(f"{RULE}, {VIEWS} views", "flank", by_flanks),
}
"""Responses beside Appendix A's, by name; a calibration that names one as a target asks for it."""


def read_beads(path: Path) -> Array:
    """Bead centres (n, 3) in m of a Parquet file with x, y and z; MeasurementError for another file."""
    try:
        with open_parquet(path) as file:
            table = file.read(["x", "y", "z"])
        return np.column_stack([table[axis].to_numpy() for axis in "xyz"]).astype(float)
    except (KeyError, OSError, TypeError, ValueError) as error:
        raise MeasurementError(
            f"{path}: is not a table of beads with the columns x, y and z in m; name a heap.parquet"
        ) from error


def responses(names: tuple[str, ...]) -> tuple[Response, ...]:
    """Those responses, in degrees."""
    return tuple(Response(name, "deg", short=RULES[name].short) for name in names)


def angles(
    names: tuple[str, ...],
    centres: Array,
    diameter: float,
    measured: HeapMeasurement,
    radii: Array | None = None,
) -> dict[str, float]:
    """Those angles in degrees of a heap; MeasurementError where one cannot be read.

    Bead centres (n, 3) and diameter in m; ``radii`` (n,) where they have several sizes.
    """
    each = np.full(len(centres), 0.5 * diameter) if radii is None else radii
    return {name: RULES[name].angle(centres, each, measured) for name in names}


def noise_of(names: tuple[str, ...], table: str, without: str, model_hash: str) -> str:
    """Text of a noise.csv of a model with those responses, from the table of all rules.

    That table has the hash of the model ``without`` them, in whose place stands ``model_hash``.
    """
    columns = ["model_hash", "label", "n", *(f"{name}{end}" for name in names for end in ("", "_sd"))]
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for line in csv.DictReader(io.StringIO(table)):
        if line["model_hash"] == without:
            writer.writerow(line | {"model_hash": model_hash})
    return text.getvalue()
