"""A model's folder with another material."""

from __future__ import annotations

from dataclasses import replace

from calstudy.errors import InputError
from calstudy.models.folder.model import FolderModel
from calstudy.models.material.material import AS_SHIPPED, Material
from calstudy.models.material.scaling import cost_ratio
from calstudy.models.material.script import NoSuchLineError, cohesion_variables, rewritten

HELD = "unfix integrate\n"
"""Line of a script that stops the motion of its beads."""
DIAMETER, SOFTENING = "bead_diameter", "softening"
"""Variables of the scripts: diameter of the beads in m, nominal YM over that of the engine."""


def refuse_clumps(script: str, name: str, ranks: int) -> None:
    """InputError where LIGGGHTS cannot run clumps: on several ranks, or held and let go in the script."""
    if ranks > 1:
        raise InputError(
            f"clump: LIGGGHTS-PUBLIC moves clumps on one rank alone, not on {ranks}; set ranks to 1"
        )
    if HELD in script:
        raise InputError(
            f"clump: the script of {name} holds single beads and lets them go, which LIGGGHTS cannot do with "
            "the spheres of a clump; leave this test out, or take spheres with a higher RF_PP for it"
        )


def of_material(model: FolderModel, material: Material) -> FolderModel:
    """The model with another material; the model itself where nothing is different.

    InputError: the model's script does not state its material as those of the shipped tests do.
    """
    if material == AS_SHIPPED:
        return model
    script = model.files[model.script].decode()
    if material.clump:
        refuse_clumps(script, model.name, model.ranks)
    try:
        if DIAMETER not in model.fixed:
            raise NoSuchLineError(DIAMETER)
        sizes = material.simulated(model.fixed[DIAMETER])
        lines = cohesion_variables(SOFTENING in model.fixed)
        script = rewritten(script, material, sizes, lines)
    except NoSuchLineError as error:
        raise InputError(
            f"the model {model.name} takes no [models.material]: its script does not state the material as "
            "those of the shipped tests do; state it in the script itself"
        ) from error
    diameter, smallest = sizes.diameter, min(sizes.diameters)
    return replace(
        model,
        files={**model.files, model.script: script.encode()},
        fixed={**model.fixed, DIAMETER: diameter},
        parameters={**model.parameters, **material.parameters},
        reference=model.reference and {**model.reference, **dict.fromkeys(material.parameters, 0.0)},
        plausible={**model.plausible, **material.plausible},
        ratio=None if material.parameters else model.ratio,
        particles=model.particles and replace(model.particles, radius=smallest / 2),
        expected_seconds=model.expected_seconds * cost_ratio(sizes, model.fixed[DIAMETER]),
    )
