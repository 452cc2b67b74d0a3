"""A shipped script with the lines of another material in place of its own."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from calstudy.models.material.clump import Clump
from calstudy.models.material.material import AS_SHIPPED, Material
from calstudy.models.material.scaling import SOFTENED_COHESION
from calstudy.models.material.sizes import Sizes

TEMPLATE_SEEDS = (
    50_000_017, 50_000_021, 50_000_047, 50_000_059, 50_000_063, 50_000_101, 50_000_131, 50_000_141,
    50_000_161, 50_000_201, 50_000_207, 50_000_221, 50_000_231, 50_000_233, 50_000_239, 50_000_243,
)  # fmt: skip
"""Primes above those that runs draw. LIGGGHTS wants another one of each size, and never uses it."""
WEIGH = "variable weighed equal mass(all)\nvariable mass equal ${weighed}"
"""A formula would be worked out again wherever it is used; the number must be that of this moment."""
WEIGHED = {
    "(${filled}-v_beads_inside)*${bead_mass}": "${mass}-mass(all,inside)",
    "(${filled}-${beads_inside})*${bead_mass}": "${mass}-mass(all,inside)",
    "${beads_inside}*${bead_mass}": "mass(all,inside)",
    "variable mass equal ${filled}*${bead_mass}": WEIGH,
    "variable mass equal ${beads}*${bead_mass}": WEIGH,
}
"""Masses counted in beads of one size, and as LIGGGHTS weighs beads of several."""

TRIES = 1_000_000
"""Points by which LIGGGHTS finds a clump's mass and moments of inertia: the mass to about 0.1 %."""
DELETED = re.compile(r"^delete_atoms .* compress no$", re.MULTILINE)
"""What is left of a clump whose spheres were deleted in part goes in the next step."""
COHESION_PROPERTY = """\
fix cohesion all property/global cohesionEnergyDensity peratomtypepair 2 &
    ${engine_CED_PP} ${engine_CED_PW} ${engine_CED_PW} ${engine_CED_PW}"""

Swap = tuple[str, str | Callable[[re.Match[str]], str]]


class NoSuchLineError(Exception):
    """A script that does not state its material as the shipped ones do."""


def rewritten(text: str, material: Material, sizes: Sizes | Clump, cohesion: str = "") -> str:
    """Text of a script, and of what it includes, for a material whose simulated beads have ``sizes``.

    ``cohesion`` are the lines that define ``engine_CED_PP`` and ``engine_CED_PW``, if nothing else does.
    Nothing changes where the material is the deck's own. NoSuchLineError: a line that must change is not
    there exactly once.
    """
    for pattern, new in _swaps(material, sizes, cohesion):
        text, found = re.subn(pattern, new, text, flags=re.MULTILINE)
        if found != 1:
            raise NoSuchLineError(pattern)
    if isinstance(sizes, Clump):
        text = re.sub(DELETED, r"\g<0>\nrun 1", text)
    if len(sizes.diameters) > 1:
        for counted, weighed in WEIGHED.items():
            text = text.replace(counted, weighed)
        text = text.replace("1.02*${radius}", f"1.02*{max(sizes.diameters) / 2!r}")
        text = text.replace("*PI*${radius}*sqrt", f"*PI*{min(sizes.diameters) / 2!r}*sqrt")
    return text


def _swaps(material: Material, sizes: Sizes | Clump, cohesion: str) -> Iterator[Swap]:
    """Patterns of the lines that change, with what stands there instead."""
    if material.contact != AS_SHIPPED.contact:
        yield (
            r'^(variable \w+ string )"hertz tangential history rolling_friction epsd"$',
            (rf'\1"{material.contact}"'),
        )
    if material.cohesion != "none":
        yield (
            r"^(fix \w+ all property/global coefficientRollingViscousDamping .*)$",
            (lambda found: f"{found[1]}\n{cohesion}{COHESION_PROPERTY}"),
        )
    if material.wall_youngs_modulus is not None:
        yield (
            r"^(fix \w+ all property/global youngsModulus peratomtype \S+) \$\{(engine_YM|YM)\}$",
            (lambda found: f"variable wall_YM equal {_softened(found, material)}\n{found[1]} ${{wall_YM}}"),
        )
    if material.wall_poissons_ratio is not None:
        yield (
            r"^(fix \w+ all property/global poissonsRatio peratomtype \S+) \$\{poissons_ratio\}$",
            (rf"\1 {material.wall_poissons_ratio!r}"),
        )
    template = r"^fix bead all particletemplate/sphere (\S+) (.*) radius constant \S+$"
    if isinstance(sizes, Clump):
        spheres = " ".join(f"{x!r} {y!r} {z!r} {d / 2!r}" for x, y, z, d in sizes.spheres)
        yield (
            template,
            rf"fix bead all particletemplate/multisphere \1 \2 nspheres {len(sizes.spheres)} "
            rf"ntry {TRIES} spheres {spheres} type 1",
        )
        yield r"^fix integrate all nve/sphere$", "fix integrate all multisphere allow_group_and_set yes"
        yield r"^(fix \w+ all insert/\S+ .*overlapcheck yes)", r"\1 orientation random"
    elif len(sizes.diameters) > 1:
        yield template, (lambda found: _templates(found[2], sizes))
        yield (
            r"^fix beads all particledistribution/discrete (\S+) 1 bead 1\.0$",
            (lambda found: _distribution(found[1], sizes)),
        )


def cohesion_variables(is_softened: bool) -> str:
    """Lines that define the cohesion parameters and what the engine has of them."""
    softened = f"/${{softening}}^({SOFTENED_COHESION!r})" if is_softened else ""
    lines = []
    for name in ("CED_PP", "CED_PW"):
        lines += [f"variable {name} index 0", f"variable engine_{name} equal ${{{name}}}{softened}"]
    return "\n".join([*lines, ""])


def _softened(found: re.Match[str], material: Material) -> str:
    return f"{material.wall_youngs_modulus!r}" + ("/${softening}" if found[2] == "engine_YM" else "")


def _templates(settings: str, sizes: Sizes) -> str:
    """A particle template for each size."""
    return "\n".join(
        f"fix bead_{k} all particletemplate/sphere {seed} {settings} radius constant {diameter / 2!r}"
        for k, (diameter, seed) in enumerate(zip(sizes.diameters, TEMPLATE_SEEDS, strict=False), start=1)
    )


def _distribution(seed: str, sizes: Sizes) -> str:
    """Their shares by number."""
    shares = " ".join(f"bead_{k} {share!r}" for k, share in enumerate(sizes.shares, start=1))
    return f"fix beads all particledistribution/discrete/numberbased {seed} {len(sizes.shares)} {shares}"
