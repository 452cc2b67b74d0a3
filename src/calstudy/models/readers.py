"""How a response of a model folder is read where a run was: file, log, Python, command, silhouette."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np

from calstudy.disk.files import cannot_write
from calstudy.engines import guardian
from calstudy.engines.liggghts import LOG, read_particles
from calstudy.engines.process import SINGLE_THREAD, output_text
from calstudy.engines.program import OUTPUT
from calstudy.errors import RunError
from calstudy.models.measurement import HeapMeasurement, measure_heap
from calstudy.parameters import Array

FUNCTION_SECONDS = 600.0
"""A Python function that has not answered by then is ended."""
PARAMETERS = "calstudy_parameters.json"
"""File in a run's directory with the values of all variables, for readers."""
SHOWN = 60
"""Characters of a line that are shown of it."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


class Reader(Protocol):
    """How a response is read in the directory of a run."""

    way: ClassVar[str]
    """The key of model.toml that asks for it."""
    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def files(self) -> tuple[str, ...]:
        """Outputs that it reads."""

    @property
    def sources(self) -> tuple[str, ...]:
        """Files of the model's folder that it is made of."""

    def read(self, directory: Path) -> float:
        """The response; RunError if it is missing or not a number."""

    def shown(self, directory: Path) -> str:
        """What was read and where, for a person to check; RunError as ``read``."""


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

    @property
    def sources(self) -> tuple[str, ...]:
        """None."""
        return ()

    def read(self, directory: Path) -> float:
        """The number; empty lines and comments (#) do not count as lines."""
        return self._found(directory)[0]

    def shown(self, directory: Path) -> str:
        """The line that the number stands in."""
        return f"{self.file}: {_shortened(self._found(directory)[1])}"

    def _found(self, directory: Path) -> tuple[float, str]:
        lines = [line.split("#")[0] for line in output_text(directory / self.file).splitlines()]
        full = [line.strip() for line in lines if line.strip()]
        try:
            line = full[_from_zero(self.line)]
            return float(re.split(r"[,;\s]+", line)[_from_zero(self.column)]), line
        except (IndexError, ValueError) as error:
            place = f"line {self.line}, column {self.column}"
            raise RunError(f"{self.file}: there is no number at {place}") from error


@dataclass(frozen=True, slots=True)
class NumberInLog:
    """The number behind a marker at the beginning of a line of the program's log.

    A marker that ends in a letter or digit ends there: AOR is not found in AOR2. The last line that has the
    marker and a number counts. A script that moves its log elsewhere is read on the screen.
    """

    way: ClassVar[str] = "log"
    marker: str
    log: str = LOG
    """Name of the log file."""

    @property
    def files(self) -> tuple[str, ...]:
        """The log."""
        return (self.log,)

    @property
    def sources(self) -> tuple[str, ...]:
        """None."""
        return ()

    def read(self, directory: Path) -> float:
        """The number; a line that begins with the marker is meant, not one that echoes a command."""
        return self._found(directory)[0]

    def shown(self, directory: Path) -> str:
        """The line that was matched, with its number."""
        _, place, line = self._found(directory)
        return f"{place}: {_shortened(line)}"

    def _found(self, directory: Path) -> tuple[float, str, str]:
        end = r"(?!\w)" if re.search(r"\w$", self.marker) else ""
        pattern = re.compile(rf"\s*{re.escape(self.marker)}{end}[\s=:]*({_NUMBER.pattern})")
        for name, text in said(directory, self.log):
            lines = enumerate(text.splitlines(), start=1)
            if matches := [(found, n, line) for n, line in lines if (found := pattern.match(line))]:
                found, number, line = matches[-1]
                return float(found[1]), f"{name}, line {number}", line
        raise RunError(f"{self.log}: there is no line that begins with {self.marker!r} and a number")


@dataclass(frozen=True, slots=True)
class PythonFunction:
    """A function in a file of the model's folder: of a run's directory, or of that and the parameters.

    See ``python_reader``.
    """

    way: ClassVar[str] = "python"
    source: str
    function: str
    origin: str
    files: tuple[str, ...]
    """Outputs that it reads, as model.toml says."""

    @property
    def sources(self) -> tuple[str, ...]:
        """The file of the function."""
        return (self.origin,)

    def read(self, directory: Path) -> float:
        """What the function returns; RunError for any error in it."""
        for name in self.files:
            if not (directory / name).exists():
                raise RunError(f"{name} is not there")
        directory = directory.absolute()
        try:
            module = ("-P", "-m", "calstudy.models.python_reader")
            done = _answer([sys.executable, *module, str(directory), self.origin, self.function], directory)
            said = json.loads(done.stdout)
        except subprocess.TimeoutExpired:
            said = {"error": f"no answer after {FUNCTION_SECONDS:.0f} s, so it was ended"}
        except ValueError:
            said = {"error": f"it ended with exit code {done.returncode} and no answer"}
        if "error" in said:
            raise RunError(f"{self.origin}:{self.function}: {said['error']}")
        return float(said["value"])

    def shown(self, directory: Path) -> str:
        """The function, and the outputs that it was said to read."""
        return f"{self.origin}:{self.function} of {', '.join(self.files) or 'the run'}"


@dataclass(frozen=True, slots=True)
class Command:
    """Any executable: what it prints last is the number, or a JSON object that has it by the response's name.

    {directory} and {parameters} in its words are the run's directory and `PARAMETERS` in it.
    """

    way: ClassVar[str] = "command"
    words: tuple[str, ...]
    response: str
    files: tuple[str, ...]
    """Outputs that it reads, as model.toml says."""
    sources: tuple[str, ...]
    """Files of the model's folder among its words."""

    def read(self, directory: Path) -> float:
        """The number; RunError if it is missing, or the command ended with an error."""
        for name in self.files:
            if not (directory / name).exists():
                raise RunError(f"{name} is not there")
        directory = directory.absolute()
        places = {"{directory}": str(directory), "{parameters}": str(directory / PARAMETERS)}
        words = [
            re.sub(r"\{\w+\}", lambda found: places.get(found[0], found[0]), word) for word in self.words
        ]
        if (own := directory / words[0]).is_file():
            own.chmod(own.stat().st_mode | 0o100)  # the folder's files are written without it
            words[0] = str(own)
        try:
            done = _answer(words, directory)
        except subprocess.TimeoutExpired as error:
            raise RunError(f"{self.words[0]}: no answer after {FUNCTION_SECONDS:.0f} s") from error
        except OSError as error:
            raise RunError(f"{self.words[0]} cannot be started: {error.strerror}") from error
        lines = [line for line in (done.stdout, done.stderr) for line in line.splitlines() if line.strip()]
        if done.returncode:
            raise RunError(
                f"{self.words[0]} ended with exit code {done.returncode}: {_shortened((lines or [''])[-1])}"
            )
        return self._number(done.stdout)

    def _number(self, text: str) -> float:
        """The number in what it printed."""
        last = next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")
        try:
            said = json.loads(last)
            return float(said[self.response] if isinstance(said, dict) else said)
        except (ValueError, TypeError, KeyError) as error:
            raise RunError(
                f"{self.words[0]}: its last line is {_shortened(last)!r}, neither a number nor a JSON object "
                f"with {self.response}"
            ) from error

    def shown(self, directory: Path) -> str:
        """The command."""
        return _shortened(" ".join(self.words))


def tell(directory: Path, values: Mapping[str, float | str]) -> None:
    """Write what the script was given where readers find it; SetupError: it cannot be written."""
    try:
        (directory / PARAMETERS).write_text(json.dumps(values))
    except OSError as error:
        raise cannot_write(directory / PARAMETERS, error) from error


def _answer(words: Sequence[str], directory: Path) -> subprocess.CompletedProcess[str]:
    """Run what reads a finished run, in its directory. Raises OSError, subprocess.TimeoutExpired."""
    return subprocess.run(
        words,
        cwd=directory,
        env=os.environ | SINGLE_THREAD | guardian.mark() | {"PYTHONDONTWRITEBYTECODE": "1"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        start_new_session=True,  # a signal to the campaign is not one to what reads a finished run
        timeout=FUNCTION_SECONDS,
        check=False,
    )


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

    @property
    def sources(self) -> tuple[str, ...]:
        """None."""
        return ()

    def measure(self, directory: Path) -> tuple[Array, HeapMeasurement]:
        """Beads (n, 3) in m and their measures; MeasurementError where Appendix A cannot be applied.

        Beads have the dump's own radii. Where it has none, they have the diameter of model.toml.
        """
        positions, radii = read_particles(directory / self.file)
        # Positions are kept in single precision; measuring the same makes a stored heap measure the same.
        heap = positions.astype(np.float32).astype(float)
        if radii is None and math.isnan(self.particle_diameter):
            raise RunError(
                f"{self.file} has no column radius, and model.toml gives no number for it; dump the radius"
            )
        return heap, measure_heap(
            heap,
            self.particle_diameter if radii is None or not len(radii) else 2 * float(radii.mean()),
            radii=radii,
            pixels_per_mm=self.pixels_per_mm,
            sphere_diameter=self.sphere_diameter,
        )

    def read(self, directory: Path) -> float:
        """The angle in deg."""
        return self.measure(directory)[1].angle_of_repose_deg

    def shown(self, directory: Path) -> str:
        """How many beads were drawn, and with which diameter."""
        positions, radii = read_particles(directory / self.file)
        drawn = np.array([self.particle_diameter]) if radii is None else 2 * radii
        sizes = " to ".join(f"{1e3 * size:g}" for size in dict.fromkeys((drawn.min(), drawn.max())))
        return f"{self.file}: {len(positions)} beads drawn with {sizes} mm"


def said(directory: Path, log: str) -> list[tuple[str, str]]:
    """Names and texts of what a program said: its log, then the screen; RunError if there is neither."""
    names = [name for name in (log, OUTPUT) if (directory / name).is_file()]
    return [(name, output_text(directory / name)) for name in names or (log,)]


def _shortened(line: str) -> str:
    line = line.strip()
    return line if len(line) <= SHOWN else f"{line[:SHOWN]} ..."


def _from_zero(place: int) -> int:
    return place - 1 if place > 0 else place
