"""``[holdout]``: responses that are not calibrated to, with a criterion that is fixed before any run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from calstudy.study.definition.models import Chosen
from calstudy.tomlfile import Section
from calstudy.written import choice

HOLDOUT = "holdout"
"""Section of the file, and key of the study's settings."""


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A response with its measured value: passed if the mean at the optimum is within the tolerance of it."""

    response: str
    unit: str
    value: float
    tolerance: float

    @property
    def settings(self) -> dict[str, Any]:
        """What a study stores of it: another criterion is another study."""
        return {"value": self.value, "tolerance": self.tolerance}


def holdout_of(top: Section, models: Sequence[Chosen]) -> tuple[HeldOut, ...]:
    """What the file holds out; InputError with the line."""
    section, targets = top.section(HOLDOUT), top.section("targets")
    units = {name: unit for chosen in models for name, unit in chosen.responses.items()}
    found = []
    for name in section:
        if name in targets:
            raise section.wrong(
                f"{name} is a target, too; what is calibrated to cannot be held out: remove one",
                name,
            )
        if name not in units:
            raise section.wrong(
                f"no model gives a response {name}; {choice(name, units, 'there are:')}", name
            )
        one = section.section(name)
        one.only("value", "tolerance")
        value, tolerance = one.get("value", "number"), one.get("tolerance", "number")
        if tolerance <= 0:
            raise one.wrong(f"the tolerance of {name} is {tolerance:g}; it must be positive", "tolerance")
        found.append(HeldOut(name, units[name], value, tolerance))
    return tuple(found)
