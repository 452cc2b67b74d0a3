"""The angle-of-repose model with another material, or in an apparatus of other dimensions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from calstudy.errors import InputError
from calstudy.models.angle_of_repose import AngleOfReposeModel
from calstudy.models.material.clump import Clump
from calstudy.models.material.material import AS_SHIPPED, Material
from calstudy.models.material.scaling import cost_ratio
from calstudy.models.material.script import rewritten

APPARATUS = (
    "cylinder_diameter",
    "fill_height",
    "lift_speed",
    "plate_diameter",
    "softening",
    "time_step_share",
)
"""Dimensions in m and the cylinder's speed in m/s, which may be a laboratory's own, and two numbers of the
fidelity."""
POURED_FRACTION = 0.68
"""Solid fraction at which the poured beads reach one bead above the fill height: more than any packing has,
so that the cylinder is always full."""
LARGEST_BEAD = 0.12
"""Of a bead's diameter over the cylinder's: larger ones would be poured into the wall."""
RADIUS, HEIGHT = ("pour_radius",), ("pour_bottom", "pour_top")
LINES = (
    (
        "dump heap all custom 1 heap.dump id x y z vx vy vz\n",
        "dump heap all custom 1 heap.dump id x y z vx vy vz\n"
        "dump radii all custom 1 radii.dump id x y z radius\n",
    ),
    ("undump heap\n", "undump heap\nundump radii\n"),
    (
        'print "calstudy: beads_filled ${beads}"\n',
        'print "calstudy: beads_filled ${beads}"\n'
        'variable filled_mass equal mass(all)\nprint "calstudy: mass_filled ${filled_mass}"\n',
    ),
)
"""Of beads of several sizes, and of clumps, the heap's radii are needed, and the mass of the filling."""
BOX = "-0.001 0.2 units box"
BETWEEN = "\n# ---- next file ----\n"


def heap_of(
    model: AngleOfReposeModel, material: Material, apparatus: Mapping[str, float]
) -> AngleOfReposeModel:
    """The model with another material and dimensions; the model itself where nothing is different.

    Whatever is not named grows with the cylinder's diameter or with the fill height. InputError for a
    dimension that is not positive, and for beads too large for the cylinder.
    """
    if material == AS_SHIPPED and not apparatus:
        return model
    for name, value in apparatus.items():
        if not value > 0:
            raise InputError(f"{name} is {value:g}; it must be positive")
    geometry, was = dict(model.geometry), model.geometry
    wide = apparatus.get("cylinder_diameter", was["cylinder_diameter"]) / was["cylinder_diameter"]
    high = apparatus.get("fill_height", was["fill_height"]) / was["fill_height"]
    for factor, names in (
        (wide, ("cylinder_diameter", "ring_diameter")),
        (high, ("fill_height", "cylinder_top")),
    ):
        geometry |= {name: factor * was[name] for name in names}
    schedule = {name: value * high if name in HEIGHT else value for name, value in model.schedule.items()}
    schedule |= {name: wide * schedule[name] for name in RADIUS}
    slow = schedule["lift_speed"] / apparatus.get("lift_speed", schedule["lift_speed"])
    schedule["lift_speed"] /= slow
    schedule["closed_lift_speed"] = max(schedule["closed_lift_speed"], schedule["lift_speed"])
    schedule["lift_intervals"] = math.ceil(schedule["lift_intervals"] * high * slow)
    sizes = material.simulated(model.fidelity.particle_diameter)
    diameter = sizes.diameter
    of = replace(
        model.fidelity,
        softening=apparatus.get("softening", model.fidelity.softening),
        time_step_share=apparatus.get("time_step_share", model.fidelity.time_step_share),
    )
    steps = model.fidelity.time_step_share / of.time_step_share
    steps *= math.sqrt(model.fidelity.softening / of.softening)
    longest = sizes.length if isinstance(sizes, Clump) else max(sizes.diameters)
    if longest > LARGEST_BEAD * geometry["cylinder_diameter"]:
        raise InputError(
            f"cylinder_diameter is {geometry['cylinder_diameter']:g}, too narrow for simulated beads of "
            f"{longest:g} m; it must be {1 / LARGEST_BEAD:.2g} beads wide"
        )
    area = math.pi / 4 * geometry["cylinder_diameter"] ** 2
    poured = POURED_FRACTION * area * (geometry["fill_height"] + diameter) / (math.pi / 6 * diameter**3)
    if (wide, high, diameter) == (1.0, 1.0, of.particle_diameter):
        poured = of.poured_beads
    variant = replace(
        model.variant,
        plate_radius=apparatus.get("plate_diameter", 2 * wide * model.variant.plate_radius) / 2,
        wall_youngs_modulus=material.wall_youngs_modulus or model.variant.wall_youngs_modulus,
        wall_poissons_ratio=model.variant.wall_poissons_ratio
        if material.wall_poissons_ratio is None
        else material.wall_poissons_ratio,
    )
    in_script = replace(material, wall_youngs_modulus=None, wall_poissons_ratio=None)
    text = rewritten(BETWEEN.join(model.scripts.values()), in_script, sizes)
    for old, new in LINES if len(sizes.diameters) > 1 else ():
        text = text.replace(old, new)
    if high > 1:
        text = text.replace(BOX, f"-0.001 {0.2 * high!r} units box")
    return replace(
        model,
        fidelity=replace(
            of,
            particle_diameter=diameter,
            ring_height=of.ring_height / of.particle_diameter * diameter,
            poured_beads=math.ceil(poured),
            expected_seconds=of.expected_seconds
            * cost_ratio(sizes, of.particle_diameter)
            * wide**2
            * high
            * slow
            * steps,
        ),
        variant=variant,
        geometry=geometry,
        schedule=schedule,
        scripts=dict(zip(model.scripts, text.split(BETWEEN), strict=True)),
        material=material,
        sizes=sizes,
    )
