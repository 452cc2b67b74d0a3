"""The emulator as an engine: it answers like a DEM program, from runs that were made before."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from calstudy.disk.files import content_hash
from calstudy.emulator.emulator import (
    Answers,
    Emulator,
    Response,
    read_emulator,
    shipped_emulator,
    shipped_emulators,
)
from calstudy.engines.choose import DEFAULT_MODEL as DEFAULT_MODEL_AT
from calstudy.engines.choose import loaded
from calstudy.engines.interface import Model
from calstudy.errors import InputError, Stopped
from calstudy.models.find import DEFAULT_MODEL
from calstudy.models.targets import describe
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Run, Target

DEFAULT_FIDELITY = "full"
"""Fidelity of the shipped emulator that is meant when none is named."""
DIGITS = 8
"""Of a response's mean over the runs, to which answers are rounded: a hundred-thousandth of the noise of the
shipped ones or less, far more than what the last digits of linear algebra change."""


class EmulatorEngine:
    """A model through an emulator of it.

    ``draw`` None answers with the emulator's mean, a number with that draw from its posterior. Noise comes
    on top, from the seed and *all* parameter values: in LIGGGHTS, too, a change of a parameter by a
    thousandth makes of the same seed another packing.

    ``rounded`` answers are rounded to DIGITS, so that an emulator, too, gives equal digits for equal
    parameters and seed wherever it is run. ``prefix`` is that of the responses' names in a study of several
    models. InputError where the emulator is of another model, fidelity or variant, or of another version.
    """

    def __init__(
        self,
        model: Model,
        emulator: Emulator,
        draw: int | None = None,
        rounded: bool = False,
        prefix: str = "",
    ) -> None:
        origin, labels = emulator.origin, model.labels
        if origin.model != model.name:
            raise InputError(
                f"the emulator {emulator.version} is of {origin.in_words}, not of {model.name}; name another"
            )
        if (origin.fidelity, origin.variant) != (labels["fidelity"], labels["variant"]):
            raise InputError(
                f"the emulator {emulator.version} is of {origin.fidelity} fidelity, {origin.variant}; "
                f"asked for {labels['fidelity']}, {labels['variant']}"
            )
        if origin.model_hash != model.hash:
            raise InputError(
                f"the emulator {emulator.version} was made from another version of {model.name}; run its "
                "design again with this one: calstudy emulator sample"
            )
        self.model, self.emulator, self.draw, self.rounded = model, emulator, draw, rounded
        self.prefix = prefix
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
        """Diameter of the beads that are emulated, in m; NaN where it is not known."""
        return self.model.particle_diameter

    def twin(self, truth: Mapping[str, float]) -> Target:
        """The noise-free responses at known parameters as a target; InputError for ones outside the box."""
        point = self.emulator.point(truth)
        emulated = {
            response.name: self._rounded(response, float(of.noise_free(point)[0]))
            for response, of in self._with_answers()
        }
        wanted = self._responses(emulated, truth)
        units = {response.name: response.unit for response in self.model.responses}
        origin = (
            f"twin: noise-free responses of {self.identity} at known parameters, {describe(wanted, units)}"
        )
        return Target(wanted, "twin", origin, dict(truth))

    def _with_answers(self) -> list[tuple[Response, Answers]]:
        return [(response, self._answers[response.name]) for response in self.emulator.responses]

    def _rounded(self, response: Response, value: float) -> float:
        if not self.rounded or not math.isfinite(value):
            return value
        member = response.process.members[0]
        return round(value, DIGITS - 1 - math.floor(math.log10(max(abs(member.centre), member.scale))))

    def _responses(self, emulated: Mapping[str, float], parameters: Mapping[str, float]) -> dict[str, float]:
        """The model's responses, of which some are emulated as quotients by a parameter."""
        return {
            of.name: emulated[of.reduced]
            if of.proportional_to is None
            else parameters[of.proportional_to] * emulated[of.reduced]
            for of in self.emulator.similarity.responses
        }

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Answer; nothing is written to ``directory``. InputError for parameters outside the box."""
        if stop.is_set():
            raise Stopped("interrupted")
        started, used = time.perf_counter(), time.thread_time()
        point = self.emulator.point(parameters)
        content = {"parameters": {k: float(v) for k, v in parameters.items()}, "seed": int(seed)}
        noise = np.random.default_rng(int(content_hash(content), 16))
        values, reasons = {}, []
        for response, of in self._with_answers():
            value = float(of.noise_free(point)[0] + of.noise_sd(point)[0] * noise.standard_normal())
            if response.region is not None and response.region.contains(point)[0]:
                value = math.nan
                reasons.append(
                    f"the {response.name} jumps near here ({len(response.off)} of {len(self.emulator.runs)} "
                    "DEM runs left the branch that is emulated)"
                )
            values[response.name] = self._rounded(response, value)
        responses, particles = self._responses(values, parameters), self.model.particles
        step = math.nan if particles is None else float(particles.rayleigh_time_step(parameters))
        return Run(
            outcome=Outcome.UNMEASURABLE if reasons else Outcome.OK,
            reason="; ".join(reasons),
            responses={
                **{f"{self.prefix}{name}": value for name, value in responses.items()},
                RAYLEIGH_TIME_STEP: step,
            },
            wall_time=time.perf_counter() - started,
            cpu_time=time.thread_time() - used,
        )


def twin_of(engines: Sequence[EmulatorEngine], names: Sequence[str], truth: Mapping[str, float]) -> Target:
    """The noise-free responses ``names`` of several models at known parameters as one target."""
    found = {f"{e.prefix}{name}": value for e in engines for name, value in e.twin(truth).values.items()}
    identity = "+".join(engine.identity for engine in engines)
    origin = f"twin: noise-free responses of {identity} at known parameters"
    return Target({name: found[name] for name in names}, "twin", origin, dict(truth))


def emulators_of(
    models: Sequence[tuple[Model, str]], directories: Sequence[Path], rounded: bool = True
) -> list[EmulatorEngine]:
    """Emulator of each model, given with the prefix of its responses, from the directories in any order.

    InputError for a model that none of them is of, and for an emulator of another model or version.
    """
    emulators = [read_emulator(directory) for directory in directories]
    hashes = [model.hash for model, _ in models]
    for directory, emulator in zip(directories, emulators, strict=True):
        if emulator.origin.model_hash not in hashes:
            names = " or ".join(model.name for model, _ in models)
            raise InputError(
                f"{directory}: is an emulator of {emulator.origin.in_words}, not of {names} as it is here; "
                "name one of that, or make it with 'calstudy emulator sample'"
            )
    found = {emulator.origin.model_hash: emulator for emulator in emulators}
    if missing := [model.name for model, _ in models if model.hash not in found]:
        raise InputError(f"no emulator of {missing[0]} is given; name one of each model")
    return [EmulatorEngine(m, found[m.hash], rounded=rounded, prefix=prefix) for m, prefix in models]


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
        prefix: str = "",
    ) -> EmulatorEngine:
        """The emulator of a directory, or the one that is shipped of a model, its fidelity and variant.

        Without a model, and a fidelity, it is for the angle-of-repose model as the emulator was made of it.
        """
        if model is not None:
            fidelity, variant = model.labels["fidelity"], model.labels["variant"]
        at = DEFAULT_FIDELITY if fidelity is None else fidelity
        name = DEFAULT_MODEL if model is None else model.name
        emulator = read_emulator(directory or shipped_emulator(name, at, variant))
        model = model or loaded(DEFAULT_MODEL_AT)(fidelity or emulator.origin.fidelity, variant)
        return EmulatorEngine(model, emulator, draw, rounded, prefix)

    def look(self) -> str:
        """Fidelities and variants that an emulator is shipped of."""
        there = shipped_emulators(DEFAULT_MODEL)
        return f"shipped are {', '.join(path.name for path in there)}"


EMULATOR = EmulatorKind()
