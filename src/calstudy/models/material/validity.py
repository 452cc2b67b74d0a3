"""Where calibrated parameters were seen: sizes, stresses and speeds of a test."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from calstudy.engines.interface import Described
from calstudy.models.angle_of_repose import AngleOfReposeModel
from calstudy.models.folder.model import FolderModel

GRAVITY = 9.81
BEADS = "bead_diameter"
"""What the shipped tests hold fixed as the diameter of what they simulate."""


def validity_of(model: Described, bulk_density: float) -> dict[str, Any]:
    """Particle diameter, largest stress, speeds and what else a test holds fixed, in SI units.

    The diameter is that of the simulated particles; None where only the test's script says it. The stress is
    the weight of the filling, by its ``bulk_density`` in kg/m3; None where only the test's numbers say it.
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
    # The particles of the Rayleigh time-step are the real ones; what was simulated may be larger.
    return {
        "particle_diameter": held.get(BEADS),
        "largest_stress": None,
        "speeds": {},
        "held": dict(held),
    }
