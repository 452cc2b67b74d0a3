"""Fidelities and variants of a model, as its model.toml gives them, and the limits that physics sets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from calstudy.errors import InputError
from calstudy.models.material.material import Material
from calstudy.plan import FixedInputs
from calstudy.tomlfile import Section
from calstudy.written import choice

LARGEST_POISSONS_RATIO = 0.5
LEAST_RESTITUTION, LEAST_ENGINE_STIFFNESS = 0.05, 5e6
"""What LIGGGHTS refuses is less: coefficients of restitution, and Young's moduli (Pa) in SI units."""


@dataclass(frozen=True, slots=True)
class Fidelity:
    """What is simulated instead of the paper's 5 mm beads of nominal stiffness (lengths in m)."""

    name: str
    particle_diameter: float
    softening: float
    """The engine simulates YM / softening; the cost always sees the nominal YM."""
    time_step_share: float
    """Engine time-step over the Rayleigh time-step of what is really simulated."""
    ring_height: float
    poured_beads: int
    expected_seconds: float


@dataclass(frozen=True, slots=True)
class Variant:
    """One reading of what the paper leaves open (SI units)."""

    name: str
    plate_radius: float
    """Beads whose centre passes it are deleted and counted as lost."""
    meaning: str
    relative_cost: float
    wall_youngs_modulus: float | None = None
    """Before softening; None for the beads' own."""
    wall_poissons_ratio: float | None = None
    poured_share: float = 1.0
    """Beads poured, as a share of the fidelity's number."""
    schedule: Mapping[str, float] = field(default_factory=dict)
    """Numbers that stand in for the model's own."""


@dataclass(frozen=True, slots=True)
class Fixed:
    """What a folder's model holds fixed, at one of its fidelities."""

    fidelity: str
    """Empty where the folder has none."""
    values: Mapping[str, float]
    """Variables of the script that are no parameters, with their numbers."""
    expected_seconds: float


def fixed_in(top: Section, fidelity: str | None = None, changes: Mapping[str, float] | None = None) -> Fixed:
    """Fixed variables of a model.toml at a fidelity; its first one where none is named.

    The numbers of ``[fixed]`` give way to the fidelity's, and those to ``changes``. InputError for a fidelity
    or a variable that is not there.
    """
    section, fidelities = top.section("fixed"), top.section("fidelity")
    values = {name: section.get(name, "number") for name in section}
    if fidelity is not None and fidelity not in fidelities:
        model = top.path.parent.resolve().name
        remedy = choice(fidelity, list(fidelities)) if fidelities.data else "it has none, so leave it out"
        raise InputError(f"fidelity {fidelity} is unknown to the model {model}; {remedy}")
    name = next(iter(fidelities), "") if fidelity is None else fidelity
    of = fidelities.section(name)
    for one in fidelities:
        fidelities.section(one).only(*values, "expected_seconds")
    where = of if "expected_seconds" in of else top
    seconds = where.get("expected_seconds", "number")
    if seconds <= 0:
        raise where.wrong(f"expected_seconds is {seconds:g}; it must be positive", "expected_seconds")
    values |= {key: of.get(key, "number") for key in of if key != "expected_seconds"}
    for changed in changes or {}:
        if changed not in values:
            remedy = choice(changed, list(values))
            raise InputError(f"{changed} is not among what the model holds fixed; {remedy}")
    return Fixed(name, values | dict(changes or {}), seconds)


def check_physics(parameters: Mapping[str, float], fixed: FixedInputs) -> None:
    """Refuse parameter values that no material has; InputError names the value."""
    for name, value in parameters.items():
        if not math.isfinite(value):
            raise InputError(f"{name} is {value}; give a finite number")
        if name in ("DENS", "YM") and value <= 0:
            raise InputError(f"{name} is {value:g}; it must be positive")
        if value < 0:
            what = "a cohesion energy density" if name.startswith("CED") else "a friction coefficient"
            raise InputError(f"{name} is {value:g}; {what} cannot be negative")
    _check_poissons_ratio("poissons_ratio", fixed.poissons_ratio)
    for name in ("restitution_pp", "restitution_pw"):
        if not LEAST_RESTITUTION < (value := getattr(fixed, name)) <= 1:
            raise InputError(f"{name} is {value:g}; for LIGGGHTS it must lie in ({LEAST_RESTITUTION:g}; 1]")
    for name in ("rolling_viscous_damping_pp", "rolling_viscous_damping_pw"):
        if not 0 <= (value := getattr(fixed, name)) < math.inf:
            raise InputError(f"{name} is {value:g}; it must be finite and not negative")
    for name in ("gravity", "particle_radius"):
        if not 0 < (value := getattr(fixed, name)) < math.inf:
            raise InputError(f"{name} is {value:g}; it must be finite and positive")


def check_wall(variant: Variant) -> None:
    """Refuse elastic constants that no wall has."""
    if variant.wall_youngs_modulus is not None and not 0 < variant.wall_youngs_modulus < math.inf:
        raise InputError(f"wall_youngs_modulus is {variant.wall_youngs_modulus:g}; it must be positive")
    if variant.wall_poissons_ratio is not None:
        _check_poissons_ratio("wall_poissons_ratio", variant.wall_poissons_ratio)


def _check_poissons_ratio(name: str, value: float) -> None:
    if not 0 <= value < LARGEST_POISSONS_RATIO:
        raise InputError(f"{name} is {value:g}; it must lie in [0; 0.5)")


def properties(
    values: Mapping[str, float], fixed: FixedInputs, variant: Variant, material: Material
) -> list[str]:
    """Material properties for atom type 1 (particles) and 2 (walls)."""
    wall_modulus = values["YM"] if variant.wall_youngs_modulus is None else variant.wall_youngs_modulus
    wall_ratio = fixed.poissons_ratio if variant.wall_poissons_ratio is None else variant.wall_poissons_ratio

    def pair(particles: float, walls: float) -> str:
        return f"peratomtypepair 2 {particles!r} {walls!r} {walls!r} {walls!r}"

    return [
        f"# types: 1 particles, 2 walls (variant {variant.name}); YM is not softened",
        f"fix youngs_modulus all property/global youngsModulus peratomtype {values['YM']!r} {wall_modulus!r}",
        "fix poissons_ratio all property/global poissonsRatio peratomtype "
        f"{fixed.poissons_ratio!r} {wall_ratio!r}",
        "fix restitution all property/global coefficientRestitution "
        + pair(fixed.restitution_pp, fixed.restitution_pw),
        "fix friction all property/global coefficientFriction " + pair(values["MU_PP"], values["MU_PW"]),
        "fix rolling_friction all property/global coefficientRollingFriction "
        + pair(values["RF_PP"], values["RF_PW"]),
        "fix rolling_damping all property/global coefficientRollingViscousDamping "
        + pair(fixed.rolling_viscous_damping_pp, fixed.rolling_viscous_damping_pw),
        f"# fix ... particletemplate/{'multisphere' if material.clump else 'sphere'} ... "
        f"density constant {values['DENS']!r}",
        *(
            f"fix cohesion all property/global cohesionEnergyDensity {pair(*(values[n] for n in of))}"
            for of in (tuple(material.parameters),)
            if of
        ),
        f"# pair_style gran model {material.contact}",
    ]
