"""Measured curves: the CSV that a target names, in the units of the model's curve."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from calstudy.errors import InputError
from calstudy.models.folder import FolderModel
from calstudy.models.folder.curves import Curve, points_of
from calstudy.study.definition.models import Chosen
from calstudy.tomlfile import Section
from calstudy.written import choice, number_in, text_of

LEAST, MOST = 3, 50
"""Points of a measured curve. Fewer are targets of their own; more say nothing new, and each is a column."""
UNITS: Mapping[str, tuple[str, float]] = {
    "kPa": ("Pa", 1e3),
    "MPa": ("Pa", 1e6),
    "GPa": ("Pa", 1e9),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "%": ("-", 1e-2),
    "g": ("kg", 1e-3),
    "ms": ("s", 1e-3),
    "min": ("s", 60.0),
}
"""Units that a laboratory writes, with the model's and what they are multiplied by."""
_HEADER = re.compile(r"\s*(.*?)\s*\[\s*([^\[\]]*?)\s*\]\s*")
FORM = "its first line names the columns and their units, such as: normal stress [kPa], strain [%], sd"


@dataclass(frozen=True, slots=True)
class MeasuredCurve:
    """A measured curve, in the model's units."""

    name: str
    """Of the curve in the calibration."""
    points: tuple[str, ...]
    """Responses that are its points."""
    file: str
    of: Curve
    x: tuple[float, ...]
    """Rising."""
    y: tuple[float, ...]
    sd: tuple[float, ...]
    """Standard deviation of each point's measurement; empty where none is given."""

    @property
    def size(self) -> float:
        """Root mean square of its ordinates, by which deviations are divided where no error is known."""
        return math.sqrt(math.fsum(value**2 for value in self.y) / len(self.y))


def measured_curves(
    top: Section, models: tuple[Chosen, ...]
) -> tuple[tuple[Chosen, ...], tuple[MeasuredCurve, ...]]:
    """Models with the points of the curves that are targets, and these curves; InputError with the line."""
    section, found, given = top.section("targets"), [], []
    for chosen in models:
        curves = chosen.model.curves if isinstance(chosen.model, FolderModel) else {}
        places = {}
        for name, curve in curves.items():
            called = f"{chosen.prefix}{name}"
            if called not in section:
                continue
            one = _measured(section, called, name, curve, chosen.prefix)
            places[name] = one.x
            found.append(one)
        own = chosen.model
        given.append(
            replace(chosen, model=own.measured_at(places))
            if places and isinstance(own, FolderModel)
            else chosen
        )
    names = {curve.name for curve in found}
    for name in section:
        if name not in names and isinstance(section.data[name], dict) and "curve" in section.data[name]:
            known = [
                f"{chosen.prefix}{name}"
                for chosen in models
                if isinstance(chosen.model, FolderModel)
                for name in chosen.model.curves
            ]
            remedy = choice(name, known, "there are:") if known else "these models give none"
            raise section.wrong(f"no model gives a curve {name}; {remedy}", name)
    return tuple(given), tuple(found)


def _measured(section: Section, called: str, name: str, curve: Curve, prefix: str) -> MeasuredCurve:
    if not isinstance(section.data[called], dict) or "curve" not in section.data[called]:
        raise section.wrong(
            f"{called} is a curve of {curve.unit} over {curve.abscissa}; write {called} = "
            '{ curve = "measured.csv" }',
            called,
        )
    table = section.section(called)
    table.only("curve", "weight", "scale", "tolerance", "sd", "noise")
    file = table.get("curve", "text")
    try:
        x, y, sd = read_curve(section.path.parent / file, curve)
    except InputError as error:
        raise table.wrong(str(error), "curve") from error
    points = tuple(f"{prefix}{point}" for point in points_of(name, len(x)))
    return MeasuredCurve(called, points, file, curve, x, y, sd)


def read_curve(path: Path, curve: Curve) -> tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]:
    """Abscissa, ordinate and errors of a CSV, in the units of the model's curve, by rising abscissa.

    Cells are divided by commas, semicolons or tabs. A third column holds the standard deviation of each
    point's measurement, in the ordinate's unit. InputError names the line.
    """
    text = text_of(path)
    first = text.partition("\n")[0]
    divider = next((d for d in (";", "\t", ",") if d in first), ",")
    rows = list(csv.reader(io.StringIO(text), delimiter=divider))
    header = rows[0] if rows else []
    heads = [_HEADER.fullmatch(cell) for cell in header[:2]]
    if len(header) not in (2, 3) or not all(heads):
        raise InputError(f"{path.name}, line 1: {FORM}")
    if len(header) == 3 and header[2].strip().partition(" ")[0] != "sd":
        raise InputError(f"{path.name}, line 1: the third column is {header[2].strip()!r}; it can only be sd")
    factors = [
        _factor(path, head[2], unit)
        for head, unit in zip(heads, (curve.abscissa_unit, curve.unit), strict=True)
        if head is not None
    ]
    factors += factors[1:] if len(header) == 3 else []
    points = []
    for number, row in enumerate(rows[1:], start=2):
        if not any(cell.strip() for cell in row):
            continue
        if len(row) != len(header):
            raise InputError(
                f"{path.name}, line {number}: {len(row)} cells where the first line has {len(header)}; "
                "correct it (a decimal comma needs ; between the cells and still is a point here)"
            )
        try:
            points.append([number_in(cell) * factor for cell, factor in zip(row, factors, strict=True)])
        except InputError as error:
            raise InputError(f"{path.name}, line {number}: {error}") from error
        if len(header) == 3 and not points[-1][2] > 0:
            raise InputError(f"{path.name}, line {number}: an sd must be positive; leave the column out")
    if not LEAST <= len(points) <= MOST:
        raise InputError(
            f"{path.name} has {len(points)} points; give {LEAST} to {MOST}, spread over the curve"
        )
    points.sort()
    x, y, *sd = (tuple(column) for column in zip(*points, strict=True))
    if len({*x}) < len(x):
        raise InputError(f"{path.name}: an abscissa stands twice; take the mean of its ordinates")
    return x, y, sd[0] if sd else ()


def _factor(path: Path, unit: str, wanted: str) -> float:
    """What a column is multiplied by to be in the model's unit."""
    if unit == wanted or (unit == "" and wanted == "-"):
        return 1.0
    base, factor = UNITS.get(unit, ("", 1.0))
    if base != wanted:
        others = [name for name, (of, _) in UNITS.items() if of == wanted]
        raise InputError(
            f"{path.name}, line 1: a column is in [{unit}], where the model's curve is in [{wanted}]; "
            f"convert it to {' or '.join([wanted, *others])}"
        )
    return factor
