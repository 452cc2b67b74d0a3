"""A LIGGGHTS model at one fidelity and variant: its numbers, its files, its identity."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from importlib import resources
from typing import Any

import numpy as np

from calstudy.errors import InputError
from calstudy.geometry import stl, tube
from calstudy.identity import content_hash
from calstudy.measurement import VERSION as MEASUREMENT_VERSION
from calstudy.plan import FixedInputs
from calstudy.rayleigh import rayleigh_time_step

DEFAULT_MODEL = "angle_of_repose"
DEFAULT_VARIANT = "ring"

LARGEST_POISSONS_RATIO = 0.5


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


@dataclass(frozen=True)
class AngleOfReposeModel:
    """Section 2.2 as a LIGGGHTS input script and the numbers it needs (SI units)."""

    name: str
    deck: int
    fidelity: Fidelity
    variant: Variant
    fixed: FixedInputs
    geometry: Mapping[str, float]
    schedule: Mapping[str, float]
    skin_per_diameter: float
    pixels_per_mm: float
    sphere_diameter: float
    scripts: Mapping[str, str]
    """Input scripts by name, the one that is run first."""

    @cached_property
    def files(self) -> dict[str, str]:
        """Files that are the same for every run: the script and the meshes, by name."""
        g, f = self.geometry, self.fidelity
        facets = int(g["facets"])
        ring = tube(g["ring_diameter"] / 2, 0.0, f.ring_height, facets)
        cylinder = tube(g["cylinder_diameter"] / 2, f.ring_height, g["cylinder_top"], facets)
        return {
            **self.scripts,
            "ring.stl": stl("ring", ring),
            "cylinder.stl": stl("cylinder", cylinder),
        }

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that decides the responses but the parameters, the seed and the engine."""
        f, v = asdict(self.fidelity), asdict(self.variant)
        # What a run is expected to cost, and how a variant is described, decide no response.
        del f["expected_seconds"], v["relative_cost"], v["meaning"]
        settings = {
            "fixed": asdict(self.fixed),
            "fidelity": f,
            "variant": v,
            "geometry": dict(self.geometry),
            "schedule": dict(self.schedule),
            "skin_per_diameter": self.skin_per_diameter,
            "pixels_per_mm": self.pixels_per_mm,
            "sphere_diameter": self.sphere_diameter,
        }
        return content_hash(
            {
                "name": self.name,
                "deck": self.deck,
                "files": self.files,
                "measurement": MEASUREMENT_VERSION,
                "settings": settings,
            }
        )

    @property
    def particle_radius(self) -> float:
        """Radius of the simulated beads in m."""
        return self.fidelity.particle_diameter / 2

    @property
    def poured_beads(self) -> int:
        """Beads that are poured."""
        return round(self.variant.poured_share * self.fidelity.poured_beads)

    @property
    def expected_seconds(self) -> float:
        """What one run is expected to take on one core; a guide, not a promise."""
        return self.fidelity.expected_seconds * self.variant.relative_cost

    @property
    def fill_volume(self) -> float:
        """Volume below the fill height inside the cylinder in m3."""
        return math.pi / 4 * self.geometry["cylinder_diameter"] ** 2 * self.geometry["fill_height"]

    def particle_mass(self, density: float) -> float:
        """Mass of one simulated bead in kg."""
        return density * math.pi / 6 * self.fidelity.particle_diameter**3

    def engine_time_step(self, parameters: Mapping[str, float]) -> float:
        """Time-step of the simulation in s: a share of the Rayleigh time-step of what is simulated."""
        critical = rayleigh_time_step(
            parameters["DENS"],
            parameters["YM"] / self.fidelity.softening,
            radius=self.particle_radius,
            poissons_ratio=self.fixed.poissons_ratio,
        )
        return self.fidelity.time_step_share * float(critical)

    def variables(self, parameters: Mapping[str, float], seed: int) -> dict[str, str]:
        """Every variable that parameters.in sets, as text with all its digits.

        Raises InputError for values outside what physics and LIGGGHTS allow.
        """
        check_physics(parameters, self.fixed)
        _check_wall(self.variant)
        f, v = self.fidelity, self.variant
        template, distribution, insertion = insertion_seeds(seed)
        values: dict[str, float | int] = {
            **parameters,
            **{k: v for k, v in asdict(self.fixed).items() if k != "particle_radius"},
            **self.schedule,
            "engine_youngs_modulus": parameters["YM"] / f.softening,
            "wall_youngs_modulus": (
                parameters["YM"] if v.wall_youngs_modulus is None else v.wall_youngs_modulus
            )
            / f.softening,
            "wall_poissons_ratio": self.fixed.poissons_ratio
            if v.wall_poissons_ratio is None
            else v.wall_poissons_ratio,
            "engine_time_step": self.engine_time_step(parameters),
            "particle_diameter": f.particle_diameter,
            "particle_radius": self.particle_radius,
            "particle_mass": self.particle_mass(parameters["DENS"]),
            "ring_height": f.ring_height,
            "poured_beads": self.poured_beads,
            "plate_radius": v.plate_radius,
            "fill_height": self.geometry["fill_height"],
            "skin": self.skin_per_diameter * f.particle_diameter,
            "seed_template": template,
            "seed_distribution": distribution,
            "seed_insertion": insertion,
        }
        # NumPy's numbers would write their type's name along.
        return {
            name: repr(value if isinstance(value, int) else float(value)) for name, value in values.items()
        }


def load_model(
    fixed: FixedInputs, fidelity: str, variant: str = DEFAULT_VARIANT, name: str = DEFAULT_MODEL
) -> AngleOfReposeModel:
    """Read a model's folder and choose a fidelity and a variant; InputError names what exists."""
    folder = resources.files("calstudy.liggghts_models") / name
    data = tomllib.loads((folder / "model.toml").read_text())
    chosen = Variant(name=variant, **_choose(data["variant"], variant, "variant"))
    return AngleOfReposeModel(
        name=data["name"],
        deck=data["deck"],
        fidelity=Fidelity(name=fidelity, **_choose(data["fidelity"], fidelity, "fidelity")),
        variant=chosen,
        fixed=fixed,
        geometry=_numbers(data["geometry"]),
        schedule={**_numbers(data["schedule"]), **chosen.schedule},
        skin_per_diameter=float(data["engine"]["skin_per_diameter"]),
        pixels_per_mm=float(data["measurement"]["pixels_per_mm"]),
        sphere_diameter=float(data["measurement"]["sphere_diameter"]),
        scripts={script: (folder / script).read_text() for script in data["scripts"]},
    )


def _choose(table: Mapping[str, dict[str, Any]], name: str, kind: str) -> dict[str, Any]:
    if name not in table:
        raise InputError(f"{kind} {name!r} is unknown; choose one of {', '.join(table)}")
    return _numbers(table[name])


COUNTS = ("facets", "settle_intervals", "lift_intervals", "poured_beads")


def _numbers(table: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers in their declared type, so that 80 and 80.0 are the same model."""

    def typed(name: str, value: Any) -> Any:
        if isinstance(value, dict):
            return _numbers(value)
        if isinstance(value, str):
            return value
        return int(value) if name in COUNTS else float(value)

    return {name: typed(name, value) for name, value in table.items()}


def check_physics(parameters: Mapping[str, float], fixed: FixedInputs) -> None:
    """Refuse parameter values that no material has; InputError names the value."""
    for name, value in parameters.items():
        if not math.isfinite(value):
            raise InputError(f"{name} is {value}; give a finite number")
        if name in ("DENS", "YM") and value <= 0:
            raise InputError(f"{name} is {value:g}; it must be positive")
        if value < 0:
            raise InputError(f"{name} is {value:g}; a friction coefficient cannot be negative")
    _check_poissons_ratio("poissons_ratio", fixed.poissons_ratio)
    for name in ("restitution_pp", "restitution_pw"):
        if not 0 < (value := getattr(fixed, name)) <= 1:
            raise InputError(f"{name} is {value:g}; it must lie in (0; 1]")
    for name in ("rolling_viscous_damping_pp", "rolling_viscous_damping_pw"):
        if not 0 <= (value := getattr(fixed, name)) < math.inf:
            raise InputError(f"{name} is {value:g}; it must be finite and not negative")
    for name in ("gravity", "particle_radius"):
        if not 0 < (value := getattr(fixed, name)) < math.inf:
            raise InputError(f"{name} is {value:g}; it must be finite and positive")


def _check_wall(variant: Variant) -> None:
    """Refuse elastic constants that no wall has."""
    if variant.wall_youngs_modulus is not None and not 0 < variant.wall_youngs_modulus < math.inf:
        raise InputError(f"wall_youngs_modulus is {variant.wall_youngs_modulus:g}; it must be positive")
    if variant.wall_poissons_ratio is not None:
        _check_poissons_ratio("wall_poissons_ratio", variant.wall_poissons_ratio)


def _check_poissons_ratio(name: str, value: float) -> None:
    if not 0 <= value < LARGEST_POISSONS_RATIO:
        raise InputError(f"{name} is {value:g}; it must lie in [0; 0.5)")


def insertion_seeds(seed: int) -> tuple[int, int, int]:
    """Three different primes above 10000, which is what LIGGGHTS takes as seeds, drawn from ``seed``."""
    candidates = np.random.default_rng(np.random.SeedSequence([seed, 0x5EED]))
    primes: list[int] = []
    while len(primes) < 3:
        number = int(candidates.integers(10_001, 50_000_000))
        if _is_prime(number) and number not in primes:
            primes.append(number)
    return primes[0], primes[1], primes[2]


def _is_prime(number: int) -> bool:
    if number < 2 or number % 2 == 0:
        return number == 2
    return all(number % divisor for divisor in range(3, math.isqrt(number) + 1, 2))
