"""Plausible values of a quantity in its unit, and the likely mistake behind a value outside.

The ranges are wide. They cover granular materials and their models, from foam to tungsten and from rubber to
diamond, but not the same values in other units. --force accepts a value outside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import mul

from calstudy.errors import InputError
from calstudy.records import Target
from calstudy.tomlfile import Section

INSIST = "--force"
"""Option that accepts values outside."""


@dataclass(frozen=True, slots=True)
class Mistake:
    """Values from ``low`` to ``high``, outside the range, that are likely in another unit."""

    low: float
    high: float
    unit: str
    convert: Callable[[float], float]
    """Converts a value to the unit that was meant."""


@dataclass(frozen=True, slots=True)
class Range:
    """Plausible values of a quantity, from ``low`` to ``high`` inclusive."""

    low: float
    high: float
    unit: str = "-"
    mistakes: tuple[Mistake, ...] = ()

    def objection(self, name: str, value: float) -> str:
        """What is wrong with a value, and the remedy, in one line; empty for a plausible value."""
        if self.low <= value <= self.high:
            return ""
        remedy = self.likely(value) or "correct it"
        unit = "" if self.unit == "-" else f" {self.unit}"
        return (
            f"{name} is {value:g}{unit}, outside the plausible range of {self.low:g} to {self.high:g}; "
            f"{remedy}, or insist with {INSIST}"
        )

    def likely(self, value: float) -> str:
        """The likely mistake behind a value outside, and what to write; empty if none is known."""
        looks = next((m for m in self.mistakes if m.low <= value <= m.high), None)
        return f"it looks like {looks.unit}: write {looks.convert(value):.4g}" if looks else ""


def _tangent(angle_deg: float) -> float:
    return math.tan(math.radians(angle_deg))


_DENSITY = Mistake(0.025, 25.0, "g/cm3", partial(mul, 1e3))
_FRICTION = Range(0.0, 3.0, "-", (Mistake(3.0, 71.5, "an angle of friction in degrees", _tangent),))
_DAMPING = Range(0.0, 10.0)
_COHESION = Range(0.0, 1e9, "J/m3")

RANGES: Mapping[str, Range] = {
    "DENS": Range(25.0, 25e3, "kg/m3", (_DENSITY,)),
    "MU_PP": _FRICTION,
    "MU_PW": _FRICTION,
    "RF_PP": _FRICTION,
    "RF_PW": _FRICTION,
    "CED_PP": _COHESION,
    "CED_PW": _COHESION,
    "YM": Range(
        1e6,
        2e12,
        "Pa",
        (Mistake(0.01, 400.0, "GPa", partial(mul, 1e9)), Mistake(400.0, 1e6, "MPa", partial(mul, 1e6))),
    ),
    "angle_of_repose_deg": Range(2.0, 90.0, "deg", (Mistake(0.035, 1.57, "radians", math.degrees),)),
    "bulk_density": Range(10.0, 16e3, "kg/m3", (Mistake(0.01, 10.0, "g/cm3", partial(mul, 1e3)),)),
    "WRL": Range(0.0, 1.0, "-", (Mistake(1.0, 100.0, "percent", partial(mul, 1e-2)),)),
    "samples_per_parameter": Range(1, 100),
    "budget": Range(1, 10_000),
    "gravity": Range(0.01, 5e3, "m/s2", (Mistake(5e3, 5e4, "mm/s2", partial(mul, 1e-3)),)),
    "rolling_viscous_damping_pp": _DAMPING,
    "rolling_viscous_damping_pw": _DAMPING,
    "radius": Range(1e-7, 0.5, "m", (Mistake(0.5, 100.0, "mm", partial(mul, 1e-3)),)),
}
"""Ranges by name. The cost allows any WRL from 0. At 1, the largest in the paper, the shortest time-step of
the box costs as much as a response that is 100 % off its target (Eq. 10)."""


def require_plausible(
    values: Mapping[str, float], insist: bool, where: str = "", ranges: Mapping[str, Range] = RANGES
) -> None:
    """Raise InputError if a value is outside its range in ``ranges``, unless the user insists."""
    for name, value in values.items():
        if name in ranges and not insist and (objection := ranges[name].objection(name, value)):
            raise InputError(f"{where}{objection}")


def require_plausible_file(
    top: Section,
    ranges: Sequence[Mapping[str, Range]],
    bounds: Mapping[str, tuple[float, float]],
    target: Target,
) -> None:
    """Raise InputError, with the line, if a value in a calibration file is implausible.

    ``ranges`` has the ranges of each model's parameters and responses, by their names in the file; ``bounds``
    the ends of each parameter's interval, or its value twice.
    """
    for name in ("WRL", "samples_per_parameter", "budget"):
        if name in top:
            _refuse(top, RANGES[name], name, float(top.data[name]), name)
    for model in top.sections("models"):
        fixed = model.section("fixed")
        for name in fixed:
            if name in RANGES:
                _refuse(fixed, RANGES[name], name, float(fixed.data[name]), name)
    parameters, responses = top.section("parameters"), top.section("targets")
    for model_ranges in ranges:
        for name, of in model_ranges.items():
            for value in bounds.get(name, ()):
                _refuse(parameters, of, name, value, name)
            if name in target.values and name not in target.minimised:
                _refuse(responses, of, f"the target of {name}", target.values[name], name)
    for name, value in target.values.items():
        given = responses.data.get(name)  # a curve's points have no line of their own
        if name in target.scale or value == 0:
            continue
        for what in ("tolerance", "noise", "sd"):
            spread = float(given.get(what, 0.0)) if isinstance(given, dict) else 0.0
            if spread >= abs(value):
                raise responses.wrong(
                    f"the {what} of {name} is {spread:g}, as large as its target of {value:g}; "
                    f"it is in the same unit; correct it, or insist with {INSIST}",
                    name,
                )


def _refuse(section: Section, of: Range, called: str, value: float, key: str) -> None:
    if objection := of.objection(called, value):
        raise section.wrong(objection, key)
