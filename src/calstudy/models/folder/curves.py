"""Curves that a run leaves in a file of columns, and their values where somebody measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from calstudy.engines.process import output_text
from calstudy.errors import RunError
from calstudy.models.folder.content import NAME, inside
from calstudy.parameters import Array
from calstudy.tomlfile import Section

SLACK = 0.01
"""Share of a curve's reach by which a place may lie beyond an end that the run met a step too early."""
CURVES = "curves"
"""Table of model.toml."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Where a curve stands in a file of columns, which count from 1."""

    file: str
    x: int
    y: int
    where: tuple[int, float] | None = None
    """Column and the number that it has in the curve's lines; None for all lines."""
    strain: str = ""
    """``x`` or ``y`` where that column is the height of a bed, which is read as 1 - height / first height."""

    def read(self, directory: Path) -> tuple[Array, Array]:
        """Abscissa and ordinate (n,), as far as the abscissa grows; RunError for a file without them."""
        lines = [line.split("#")[0] for line in output_text(directory / self.file).splitlines()]
        try:
            table = np.array([line.split() for line in lines if line.strip()], float)
            if self.where is not None:
                table = table[table[:, self.where[0] - 1] == self.where[1]]
            x, y = table[:, self.x - 1], table[:, self.y - 1]
        except (ValueError, IndexError) as error:
            raise RunError(f"{self.file}: its lines have not the columns of the curve") from error
        if not len(x):
            raise RunError(f"{self.file}: no line is of the curve")
        x = 1 - x / x[0] if self.strain == "x" else x
        y = 1 - y / y[0] if self.strain == "y" else y
        grows = np.diff(np.maximum.accumulate(x), prepend=-np.inf) > 0
        return x[grows], y[grows]


@dataclass(frozen=True, slots=True)
class PointOfCurve:
    """The ordinate of a curve where its abscissa first has a value; straight lines between the points."""

    way: ClassVar[str] = "curve"
    columns: Columns
    at: float

    @property
    def files(self) -> tuple[str, ...]:
        """The file."""
        return (self.columns.file,)

    @property
    def sources(self) -> tuple[str, ...]:
        """None."""
        return ()

    def read(self, directory: Path) -> float:
        """The ordinate; RunError where the run's curve does not reach so far."""
        x, y = self.columns.read(directory)
        slack = SLACK * (x[-1] - x[0])
        if not x[0] - slack <= self.at <= x[-1] + slack:
            raise RunError(
                f"{self.columns.file}: the curve goes from {x[0]:.4g} to {x[-1]:.4g} and has no value at "
                f"{self.at:g}; leave that point out, or run the test farther"
            )
        return float(np.interp(self.at, x, y))

    def shown(self, directory: Path) -> str:
        """The place, and how far the curve goes."""
        x, _ = self.columns.read(directory)
        return f"{self.columns.file}: at {self.at:g} of {x[0]:.4g} to {x[-1]:.4g}"


@dataclass(frozen=True, slots=True)
class Curve:
    """A curve that a model gives, as [curves.NAME] of model.toml says."""

    unit: str
    abscissa: str
    abscissa_unit: str
    columns: Columns


def curves_in(top: Section) -> dict[str, Curve]:
    """Curves of a model.toml, by name; InputError with the line."""
    found = {}
    for name in top.section(CURVES):
        one = top.section(CURVES).section(name)
        one.only("unit", "abscissa", "abscissa_unit", "file", "x", "y", "where", "strain")
        if not NAME.fullmatch(name):
            raise one.wrong(f"{name} cannot be a curve's name; use letters, digits and _")
        file = one.get("file", "text")
        if not inside(file):
            raise one.wrong(f"{file} leads out of the run's directory; name a file in it", "file")
        x, y = (one.get(key, "whole number") for key in ("x", "y"))
        where = one.get("where", "list") if "where" in one else None
        if where is not None and len(where) != 2:
            raise one.wrong("where: write [column, number], such as [2, 0]", "where")
        places = [x, y, *(where[:1] if where else ())]
        if min(places) < 1:
            raise one.wrong("columns count from 1")
        strain = one.get("strain", "text") if "strain" in one else ""
        if strain not in ("", "x", "y"):
            raise one.wrong(f"strain is {strain!r}; it is the column that is a height: x or y", "strain")
        columns = Columns(file, x, y, (int(where[0]), float(where[1])) if where else None, strain)
        unit, abscissa, abscissa_unit = (
            one.get(key, "text") for key in ("unit", "abscissa", "abscissa_unit")
        )
        found[name] = Curve(unit, abscissa, abscissa_unit, columns)
    return found


def points_of(name: str, count: int) -> tuple[str, ...]:
    """Names of the responses that are the points of a curve."""
    return tuple(f"{name}_{k:02d}" for k in range(1, count + 1))
