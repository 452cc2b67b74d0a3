"""The protocols of engines and models, and what they hand to each other."""

from __future__ import annotations

import hashlib
import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from calstudy.disk.files import content_hash
from calstudy.plausible import Range
from calstudy.records import Beads, Outcome, Response, Run

if TYPE_CHECKING:
    from calstudy.engines.program import Profile
    from calstudy.parameters import Array
    from calstudy.rayleigh import Particles


class Engine(Protocol):
    """What a campaign needs of an engine. It need not be a DEM program."""

    @property
    def identity(self) -> str:
        """Name and version; part of each run's identity."""

    @property
    def model_hash(self) -> str:
        """Identity of the model that is run."""

    @property
    def expected_seconds(self) -> float:
        """Expected time of one run on one core, in s."""

    @property
    def particle_diameter(self) -> float:
        """Diameter of the simulated beads in m; NaN without beads."""

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Run once in a new ``directory``, which the engine makes. A run that fails is a Run, too.

        Stopped: ``stop`` was set. SetupError: the program cannot be started or the directory not written.
        """


class Described(Protocol):
    """What a calibration needs of a model, whichever engine runs it."""

    @property
    def name(self) -> str:
        """Name of its folder."""

    @property
    def deck(self) -> int:
        """Version of its input script."""

    @property
    def hash(self) -> str:
        """SHA-256 of everything that decides the responses, except parameters, seed and engine."""

    @property
    def particles(self) -> Particles | None:
        """Particles of the Rayleigh time-step (Eq. 1) in the cost; None without particles."""

    @property
    def parameters(self) -> Mapping[str, str]:
        """Names of the parameters with their units, in the order of every point."""

    @property
    def responses(self) -> tuple[Response, ...]:
        """Responses that it measures."""

    @property
    def ratio(self) -> tuple[str, str] | None:
        """Two parameters that act on the responses through the quotient of the first by the second alone.

        A response that is proportional to a parameter counts as its quotient by that. None without such two.
        """

    @property
    def plausible(self) -> Mapping[str, Range]:
        """Known plausible ranges of parameters and responses, by name."""

    @property
    def labels(self) -> Mapping[str, str]:
        """Its ``fidelity`` and ``variant``, for the columns of tables; empty if it has none."""

    @property
    def noise_table(self) -> str:
        """Text of its noise.csv, from runs that differ only in their seed; empty without one."""

    def expected_seconds_at(self, parameters: Mapping[str, float]) -> float:
        """Expected time of a run with these parameters on one core, in s."""

    def check(self, parameters: Mapping[str, float]) -> None:
        """Check values of some or all parameters. InputError: the model cannot have one of them."""

    def script_lines(self, parameters: Mapping[str, float]) -> list[str]:
        """Lines of a LIGGGHTS script that set these parameters of a material; empty if it has none."""


class Model(Described, Protocol):
    """What `ProgramEngine` needs of a model: its input files, and how its output is read."""

    @property
    def reference(self) -> Mapping[str, float]:
        """Parameters at its reference point; empty if it has none."""

    @property
    def program(self) -> str | Profile:
        """Program that its script is written for, by its name in the table of engines."""

    @property
    def ranks(self) -> int:
        """MPI ranks of a run; 1 is a run without MPI."""

    @property
    def threads(self) -> int:
        """Threads of each rank."""

    @property
    def title(self) -> str:
        """Its name with fidelity and variant, in words."""

    @property
    def particle_diameter(self) -> float:
        """Diameter of the simulated beads in m; NaN where it is not known."""

    @property
    def expected_seconds(self) -> float:
        """Expected time of one run on one core, in s."""

    @property
    def poured_beads(self) -> int:
        """Beads that are poured, for estimates; 0 where the script alone knows."""

    def engine_time_step(self, parameters: Mapping[str, float]) -> float:
        """Time-step of the simulation in s; NaN if only the script knows it."""

    def inputs(self, parameters: Mapping[str, float], seed: int) -> Inputs:
        """Input of one run. InputError: the model cannot have these parameters."""

    def ended(self, directory: Path) -> bool:
        """Whether a run said that it reached its end, whatever its exit code; RunError if it said nothing."""

    def read(self, directory: Path, parameters: Mapping[str, float]) -> Reading:
        """Read what a run that ended well left in its directory. RunError: its results are not there."""


ModelT = TypeVar("ModelT", bound=Model)


@lru_cache(maxsize=256)
def _digest(content: bytes) -> str:
    """SHA-256 of a file that many runs get."""
    return hashlib.sha256(content).hexdigest()


@dataclass(frozen=True, slots=True)
class Linked:
    """A file that a run reads where it lies, because it is too large to be copied."""

    path: Path
    """Absolute."""
    sha256: str
    size: int
    modified: int
    """Time of the last change in ns."""

    @property
    def is_untouched(self) -> bool:
        """Whether it is what it was, by its size and time."""
        there = self.path.stat()
        return (there.st_size, there.st_mtime_ns) == (self.size, self.modified)


@dataclass(frozen=True, slots=True)
class Inputs:
    """Input of one run of a program."""

    script: str
    """Name of the input script."""
    files: Mapping[str, bytes]
    """Contents by path. Folders in a path are made; a path that ends with / is an empty folder."""
    arguments: tuple[str, ...] = ()
    """Further arguments of the command line."""
    of_readers: frozenset[str] = frozenset()
    """Files that only what reads the run uses: another content of them makes the same run."""
    links: Mapping[str, Linked] = field(default_factory=dict)
    """Files that are linked into the run's directory, by path."""

    def making(self, seed: int, engine: str, ranks: int, threads: int = 1) -> str:
        """Identity of a run by all that makes it, whatever is read of it and whatever the script is called.

        ``engine`` is the identity of its program.
        """
        content = {
            "files": {
                "" if name == self.script else name: _digest(given)
                for name, given in self.files.items()
                if name not in self.of_readers
            }
            | {name: linked.sha256 for name, linked in self.links.items()},
            "arguments": ["" if argument == self.script else argument for argument in self.arguments],
            "seed": seed,
            "engine": engine,
            "ranks": ranks,
        }
        if threads > 1:  # so that runs from before there was the choice keep their identity
            content["threads"] = threads
        return content_hash(content)[:16]


@dataclass(frozen=True, slots=True)
class Reading:
    """What a model reads in the directory of a run. The fields are those of ``Run``."""

    responses: Mapping[str, float]
    outcome: Outcome = Outcome.OK
    reason: str = ""
    radius: float = math.nan
    height: float = math.nan
    beads: Beads | None = None
    simulated_time: float = math.nan
    positions: Array | None = field(default=None, compare=False, repr=False)
