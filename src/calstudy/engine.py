"""The engine boundary: a parameter set and a seed go in, one DEM run's record comes out.

``LiggghtsEngine`` joins four parts that know nothing of each other: the model (which numbers), the
program (which command), the process (how it is run) and the dump format (what it leaves). An engine
never raises because a simulation went wrong: that is an outcome.
"""

from __future__ import annotations

import math
import re
import shutil
import signal
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from calstudy.dump import read_dump
from calstudy.errors import CalstudyError, MeasurementError, RunError, SetupError
from calstudy.liggghts import ENVIRONMENT, Liggghts, markers
from calstudy.measurement import measure_heap
from calstudy.model import AngleOfReposeModel
from calstudy.parameters import Array
from calstudy.process import Finished, run_process
from calstudy.rayleigh import rayleigh_time_step
from calstudy.records import ANGLE_OF_REPOSE, BULK_DENSITY, RAYLEIGH_TIME_STEP, Beads, Outcome, Run

LEAST_FREE = 5_000_000
"""Bytes; a run that failed with less left on its disk failed for want of them."""
SPEED_LIMIT = 20.0
"""m/s; a bead that falls the height of the box reaches 2 m/s, so a faster one was thrown by an error."""
LEAST_POURED = 0.99
"""Share of the beads asked for that must be there after pouring; insertion may fall short by one or two."""
LEAST_REMOVED = 0.01
"""Share of the poured beads that must have lain above the fill height, or the cylinder was not full."""
TIME_LIMIT_FACTOR = 20.0
SHORTEST_TIME_LIMIT = 120.0
POSITION_LIMIT = 1.0
"""m; the box is smaller and LIGGGHTS deletes what leaves it, so a bead that far out is no result."""
LOG_TAIL_LINES = 3
LOG_LINE_LENGTH = 200


class Stopped(CalstudyError):
    """The run was ended on request; it leaves no record."""

    exit_code = 130


class Engine(Protocol):
    """What a campaign needs of a DEM program."""

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
        """Diameter of the simulated beads in m."""

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Run once in a fresh ``directory``; raises Stopped when ``stop`` is set, SetupError when
        the program cannot be started or the directory not be written.
        """


class LiggghtsEngine:
    """The angle-of-repose model through LIGGGHTS."""

    def __init__(self, model: AngleOfReposeModel, program: Liggghts) -> None:
        self.model = model
        self.program = program

    @property
    def identity(self) -> str:
        """Program and version."""
        return f"LIGGGHTS {self.program.version}"

    @property
    def model_hash(self) -> str:
        """The model's identity by content."""
        return self.model.hash

    @property
    def expected_seconds(self) -> float:
        """What one run is expected to take on one core."""
        return self.model.expected_seconds

    @property
    def particle_diameter(self) -> float:
        """Diameter of the simulated beads in m."""
        return self.model.fidelity.particle_diameter

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Write the deck, run LIGGGHTS, prove that it did its work, measure the heap."""
        script = write_deck(self.model, parameters, seed, directory)
        finished = run_process(
            self.program.command(script),
            directory=directory,
            output=directory / "output.txt",
            time_limit=max(SHORTEST_TIME_LIMIT, TIME_LIMIT_FACTOR * self.expected_seconds),
            stop=stop,
            environment=ENVIRONMENT,
        )
        if finished.stopped:
            raise Stopped("the DEM run was stopped")
        step = self._rayleigh_time_step(parameters)
        unmeasured = Run(
            outcome=Outcome.TIMED_OUT if finished.timed_out else Outcome.FAILED,
            reason="",
            responses={ANGLE_OF_REPOSE: math.nan, BULK_DENSITY: math.nan, RAYLEIGH_TIME_STEP: step},
            wall_time=finished.wall_time,
            cpu_time=finished.cpu_time,
            engine_time_step=self.model.engine_time_step(parameters),
        )
        try:
            simulated = self._read(finished, parameters, directory)
        except RunError as error:
            # A full disk is no property of the parameters: it must not be stored as their failure.
            # Nor is a directory that somebody removed.
            try:
                free = shutil.disk_usage(directory).free
            except OSError as gone:
                raise SetupError(f"{directory}: gone while the run went on; see --scratch") from gone
            if free < LEAST_FREE:
                raise SetupError(f"{directory}: the disk is full; free space, or see --scratch") from error
            return replace(unmeasured, reason=f"{error}{_log_tail(directory)}")
        heap, beads, simulated_time = simulated
        seen = replace(unmeasured, beads=beads, heap=heap, simulated_time=simulated_time)
        mass = beads.filled * self.model.particle_mass(parameters["DENS"])
        responses = {**unmeasured.responses, BULK_DENSITY: mass / self.model.fill_volume}
        try:
            measured = measure_heap(
                heap,
                self.model.fidelity.particle_diameter,
                pixels_per_mm=self.model.pixels_per_mm,
                sphere_diameter=self.model.sphere_diameter,
            )
        except MeasurementError as error:
            return replace(seen, outcome=Outcome.UNMEASURABLE, reason=str(error), responses=responses)
        if not measured.heap:
            reason = "nothing stands above the first layer of beads"
            return replace(seen, outcome=Outcome.NO_HEAP, reason=reason, responses=responses)
        return replace(
            seen,
            outcome=Outcome.OK,
            responses={**responses, ANGLE_OF_REPOSE: measured.angle_of_repose_deg},
            radius=measured.radius,
            height=measured.height,
        )

    def _rayleigh_time_step(self, parameters: Mapping[str, float]) -> float:
        fixed = self.model.fixed
        return float(
            rayleigh_time_step(
                parameters["DENS"],
                parameters["YM"],
                radius=fixed.particle_radius,
                poissons_ratio=fixed.poissons_ratio,
            )
        )

    def _read(
        self, finished: Finished, parameters: Mapping[str, float], directory: Path
    ) -> tuple[Array, Beads, float]:
        """Heap (n, 3), counts and simulated time of a run that is proven complete, or RunError."""
        if finished.timed_out:
            raise RunError(f"no end after {finished.wall_time:.0f} s, so it was ended")
        if finished.exit_code != 0:
            raise RunError(f"LIGGGHTS ended {_in_words(finished.exit_code)}")
        marks = markers(directory / "log.liggghts")
        if "finished" not in marks:
            raise RunError("LIGGGHTS ended with exit code 0 but did not reach the last line of its script")
        filled = read_dump(directory / "filled.dump")
        heap = read_dump(directory / "heap.dump")
        poured, simulated_time = _count(marks, "beads_poured"), _number(marks, "simulated_time")
        if (len(filled), len(heap)) != (_count(marks, "beads_filled"), _count(marks, "beads_heap")):
            raise RunError("the dumps hold other numbers of beads than the log")
        if len(heap) > len(filled):
            raise RunError(f"the heap has {len(heap)} beads, more than the {len(filled)} that it was made of")
        removed = poured - len(filled)
        if removed < LEAST_REMOVED * poured:
            height = self.model.geometry["fill_height"]
            raise RunError(
                f"only {removed} of {poured} beads lay above {1e3 * height:g} mm: the cylinder was not full"
            )
        # Beads that an error throws out of the box are gone without a word, and few of them lie calmly.
        asked, diameter = self.model.poured_beads, self.model.geometry["cylinder_diameter"]
        if poured < LEAST_POURED * asked:
            raise RunError(f"only {poured} of {asked} beads were left after pouring; the simulation exploded")
        if len(filled) and np.hypot(filled[:, 1], filled[:, 2]).max() > 0.5 * diameter:
            raise RunError("filled.dump: a bead lies outside the cylinder; the simulation exploded")
        for name, frame in (("filled", filled), ("heap", heap)):
            if len(frame) and np.abs(frame[:, 1:4]).max() > POSITION_LIMIT:
                raise RunError(
                    f"{name}.dump: a bead is more than {POSITION_LIMIT:g} m away; the simulation exploded"
                )
            if len(frame) and np.abs(frame[:, 4:7]).max() > SPEED_LIMIT:
                raise RunError(
                    f"{name}.dump: a bead is faster than {SPEED_LIMIT:g} m/s; the simulation exploded"
                )
        beads = Beads(poured=poured, filled=len(filled), heap=len(heap), lost=len(filled) - len(heap))
        # Positions are kept in single precision; measuring the same makes a stored heap measure the same.
        return heap[:, 1:4].astype(np.float32).astype(float), beads, simulated_time


def write_deck(model: AngleOfReposeModel, parameters: Mapping[str, float], seed: int, directory: Path) -> str:
    """Write script, meshes and parameters.in into a fresh directory; returns the script's name."""
    files = dict(model.files)
    lines = [f"variable {name} index {text}" for name, text in model.variables(parameters, seed).items()]
    files["parameters.in"] = "\n".join([*lines, ""])
    try:
        directory.mkdir(parents=True)
        for name, text in files.items():
            (directory / name).write_text(text)
    except OSError as error:
        reason = error.strerror or str(error)
        raise SetupError(f"{directory}: cannot write the run's files: {reason}; see --scratch") from error
    return next(iter(model.scripts))


def _count(marks: Mapping[str, str], name: str) -> int:
    """Whole number that the script printed into its log; RunError when it is not there or none."""
    text = marks.get(name, "")
    if not re.fullmatch(r"[0-9]{1,9}", text):
        raise RunError(f"log.liggghts: {name} is not there or no number")
    return int(text)


def _number(marks: Mapping[str, str], name: str) -> float:
    """Positive number that the script printed into its log; RunError when it is not there or none."""
    try:
        number = float(marks.get(name, ""))
    except ValueError:
        number = math.nan
    if not 0 < number < math.inf:
        raise RunError(f"log.liggghts: {name} is not there or no number")
    return number


def _in_words(exit_code: int) -> str:
    if exit_code >= 0:
        return f"with exit code {exit_code}"
    names = {int(known): known.name for known in signal.Signals}  # some numbers have no name
    hint = " (out of memory?)" if -exit_code == signal.SIGKILL else ""
    return f"by signal {names.get(-exit_code, -exit_code)}{hint}"


def _log_tail(directory: Path) -> str:
    """End of what the program printed, for a failed run's reason."""
    for name in ("log.liggghts", "output.txt"):
        try:
            text = (directory / name).read_text(errors="replace")
        except OSError:
            continue  # the program need not have come as far as writing it
        lines = [line.strip()[:LOG_LINE_LENGTH] for line in text.splitlines() if line.strip()]
        errors = [line for line in lines if line.startswith("ERROR")]
        if shown := errors[-1:] or lines[-LOG_TAIL_LINES:]:
            return f"; {name} ends: {' | '.join(shown)}"
    return ""
