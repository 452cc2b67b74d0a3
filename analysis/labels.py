"""Names of responses, counts and units in tables and figures."""

from __future__ import annotations

from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.records import RAYLEIGH_TIME_STEP

LABELS = {
    ANGLE_OF_REPOSE: "angle of repose",
    BULK_DENSITY: "bulk density",
    RAYLEIGH_TIME_STEP: "Rayleigh time-step",
    f"distance_{ANGLE_OF_REPOSE}": "|angle of repose - target|",
    f"distance_{BULK_DENSITY}": "|bulk density - target|",
    "runs_optimisation": "DEM runs of the second optimisation",
    "runs_total": "DEM runs in all",
}
PICTURE_UNITS = {
    ANGLE_OF_REPOSE: ("deg", 1.0),
    BULK_DENSITY: ("kg/m³", 1.0),
    RAYLEIGH_TIME_STEP: ("µs", 1e6),
    "DENS": ("kg/m³", 1.0),
    "YM": ("MPa", 1e-6),
}
"""Unit in figures and factor from SI, by quantity; counts are not in it."""


def axis(name: str) -> str:
    """Label of an axis: response, parameter or count, and unit."""
    label = LABELS.get(name, name)
    return f"{label} in {PICTURE_UNITS[name][0]}" if name in PICTURE_UNITS else label
