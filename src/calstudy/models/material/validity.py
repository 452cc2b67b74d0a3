"""Where calibrated parameters were seen: sizes, stresses and speeds of a test."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from calstudy.engines.interface import Described
from calstudy.models.angle_of_repose import AngleOfReposeModel
from calstudy.models.folder.model import FolderModel

GRAVITY = 9.81


def validity_of(model: Described, bulk_density: float) -> dict[str, Any]:
    """Particle diameter, largest stress, speeds and what else a test holds fixed, in SI units.

    The stress is the weight of the filling, by its ``bulk_density`` in kg/m3; None where only the test's
    numbers say it.
    """
    if isinstance(model, AngleOfReposeModel):
        speeds = {name: value for name, value in model.schedule.items() if name.endswith("_speed")}
        return {
            "particle_diameter": model.particle_diameter,
            "largest_stress": GRAVITY * bulk_density * model.geometry["fill_height"],
            "speeds": speeds,
            "held": dict(model.geometry),
        }
    held: Mapping[str, float] = model.fixed if isinstance(model, FolderModel) else {}
    diameter = math.nan if model.particles is None else model.particles.diameter
    known = None if math.isnan(diameter) else diameter
    return {"particle_diameter": known, "largest_stress": None, "speeds": {}, "held": dict(held)}
