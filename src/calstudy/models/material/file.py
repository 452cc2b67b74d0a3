"""[models.material] of a calibration's file."""

from __future__ import annotations

from calstudy.errors import InputError
from calstudy.models.material.material import COHESION_MODELS, ROLLING_MODELS, Material
from calstudy.models.material.script import TEMPLATE_SEEDS
from calstudy.models.material.sizes import Sizes, Weighting, discrete, log_normal
from calstudy.plausible import RANGES
from calstudy.tomlfile import Section
from calstudy.written import choice

NUMBERS = ("diameter", "wall_youngs_modulus", "wall_poissons_ratio", "coarse_graining")
KEYS = (*NUMBERS, "sizes", "cohesion", "rolling")


def material_in(section: Section, insist: bool = False) -> Material:
    """The material of the section; InputError with the line for what no material has.

    Implausible sizes are errors, too, unless ``insist``.
    """
    section.only(*KEYS)
    numbers = {name: section.get(name, "number") for name in NUMBERS if name in section}
    if "diameter" in numbers and "sizes" in section:
        raise section.wrong("sizes and diameter both say how large the beads are; remove one", "diameter")
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
    given = sizes.diameters if sizes else (numbers["diameter"],) if "diameter" in numbers else ()
    for diameter in given:
        if not insist and (objection := RANGES["radius"].objection("half a diameter", diameter / 2)):
            raise section.wrong(objection, "sizes" if sizes else "diameter")
    return Material(sizes=sizes, **numbers, **chosen)


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
