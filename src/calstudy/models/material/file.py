"""[models.material] of a calibration's file."""

from __future__ import annotations

from calstudy.errors import InputError
from calstudy.models.material.clump import Clump, clump
from calstudy.models.material.material import COHESION_MODELS, ROLLING_MODELS, Material
from calstudy.models.material.script import TEMPLATE_SEEDS
from calstudy.models.material.sizes import Sizes, Weighting, discrete, log_normal
from calstudy.plausible import RANGES
from calstudy.tomlfile import Section
from calstudy.written import choice

NUMBERS = ("diameter", "wall_youngs_modulus", "wall_poissons_ratio", "coarse_graining")
SHAPES = ("diameter", "sizes", "clump")
"""Of which a material has one at most."""
KEYS = (*NUMBERS, "sizes", "clump", "cohesion", "rolling")


def material_in(section: Section, insist: bool = False) -> Material:
    """The material of the section; InputError with the line for what no material has.

    Implausible sizes are errors, too, unless ``insist``.
    """
    section.only(*KEYS)
    numbers = {name: section.get(name, "number") for name in NUMBERS if name in section}
    if len(both := [name for name in SHAPES if name in section]) > 1:
        raise section.wrong(f"{both[1]} and {both[0]} both say how large the beads are; remove one", both[0])
    for name, least, limit in (
        ("diameter", 1e-9, float("inf")),
        ("wall_youngs_modulus", 5e6, float("inf")),
        ("wall_poissons_ratio", 0.0, 0.5),
        ("coarse_graining", 1.0, float("inf")),
    ):
        if name in numbers and not least <= numbers[name] < limit:
            below = "" if limit == float("inf") else f" and below {limit:g}"
            raise section.wrong(f"{name} is {numbers[name]:g}; it must be {least:g} or more{below}", name)
    chosen = {}
    for name, known in (("cohesion", COHESION_MODELS), ("rolling", ROLLING_MODELS)):
        if name in section:
            chosen[name] = section.get(name, "text")
            if chosen[name] not in known:
                raise section.wrong(
                    f"{name} {chosen[name]!r} is unknown; {choice(chosen[name], known)}", name
                )
    sizes = _sizes(section.section("sizes")) if "sizes" in section else None
    shape = _clump(section) if "clump" in section else None
    made = sizes or shape
    given = made.diameters if made else (numbers["diameter"],) if "diameter" in numbers else ()
    for diameter in given:
        if not insist and (objection := RANGES["radius"].objection("half a diameter", diameter / 2)):
            raise section.wrong(objection, next(name for name in SHAPES if name in section))
    return Material(sizes=sizes, clump=shape, **numbers, **chosen)


def _clump(section: Section) -> Clump:
    """The spheres of a clump."""
    rows = section.get("clump", "list")
    spheres = [
        [section.typed(one, "number", "clump") for one in section.typed(row, "list", "clump")] for row in rows
    ]
    try:
        return clump(spheres)
    except InputError as error:
        raise section.wrong(str(error), "clump") from error


def _sizes(section: Section) -> Sizes:
    """Sizes as a list with shares, or as a log-normal distribution."""
    kinds = {"diameters": ("diameters", "shares"), "median": ("median", "deviation", "smallest", "largest")}
    found = [keys for first, keys in kinds.items() if first in section]
    if len(found) != 1:
        raise section.wrong(
            "sizes: give diameters and shares, or median, deviation, smallest and largest of a log-normal "
            "distribution"
        )
    section.only(*found[0], "weighting")
    weighting: Weighting = section.get("weighting", "text")
    if weighting not in ("number", "mass"):
        known = choice(weighting, ("number", "mass"))
        raise section.wrong(f"weighting {weighting!r}: shares are of what? {known}", "weighting")
    try:
        if "median" in section:
            median, deviation, smallest, largest = (section.get(name, "number") for name in kinds["median"])
            return log_normal(median, deviation, smallest, largest, weighting)
        diameters, shares = (
            [section.typed(one, "number", name) for one in section.get(name, "list")]
            for name in kinds["diameters"]
        )
        if len(diameters) > len(TEMPLATE_SEEDS):
            raise InputError(f"{len(diameters)} sizes; LIGGGHTS is given {len(TEMPLATE_SEEDS)} at most")
        return discrete(diameters, shares, weighting)
    except InputError as error:
        if str(error).startswith(str(section.path)):
            raise
        raise section.wrong(str(error)) from error
