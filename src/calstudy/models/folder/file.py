"""model.toml read: which parameters a model's folder takes, which program runs it, and what it gives."""

from __future__ import annotations

import logging
import re
import shlex
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

from calstudy.disk.first_use import is_first_use
from calstudy.disk.kept import MOST_OF_RUN
from calstudy.engines.choose import DEFAULT, profile_of
from calstudy.engines.program import OUTPUT, Profile
from calstudy.errors import InputError
from calstudy.models.fidelity import fixed_in
from calstudy.models.find import FILE, NOISE_FILE, SHIPPED, model_folder
from calstudy.models.folder.content import NAME, PLACEHOLDER, files_of, placeholders, stale
from calstudy.models.folder.curves import curves_in
from calstudy.models.folder.handing import command_in, handing_in
from calstudy.models.folder.model import FolderModel
from calstudy.models.folder.responses import range_in, responses_in
from calstudy.models.trial.script import Script, objections
from calstudy.plausible import RANGES, Range
from calstudy.rayleigh import Particles
from calstudy.tomlfile import Section, read_toml
from calstudy.written import text_of

log = logging.getLogger(__name__)
KEYS = (
    "program",
    "command",
    "version",
    "ranks",
    "threads",
    "files",
    "links",
    "template",
    "keep",
    "script",
    "include",
    "style",
    "seeds",
    "finished",
    "expected_seconds",
    "ratio",
    "parameters",
    "reference",
    "fixed",
    "fidelity",
    "particles",
    "responses",
    "curves",
)


def load_folder(
    folder: Path,
    insist: bool = False,
    fidelity: str | None = None,
    changes: Mapping[str, float] | None = None,
    ranks: int | None = None,
) -> FolderModel:
    """Read a model's folder; InputError with the line of model.toml for all that is wrong with it.

    It refuses implausible particles, too, unless ``insist`` is set. Without a fidelity its first one is
    meant; ``changes`` are numbers in place of those that it holds fixed, ``ranks`` stand in place of its own.
    """
    top = read_toml(folder / FILE)
    top.only(*KEYS)
    fixed = fixed_in(top, fidelity, changes)
    program, profile = _program(top)
    at_once = {key: top.get(key, "whole number") if key in top else 1 for key in ("ranks", "threads")}
    for least, count in at_once.items():
        if count < 1:
            raise top.wrong(f"{least} is {count}; give a whole number from 1", least)
    keep = 1e6 * top.get("keep", "number") if "keep" in top else MOST_OF_RUN
    if keep < 0:
        raise top.wrong(f"keep is {keep / 1e6:g} MB; give 0 to keep no results, or more", "keep")
    files, links = files_of(folder, _list(top, "files"), _list(top, "links"))
    script = top.get("script", "text")
    if script not in files:
        raise top.wrong(f"script {script} is not in the folder; correct its name", "script")
    parameters = _units(top.section("parameters"))
    templates = _list(top, "template")
    particles = _particles(top.section("particles"), parameters) if "particles" in top else None
    handing = handing_in(top, script, profile.reads_lammps)
    found = responses_in(top.section("responses"), files, parameters, particles, profile.log)
    for name, reader in found.readers.items():
        if old := next(filter(None, (stale(output, links) for output in reader.files)), None):
            one = top.section("responses").section(name)
            raise one.wrong(f"{old} is linked, so no run writes it; take it out of links")
    if not folder.is_relative_to(SHIPPED) and is_first_use(folder):
        code = dict.fromkeys((script, *(name for name in files if name.endswith(".py"))))
        own = [f"the command {profile.command}"] if "command" in top else []
        log.warning(
            "first use of the model %s: %s will run as you; %s is to be trusted like any program",
            folder.name,
            ", ".join([*own, *code]),
            folder,
        )
    plausible = {**_plausible(top, particles, parameters, insist), **found.plausible}
    seeds = tuple(
        top.typed(seed, "text", "seeds", k)
        for k, seed in enumerate(top.get("seeds", "list") if "seeds" in top else [])
    )
    if len(seeds) > 3 or len({*seeds, *parameters}) < len(seeds) + len(parameters):
        raise top.wrong("seeds: give at most three names that no parameter has", "seeds")
    if twice := {*fixed.values} & {*parameters, *seeds}:
        raise top.wrong(f"{min(twice)} is set by a run already; it cannot be fixed, too", "fixed", min(twice))
    finished = top.get("finished", "text") if "finished" in top else None
    names = (*parameters, *fixed.values, *seeds)
    filled = _filled_in(top, templates, files, names)
    there = dict(files) | {name: PLACEHOLDER.sub(rb"1", files[name]) for name in templates}
    by_script = tuple(name for name in names if name not in filled)
    for fault in objections(
        Script(script, there, handing.include, by_script, finished is not None, profile.reads_lammps)
    ):
        tables = ("parameters", "fixed")
        key = next(((t, fault.about) for t in tables if fault.about in top.section(t)), (fault.about,))
        raise top.wrong(fault.text, *(("seeds",) if fault.about in seeds else key))
    ratio = tuple(
        top.typed(name, "text", "ratio", k)
        for k, name in enumerate(top.get("ratio", "list") if "ratio" in top else [])
    )
    if ratio and (len(set(ratio)) != 2 or not {*ratio} <= {*parameters}):
        raise top.wrong("ratio: name two of the parameters, such as ['YM', 'DENS'] for YM/DENS", "ratio")
    return FolderModel(
        name=folder.resolve().name,
        script=script,
        files=files,
        parameters=parameters,
        handing=handing,
        seeds=seeds,
        particles=particles,
        readers=found.readers,
        responses=found.responses,
        program=program,
        ranks=ranks or at_once["ranks"],
        threads=at_once["threads"],
        finished=finished,
        expected_seconds=fixed.expected_seconds,
        plausible=plausible,
        ratio=(ratio[0], ratio[1]) if ratio else None,
        curves=curves_in(top),
        noise_table=text_of(folder / NOISE_FILE) if (folder / NOISE_FILE).is_file() else "",
        fidelity=fixed.fidelity,
        fixed=fixed.values,
        reference=_reference(top.section("reference"), parameters),
        links=links,
        templates=templates,
        keep=keep,
        texts=_texts(top.section("parameters")),
    )


def _list(top: Section, key: str) -> tuple[str, ...]:
    given = top.get(key, "list") if key in top else []
    return tuple(top.typed(one, "text", key, k) for k, one in enumerate(given))


def _filled_in(
    top: Section, templates: Sequence[str], files: Mapping[str, bytes], names: Sequence[str]
) -> set[str]:
    """Variables that the templates have; InputError for a file or name that is none."""
    filled: set[str] = set()
    for file in templates:
        if file not in files:
            raise top.wrong(f"template {file} is not in the folder; correct its name", "template")
        if b"{%" in files[file]:
            raise top.wrong(
                f"{file} has {{% %}}: only {{{{ NAME }}}} is filled in; let the script decide", "template"
            )
        if strange := placeholders(files[file]) - {*names}:
            raise top.wrong(
                f"{file} has {{{{ {min(strange)} }}}}, which is no variable of this file; add it to "
                "[parameters] or [fixed]",
                "template",
            )
        filled |= placeholders(files[file])
    return filled


def _program(top: Section) -> tuple[str | Profile, Profile]:
    """Program of the table, or that of one's own command, with its profile."""
    if "command" not in top:
        if "version" in top:
            raise top.wrong("version is of a command of one's own; add command, or remove it", "version")
        name = top.get("program", "text") if "program" in top else DEFAULT
        try:
            return name, profile_of(name)
        except InputError as error:
            raise top.wrong(str(error), "program") from error
    if "program" in top:
        raise top.wrong("command and program both say what is run; remove one", "program")
    first = command_in(top)[0]
    asked = top.get("version", "list") if "version" in top else []
    own = Profile(
        name=Path(first).name,
        command=shlex.quote(first),
        variable="",
        option="",
        how_to_install=f"install it, or correct command in {top.path}",
        banner=re.compile(r"(\S[^\n]*)"),
        called=first,
        call=(),
        log=OUTPUT,
        question=tuple(top.typed(word, "text", "version", k) for k, word in enumerate(asked)),
    )
    return own, own


def _shipped(name: str, fidelity: str | None = None, variant: str = "") -> FolderModel:
    """A shipped model's folder, which has no variants."""
    return load_folder(model_folder(name), fidelity=fidelity)


lammps_heap = partial(_shipped, "angle_of_repose_lammps")
"""The shipped angle-of-repose test for LAMMPS, at a fidelity."""
yade_heap = partial(_shipped, "angle_of_repose_yade")
"""The same for YADE."""


def _units(section: Section) -> dict[str, str]:
    """Parameters with their units."""
    if not section.data:
        raise section.wrong("[parameters] names none; add lines such as DENS = 'kg/m3'")
    for name in section:
        if not NAME.fullmatch(name):
            raise section.wrong(f"{name} is no name of a variable; use letters, digits and _", name)
    units = {}
    for name in section:
        if isinstance(section.data[name], dict):
            section.section(name).only("unit", "plausible", "values")
            units[name] = section.section(name).get("unit", "text")
        else:
            units[name] = section.get(name, "text")
    return units


def _texts(section: Section) -> dict[str, tuple[str, ...]]:
    """What the script is given for the parameters that are a choice."""
    found = {}
    for name in section:
        if not isinstance(section.data[name], dict) or "values" not in section.data[name]:
            continue
        one = section.section(name)
        texts = tuple(
            one.typed(text, "text", "values", k) for k, text in enumerate(one.get("values", "list"))
        )
        if (
            len(texts) < 2
            or len({*texts}) < len(texts)
            or any(not re.fullmatch(r"[\w./+-]+", t) for t in texts)
        ):
            raise one.wrong("values: give two or more different words, such as ['hertz', 'hooke']", "values")
        found[name] = texts
    return found


def _reference(section: Section, parameters: Mapping[str, str]) -> dict[str, float]:
    """Values of all parameters at the reference point; empty if the model has none."""
    section.only(*parameters)
    return {name: section.get(name, "number") for name in parameters} if section.data else {}


def _plausible(
    top: Section, particles: Particles | None, parameters: Mapping[str, str], insist: bool
) -> dict[str, Range]:
    """Plausible ranges of the parameters; refuses particles outside those that are known of any."""
    section, known = top.section("particles"), dict(RANGES)
    for quantity, name in (("density", "DENS"), ("youngs_modulus", "YM")) if particles else ():
        given = getattr(particles, quantity)
        if isinstance(given, str):
            known[given] = RANGES[name]
        elif not insist and (objection := RANGES[name].objection(quantity, given)):
            raise section.wrong(objection, quantity)
    radius = particles.radius if particles else ""
    if isinstance(radius, str):
        known[radius] = RANGES["radius"]
    elif not insist and (objection := RANGES["radius"].objection("radius", radius)):
        raise section.wrong(objection, "radius")
    found = {
        name: known[name] for name, unit in parameters.items() if name in known and known[name].unit == unit
    }
    for name in parameters:
        given = top.section("parameters").data[name]
        if isinstance(given, dict) and "plausible" in given:
            found[name] = range_in(top.section("parameters").section(name), parameters[name])
    return found


def _particles(section: Section, parameters: Mapping[str, str]) -> Particles:
    section.only("radius", "poissons_ratio", "density", "youngs_modulus")
    given: list[str | float] = []
    for name in ("radius", "poissons_ratio", "density", "youngs_modulus"):
        value = section.data.get(name)
        if isinstance(value, str):
            if value not in parameters:
                known = ", ".join(parameters)
                raise section.wrong(f"{name} is {value!r}, which is none of the parameters ({known})", name)
            given.append(value)
            continue
        number = section.get(name, "number")
        if name == "poissons_ratio":
            if not 0 <= number < 0.5:
                raise section.wrong(f"poissons_ratio is {number:g}; it must lie in [0; 0.5)", name)
        elif number <= 0:
            unit = " m" if name == "radius" else ""
            raise section.wrong(f"{name} is {number:g}{unit}; it must be positive", name)
        given.append(number)
    return Particles(*given)
