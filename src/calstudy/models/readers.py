"""How a response of a model folder is read where a run was: a file, the log, Python, a silhouette."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from calstudy.engines import guardian
from calstudy.engines.liggghts import LOG, read_positions
from calstudy.engines.process import SINGLE_THREAD, output_text
from calstudy.errors import RunError
from calstudy.models.measurement import HeapMeasurement, measure_heap
from calstudy.parameters import Array

FUNCTION_SECONDS = 600.0
"""A Python function that has not answered by then is ended."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


class Reader(Protocol):
    """How a response is read in the directory of a run."""

    way: ClassVar[str]
    """The key of model.toml that asks for it."""
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def files(self) -> tuple[str, ...]:
        """Outputs that it reads."""

    def read(self, directory: Path) -> float:
        """The response; RunError where it is not there, or is no number."""


@dataclass(frozen=True, slots=True)
class NumberInFile:
    """A number in a file, by line and column; negative ones count from the end."""

    way: ClassVar[str] = "file"
    file: str
    line: int = -1
    column: int = -1

    @property
    def files(self) -> tuple[str, ...]:
        """The file."""
        return (self.file,)

    def read(self, directory: Path) -> float:
        """The number; empty lines and comments (#) are no lines."""
        lines = [line.split("#")[0] for line in output_text(directory / self.file).splitlines()]
        rows = [re.split(r"[,;\s]+", line.strip()) for line in lines if line.strip()]
        try:
            return float(rows[_from_zero(self.line)][_from_zero(self.column)])
        except (IndexError, ValueError) as error:
            place = f"line {self.line}, column {self.column}"
            raise RunError(f"{self.file}: there is no number at {place}") from error


@dataclass(frozen=True, slots=True)
class NumberInLog:
    """The number behind a marker in LIGGGHTS's log; the last one, if it was printed more than once."""

    way: ClassVar[str] = "log"
    marker: str

    @property
    def files(self) -> tuple[str, ...]:
        """The log."""
        return (LOG,)

    def read(self, directory: Path) -> float:
        """The number; a line that begins with the marker is meant, not one that echoes a command."""
        lines = [line.strip() for line in output_text(directory / LOG).splitlines()]
        said = [line.removeprefix(self.marker) for line in lines if line.startswith(self.marker)]
        found = _NUMBER.match(said[-1].strip(" \t=:")) if said else None
        if found is None:
            raise RunError(f"{LOG}: there is no line that begins with {self.marker!r} and a number")
        return float(found[0])


@dataclass(frozen=True, slots=True)
class PythonFunction:
    """A function of the run's directory, in a file of the model's folder; see ``response``."""

    way: ClassVar[str] = "python"
    source: str
    function: str
    origin: str
    files: tuple[str, ...]
    """Outputs that it reads, as model.toml says."""

    def read(self, directory: Path) -> float:
        """What the function returns; whatever goes wrong in it is the run's failure."""
        for name in self.files:
            if not (directory / name).exists():
                raise RunError(f"{name} is not there")
        directory = directory.absolute()
        try:
            done = subprocess.run(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    "calstudy.models.python_reader",
                    str(directory),
                    self.origin,
                    self.function,
                ],
                cwd=directory,
                env=os.environ | SINGLE_THREAD | guardian.mark() | {"PYTHONDONTWRITEBYTECODE": "1"},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                errors="replace",
                start_new_session=True,  # a signal to the campaign is not one to what reads a finished run
                timeout=FUNCTION_SECONDS,
            )
            said = json.loads(done.stdout)
        except subprocess.TimeoutExpired:
            said = {"error": f"no answer after {FUNCTION_SECONDS:.0f} s, so it was ended"}
        except ValueError:
            said = {"error": f"it ended with exit code {done.returncode} and no answer"}
        if "error" in said:
            raise RunError(f"{self.origin}:{self.function}: {said['error']}")
        return float(said["value"])


@dataclass(frozen=True, slots=True)
class Silhouette:
    """The angle of repose of the beads in a dump, by Appendix A."""

    way: ClassVar[str] = "silhouette"
    file: str
    particle_diameter: float
    pixels_per_mm: float
    sphere_diameter: float

    @property
    def files(self) -> tuple[str, ...]:
        """The dump."""
        return (self.file,)

    def measure(self, directory: Path) -> tuple[Array, HeapMeasurement]:
        """Beads (n, 3) in m and their measures; MeasurementError where Appendix A cannot be applied."""
        # Positions are kept in single precision; measuring the same makes a stored heap measure the same.
        heap = read_positions(directory / self.file).astype(np.float32).astype(float)
        return heap, measure_heap(
            heap,
            self.particle_diameter,
            pixels_per_mm=self.pixels_per_mm,
            sphere_diameter=self.sphere_diameter,
        )

    def read(self, directory: Path) -> float:
        """The angle in deg."""
        return self.measure(directory)[1].angle_of_repose_deg


def _from_zero(place: int) -> int:
    return place - 1 if place > 0 else place
