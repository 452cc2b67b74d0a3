"""The experimental plan: its rows, factors and parameters, and what stays fixed (section 2.3.4, Table B-1).

Definitions come from a TOML file and rows from a CSV file. Both are shipped as ``calstudy.plans``. Reading
refuses only what is not a complete plan; ``plan_check`` checks whether the rows are as they should be.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from calstudy.disk.files import content_hash
from calstudy.errors import InputError
from calstudy.parameters import Parameter, Space
from calstudy.rayleigh import Particles

EMBEDDED = "rackl_hanley_2017"
FULL_FACTORIAL = "full-factorial"
"""Name of the plan with all combinations of levels. The published plan is half of it."""
MATERIAL_TESTS = "material-tests"
"""Name of the plan whose rows differ in the number of material tests, too."""
NAMED = (FULL_FACTORIAL, MATERIAL_TESTS)
"""Shipped plans beside the paper's."""
HEADER = ("run", "WRL", "SPP", "MU_PP", "MU_PW", "YM", "RF_PW")
"""Columns of a plan file, in the order of Table B-1."""
FACTORS = HEADER[1:]
TESTS = "TESTS"
"""Factor of plans with several material tests, and its column, which comes last."""
PARAMETERS = ("DENS", "MU_PP", "MU_PW", "RF_PP", "RF_PW", "YM")
"""Parameters in the order of every point. Those that are not factors (DENS, RF_PP) are always calibrated."""
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")


@dataclass(frozen=True, slots=True)
class Factor:
    """A factor of the plan and its levels (section 2.3.4)."""

    name: str
    levels: tuple[float, ...]
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of Table B-1: one calibration. MU_PP to RF_PW are 1 if calibrated and 0 if constant."""

    run: int
    WRL: float
    SPP: int
    MU_PP: int
    MU_PW: int
    YM: int
    RF_PW: int
    TESTS: int | None = None
    """Number of the plan's material tests, the first ones, that it calibrates to; None where that is no
    factor."""

    @property
    def calibrated(self) -> tuple[str, ...]:
        """Names of the calibrated parameters, in the parameters' order."""
        return tuple(name for name in PARAMETERS if name not in FACTORS or getattr(self, name))

    @property
    def samples(self) -> int:
        """Number of sample locations, S = (f_cal + 2) SPP (Eq. 11); the 2 are DENS and RF_PP."""
        return len(self.calibrated) * self.SPP

    @property
    def levels(self) -> tuple[float, ...]:
        """Factor levels in the order of the columns, without the run number."""
        tests = () if self.TESTS is None else (self.TESTS,)
        return (*(getattr(self, name) for name in FACTORS), *tests)


@dataclass(frozen=True, slots=True)
class PlannedTest:
    """A material test of a plan: its shipped model, and which of its responses are calibrated to."""

    model: str
    targets: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FixedInputs:
    """DEM inputs that are the same in all rows (Table 1, section 2.2), in SI units."""

    poissons_ratio: float
    restitution_pp: float
    restitution_pw: float
    rolling_viscous_damping_pp: float
    rolling_viscous_damping_pw: float
    gravity: float
    particle_radius: float

    @property
    def particles(self) -> Particles:
        """Particles of the Rayleigh time-step in the cost."""
        return Particles(self.particle_radius, self.poissons_ratio)


@dataclass(frozen=True, slots=True)
class Published:
    """Properties that the rows must have: word lengths as printed (section 2.3.4), samples by Eq. 11.

    Those of the full factorial are computed."""

    A3: float
    A4: float
    A5: float
    decimals: int
    total_samples: int


@dataclass(frozen=True, slots=True)
class Source:
    """Where each part of a plan was published."""

    citation: str
    doi: str
    rows: str
    factors: str
    intervals: str
    constants: str
    fixed_inputs: str
    targets: str
    published: str


@dataclass(frozen=True, slots=True)
class Plan:
    """An experimental plan with everything that its rows refer to; ``rows`` are in order of run number."""

    name: str
    runs: int
    source: Source
    factors: tuple[Factor, ...]
    parameters: tuple[Parameter, ...]
    fixed: FixedInputs
    targets: Mapping[str, float]
    """Responses that were measured, to which each row calibrates (section 2.2); in the model's units."""
    published: Published
    rows: tuple[Row, ...]
    tests: tuple[PlannedTest, ...] = ()
    """In the order in which rows take them; empty where all rows calibrate to all responses of one model."""
    origin: str = field(default="", compare=False)
    """The file that the rows were read from, for messages."""

    def row(self, run: int) -> Row:
        """Return the row with that run number; InputError if there is none."""
        for row in self.rows:
            if row.run == run:
                return row
        raise InputError(f"row {run} is not in plan {self.name}; {known_runs(self)}")

    @property
    def header(self) -> tuple[str, ...]:
        """Columns of its file."""
        return ("run", *(factor.name for factor in self.factors))

    def cells(self, row: Row) -> dict[str, float]:
        """A row as its file has it."""
        return dict(zip(self.header, (row.run, *row.levels), strict=True))

    def prefix(self, test: PlannedTest) -> str:
        """What stands before the names of a test's responses; nothing before those of the first."""
        return "" if test == self.tests[0] else f"{test.model}_"

    def aims(self, row: Row) -> tuple[str, ...]:
        """Names of the responses that a row calibrates to, as in ``targets``."""
        tests = self.tests[: row.TESTS]
        return tuple(f"{self.prefix(t)}{name}" for t in tests for name in t.targets) or tuple(self.targets)

    def space(self, row: Row) -> Space:
        """Parameter space of a row: its calibrated parameters, and the others at their constant values."""
        return Space(self.parameters, row.calibrated)

    def sampled_as(self, run: int) -> int:
        """First row that differs from a row at most in WRL or its tests, so that both can share samples."""
        alike = self.row(run)
        return next(r.run for r in self.rows if (r.SPP, r.calibrated) == (alike.SPP, alike.calibrated))

    @property
    def total_samples(self) -> int:
        """Sum of Eq. 11 over all rows."""
        return sum(row.samples for row in self.rows)

    @property
    def hash(self) -> str:
        """SHA-256 (hex) of everything in the plan that affects results.

        Numbers are taken as floats, so 1 and 1.0 are the same plan. Names of files, citations and
        explanations do not count, so that correcting a comma does not orphan a study.
        """
        content = {
            "factors": {f.name: f.levels for f in self.factors},
            "parameters": [(p.name, p.unit, p.lower, p.upper, p.constant) for p in self.parameters],
            "fixed": asdict(self.fixed),
            "targets": dict(self.targets),
            "rows": [(row.run, *row.levels) for row in self.rows],
        }
        if self.tests:
            content["tests"] = [[test.model, *test.targets] for test in self.tests]
        return content_hash(_canonical(content))


def known_runs(plan: Plan) -> str:
    """First and last row of a plan, in words."""
    runs = [row.run for row in plan.rows]
    return f"its rows are {min(runs)} to {max(runs)}" if runs else "it has no rows"


def _canonical(value: Any) -> Any:
    """The value with every number as a float, and -0 as 0, so that equal content gives equal text."""
    if isinstance(value, dict):
        return {key: _canonical(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_canonical(item) for item in value]
    return float(value) + 0.0 if isinstance(value, int | float) else value
