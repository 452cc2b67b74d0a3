"""Plans as files: their definition in TOML and their rows in CSV."""

from __future__ import annotations

import csv
import io
import re
import tomllib
from collections.abc import Iterator
from dataclasses import replace
from importlib.resources import files
from importlib.resources.abc import Traversable
from itertools import product, zip_longest
from pathlib import Path
from typing import Any

from calstudy.errors import InputError
from calstudy.plan import (
    _NUMBER,
    EMBEDDED,
    FACTORS,
    FULL_FACTORIAL,
    MATERIAL_TESTS,
    PARAMETERS,
    TESTS,
    Factor,
    Plan,
    Row,
)
from calstudy.tomlfile import _build
from calstudy.written import shortened, text_of

RUN = re.compile(r"[0-9]{1,9}")
"""Pattern of a run number."""


def load_plan(csv_path: str | Path | None = None) -> Plan:
    """Read the plan of Rackl & Hanley (2017), or the same definitions with the rows of a CSV file.

    `FULL_FACTORIAL` instead of a file gives the plan with all combinations, `MATERIAL_TESTS` the one with the
    number of material tests as a factor, which has definitions of its own. The file is only read here:
    ``plan_check.check`` checks its rows. InputError as in ``read_rows``.
    """
    folder = files("calstudy.plans")
    if str(csv_path) == FULL_FACTORIAL:
        return full_factorial(load_plan())
    if str(csv_path) == MATERIAL_TESTS:
        name = MATERIAL_TESTS.replace("-", "_")
        return read_plan(folder / f"{name}.toml", folder / f"{name}.csv")
    rows = folder / f"{EMBEDDED}.csv" if csv_path is None else Path(csv_path)
    return read_plan(folder / f"{EMBEDDED}.toml", rows)


def full_factorial(half: Plan) -> Plan:
    """Plan with all combinations of the factors' levels, beginning with the rows of ``half``.

    The other rows follow in the order of their levels; the last factor changes fastest. It confounds no
    effects, so its word lengths are 0.
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

    InputError: the definition is not TOML, or a key is missing, unknown or of the wrong type; for the rows
    as in ``read_rows``.
    """
    text = text_of(definition)
    try:
        plan: Plan = _build(Plan, {**tomllib.loads(text), "rows": []}, "")
        factors = (*FACTORS, TESTS) if plan.tests else FACTORS
        _require_names("factors", [f.name for f in plan.factors], factors)
        _require_names("parameters", [p.name for p in plan.parameters], PARAMETERS)
    except (tomllib.TOMLDecodeError, InputError) as error:
        raise InputError(f"{definition}: {error}; correct it or restore the shipped file") from error
    return replace(plan, rows=read_rows(rows, plan.factors, plan.runs), origin=str(rows))


def read_rows(file: Traversable, factors: tuple[Factor, ...], runs: int) -> tuple[Row, ...]:
    """Read all rows of a plan file, in order of run number.

    ``factors`` gives the levels that a cell may have, ``runs`` the number of rows. InputError, in one line
    with file, row, column and remedy: the file is unreadable or empty, the header is another one, a line is
    too short or too long, a cell is not a number or not a level, a run number is missing, unknown or
    repeated.
    """
    lines = _lines(file)
    columns = ("run", *(factor.name for factor in factors))
    _require_header(file, columns, *next(lines, (1, [])))
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


def _require_header(file: Traversable, columns: tuple[str, ...], line: int, header: list[str]) -> None:
    """Raise InputError if the first line of a plan file is not its header."""
    right = f"the header is {','.join(columns)}"
    if not header:
        raise InputError(f"{file}: row 1, column run: the file is empty; give it a header and rows; {right}")
    for k, (found, name) in enumerate(zip_longest(header, columns), start=1):
        if found != name:
            wrong = "is missing" if found is None else f"has {shortened(found)}"
            remedy = f"write {name}" if name else "remove it"
            where = f"header row (line {line}), column {name or k}"
            raise InputError(f"{file}: {where} {wrong}; {remedy}; {right}")


def _row(where: str, line: int, cells: list[str], factors: tuple[Factor, ...], runs: int) -> Row:
    """Build a row from the cells of a line. InputError names the first wrong cell."""
    run = cells[0].strip()
    if not RUN.fullmatch(run):
        raise InputError(
            f"{where}row at line {line}, column run: {shortened(run)} is not a row number; correct it"
        )
    where = f"{where}row {int(run)} (line {line}), column"
    columns = ("run", *(factor.name for factor in factors))
    if not 1 <= int(run) <= runs:
        raise InputError(f"{where} run: the plan has rows 1 to {runs}; correct the number or remove the row")
    if len(cells) < len(columns):
        raise InputError(f"{where} {columns[len(cells)]}: the cell is missing; write all {len(columns)}")
    if len(cells) > len(columns):
        raise InputError(
            f"{where} {len(columns) + 1}: {shortened(cells[len(columns)])} is too many; "
            "remove it, or write a decimal point if it is the end of a number"
        )
    levels: dict[str, Any] = {}
    for factor, cell in zip(factors, cells[1:], strict=True):
        remedy = f"use {', '.join(f'{level:g}' for level in factor.levels)}"
        if not _NUMBER.fullmatch(cell.strip()):
            raise InputError(f"{where} {factor.name}: {shortened(cell)} is not a number; {remedy}")
        if float(cell) not in factor.levels:
            raise InputError(f"{where} {factor.name}: {shortened(cell)} is not a level; {remedy}")
        levels[factor.name] = float(cell) if factor.name == "WRL" else int(float(cell))
    return Row(int(run), **levels)


def _lines(file: Traversable) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each line that is not blank."""
    reader = csv.reader(io.StringIO(text_of(file), newline=""), strict=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, cells
    except csv.Error as error:
        raise InputError(f"{file}: row at line {reader.line_num}: not CSV ({error}); correct it") from error


def _require_names(key: str, found: list[str], wanted: tuple[str, ...]) -> None:
    if tuple(found) != wanted:
        raise InputError(f"key {key}: the names must be {', '.join(wanted)}, in this order")
