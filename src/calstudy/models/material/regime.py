"""How far a shipped test is from slow and stiff, where density and stiffness do not act on friction and flow.

Whoever raises DENS to have a longer time-step (density scaling) keeps the results only as long as these
numbers stay small:

* the inertial number I = rate x d sqrt(DENS / p), where a stress p is given: shear cell and compression;
* the weight of the bed over the stress that its height is measured under, in the compression. The shear cell
  has no gravity while it shears;
* the overlap of two beads over their diameter, (p / E)^(2/3), with E of the engine. Where weight alone acts,
  DENS cancels out of everything else: p is the weight of the filling.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass

from calstudy.engines.interface import Described
from calstudy.models.angle_of_repose import AngleOfReposeModel
from calstudy.models.folder.model import FolderModel

LARGEST_INERTIA = 0.02
"""In the shear cell all is as in slow shear at 0.014, and peaks are higher at 0.028 (its notes)."""
LARGEST_OVERLAP = 0.005
"""The shipped tests have 0.0024 to 0.0034; at 0.007 the drum's slopes are 2 to 4 deg lower (its notes)."""
LARGEST_WEIGHT = 2.0
"""Of the bed over the seating stress; the compression as shipped has 0.4."""
SOLID_FRACTION = 0.6
"""Of a filling, for its weight."""


@dataclass(frozen=True, slots=True)
class _Loaded:
    """A test under given stresses: names of what it holds fixed."""

    speed: str
    height: str
    least_stress: str
    largest_stress: str


LOADED = {
    "shear_cell": _Loaded("speed", "fill_height", "shear_stress_2", "preshear_stress"),
    "uniaxial_compression": _Loaded("lid_speed", "fill_height", "seating_stress", "largest_stress"),
}
WEIGHING = {"draw_down": ("fill_height",), "rotating_drum": ("drum_diameter", "fill_fraction")}
"""Tests that weight alone acts in: factors of the height of their filling."""


def _held(model: Described, parameters: Mapping[str, float], *names: str) -> Mapping[str, float] | None:
    """What a shipped test holds fixed; None where a name is missing, as in a model of one's own."""
    if not isinstance(model, FolderModel) or not {"DENS", "YM"} <= {*parameters}:
        return None
    return model.fixed if {*names} <= {*model.fixed} else None


def inertial_number(model: Described, parameters: Mapping[str, float]) -> float | None:
    """Largest inertial number of a run; None where no stress is given."""
    of = LOADED.get(model.name)
    if of is None or (held := _held(model, parameters, *astuple(of), "bead_diameter")) is None:
        return None
    rate = held[of.speed] / held[of.height]
    return rate * held["bead_diameter"] * math.sqrt(parameters["DENS"] / held[of.least_stress])


def weight_share(model: Described, parameters: Mapping[str, float]) -> float | None:
    """Weight of the bed of a compression over its seating stress; None for other tests."""
    held = _held(model, parameters, "gravity", "fill_height", "seating_stress")
    if model.name != "uniaxial_compression" or held is None:
        return None
    weight = SOLID_FRACTION * parameters["DENS"] * held["gravity"] * held["fill_height"]
    return weight / held["seating_stress"]


def overlap(model: Described, parameters: Mapping[str, float]) -> float | None:
    """Largest overlap of two beads in the bed at rest, over their diameter; None for a model of one's own."""
    if isinstance(model, AngleOfReposeModel):
        height, gravity = model.geometry["fill_height"], model.fixed.gravity
        stress, softening = SOLID_FRACTION * parameters["DENS"] * gravity * height, model.fidelity.softening
    elif (of := LOADED.get(model.name)) and (held := _held(model, parameters, of.largest_stress)):
        stress, softening = held[of.largest_stress], held.get("softening", 1.0)
    elif (of_height := WEIGHING.get(model.name)) and (
        held := _held(model, parameters, *of_height, "gravity", "softening")
    ):
        height = math.prod(held[name] for name in of_height)
        stress = SOLID_FRACTION * parameters["DENS"] * held["gravity"] * height
        softening = held["softening"]
    else:
        return None
    return float((stress * softening / parameters["YM"]) ** (2 / 3))


def cautions(model: Described, points: Sequence[Mapping[str, float]]) -> Iterator[str]:
    """What is worth saying where runs of a model, at any of these parameters, are too fast or too soft."""
    for number, most, what, remedy in (
        (
            inertial_number,
            LARGEST_INERTIA,
            "the inertial number",
            "beads are too heavy, or the test too fast, for slow shear: peaks of the stress come out too "
            "high; lower DENS to that of your material, or the speed in [models.fixed]",
        ),
        (
            weight_share,
            LARGEST_WEIGHT,
            "the weight of the bed over the seating stress",
            "the strain begins where weight has pressed the bed already; lower DENS to that of your "
            "material, or raise seating_stress in [models.fixed]",
        ),
        (
            overlap,
            LARGEST_OVERLAP,
            "the overlap of beads over their diameter",
            "beads are too soft for their load: the bed comes out too dense and too mobile; lower DENS to "
            "that of your material, raise YM, or lower softening in [models.fixed]",
        ),
    ):
        found = [value for point in points if (value := number(model, point)) is not None]
        if found and max(found) > most:
            yield f"{model.name}: {what} is up to {max(found):.2g}, above {most:g}: {remedy}."
