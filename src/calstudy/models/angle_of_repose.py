"""The angle-of-repose model at one fidelity and variant: numbers, files, identity, and what a run left."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from calstudy.disk.files import content_hash
from calstudy.engines.interface import Inputs, Reading
from calstudy.engines.liggghts import insertion_seeds, read_particles
from calstudy.errors import InputError, MeasurementError
from calstudy.models.completed import completed_run, weighed
from calstudy.models.fidelity import (
    LEAST_ENGINE_STIFFNESS,
    Fidelity,
    Variant,
    check_physics,
    check_wall,
    properties,
)
from calstudy.models.find import DEFAULT_MODEL, FILE, Declaration, declaration, model_folder, shipped_noise
from calstudy.models.geometry import stl, tube
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.models.material.clump import Clump
from calstudy.models.material.material import AS_SHIPPED, Material
from calstudy.models.material.scaling import SOFTENED_COHESION
from calstudy.models.material.sizes import Sizes
from calstudy.models.measurement import VERSION as MEASUREMENT_VERSION
from calstudy.models.measurement import measure_heap
from calstudy.models.photograph.rules import RULES, angles, noise_of
from calstudy.models.photograph.rules import responses as further
from calstudy.plan import FixedInputs
from calstudy.plan_file import load_plan
from calstudy.plausible import RANGES, Range
from calstudy.rayleigh import Particles, rayleigh_time_step
from calstudy.records import Outcome, Response
from calstudy.written import choice

DEFAULT_VARIANT = "ring"
DEFAULT_FIDELITY = "soft"
RULES_FILE = "rules.csv"
"""Of its folder: means and deviations of further responses, from seed to seed."""
COSTED = {"DENS": 2500.0, "YM": 5.06e8}
"""The material whose runs took the fidelities' expected seconds."""


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
    material: Material = AS_SHIPPED
    """What of it the script has of its own; sizes and walls are in the fidelity and the variant."""
    sizes: Sizes | Clump | None = None
    """Of the simulated beads, or their shape; None for the fidelity's one size."""
    also: tuple[str, ...] = ()
    """Responses of `photograph.rules` that are read of the heap, too."""
    program: ClassVar[str] = "liggghts"
    ranks: ClassVar[int] = 1
    """A run on one core is the efficient way to use a machine."""
    threads: ClassVar[int] = 1

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
            # Without them it is the model that it was before there were any.
            | ({"also": {name: RULES[name].version for name in self.also}} if self.also else {})
        )

    @property
    def particle_radius(self) -> float:
        """Radius of the simulated beads in m."""
        return self.fidelity.particle_diameter / 2

    @property
    def smallest_radius(self) -> float:
        """Radius of the smallest of them in m, which the time-step is made for."""
        return self.particle_radius if self.sizes is None else min(self.sizes.diameters) / 2

    @property
    def particle_diameter(self) -> float:
        """Diameter of the simulated beads in m; of several sizes, that of mean volume."""
        return self.fidelity.particle_diameter

    @property
    def particles(self) -> Particles:
        """The paper's particles at every fidelity, or one's own: the cost takes their time-step."""
        return (
            self.fixed.particles
            if self.sizes is None
            else replace(self.fixed.particles, radius=self.smallest_radius)
        )

    @property
    def declared(self) -> Declaration:
        """What its model.toml says of it at every fidelity and variant."""
        return declaration(self.name)

    @property
    def parameters(self) -> Mapping[str, str]:
        """The six parameters with their units, and those of a cohesive material."""
        return {**self.declared.parameters, **self.material.parameters}

    @property
    def responses(self) -> tuple[Response, ...]:
        """Angle of repose and bulk density, and those that were asked for."""
        return (*self.declared.responses, *further(self.also))

    @property
    def ratio(self) -> tuple[str, str] | None:
        """YM and DENS, which act through YM/DENS alone where nothing coheres."""
        return None if self.material.parameters else self.declared.ratio

    @property
    def plausible(self) -> Mapping[str, Range]:
        """Plausible ranges of all parameters and responses."""
        known = {
            name: RANGES[name] for name in (*self.parameters, *(r.name for r in self.declared.responses))
        }
        return known | dict.fromkeys(self.also, RANGES[ANGLE_OF_REPOSE])

    @property
    def labels(self) -> dict[str, str]:
        """Names of its fidelity and variant."""
        return {"fidelity": self.fidelity.name, "variant": self.variant.name}

    @property
    def title(self) -> str:
        """Its name, fidelity and variant."""
        variant = f"{self.variant.name}: {self.variant.meaning}"
        return f"{self.name}, {self.fidelity.name} fidelity, {variant}"

    @property
    def reference(self) -> Mapping[str, float]:
        """A twin's parameters."""
        return {**self.declared.reference, **dict.fromkeys(self.material.parameters, 0.0)}

    @property
    def noise_table(self) -> str:
        """Noise of all fidelities and variants that were measured, by model hash."""
        if not self.also:
            return shipped_noise(self.name)
        table = (model_folder(self.name) / RULES_FILE).read_text()
        return noise_of(self.also, table, replace(self, also=()).hash, self.hash)

    @property
    def poured_beads(self) -> int:
        """Beads that are poured."""
        return round(self.variant.poured_share * self.fidelity.poured_beads)

    @property
    def expected_seconds(self) -> float:
        """What one run is expected to take on one core; a guide, not a promise."""
        return self.fidelity.expected_seconds * self.variant.relative_cost

    def expected_seconds_at(self, parameters: Mapping[str, float]) -> float:
        """What a run of these parameters is expected to take: the shorter its time-step, the longer."""
        return self.expected_seconds * (self.engine_time_step(COSTED) / self.engine_time_step(parameters))

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
            radius=self.smallest_radius,
            poissons_ratio=self.fixed.poissons_ratio,
        )
        return self.fidelity.time_step_share * float(critical)

    def check(self, parameters: Mapping[str, float]) -> None:
        """Refuse values, of some or all parameters, that physics or LIGGGHTS does not allow; InputError."""
        check_physics(parameters, self.fixed)
        softening = self.fidelity.softening
        if parameters.get("YM", math.inf) / softening < LEAST_ENGINE_STIFFNESS:
            likely = RANGES["YM"].likely(parameters["YM"])
            raise InputError(
                f"YM is {parameters['YM']:g} Pa, which {self.fidelity.name} fidelity divides by "
                f"{softening:g}; LIGGGHTS needs {LEAST_ENGINE_STIFFNESS:g}: raise it or take a "
                f"stiffer fidelity{likely and f'; {likely}'}"
            )

    def variables(self, parameters: Mapping[str, float], seed: int) -> dict[str, str]:
        """Every variable that parameters.in sets, as text with all its digits.

        Raises InputError for values outside what physics and LIGGGHTS allow.
        """
        self.check(parameters)
        check_wall(self.variant)
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
            **{
                f"engine_{name}": parameters[name] / f.softening**SOFTENED_COHESION
                for name in self.material.parameters
            },
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

    def script_lines(self, parameters: Mapping[str, float]) -> list[str]:
        """Material properties, nothing softened."""
        return properties(parameters, self.fixed, self.variant, self.material)

    def inputs(self, parameters: Mapping[str, float], seed: int) -> Inputs:
        """Script, meshes and parameters.in."""
        lines = [f"variable {name} index {text}" for name, text in self.variables(parameters, seed).items()]
        files = {**self.files, "parameters.in": "\n".join([*lines, ""])}
        encoded = {name: text.encode() for name, text in files.items()}
        return Inputs(script=next(iter(self.scripts)), files=encoded)

    def ended(self, directory: Path) -> bool:
        """Never: a run that ended with an error is not believed."""
        return False

    def read(self, directory: Path, parameters: Mapping[str, float]) -> Reading:
        """Count the beads and measure the heap; RunError where the run is not proven complete."""
        bead_mass = self.particle_mass(parameters["DENS"])
        heap, beads, simulated_time = completed_run(
            directory,
            asked=self.poured_beads * (len(self.sizes.spheres) if isinstance(self.sizes, Clump) else 1),
            cylinder_diameter=self.geometry["cylinder_diameter"],
            fill_height=self.geometry["fill_height"],
            rest_energy=0.5 * bead_mass * self.schedule["rest_speed"] ** 2,
        )
        mixed = self.sizes is not None and len(self.sizes.diameters) > 1
        mass = weighed(directory) if mixed else beads.filled * bead_mass
        reading = Reading(
            responses={
                ANGLE_OF_REPOSE: math.nan,
                BULK_DENSITY: mass / self.fill_volume,
                **dict.fromkeys(self.also, math.nan),
            },
            beads=beads,
            positions=heap,
            simulated_time=simulated_time,
        )
        radii = read_particles(directory / "radii.dump")[1] if mixed else None
        try:
            measured = measure_heap(
                heap,
                self.particle_diameter,
                radii=radii,
                pixels_per_mm=self.pixels_per_mm,
                sphere_diameter=self.sphere_diameter,
            )
            if not measured.stands:
                reason = "nothing stands above the first layer of beads"
                return replace(reading, outcome=Outcome.NO_HEAP, reason=reason)
            also = angles(self.also, heap, self.particle_diameter, measured, radii)
        except MeasurementError as error:
            return replace(reading, outcome=Outcome.UNMEASURABLE, reason=str(error))
        return replace(
            reading,
            responses={**reading.responses, ANGLE_OF_REPOSE: measured.angle_of_repose_deg, **also},
            radius=measured.radius,
            height=measured.height,
        )


def load_model(
    fixed: FixedInputs, fidelity: str, variant: str = DEFAULT_VARIANT, name: str = DEFAULT_MODEL
) -> AngleOfReposeModel:
    """Read a shipped model's folder and choose a fidelity and a variant; InputError names what exists."""
    folder = model_folder(name)
    data = tomllib.loads((folder / FILE).read_text())
    if "variant" not in data:
        raise InputError(f"the model {name} has no variants; it is read with models.folder.load_folder")
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


def shipped_model(fidelity: str | None = None, variant: str = DEFAULT_VARIANT) -> AngleOfReposeModel:
    """The angle-of-repose model with the paper's fixed inputs, without a fidelity at ``soft``."""
    return load_model(load_plan().fixed, fidelity or DEFAULT_FIDELITY, variant)


def _choose(table: Mapping[str, dict[str, Any]], name: str, kind: str) -> dict[str, Any]:
    if name not in table:
        raise InputError(f"{kind} {name!r} is unknown; {choice(name, table)}")
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
