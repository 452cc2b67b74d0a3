"""The experimental plan: which rows, which factors, which parameters, and what stays fixed.

Definitions come from a TOML file, rows from a CSV file; both are shipped as ``calstudy.plans``.
Whether the rows are what they should be is asked in ``plan_check``; here only what cannot be read as
a complete plan is refused.
"""

from __future__ import annotations

import csv
import io
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, is_dataclass, replace
from importlib.resources import files
from importlib.resources.abc import Traversable
from itertools import product, zip_longest
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from calstudy.errors import InputError
from calstudy.identity import content_hash
from calstudy.parameters import Parameter, Space
from calstudy.rayleigh import Particles
from calstudy.written import shortened, text_of

EMBEDDED = "rackl_hanley_2017"
FULL_FACTORIAL = "full-factorial"
"""Name of the plan of all combinations of levels, of which the published one is a half."""
HEADER = ("run", "WRL", "SPP", "MU_PP", "MU_PW", "YM", "RF_PW")
"""Columns of a plan file, in the order of Table B-1."""
FACTORS = HEADER[1:]
PARAMETERS = ("DENS", "MU_PP", "MU_PW", "RF_PP", "RF_PW", "YM")
"""Parameter order of every point; one that is no factor (DENS, RF_PP) is always calibrated."""

_RUN = re.compile(r"[0-9]{1,9}")
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")


@dataclass(frozen=True, slots=True)
class Factor:
    """A factor of the plan and the levels it may take (section 2.3.4)."""

    name: str
    levels: tuple[float, ...]
    meaning: str = ""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of Table B-1: one complete calibration. Of the switches, 1 = calibrated, 0 = constant."""

    run: int
    WRL: float
    SPP: int
    MU_PP: int
    MU_PW: int
    YM: int
    RF_PW: int

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
        return tuple(getattr(self, name) for name in FACTORS)


@dataclass(frozen=True, slots=True)
class FixedInputs:
    """DEM inputs that no row varies (Table 1, section 2.2); SI units."""

    poissons_ratio: float
    restitution_pp: float
    restitution_pw: float
    rolling_viscous_damping_pp: float
    rolling_viscous_damping_pw: float
    gravity: float
    particle_radius: float

    @property
    def particles(self) -> Particles:
        """The paper's particles, whose Rayleigh time-step is in the cost."""
        return Particles(self.particle_radius, self.poissons_ratio)


@dataclass(frozen=True, slots=True)
class Targets:
    """Measured responses to calibrate to (section 2.2); deg and kg/m3."""

    angle_of_repose_deg: float
    bulk_density: float


@dataclass(frozen=True, slots=True)
class Published:
    """Properties that the rows must have: word lengths as printed (section 2.3.4), samples by Eq. 11.

    Those of the full factorial follow from its being one."""

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
    """An experimental plan with everything that its rows refer to; ``rows`` ascend by run number."""

    name: str
    runs: int
    source: Source
    factors: tuple[Factor, ...]
    parameters: tuple[Parameter, ...]
    fixed: FixedInputs
    targets: Targets
    published: Published
    rows: tuple[Row, ...]
    origin: str = field(default="", compare=False)
    """The file that the rows were read from, for messages."""

    def row(self, run: int) -> Row:
        """Return the row with that run number; InputError if there is none."""
        for row in self.rows:
            if row.run == run:
                return row
        raise InputError(f"row {run} is not in plan {self.name}; {_known_runs(self)}")

    def space(self, row: Row) -> Space:
        """Parameter space of a row: its calibrated parameters, the others at their constants."""
        return Space(self.parameters, row.calibrated)

    def sampled_as(self, run: int) -> int:
        """First row that differs from a row in WRL alone, or that row: the two could share samples."""
        alike = self.row(run)
        return next(r.run for r in self.rows if (r.SPP, r.calibrated) == (alike.SPP, alike.calibrated))

    @property
    def total_samples(self) -> int:
        """Sum of Eq. 11 over all rows."""
        return sum(row.samples for row in self.rows)

    @property
    def hash(self) -> str:
        """SHA-256 (hex) of all that decides what the plan computes.

        Numbers are taken as floats, so 1 and 1.0 are the same plan. Names of files, citations and
        explanations do not count: correcting a comma must not orphan a study.
        """
        content = {
            "factors": {f.name: f.levels for f in self.factors},
            "parameters": [(p.name, p.unit, p.lower, p.upper, p.constant) for p in self.parameters],
            "fixed": asdict(self.fixed),
            "targets": asdict(self.targets),
            "rows": [(row.run, *row.levels) for row in self.rows],
        }
        return content_hash(_canonical(content))


def load_plan(csv_path: str | Path | None = None) -> Plan:
    """Read the plan of Rackl & Hanley (2017), or the same definitions with the rows of a CSV file.

    `FULL_FACTORIAL` in the place of a file is the plan with all combinations. A file is only read here:
    whether its rows make a sound plan, and the published one, is what ``plan_check.check`` tells.
    InputError as ``read_rows``.
    """
    folder = files("calstudy.plans")
    if str(csv_path) == FULL_FACTORIAL:
        return full_factorial(load_plan())
    rows = folder / f"{EMBEDDED}.csv" if csv_path is None else Path(csv_path)
    return read_plan(folder / f"{EMBEDDED}.toml", rows)


def full_factorial(half: Plan) -> Plan:
    """Plan with all combinations of the factors' levels: the rows of ``half`` first, as they are.

    The others follow in the order of their levels, the last factor changing first. No effects are
    confounded in it, so its word lengths are 0.
    """
    there = {row.levels for row in half.rows}
    combinations = product(*(factor.levels for factor in half.factors))
    others = [levels for levels in combinations if levels not in there]
    more = [
        Row(run, levels[0], *(int(level) for level in levels[1:]))
        for run, levels in enumerate(others, start=half.runs + 1)
    ]
    runs = half.runs + len(more)
    samples = half.published.total_samples * runs // half.runs  # both halves are balanced
    published = replace(half.published, A3=0.0, A4=0.0, A5=0.0, total_samples=samples)
    name = FULL_FACTORIAL
    return replace(half, name=name, runs=runs, rows=(*half.rows, *more), published=published, origin=name)


def read_plan(definition: Traversable, rows: Traversable) -> Plan:
    """Read a plan from its TOML definition and its CSV rows.

    InputError with the file and the key for a definition that is no TOML, or in which a key is
    missing, unknown or of the wrong type; as ``read_rows`` for the rows.
    """
    text = text_of(definition)
    try:
        plan: Plan = _build(Plan, {**tomllib.loads(text), "rows": []}, "")
        _require_names("factors", [f.name for f in plan.factors], FACTORS)
        _require_names("parameters", [p.name for p in plan.parameters], PARAMETERS)
    except (tomllib.TOMLDecodeError, InputError) as error:
        raise InputError(f"{definition}: {error}; correct it or restore the shipped file") from error
    return replace(plan, rows=read_rows(rows, plan.factors, plan.runs), origin=str(rows))


def read_rows(file: Traversable, factors: tuple[Factor, ...], runs: int) -> tuple[Row, ...]:
    """Read all rows of a plan file, ascending by run number whatever their order in the file.

    ``factors`` gives the levels that a cell may have, ``runs`` how many rows there must be. InputError
    in one line with file, row, column and remedy for: an unreadable or empty file, another header, a
    line that is too short or too long, a cell that is no number or no level, a run number that is
    missing, unknown or there twice.
    """
    lines = _lines(file)
    _require_header(file, *next(lines, (1, [])))
    seen: dict[int, tuple[int, Row]] = {}
    problems = []
    for line, cells in lines:
        row = _row(f"{file}: ", line, cells, factors, runs)
        first, _ = seen.setdefault(row.run, (line, row))
        if first != line:
            problems.append(f"row {row.run}, column run: stands at lines {first} and {line}")
    missing = [run for run in range(1, runs + 1) if run not in seen]
    if missing:
        more = f", like {len(missing) - 1} more" if len(missing) > 1 else ""
        problems = [*problems[:1], f"row {missing[0]}, column run: missing{more}"]
    if problems:
        what = "; ".join(problems[:2])
        raise InputError(f"{file}: {what}; every run number from 1 to {runs} must be there once")
    return tuple(seen[run][1] for run in sorted(seen))


def _require_header(file: Traversable, line: int, header: list[str]) -> None:
    right = f"the header is {','.join(HEADER)}"
    if not header:
        raise InputError(f"{file}: row 1, column run: the file is empty; give it a header and rows; {right}")
    for k, (found, name) in enumerate(zip_longest(header, HEADER), start=1):
        if found != name:
            wrong = "is missing" if found is None else f"has {shortened(found)}"
            remedy = f"write {name}" if name else "remove it"
            where = f"header row (line {line}), column {name or k}"
            raise InputError(f"{file}: {where} {wrong}; {remedy}; {right}")


def _row(where: str, line: int, cells: list[str], factors: tuple[Factor, ...], runs: int) -> Row:
    """Build a row from the cells of one line; InputError names the first cell that is wrong."""
    run = cells[0].strip()
    if not _RUN.fullmatch(run):
        raise InputError(
            f"{where}row at line {line}, column run: {shortened(run)} is no row number; correct it"
        )
    where = f"{where}row {int(run)} (line {line}), column"
    if not 1 <= int(run) <= runs:
        raise InputError(f"{where} run: the plan has rows 1 to {runs}; correct the number or remove the row")
    if len(cells) < len(HEADER):
        raise InputError(f"{where} {HEADER[len(cells)]}: there is no cell; write all {len(HEADER)}")
    if len(cells) > len(HEADER):
        raise InputError(
            f"{where} {len(HEADER) + 1}: {shortened(cells[len(HEADER)])} is too many; "
            "remove it, or write a decimal point if it is the end of a number"
        )
    levels: dict[str, Any] = {}
    for factor, cell in zip(factors, cells[1:], strict=True):
        remedy = f"use {', '.join(f'{level:g}' for level in factor.levels)}"
        if not _NUMBER.fullmatch(cell.strip()):
            raise InputError(f"{where} {factor.name}: {shortened(cell)} is no number; {remedy}")
        if float(cell) not in factor.levels:
            raise InputError(f"{where} {factor.name}: {shortened(cell)} is no level; {remedy}")
        levels[factor.name] = float(cell) if factor.name == "WRL" else int(float(cell))
    return Row(int(run), **levels)


def parse_rows_option(text: str, plan: Plan) -> tuple[int, ...]:
    """Run numbers, ascending and once each, from numbers and ranges such as ``1,4,10-12``.

    InputError for an empty part, something that is no number, a range that goes downwards and a row
    that the plan does not have.
    """
    known = {row.run for row in plan.rows}
    chosen: set[int] = set()
    for part in text.split(","):
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if not _RUN.fullmatch(first) or not _RUN.fullmatch(last if dash else first):
            raise InputError(f"rows: {shortened(part)} is no row and no range; write for example 1,4,10-12")
        low, high = int(first), int(last if dash else first)
        if low > high:
            raise InputError(f"rows: {shortened(part)} goes downwards; write {high}-{low}")
        for end in (low, high):
            if end not in known:
                raise InputError(f"rows: {end} is not in plan {plan.name}; {_known_runs(plan)}")
        chosen |= known.intersection(range(low, high + 1))
    return tuple(sorted(chosen))


def _known_runs(plan: Plan) -> str:
    runs = [row.run for row in plan.rows]
    return f"its rows are {min(runs)} to {max(runs)}" if runs else "it has no rows"


def _lines(file: Traversable) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each line that is not blank."""
    reader = csv.reader(io.StringIO(text_of(file), newline=""), strict=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells
    except csv.Error as error:
        raise InputError(f"{file}: row at line {reader.line_num}: is no CSV ({error}); correct it") from error


def _build(kind: Any, table: Mapping[str, Any], key: str) -> Any:
    """Make a dataclass from a TOML table; InputError names a key that is unknown or missing."""
    hints = get_type_hints(kind)
    for name in table:
        if name not in hints:
            raise InputError(f"key {key}{name} is unknown")
    values = {}
    for f in fields(kind):
        if f.name in table:
            values[f.name] = _coerce(table[f.name], hints[f.name], key + f.name)
        elif NoneType in get_args(hints[f.name]):
            values[f.name] = None
        elif f.default is MISSING:
            raise InputError(f"key {key}{f.name} is missing")
    return kind(**values)


def _coerce(value: Any, kind: Any, key: str) -> Any:
    """Bring a TOML value to its declared type; InputError names the key."""
    if is_dataclass(kind) and isinstance(value, dict):
        return _build(kind, value, f"{key}.")
    if get_origin(kind) is tuple and isinstance(value, list):
        item_kind = get_args(kind)[0]
        return tuple(_coerce(item, item_kind, f"{key}[{k}]") for k, item in enumerate(value))
    if float in (kind, *get_args(kind)):
        if type(value) in (int, float) and math.isfinite(value):
            return float(value)
    elif type(value) is kind:
        return value
    raise InputError(f"key {key}: {shortened(str(value))} is not what belongs there")


def _require_names(key: str, found: list[str], wanted: tuple[str, ...]) -> None:
    if tuple(found) != wanted:
        raise InputError(f"key {key}: the names must be {', '.join(wanted)}, in this order")


def _canonical(value: Any) -> Any:
    """Take every number as a float (and -0 as 0), so that equal content gives equal text."""
    if isinstance(value, dict):
        return {key: _canonical(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_canonical(item) for item in value]
    return float(value) + 0.0 if isinstance(value, int | float) else value
