"""What an engine is asked for and what it needs of a model."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from calstudy.plausible import Range
from calstudy.records import Beads, Outcome, Response, Run

if TYPE_CHECKING:
    from calstudy.parameters import Array
    from calstudy.rayleigh import Particles


class Engine(Protocol):
    """What a campaign needs of whatever answers it: five things, and none of them says that it is DEM."""

    @property
    def identity(self) -> str:
        """Name and version; part of each run's identity."""

    @property
    def model_hash(self) -> str:
        """Identity of the model that is run."""

    @property
    def expected_seconds(self) -> float:
        """What one run is expected to take on one core."""

    @property
    def particle_diameter(self) -> float:
        """Diameter of the simulated beads in m; NaN where there are none."""

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Run once in a fresh ``directory``; raises Stopped when ``stop`` is set, SetupError when
        the program cannot be started or the directory not be written.
        """


class Described(Protocol):
    """What a calibration needs of a model, whatever answers for it."""

    @property
    def name(self) -> str:
        """Name of its folder."""

    @property
    def deck(self) -> int:
        """Version of its input script."""

    @property
    def hash(self) -> str:
        """SHA-256 of all that decides the responses but the parameters, the seed and the engine."""

    @property
    def particles(self) -> Particles | None:
        """What the cost's Rayleigh time-step (Eq. 1) is computed from; None where there are no particles."""

    @property
    def parameters(self) -> Mapping[str, str]:
        """Names of the parameters with their units, in the order of every point."""

    @property
    def responses(self) -> tuple[Response, ...]:
        """What it measures."""

    @property
    def plausible(self) -> Mapping[str, Range]:
        """Plausible ranges of parameters and responses, where known."""

    @property
    def labels(self) -> Mapping[str, str]:
        """Its ``fidelity`` and ``variant``, as the tables' columns say them; empty where it has none."""

    @property
    def noise_table(self) -> str:
        """Its noise.csv: what runs that differ in their seed alone said; empty where there is none."""

    def expected_seconds_at(self, parameters: Mapping[str, float]) -> float:
        """What a run of these parameters is expected to take on one core."""

    def check(self, parameters: Mapping[str, float]) -> None:
        """Refuse values, of some or all parameters, that it cannot have; InputError."""

    def script_lines(self, parameters: Mapping[str, float]) -> list[str]:
        """Lines of a LIGGGHTS script that give a material these parameters; none where it knows none."""


class Model(Described, Protocol):
    """What ProgramEngine needs of a model: numbers, what goes in, what is read of what comes out."""

    @property
    def particles(self) -> Particles:
        """What the cost's Rayleigh time-step (Eq. 1) is computed from."""

    @property
    def reference(self) -> Mapping[str, float]:
        """Parameters of its reference point; empty where it has none."""

    @property
    def title(self) -> str:
        """Its name, and what else tells it from others, in words."""

    @property
    def particle_diameter(self) -> float:
        """Diameter of the simulated beads in m."""

    @property
    def expected_seconds(self) -> float:
        """What one run is expected to take on one core."""

    def engine_time_step(self, parameters: Mapping[str, float]) -> float:
        """Time-step of the simulation in s; NaN where the script alone knows it."""

    def inputs(self, parameters: Mapping[str, float], seed: int) -> Inputs:
        """What one run is given; InputError for parameters that the model cannot have."""

    def read(self, directory: Path, parameters: Mapping[str, float]) -> Reading:
        """What a run that ended well left in its directory; RunError where it did not do its work."""


ModelT = TypeVar("ModelT", bound=Model)


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a model hands to the program for one run."""

    script: str
    """Name of the file that is run."""
    files: Mapping[str, bytes]
    """Contents by name; folders in a name are made, and a name that ends with / is an empty one."""
    arguments: tuple[str, ...] = ()
    """Of the command line."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What a model reads in the directory of a run that ended well; fields are those of ``Run``."""

    responses: Mapping[str, float]
    outcome: Outcome = Outcome.OK
    reason: str = ""
    radius: float = math.nan
    height: float = math.nan
    beads: Beads | None = None
    simulated_time: float = math.nan
    heap: Array | None = field(default=None, compare=False, repr=False)
