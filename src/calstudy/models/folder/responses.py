"""Responses of a model's folder: what each is, and where a run leaves it."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from calstudy.errors import InputError
from calstudy.models.find import RESPONSE_KEYS
from calstudy.models.folder.content import NAME, inside, stale
from calstudy.models.measurement import check_drawing
from calstudy.models.readers import Command, NumberInFile, NumberInLog, PythonFunction, Reader, Silhouette
from calstudy.plausible import RANGES, Range
from calstudy.rayleigh import Particles
from calstudy.records import RAYLEIGH_TIME_STEP, Response
from calstudy.tomlfile import Section


@dataclass(frozen=True, slots=True)
class Responses:
    """What [responses] of model.toml says, by name."""

    readers: Mapping[str, Reader]
    responses: tuple[Response, ...]
    plausible: Mapping[str, Range]


def responses_in(
    responses: Section,
    files: Mapping[str, bytes],
    parameters: Mapping[str, str],
    particles: Particles | None,
    log: str,
) -> Responses:
    """Responses of the section; InputError with the line for what cannot be read."""
    readers: dict[str, Reader] = {}
    plausible: dict[str, Range] = {}
    given = []
    for name in responses:
        one = responses.section(name)
        if not NAME.fullmatch(name) or name == RAYLEIGH_TIME_STEP:
            raise one.wrong(f"{name} cannot be a response's name; use letters, digits and _")
        unit = one.get("unit", "text")
        if "plausible" in one:
            plausible[name] = range_in(one, unit)
        elif name in RANGES and RANGES[name].unit == unit:
            plausible[name] = RANGES[name]
        readers[name] = _reader(one, files, particles, log)
        for output in readers[name].files:
            if not inside(output):
                raise one.wrong(f"{output} leads out of the run's directory; name a file in it")
            if old := stale(output, files):
                raise one.wrong(
                    f"the folder holds {old}, which {name} is read from, so an old result could be "
                    "taken for a new one; remove it from the folder"
                )
        divisor = one.get("proportional_to", "text") if "proportional_to" in one else None
        if divisor is not None and divisor not in parameters:
            raise one.wrong(f"{divisor} is none of the parameters", "proportional_to")
        told = {key: one.get(key, "text") for key in RESPONSE_KEYS if key in one}
        given.append(Response(name, **told))
    if not readers:
        raise responses.wrong("[responses] names none; add one")
    return Responses(readers, tuple(given), plausible)


def range_in(section: Section, unit: str) -> Range:
    """The plausible range that a section gives."""
    ends = [section.typed(end, "number", "plausible") for end in section.get("plausible", "list")]
    if len(ends) != 2 or not ends[0] < ends[1]:
        raise section.wrong("plausible: write [lowest, highest]", "plausible")
    return Range(ends[0], ends[1], unit)


def _words(section: Section, key: str) -> tuple[str, ...]:
    return tuple(section.typed(word, "text", key, k) for k, word in enumerate(section.get(key, "list")))


def _reader(section: Section, files: Mapping[str, bytes], particles: Particles | None, log: str) -> Reader:
    ways = [way for way in ("file", "log", "python", "command", "silhouette") if way in section]
    if len(ways) != 1:
        raise section.wrong(
            f"response {section.keys[-1]} is read in {len(ways)} ways; "
            "give one of file, log, python, command, silhouette"
        )
    way, others = ways[0], (*RESPONSE_KEYS, "plausible")
    if way == "command":
        section.only(way, "reads", *others)
        words, outputs = _words(section, way), _words(section, "reads")
        if not words:
            raise section.wrong("command has no words; write ['python3', 'measure.py', '{directory}']", way)
        return Command(words, str(section.keys[-1]), outputs, tuple(word for word in words if word in files))
    what = section.get(way, "text")
    if way == "log":
        section.only(way, *others)
        return NumberInLog(what, log)
    if way == "python":
        section.only(way, "reads", *others)
        source, _, function = what.partition(":")
        if source not in files or not function.isidentifier():
            raise section.wrong(f"{what!r} is no FILE:FUNCTION of the folder; write 'measure.py:angle'", way)
        outputs = _words(section, "reads")
        text = files[source].decode(errors="replace")
        try:
            compile(text, source, "exec")
        except SyntaxError as error:
            raise section.wrong(f"{source}, line {error.lineno}: {error.msg}; correct it", way) from error
        if not re.search(rf"^(def {function}\b|{function}\s*=)", text, re.MULTILINE):
            raise section.wrong(f"{source} has no function {function}; correct the name", way)
        return PythonFunction(text, function, source, outputs)
    if not inside(what):
        raise section.wrong(f"{what} leads out of the run's directory; name a file in it", way)
    if way == "file":
        section.only(way, "line", "column", *others)
        places = [section.get(k, "whole number") if k in section else -1 for k in ("line", "column")]
        if 0 in places:
            raise section.wrong("lines and columns count from 1, or from the end as -1, -2; 0 is none")
        return NumberInFile(what, *places)
    section.only(way, "pixels_per_mm", "sphere_diameter", *others)
    if particles is None:
        raise section.wrong("a silhouette is drawn of particles of a known radius; add [particles]", way)
    defaults = {"pixels_per_mm": 4.0, "sphere_diameter": 0.050}
    numbers = [section.get(k, "number") if k in section else default for k, default in defaults.items()]
    try:
        if not math.isnan(particles.diameter):
            check_drawing(particles.diameter, *numbers)
    except InputError as error:
        raise section.wrong(
            str(error), "pixels_per_mm" if "pixels" in str(error) else "sphere_diameter"
        ) from error
    return Silhouette(what, particles.diameter, *numbers)
