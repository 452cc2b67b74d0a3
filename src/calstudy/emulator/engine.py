"""The emulator as an engine: it answers like a DEM program, from runs that were made before."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calstudy.emulator.emulator import SHIPPED, Emulator, read_emulator, shipped_emulator
from calstudy.emulator.similarity import SOLID_FRACTION
from calstudy.engines.interface import Model
from calstudy.errors import InputError, Stopped
from calstudy.files import content_hash
from calstudy.models.angle_of_repose import AngleOfReposeModel, shipped_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.models.targets import describe
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Run, Target

DEFAULT_FIDELITY = "full"
"""Fidelity of the shipped emulator that is meant when none is named."""
DECIMALS = {ANGLE_OF_REPOSE: 6, SOLID_FRACTION: 8}
"""Of an angle in deg and a solid fraction: a hundred-thousandth of their noise, far more than what the last
digits of linear algebra change."""


class EmulatorEngine:
    """The angle-of-repose model through an emulator of it.

    ``draw`` None answers with the emulator's mean, a number with that draw from its posterior. Noise comes
    on top, from the seed and *all* parameter values: in LIGGGHTS, too, a change of a parameter by a
    thousandth makes of the same seed another packing.

    ``rounded`` answers are rounded to DECIMALS, so that an emulator, too, gives equal digits for equal
    parameters and seed wherever it is run.
    """

    def __init__(
        self, model: AngleOfReposeModel, emulator: Emulator, draw: int | None = None, rounded: bool = False
    ) -> None:
        origin = emulator.origin
        if (origin.fidelity, origin.variant) != (model.fidelity.name, model.variant.name):
            raise InputError(
                f"the emulator {emulator.version} is of {origin.fidelity} fidelity, {origin.variant}; "
                f"asked for {model.fidelity.name}, {model.variant.name}"
            )
        if origin.model_hash != model.hash:
            raise InputError(
                f"the emulator {emulator.version} was made from another version of {model.name}; run its "
                "design again with this one: calstudy emulator sample"
            )
        self.model, self.emulator, self.draw, self.rounded = model, emulator, draw, rounded
        self._answers = emulator.means() if draw is None else emulator.draw(draw)

    @property
    def identity(self) -> str:
        """The emulator's version, and the draw from its posterior."""
        draw = "" if self.draw is None else f", draw {self.draw}"
        return f"emulator {self.emulator.version}{draw}"

    @property
    def model_hash(self) -> str:
        """Identity of the model that is emulated."""
        return self.model.hash

    @property
    def expected_seconds(self) -> float:
        """What one answer is expected to take."""
        return 0.001

    @property
    def particle_diameter(self) -> float:
        """Diameter of the beads that are emulated, in m."""
        return self.model.fidelity.particle_diameter

    def twin(self, truth: Mapping[str, float]) -> Target:
        """The noise-free responses at known parameters as a target; InputError for ones outside the box."""
        point = self.emulator.point(truth)
        values = {
            name: self._answer(name, float(of.noise_free(point)[0])) for name, of in self._answers.items()
        }
        density = truth["DENS"] * values.pop(SOLID_FRACTION)
        wanted = {ANGLE_OF_REPOSE: values[ANGLE_OF_REPOSE], BULK_DENSITY: density}
        origin = f"twin: noise-free responses of {self.identity} at known parameters, {describe(wanted)}"
        return Target(wanted, "twin", origin, dict(truth))

    def _answer(self, name: str, value: float) -> float:
        return round(value, DECIMALS[name]) if self.rounded else value

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Answer; nothing is written to ``directory``. InputError for parameters outside the box."""
        if stop.is_set():
            raise Stopped("interrupted")
        started, used = time.perf_counter(), time.thread_time()
        point = self.emulator.point(parameters)
        content = {"parameters": {k: float(v) for k, v in parameters.items()}, "seed": int(seed)}
        noise = np.random.default_rng(int(content_hash(content), 16))
        values, reasons = {}, []
        for response in self.emulator.responses:
            of = self._answers[response.name]
            value = float(of.noise_free(point)[0] + of.noise_sd(point)[0] * noise.standard_normal())
            if response.region is not None and response.region.contains(point)[0]:
                value = math.nan
                reasons.append(
                    f"the {response.name} jumps near here ({len(response.off)} of {len(self.emulator.runs)} "
                    "DEM runs left the branch that is emulated)"
                )
            values[response.name] = self._answer(response.name, value)
        return Run(
            outcome=Outcome.UNMEASURABLE if reasons else Outcome.OK,
            reason="; ".join(reasons),
            responses={
                ANGLE_OF_REPOSE: values[ANGLE_OF_REPOSE],
                BULK_DENSITY: parameters["DENS"] * values[SOLID_FRACTION],
                RAYLEIGH_TIME_STEP: float(self.model.particles.rayleigh_time_step(parameters)),
            },
            wall_time=time.perf_counter() - started,
            cpu_time=time.thread_time() - used,
        )


class EmulatorKind:
    """Emulators as a line of the table of engines."""

    def open(
        self,
        model: Model | None = None,
        fidelity: str | None = None,
        variant: str = "ring",
        *,
        directory: Path | None = None,
        draw: int | None = None,
        rounded: bool = True,
    ) -> EmulatorEngine:
        """The emulator of a directory, or the one that is shipped of a fidelity and variant.

        Without a model, and a fidelity, it is for the model that the emulator was made of.
        """
        if model is not None and not isinstance(model, AngleOfReposeModel):
            raise InputError(f"the emulator is of the angle-of-repose model, not of {model.name}")
        if model is not None:
            fidelity, variant = model.fidelity.name, model.variant.name
        emulator = read_emulator(directory or shipped_emulator(fidelity or DEFAULT_FIDELITY, variant))
        model = model or shipped_model(fidelity or emulator.origin.fidelity, variant)
        return EmulatorEngine(model, emulator, draw, rounded)

    def look(self) -> str:
        """Fidelities and variants that an emulator is shipped of."""
        return f"shipped are {', '.join(path.name for path in sorted(SHIPPED.iterdir()))}"


EMULATOR = EmulatorKind()
