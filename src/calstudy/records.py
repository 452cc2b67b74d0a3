"""Records: what was asked of the DEM model, what it answered, and what a calibration found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from calstudy.identity import content_hash
from calstudy.parameters import Array

ANGLE_OF_REPOSE = "angle_of_repose_deg"
BULK_DENSITY = "bulk_density"
RAYLEIGH_TIME_STEP = "rayleigh_time_step"
MEASURED = (ANGLE_OF_REPOSE, BULK_DENSITY)
"""Responses that need a DEM run; the Rayleigh time-step follows from Eq. 1."""
RESPONSES = (*MEASURED, RAYLEIGH_TIME_STEP)
UNITS = {ANGLE_OF_REPOSE: "deg", BULK_DENSITY: "kg/m3", RAYLEIGH_TIME_STEP: "s"}


class Outcome(StrEnum):
    """How a DEM run ended."""

    OK = "ok"
    NO_HEAP = "no_heap"
    """It ran, and nothing stood above the first layer of beads: there is no angle of repose."""
    FAILED = "failed"
    TIMED_OUT = "timed_out"
    UNMEASURABLE = "unmeasurable"
    """It ran, and Appendix A could not be applied to its pictures."""


class Phase(StrEnum):
    """The part of a calibration that asked for a DEM run (Figure 2)."""

    SAMPLING = "sampling"
    START = "start"
    """First point of the second optimisation: the surrogate's optimum."""
    JACOBIAN = "jacobian"
    TRIAL = "trial"


OPTIMISATION = (Phase.START, Phase.JACOBIAN, Phase.TRIAL)


@dataclass(frozen=True, slots=True)
class Beads:
    """Where the beads of one run went (counts)."""

    poured: int
    filled: int
    """Left after what lay above the fill height was removed; their mass gives the bulk density."""
    heap: int
    lost: int
    """Left the plate while the cylinder was raised."""


@dataclass(frozen=True, slots=True)
class Run:
    """One DEM run. Responses are NaN where the run gave none."""

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
    """Time-step of the simulation in s: a share of the Rayleigh time-step of what was really simulated."""
    simulated_time: float = math.nan
    """From the first bead to the heap at rest, in s."""
    heap: Array | None = field(default=None, compare=False, repr=False)
    """Final bead centres (n, 3) in m."""
    host: str = ""
    """Machine that ran it."""
    finished_at: str = ""
    """End in UTC, ISO 8601."""

    @property
    def usable(self) -> bool:
        """Whether the run's responses may enter a surrogate or a cost."""
        return self.outcome is Outcome.OK

    @property
    def broke(self) -> bool:
        """Whether the program did not do its work: on another machine, or another day, it might."""
        return self.outcome in (Outcome.FAILED, Outcome.TIMED_OUT)


@dataclass(frozen=True, slots=True)
class Request:
    """One DEM run that a row's calibration asks for."""

    row: int
    phase: Phase
    index: int
    """Counts a row's requests within the phase from 0."""
    parameters: Mapping[str, float]
    seed: int

    def run_id(self, model_hash: str, engine: str) -> str:
        """Identity of the DEM run by content: equal runs have equal ids, whoever asks for them."""
        content = {
            "model": model_hash,
            "engine": engine,
            "parameters": {name: float(value) for name, value in self.parameters.items()},
            "seed": int(self.seed),
        }
        return content_hash(content)[:16]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """A request and the run that answered it."""

    request: Request
    run_id: str
    run: Run


@dataclass(frozen=True, slots=True)
class Target:
    """Desired responses m_i of Eq. 9, and how they were chosen."""

    values: Mapping[str, float]
    kind: str
    """``paper``, ``twin`` or ``set``."""
    origin: str
    """One line that every table prints."""
    truth: Mapping[str, float] | None = None
    """The parameter set behind a twin's responses."""
