"""The parameters of a calibration's file: intervals, lists, constants, and what follows from others."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

from calstudy.errors import InputError
from calstudy.models.folder import FolderModel
from calstudy.parameters import Parameter, Space
from calstudy.parameters.expression import Expression
from calstudy.study.definition.models import Chosen
from calstudy.tomlfile import Section
from calstudy.written import DECIMAL_COMMA, choice

SCALES = ("linear", "log")
MOST_CORNERS = 2**12
"""Corners of the box at which what follows from others is checked."""


def space_of(top: Section, models: Sequence[Chosen]) -> Space:
    """All parameters of the models, with what the file says of each; InputError with the line."""
    section = top.section("parameters")
    texts = {
        name: given
        for chosen in models
        if isinstance(chosen.model, FolderModel)
        for name, given in chosen.model.texts.items()
    }
    units: dict[str, str] = {}
    for chosen in models:
        for name, unit in chosen.parameters.items():
            if units.setdefault(name, unit) != unit:
                first = next(other.label for other in models if name in other.parameters)
                raise section.wrong(
                    f"{name} is in {units[name]} for {first} and in {unit} for {chosen.label}; "
                    "give both models one unit, or the parameter two names",
                    name,
                )
    if "constraints" in section and "constraints" not in units:
        raise section.wrong(
            "constraints stand before the first section of the file; move them", "constraints"
        )
    section.only(*units)
    parameters = []
    for name, unit in units.items():
        if name not in section:
            takers = " and ".join(chosen.label for chosen in models if name in chosen.parameters)
            raise section.wrong(
                f"[parameters] lacks {name}, which {takers} takes; give an interval [lower, upper] to "
                "calibrate it, or a number to fix it"
            )
        parameters.append(_parameter(section, name, unit, texts.get(name, ())))
    calibrated = tuple(p.name for p in parameters if p.constant is None and p.formula is None)
    if not calibrated:
        raise section.wrong("no parameter is calibrated; give at least one an interval [lower, upper]")
    for p in parameters:
        if p.formula is None:
            _require_physics(section, p, models)
        elif strange := set(p.formula.names) - {other.name for other in parameters if other.formula is None}:
            raise section.wrong(
                f"{p.name} is {p.formula.text!r}; give an interval [lower, upper] or a number, or what it "
                f"follows from: {min(strange)} is no parameter with a value or interval of its own",
                p.name,
            )
    space = Space(tuple(parameters), calibrated)
    _require_followers(section, space, models)
    return space


def content_of(p: Parameter) -> Any:
    """What a study keeps of a parameter, in JSON's types."""
    if p.formula is not None:
        return p.formula.text
    if p.constant is not None:
        return p.constant
    if p.values:
        return ["values", *p.values]
    kinds = {"integer": p.is_whole, "log": p.is_log}
    return [p.lower, p.upper, *(kind for kind, is_so in kinds.items() if is_so)]


def _parameter(section: Section, name: str, unit: str, texts: tuple[str, ...]) -> Parameter:
    """A parameter; ``texts`` are what the model's script is given for 1, 2 and so on."""
    given = section.data[name]
    table = section.section(name) if isinstance(given, dict) else None
    if isinstance(given, str) and texts:
        return _constant(name, unit, _choice(section, given, texts, name), texts)
    if table is not None and "values" in table:
        return _listed(table, name, unit, texts)
    if texts:
        raise section.wrong(
            f"{name} is a choice; give one of {', '.join(texts)}, or {{ values = ['{texts[0]}', ...] }}", name
        )
    if isinstance(given, str) and not DECIMAL_COMMA.fullmatch(given.strip()):
        try:
            return Parameter(name, unit, math.nan, math.nan, None, formula=Expression(given))
        except InputError as error:
            raise section.wrong(f"{name}: {error}", name) from error
    is_whole = is_log = False
    if table is not None:
        table.only("interval", "integer", "scale")
        given, is_whole = table.get("interval", "list"), table.data.get("integer", False)
        if not isinstance(is_whole, bool):
            raise table.wrong(f"integer is {is_whole!r}; give true or false", "integer")
        scale = table.get("scale", "text") if "scale" in table else "linear"
        if scale not in SCALES:
            raise table.wrong(f"scale is {scale!r}; {choice(scale, SCALES)}", "scale")
        is_log = scale == "log"
        if is_log and is_whole:
            raise table.wrong("integer and scale = 'log' go not together; list its values", "scale")
    if isinstance(given, list):
        if len(given) != 2:
            point = ", and decimals with a decimal point" if len(given) > 2 else ""
            raise section.wrong(f"{name} has {len(given)} ends; write [lower, upper]{point}", name)
        lower, upper = (_end(section, name, k, end) for k, end in enumerate(given))
        if not lower < upper:
            what = f"the interval of {name} goes from {lower:g} to {upper:g}; write the smaller one first"
            raise section.wrong(what, name)
        if is_whole and not (float(lower).is_integer() and float(upper).is_integer()):
            raise section.wrong(f"{name} counts, so its interval must begin and end with whole numbers", name)
        if is_log and lower <= 0:
            raise section.wrong(f"{name} reaches {lower:g}; a logarithmic interval must be positive", name)
        return Parameter(name, unit, lower, upper, None, is_whole=is_whole, is_log=is_log)
    if isinstance(given, bool) or not isinstance(given, int | float):
        comma = DECIMAL_COMMA.fullmatch(given.strip()) if isinstance(given, str) else None
        point = f"; it has a decimal comma; write {comma[1]}.{comma[2]} without quotes" if comma else ""
        raise section.wrong(f"{name} is {given!r}; give an interval [lower, upper] or a number{point}", name)
    return _constant(name, unit, section.typed(given, "number", name))


def _end(section: Section, name: str, k: int, end: Any) -> float:
    """An end of an interval; InputError with its place in it."""
    try:
        return float(section.typed(end, "number", name))
    except InputError as error:
        error.keys = (*error.keys, k)
        raise


def _constant(name: str, unit: str, value: float, texts: tuple[str, ...] = ()) -> Parameter:
    values = tuple(map(float, range(1, len(texts) + 1)))
    return Parameter(name, unit, value, value, value, values=values, texts=texts)


def _listed(table: Section, name: str, unit: str, texts: tuple[str, ...]) -> Parameter:
    """A parameter with a list of values; texts are numbered as the model has them."""
    table.only("values")
    given = table.get("values", "list")
    if texts:
        values = [
            _choice(table, table.typed(text, "text", "values", k), texts, "values")
            for k, text in enumerate(given)
        ]
    else:
        values = [table.typed(number, "number", "values", k) for k, number in enumerate(given)]
    if len(values) < 2 or len({*values}) < len(values):
        raise table.wrong(f"{name}: give two or more different values", "values")
    ordered = tuple(values) if texts else tuple(sorted(map(float, values)))
    chosen = tuple(texts[round(value) - 1] for value in ordered) if texts else ()
    return Parameter(name, unit, min(ordered), max(ordered), None, values=ordered, texts=chosen)


def _choice(section: Section, text: str, texts: tuple[str, ...], key: str) -> float:
    if text not in texts:
        raise section.wrong(f"{text!r} is none of the model's; {choice(text, texts)}", key)
    return float(texts.index(text) + 1)


def _require_followers(section: Section, space: Space, models: Sequence[Chosen]) -> None:
    """Refuse what follows from others where it has no value, or none that the model can have, at a corner."""
    follow = [p.name for p in space.parameters if p.formula is not None]
    if not follow:
        return
    box = space.box
    for corner in itertools.islice(itertools.product(*zip(box.lower, box.upper, strict=True)), MOST_CORNERS):
        values = space.complete(corner)
        for name in follow:
            try:
                if not math.isfinite(values[name]):
                    raise InputError(f"{name} has no finite value")
                for chosen in models:
                    if name in chosen.parameters:
                        chosen.model.check({name: values[name]})
            except InputError as error:
                at = ", ".join(f"{p.name} = {values[p.name]:g}" for p in space.free)
                raise section.wrong(f"{error}, at {at}", name) from error


def _require_physics(section: Section, p: Parameter, models: Sequence[Chosen]) -> None:
    """Refuse values that a model cannot have."""
    for chosen in models:
        model, particles = chosen.model, chosen.model.particles
        if p.name not in chosen.parameters:
            continue
        material = () if particles is None else (particles.density, particles.youngs_modulus)
        positive = (*material, *chosen.proportional.values())
        if p.name in positive and p.lower <= 0:
            raise section.wrong(f"{p.name} reaches {p.lower:g}; it must be positive", p.name)
        try:
            for value in {p.lower, p.upper} if isinstance(model, FolderModel) else {p.lower}:
                model.check({p.name: value})
        except InputError as error:
            raise section.wrong(str(error), p.name) from error
