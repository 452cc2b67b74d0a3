"""The one list of tables and figures: it feeds ``calstudy.analysis``, ``--only``, the help and the report.

A new table or figure is a module with ``TITLE``, ``notes`` and a function of its own name (a table also has
``COLUMNS``), and a line here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from types import ModuleType
from typing import Any


class Kind(Enum):
    """Kind of an exhibit."""

    TABLE = "table"
    FIGURE = "figure"


class Of(Enum):
    """What an exhibit is made from, in words."""

    STUDY = "any study"
    CONFIRMED = "a study whose DEM optima were run again"
    TESTS = "a plan with the number of material tests as a factor"
    REPLICATES = "a study that was replicated on an emulator"
    HALVES = "replicates of the full factorial"
    REPLICATES_BESIDE = "replicates, beside those of another study"
    NUMBERS_BESIDE = "a DEM model's rows, beside the numbers of an emulator's replicates"
    ROWS_BESIDE = "a DEM model's rows, beside an emulator's replicates"


@dataclass(frozen=True, slots=True)
class Exhibit:
    """A table or figure of a study."""

    name: str
    folder: str
    """Package below ``calstudy.analysis``, dotted."""
    kind: Kind
    of: Of = Of.STUDY

    @property
    def module(self) -> ModuleType:
        """Its module. It is loaded on first use."""
        return import_module(f"calstudy.analysis.{self.folder}.{self.name}")

    @property
    def function(self) -> Callable[..., Any]:
        """The function that makes it from a study."""
        function: Callable[..., Any] = getattr(self.module, self.name)
        return function


EXHIBITS = (
    Exhibit("claims", "ledger", Kind.TABLE),
    Exhibit("table1", "tables", Kind.TABLE),
    Exhibit("table2", "tables", Kind.TABLE),
    Exhibit("table3", "tables", Kind.TABLE),
    Exhibit("table4", "tables", Kind.TABLE),
    Exhibit("table5", "tables", Kind.TABLE),
    Exhibit("table6", "tables", Kind.TABLE),
    Exhibit("effects", "tables", Kind.TABLE),
    Exhibit("second_phase", "tables", Kind.TABLE),
    Exhibit("confirmed", "tables", Kind.TABLE, Of.CONFIRMED),
    Exhibit("partial_correlations", "tables", Kind.TABLE),
    Exhibit("table_b1", "tables", Kind.TABLE),
    *(Exhibit(f"figure{k}", "figures", Kind.FIGURE) for k in range(1, 10)),
    Exhibit("by_tests", "by_tests", Kind.TABLE, Of.TESTS),
    Exhibit("by_tests_figure", "by_tests", Kind.FIGURE, Of.TESTS),
    Exhibit("bands", "replicates", Kind.TABLE, Of.REPLICATES),
    Exhibit("bands_claims", "replicates", Kind.TABLE, Of.REPLICATES),
    Exhibit("coverage", "replicates", Kind.TABLE, Of.REPLICATES),
    Exhibit("half_fraction", "replicates", Kind.TABLE, Of.HALVES),
    Exhibit("bands_beside", "replicates", Kind.TABLE, Of.REPLICATES_BESIDE),
    Exhibit("bands_figure", "replicates", Kind.FIGURE, Of.REPLICATES),
    Exhibit("numbers_beside", "replicates", Kind.TABLE, Of.NUMBERS_BESIDE),
    Exhibit("numbers_beside_figure", "replicates", Kind.FIGURE, Of.NUMBERS_BESIDE),
    Exhibit("rows_beside", "replicates", Kind.TABLE, Of.ROWS_BESIDE),
    Exhibit("rows_beside_figure", "replicates", Kind.FIGURE, Of.ROWS_BESIDE),
)
"""All exhibits, in the order of the report."""

BY_NAME = {exhibit.name: exhibit for exhibit in EXHIBITS}


def names(*of: Of, kind: Kind | None = None) -> tuple[str, ...]:
    """Names of the exhibits made from ``of`` (by default from anything), in order."""
    return tuple(e.name for e in EXHIBITS if (not of or e.of in of) and kind in (None, e.kind))


def names_in_words() -> str:
    """All names for the help, by what they are made from: ``of any study: claims, table1 to table6, ...``."""
    return "; ".join(f"of {of.value}: {', '.join(_series(names(of)))}" for of in Of)


def _series(names: Sequence[str]) -> list[str]:
    """Names, with numbered series joined: ``table1 to table6``."""
    found: list[list[str]] = []
    for name in names:
        stem = name.rstrip("0123456789")
        if found and stem != name and found[-1][-1] == f"{stem}{int(name.removeprefix(stem)) - 1}":
            found[-1].append(name)
        else:
            found.append([name])
    return [series[0] if len(series) == 1 else f"{series[0]} to {series[-1]}" for series in found]
