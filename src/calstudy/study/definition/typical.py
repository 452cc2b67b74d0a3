"""Typical values of common materials with their sources: hints for a calibration's file, not bounds."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from importlib.resources import files


@dataclass(frozen=True, slots=True)
class Typical:
    """Values of a quantity of a material, from ``low`` to ``high``, in its SI unit or degrees."""

    material: str
    quantity: str
    low: float
    high: float
    source: str

    def __str__(self) -> str:
        reach = f"{self.low:.4g}" if self.low == self.high else f"{self.low:.4g} to {self.high:.4g}"
        return f"{self.material}: {reach} ({self.source})"


def typical() -> dict[str, dict[str, Typical]]:
    """What is known of each material, by its name and the quantity's."""
    found: dict[str, dict[str, Typical]] = {}
    with (files("calstudy.study.definition") / "materials.csv").open() as file:
        for line in csv.DictReader(file):
            low, high = float(line["low"]), float(line["high"])
            one = Typical(line["material"], line["quantity"], low, high, line["source"])
            found.setdefault(one.material, {})[one.quantity] = one
    return found


def interval_for(value: float, known: Typical | None, widened: float = 0.2) -> list[float]:
    """Interval to begin with for a parameter that was fixed: what is known, or its surroundings.

    ``widened`` is the share of the value that it reaches to both sides.
    """
    if known is not None and known.low < known.high:
        return [known.low, known.high]
    return sorted([value * (1 - widened), value * (1 + widened)])
