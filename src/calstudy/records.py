"""Records: requests of DEM runs, the runs that answer them, and the targets."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from calstudy.disk.files import content_hash

if TYPE_CHECKING:
    from calstudy.parameters import Array

RAYLEIGH_TIME_STEP = "rayleigh_time_step"
"""The response that needs no DEM run (Eq. 1), in s."""


@dataclass(frozen=True, slots=True)
class Response:
    """A response that a model measures in a DEM run."""

    name: str
    unit: str
    proportional_to: str | None = None
    """Parameter that it is proportional to, as bulk density is to the density of the beads."""
    short: str = ""
    """What narrow tables call it; empty for its name."""
    quotient: str = ""
    """What it is called over that parameter; empty for RESPONSE/PARAMETER."""

    @property
    def reduced(self) -> str:
        """Name of what is emulated: the response, or its quotient by what it is proportional to."""
        if self.proportional_to is None:
            return self.name
        return self.quotient or f"{self.name}/{self.proportional_to}"


def proportional(responses: Iterable[Response]) -> dict[str, str]:
    """Parameter that a response is proportional to, by response; only those that are proportional to one."""
    return {r.name: r.proportional_to for r in responses if r.proportional_to is not None}


class Outcome(StrEnum):
    """How a DEM run ended."""

    OK = "ok"
    NO_HEAP = "no_heap"
    """It ran, but no heap rose above the first layer of beads, so there is no angle of repose. It gave the
    other responses."""
    FAILED = "failed"
    TIMED_OUT = "timed_out"
    UNMEASURABLE = "unmeasurable"
    """It ran, but Appendix A could not be applied to its pictures. It gave the other responses."""


BROKEN = (Outcome.FAILED, Outcome.TIMED_OUT)
"""Outcomes of a program that did not finish. Another time, or on another machine, it might."""


class Phase(StrEnum):
    """The part of a calibration that asked for a DEM run (Figure 2)."""

    SAMPLING = "sampling"
    START = "start"
    """First round of the second optimisation. It begins with the surrogates' optimum."""
    JACOBIAN = "jacobian"
    TRIAL = "trial"
    CHEAP = "cheap"
    """At the cheap fidelity, where a calibration has two: its samples, and more where they pay."""
    CONFIRMATION = "confirmation"
    """The optimum, run again with fresh seeds."""


class Stop(StrEnum):
    """Why an optimisation ended."""

    IMPROVEMENT = "improvement"
    """No step improved the sum of squares by the tolerance: the 2 % rule of section 2.3.3."""
    TOLERANCE = "tolerance"
    """Every response is within its tolerance, where the task has tolerances."""
    EXACT = "exact"
    """The sum of squares is zero to rounding."""
    FLAT = "flat"
    """No parameter that may move changes the residuals, or no run of the Jacobian succeeded."""
    BUDGET = "budget"
    ITERATIONS = "iterations"
    START_FAILED = "start_failed"


STOPPED: Mapping[str, str] = {
    Stop.IMPROVEMENT: "no further step improves the sum of squares enough",
    Stop.TOLERANCE: "all responses are within their tolerances",
    Stop.EXACT: "the sum of squares is zero",
    Stop.FLAT: "no parameter that may still move changes the responses",
    Stop.BUDGET: "the budget of DEM runs is used up",
    Stop.ITERATIONS: "the largest number of iterations is reached",
    Stop.START_FAILED: "the DEM run at its start gave no responses",
}
"""`Stop` in words."""


ROUNDING = 1e-5
"""Relative difference of parameters that rounding seldom exceeds in an optimum of the surrogates: a hundredth
of the difference step of the second optimisation."""

OPTIMISATION = (Phase.START, Phase.JACOBIAN, Phase.TRIAL)
OF_EVERY_CALIBRATION = (Phase.SAMPLING, *OPTIMISATION)
"""The paper's phases."""


@dataclass(frozen=True, slots=True)
class Beads:
    """Where the beads of one run went (counts)."""

    poured: int
    filled: int
    """Left after those above the fill height were removed. Their mass gives the bulk density."""
    on_plate: int
    lost: int
    """Left the plate while the cylinder was raised."""


@dataclass(frozen=True, slots=True)
class Run:
    """One DEM run. Responses that it did not give are NaN. Times in s."""

    outcome: Outcome
    reason: str
    responses: Mapping[str, float]
    wall_time: float
    cpu_time: float
    radius: float = math.nan
    """Radius r_f of the heap in m (Appendix A)."""
    height: float = math.nan
    """Height h_f of the heap in m, one particle diameter taken off (Appendix A)."""
    beads: Beads | None = None
    engine_time_step: float = math.nan
    """Time-step of the simulation in s: a share of the Rayleigh time-step of the simulated material."""
    simulated_time: float = math.nan
    """From the first bead to the heap at rest, in s."""
    positions: Array | None = field(default=None, compare=False, repr=False)
    """Final bead centres (n, 3) in m."""
    host: str = ""
    """Machine that ran it."""
    finished_at: str = ""
    """End in UTC, ISO 8601."""

    @property
    def usable(self) -> bool:
        """Whether the run gave all its responses."""
        return self.outcome is Outcome.OK

    @property
    def broke(self) -> bool:
        """Whether the program did not finish."""
        return self.outcome in BROKEN


@dataclass(frozen=True, slots=True)
class Request:
    """One DEM run that a row's calibration asks for."""

    row: int
    phase: Phase
    index: int
    """Number of the request within the row and phase, from 0."""
    parameters: Mapping[str, float]
    seed: int

    def repeats(self, other: Request) -> bool:
        """Whether it is the other request except for rounding on another processor."""
        place, there = ((r.row, r.phase, r.index, r.seed) for r in (self, other))
        near = (
            math.isclose(value, other.parameters[name], rel_tol=ROUNDING)
            for name, value in self.parameters.items()
        )
        return place == there and all(near)

    def run_id(self, model_hash: str, engine: str) -> str:
        """Identity of the DEM run by content. Equal runs have equal ids, whoever requests them."""
        content = {
            "model": model_hash,
            "engine": engine,
            "parameters": {name: float(value) for name, value in self.parameters.items()},
            "seed": int(self.seed),
        }
        return content_hash(content)[:16]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """A request and the run that answered it. The runs of several models are joined into one."""

    request: Request
    run_id: str
    """The ids of several runs are joined by +."""
    run: Run
    model_hash: str = ""
    """Hash of the model that ran; empty if a study has one model, or for several runs."""

    @classmethod
    def joined(cls, parts: Sequence[Evaluation]) -> Evaluation:
        """All models' answers to a request as one. It is ok if they all are.

        It has the responses of all models and the smallest Rayleigh time-step, if any has one. One answer is
        returned as it is.
        """
        if len(parts) == 1:
            return parts[0]
        runs = [part.run for part in parts]
        failed = next((run for run in runs if not run.usable), None)
        responses = {name: value for run in runs for name, value in run.responses.items()}
        steps = [t for run in runs if not math.isnan(t := run.responses[RAYLEIGH_TIME_STEP])]
        run = Run(
            outcome=failed.outcome if failed else Outcome.OK,
            reason=failed.reason if failed else "",
            responses=responses | {RAYLEIGH_TIME_STEP: min(steps, default=math.nan)},
            wall_time=sum(run.wall_time for run in runs),
            cpu_time=sum(run.cpu_time for run in runs),
        )
        return cls(parts[0].request, "+".join(part.run_id for part in parts), run)


@dataclass(frozen=True, slots=True)
class Target:
    """Desired responses m_i of Eq. 9, and how they were chosen."""

    values: Mapping[str, float]
    kind: str
    """``paper``, ``twin`` or ``set``."""
    origin: str
    """One line about it, which every table prints."""
    truth: Mapping[str, float] | None = None
    """The parameter set behind a twin's responses."""
    sd: Mapping[str, float] = field(default_factory=dict)
    """Standard error of each measured value, in its unit, where it is known."""
    scale: Mapping[str, float] = field(default_factory=dict)
    """Deviation that counts as a residual of 1, in the response's unit, where it was chosen."""
    weight: Mapping[str, float] = field(default_factory=dict)
    """Factor of the squared residual, where it is not 1."""
    minimised: tuple[str, ...] = ()
    """Responses that are objectives: as small as may be, down to their value."""
