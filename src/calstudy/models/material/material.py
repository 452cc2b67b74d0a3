"""A material as a shipped test takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from calstudy.models.material.clump import Clump
from calstudy.models.material.sizes import Sizes
from calstudy.plausible import RANGES, Range

COHESION: Mapping[str, str] = {"CED_PP": "J/m3", "CED_PW": "J/m3"}
"""Parameters of a cohesive material: cohesion energy density between beads, and between bead and wall."""
COHESION_MODELS = ("none", "sjkr", "sjkr2")
"""Of LIGGGHTS-PUBLIC 3.8.0, which has no JKR."""
ROLLING_MODELS = ("cdt", "epsd", "epsd2")
FORCE = "hertz tangential history"


@dataclass(frozen=True, slots=True)
class Material:
    """What differs from the shipped deck; the default is the shipped deck."""

    diameter: float | None = None
    """In m, of beads of one size; None for the fidelity's."""
    sizes: Sizes | None = None
    clump: Clump | None = None
    """Particles that are no spheres; they are all alike."""
    cohesion: str = "none"
    rolling: str = "epsd"
    wall_youngs_modulus: float | None = None
    """In Pa, before softening; None for the beads' own."""
    wall_poissons_ratio: float | None = None
    coarse_graining: float = 1.0
    """Diameter of a simulated bead over that of a real one."""

    @property
    def contact(self) -> str:
        """Contact model in LIGGGHTS's words, for pairs and walls."""
        cohesion = "" if self.cohesion == "none" else f" cohesion {self.cohesion}"
        return f"{FORCE}{cohesion} rolling_friction {self.rolling}"

    @property
    def parameters(self) -> Mapping[str, str]:
        """Parameters, with their units, that the material has beside the six of the paper."""
        return {} if self.cohesion == "none" else COHESION

    @property
    def plausible(self) -> dict[str, Range]:
        """Their plausible ranges."""
        return {name: RANGES[name] for name in self.parameters}

    def simulated(self, diameter: float) -> Sizes | Clump:
        """Sizes, or the shape, of the simulated beads, where the fidelity has beads of ``diameter`` (m)."""
        real = self.clump or self.sizes or Sizes((self.diameter or diameter,), (1.0,))
        # A bead that nobody asked to be another keeps its diameter to the last digit.
        return real if self.coarse_graining == 1 else real.grown(self.coarse_graining)


AS_SHIPPED = Material()
