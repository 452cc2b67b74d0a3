"""The targets of a calibration's file: what was measured, how exactly, and what is to be minimised."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from calstudy.records import Target
from calstudy.study.definition.curves import MeasuredCurve
from calstudy.study.definition.models import Chosen
from calstudy.tomlfile import Section
from calstudy.written import choice

KEYS = ("value", "values", "sd", "scale", "weight", "minimise", "tolerance", "noise")
AT_LEAST: dict[str, tuple[Callable[[float], bool], str]] = {
    "tolerance": (lambda number: number >= 0, "give 0 or more"),
    "noise": (lambda number: number > 0, "it must be positive"),
    "sd": (lambda number: number > 0, "it must be positive; without a known error leave it out"),
    "scale": (lambda number: number > 0, "it must be positive"),
    "weight": (
        lambda number: number > 0,
        "it must be positive; remove the target to leave it out",
    ),
}
"""Of each number beside a value: what it must be, and the remedy."""


@dataclass(frozen=True, slots=True)
class _One:
    """What the file says of one response."""

    value: float
    numbers: dict[str, float]
    """Of `AT_LEAST`, those that are given; ``sd`` also where repeats gave it."""
    is_minimised: bool = False


def targets_of(
    top: Section, models: Sequence[Chosen], curves: Sequence[MeasuredCurve] = ()
) -> tuple[Target, dict[str, float], dict[str, float]]:
    """Targets, tolerances, and the noise given in the file; InputError with the line.

    A curve's points have a share of its weight each, so that it weighs as one response.
    """
    units = {name: unit for chosen in models for name, unit in chosen.responses.items()}
    section = top.section("targets")
    of_curves = {point: one for curve in curves for point, one in _points(section, curve).items()}
    for name in section:
        if name not in units and name not in {curve.name for curve in curves}:
            raise section.wrong(
                f"no model gives a response {name}; {choice(name, units, 'there are:')}", name
            )
    found = {
        name: of_curves[name] if name in of_curves else _one(section, name)
        for name in units
        if name in section or name in of_curves
    }
    if not found:
        raise section.wrong(f"[targets] names none; give at least one of {', '.join(units)}")
    exact = [name for name, one in found.items() if not {"sd", "scale"} & set(one.numbers)]
    known = [name for name, one in found.items() if "sd" in one.numbers]
    if exact and known:
        raise section.wrong(
            f"{known[0]} has an error and {exact[0]} has none, so the two cannot be weighed against each "
            f"other; give {exact[0]} sd = ..., values = [...], or scale = ..., the deviation that counts as "
            "much as one standard error",
            exact[0],
        )

    def each(key: str) -> dict[str, float]:
        return {name: one.numbers[key] for name, one in found.items() if key in one.numbers}

    target = Target(
        {name: one.value for name, one in found.items()},
        "set",
        " and ".join(
            [
                *(_in_words(name, one, units[name]) for name, one in found.items() if name not in of_curves),
                *(f"{curve.name} at {len(curve.x)} points of {curve.file}" for curve in curves),
            ]
        ),
        sd=each("sd"),
        scale=each("scale"),
        weight=each("weight"),
        minimised=tuple(name for name, one in found.items() if one.is_minimised),
    )
    return target, dict.fromkeys(found, 0.0) | each("tolerance"), each("noise")


def _points(section: Section, curve: MeasuredCurve) -> dict[str, _One]:
    """What is said of each point of a curve."""
    table = section.section(curve.name)
    numbers = _numbers(table, curve.name)
    if "sd" in numbers or "noise" in numbers:
        raise table.wrong(f"the points of {curve.name} have their own errors: a column sd in {curve.file}")
    if curve.sd and "scale" in numbers:
        raise table.wrong(f"{curve.name} has errors and a scale, and either weighs it; remove one", "scale")
    numbers["weight"] = numbers.get("weight", 1.0) / len(curve.x)
    scale = {} if curve.sd else {"scale": numbers.get("scale", curve.size)}
    return {
        point: _One(value, numbers | scale | ({"sd": curve.sd[k]} if curve.sd else {}))
        for k, (point, value) in enumerate(zip(curve.points, curve.y, strict=True))
    }


def _numbers(table: Section, name: str) -> dict[str, float]:
    """Numbers beside a value; InputError for one that cannot be."""
    numbers = {key: table.get(key, "number") for key in AT_LEAST if key in table}
    for key, number in numbers.items():
        is_right, remedy = AT_LEAST[key]
        if not is_right(number):
            raise table.wrong(f"the {key} of {name} is {number:g}; {remedy}", key)
    return numbers


def _one(section: Section, name: str) -> _One:
    if not isinstance(section.data[name], dict):
        one = _One(section.get(name, "number"), {})
    else:
        one = _of_table(section.section(name), name)
    if one.value == 0 and not {"sd", "scale"} & set(one.numbers):
        raise section.wrong(
            f"the target of {name} is 0, and Eq. 9 divides by it; write {name} = {{ value = 0, scale = ... }}"
            " with the deviation that counts as much as another response that is 100 % off, or sd = ... with "
            "the measurement's error",
            name,
        )
    return one


def _of_table(table: Section, name: str) -> _One:
    table.only(*KEYS)
    numbers = _numbers(table, name)
    if {"sd", "scale"} <= set(numbers):
        raise table.wrong(f"{name} has an sd and a scale, and either weighs it; remove one", "scale")
    minimise = table.data.get("minimise", False)
    if not isinstance(minimise, bool):
        raise table.wrong(f"minimise is {minimise!r}; give true or false", "minimise")
    if minimise:
        if "sd" in numbers or "values" in table or "scale" not in numbers:
            raise table.wrong(
                f"{name} is minimised, so it has no measured values and no error; give its scale: the change "
                "that counts as much as another response that is 100 % off",
                "minimise",
            )
        return _One(table.get("value", "number") if "value" in table else 0.0, numbers, is_minimised=True)
    if "values" not in table:
        return _One(table.get("value", "number"), numbers)
    if "value" in table or {"sd", "scale"} & set(numbers):
        raise table.wrong(
            f"{name} has values, of which the mean and its error are taken; remove value, sd and scale",
            "values",
        )
    return _repeats(table, name, numbers)


def _repeats(table: Section, name: str, numbers: dict[str, float]) -> _One:
    """Mean of repeated measurements, and the standard deviation of the mean."""
    values = [table.typed(value, "number", "values") for value in table.get("values", "list")]
    if len(values) < 2:
        raise table.wrong(
            f"{name} has {len(values)} of values; give two or more, or value = ... with its sd", "values"
        )
    error = statistics.stdev(values) / len(values) ** 0.5
    if not error > 0:
        raise table.wrong(
            f"the values of {name} are all {values[0]:g}, which tells no error; write value = {values[0]:g} "
            "with the instrument's sd",
            "values",
        )
    return _One(statistics.fmean(values), {**numbers, "sd": error})


def _in_words(name: str, one: _One, unit: str) -> str:
    if one.is_minimised:
        return f"least {name}"
    error = f" ± {one.numbers['sd']:.2g}" if "sd" in one.numbers else ""
    return f"{name} = {one.value:.5g}{error} {unit}"
