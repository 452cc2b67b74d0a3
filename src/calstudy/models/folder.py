"""A LIGGGHTS model of anybody's: a folder with an input script, what it needs, and a model.toml.

model.toml says how parameters reach the script, which responses it gives and where each is read, and what the
Rayleigh time-step is computed from where it is needed; docs/reference/model-toml.md explains each key. The
folder is copied for every run, so what is read afterwards was written by that run: outputs that lie in the
folder are refused.
"""

from __future__ import annotations

import math
import posixpath
import re
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath

from calstudy.engines.choose import DEFAULT, profile_of
from calstudy.engines.interface import Inputs, Reading
from calstudy.engines.liggghts import LOG, insertion_seeds
from calstudy.engines.process import output_text
from calstudy.errors import InputError, MeasurementError, RunError
from calstudy.files import content_hash
from calstudy.models.fidelity import fixed_in
from calstudy.models.find import FILE, NOISE_FILE, NOTES_FILE, RESPONSE_KEYS
from calstudy.models.measurement import VERSION as MEASUREMENT_VERSION
from calstudy.models.measurement import check_drawing
from calstudy.models.readers import NumberInFile, NumberInLog, PythonFunction, Reader, Silhouette
from calstudy.plausible import RANGES, Range
from calstudy.rayleigh import Particles
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Response, proportional
from calstudy.tomlfile import Section, read_toml
from calstudy.written import text_of

KEYS = (
    "program",
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
)
LINES = {
    "equal": "variable {name} equal {number}\n",
    "index": "variable {name} delete\nvariable {name} index {number}\n",
}
LARGEST_WHOLE = 2**53
"""Whole numbers below it are the same as a number with digits behind the point."""
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True)
class FolderModel:
    """A folder of anybody's as a model of the engine."""

    name: str
    script: str
    files: Mapping[str, bytes]
    """All files of the folder but model.toml, noise.csv and NOTES.md, by relative name; an empty folder's
    name ends with /."""
    parameters: Mapping[str, str]
    """Names with units, in the order of every point."""
    include: str | None
    """File at whose end parameters are set; None sets them on the command line."""
    style: str
    """Style of the variables set there: ``equal``, or ``index``, whose digits LIGGGHTS never rounds."""
    seeds: tuple[str, ...]
    """Variables that take a prime above 10000 drawn from the run's seed."""
    particles: Particles | None
    """None where no Rayleigh time-step can be computed."""
    readers: Mapping[str, Reader]
    responses: tuple[Response, ...]
    finished: str | None
    """What the log must say, for the run to count."""
    program: str = field(default=DEFAULT, kw_only=True)
    """Program that runs the script, by its name in the table of engines."""
    expected_seconds: float
    plausible: Mapping[str, Range] = field(default_factory=dict)
    """Of parameters and responses, where known; it decides no response, so it is not in the hash."""
    ratio: tuple[str, str] | None = None
    """Two parameters that act through the quotient of the first by the second alone; not in the hash."""
    noise_table: str = ""
    """Its noise.csv; it decides no response, so it is neither in the hash nor in a run."""
    fidelity: str = ""
    """Name of the fidelity; empty where the folder has none."""
    fixed: Mapping[str, float] = field(default_factory=dict)
    """Variables that are no parameters, as the fidelity has them."""
    reference: Mapping[str, float] = field(default_factory=dict)
    """Parameters of the reference point; empty where the folder does not say where to begin."""
    deck: int = 1

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that decides the responses, or what is made of them, but the parameters, the seed
        and the engine."""
        # What came later is left out where it has its default, so that older folders keep their hash.
        fixed = {"fixed": dict(self.fixed)} if self.fixed else {}
        return content_hash(
            fixed
            | {
                "script": self.script,
                "files": {name: content.hex() for name, content in self.files.items()},
                "include": self.include,
                "style": self.style,
                "parameters": list(self.parameters),
                "seeds": list(self.seeds),
                "proportional": proportional(self.responses),
                "readers": {name: _content(of) for name, of in self.readers.items()},
                "finished": self.finished,
                "particles": None if self.particles is None else asdict(self.particles),
                "measurement": MEASUREMENT_VERSION,
            }
        )

    @property
    def particle_diameter(self) -> float:
        """Diameter of the particles in m; NaN where model.toml does not give it."""
        return math.nan if self.particles is None else 2 * self.particles.radius

    @property
    def poured_beads(self) -> int:
        """0: the script alone knows."""
        return 0

    @property
    def labels(self) -> dict[str, str]:
        """Name of its fidelity; a folder has no variants."""
        return {"fidelity": self.fidelity, "variant": ""}

    @property
    def title(self) -> str:
        """Its name and fidelity."""
        return f"{self.name}, {self.fidelity} fidelity" if self.fidelity else self.name

    def check(self, parameters: Mapping[str, float]) -> None:
        """Refuse numbers that are not finite, and densities, moduli and divisors that are not positive."""
        of = self.particles
        given = () if of is None else (of.density, of.youngs_modulus)
        positive = {*given, *proportional(self.responses).values(), *(self.ratio or ())}
        for name, value in parameters.items():
            if not math.isfinite(value):
                raise InputError(f"{name} is {value}; give a finite number")
            if name in positive and value <= 0:
                raise InputError(f"{name} is {value:g}; it must be positive")

    def script_lines(self, parameters: Mapping[str, float]) -> list[str]:
        """None: the folder's own script says what it makes of them."""
        return []

    def engine_time_step(self, parameters: Mapping[str, float]) -> float:
        """NaN: the script alone knows its time-step."""
        return math.nan

    def expected_seconds_at(self, parameters: Mapping[str, float]) -> float:
        """What model.toml says, whatever the parameters."""
        return self.expected_seconds

    def inputs(self, parameters: Mapping[str, float], seed: int) -> Inputs:
        """The folder's files, and all variables with all their digits where the script looks for them."""
        values = {name: parameters[name] for name in self.parameters} | dict(self.fixed)
        numbers: dict[str, float | int] = {name: _number(value) for name, value in values.items()}
        numbers |= dict(zip(self.seeds, insertion_seeds(seed), strict=False))
        if self.include is None:
            pairs = [part for name, number in numbers.items() for part in ("-var", name, repr(number))]
            return Inputs(self.script, self.files, tuple(pairs))
        there = self.files.get(self.include, b"")
        there += b"" if there.endswith(b"\n") or not there else b"\n"
        # A variable of another style must go first: LIGGGHTS does not change a variable's style.
        form = LINES[self.style]
        lines = "".join(form.format(name=name, number=repr(number)) for name, number in numbers.items())
        return Inputs(self.script, {**self.files, self.include: there + lines.encode()})

    def read(self, directory: Path, parameters: Mapping[str, float]) -> Reading:
        """Read every response; what is missing, or no finite number, is NaN and the reading's reason."""
        log = profile_of(self.program).log
        if self.finished is not None and self.finished not in output_text(directory / log):
            raise RunError(f"{log} does not say {self.finished!r}, so the script did not reach its end")
        reading = Reading(dict.fromkeys(self.readers, math.nan))
        responses, wrong = dict(reading.responses), []
        for name, reader in self.readers.items():
            try:
                if isinstance(reader, Silhouette):
                    heap, found = reader.measure(directory)
                    reading = replace(reading, heap=heap)
                    if found.heap:
                        reading = replace(reading, radius=found.radius, height=found.height)
                        responses[name] = found.angle_of_repose_deg
                    else:
                        wrong.append((Outcome.NO_HEAP, "nothing stands above the first layer of beads"))
                else:
                    value = reader.read(directory)
                    if not math.isfinite(value):
                        raise RunError(f"it is {value}, no finite number")
                    responses[name] = value
            except MeasurementError as error:
                wrong.append((Outcome.UNMEASURABLE, f"{name}: {error}"))
            except RunError as error:
                wrong.append((Outcome.FAILED, f"{name}: {error}"))
        outcomes = [outcome for outcome, _ in wrong]
        return replace(
            reading,
            responses=responses,
            outcome=Outcome.FAILED if Outcome.FAILED in outcomes else [*outcomes, Outcome.OK][0],
            reason="; ".join(dict.fromkeys(reason for _, reason in wrong)),
        )


def load_folder(
    folder: Path,
    insist: bool = False,
    fidelity: str | None = None,
    changes: Mapping[str, float] | None = None,
) -> FolderModel:
    """Read a model's folder; InputError with the line of model.toml for all that is wrong with it.

    Implausible particles are among it, unless somebody insists on them. Without a fidelity its first one is
    meant; ``changes`` are numbers in place of those that it holds fixed.
    """
    top = read_toml(folder / FILE)
    top.only(*KEYS)
    fixed = fixed_in(top, fidelity, changes)
    program = top.get("program", "text") if "program" in top else DEFAULT
    try:
        log = profile_of(program).log
    except InputError as error:
        raise top.wrong(str(error), "program") from error
    files = _files(folder)
    script = top.get("script", "text")
    if script not in files:
        raise top.wrong(f"script {script} is not in the folder; correct its name", "script")
    parameters = _units(top.section("parameters"))
    particles = _particles(top.section("particles"), parameters) if "particles" in top else None
    plausible = _plausible(top, particles, parameters, insist)
    responses = top.section("responses")
    readers, given = {}, []
    for name in responses:
        one = responses.section(name)
        if not NAME.fullmatch(name) or name == RAYLEIGH_TIME_STEP:
            raise one.wrong(f"{name} cannot be a response's name; use letters, digits and _")
        unit = one.get("unit", "text")
        if "plausible" in one:
            plausible[name] = _range(one, unit)
        elif name in RANGES and RANGES[name].unit == unit:
            plausible[name] = RANGES[name]
        readers[name] = _reader(one, files, particles, log)
        for output in readers[name].files:
            if not _inside(output):
                raise one.wrong(f"{output} leads out of the run's directory; name a file in it")
            if old := _stale(output, files):
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
        raise top.wrong("[responses] names none; add one", "responses")
    include = top.get("include", "text") if "include" in top else None
    if include is not None and not _inside(include):
        raise top.wrong(f"include {include} leads out of the folder; name a file in it", "include")
    if include is not None:
        _require_included(top, include, script, files)
    style = top.get("style", "text") if "style" in top else "equal"
    if style not in LINES or (include is None and "style" in top):
        raise top.wrong(f"style {style!r}: it is equal or index, of the lines in an include file", "style")
    seeds = tuple(
        top.typed(seed, "text", "seeds", k)
        for k, seed in enumerate(top.get("seeds", "list") if "seeds" in top else [])
    )
    if len(seeds) > 3 or len({*seeds, *parameters}) < len(seeds) + len(parameters):
        raise top.wrong("seeds: give at most three names that no parameter has", "seeds")
    if twice := {*fixed.values} & {*parameters, *seeds}:
        raise top.wrong(f"{min(twice)} is set by a run already; it cannot be fixed, too", "fixed", min(twice))
    for name in (*parameters, *fixed.values, *seeds):
        if not _mentioned(name, files):
            raise top.wrong(
                f"no file of the folder mentions {name}, so it would change nothing; correct the name",
                *next(((s, name) for s in ("parameters", "fixed") if name in top.section(s)), ("seeds",)),
            )
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
        include=include,
        style=style,
        seeds=seeds,
        particles=particles,
        readers=readers,
        responses=tuple(given),
        program=program,
        finished=top.get("finished", "text") if "finished" in top else None,
        expected_seconds=fixed.expected_seconds,
        plausible=plausible,
        ratio=(ratio[0], ratio[1]) if ratio else None,
        noise_table=text_of(folder / NOISE_FILE) if (folder / NOISE_FILE).is_file() else "",
        fidelity=fixed.fidelity,
        fixed=fixed.values,
        reference=_reference(top.section("reference"), parameters),
    )


def _content(reader: Reader) -> dict[str, object]:
    """What decides how a response is read."""
    told = {"way": reader.way} | asdict(reader)
    return {key: value for key, value in told.items() if (key, value) != ("log", LOG)}


def _files(folder: Path) -> dict[str, bytes]:
    files = {}
    try:
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if "__pycache__" in path.parts or name in (FILE, NOISE_FILE, NOTES_FILE):
                continue
            if path.is_symlink() and path.is_dir():
                raise InputError(
                    f"{path}: is a link to a folder, which a run does not get; put a folder there"
                )
            if path.is_file():
                files[name] = path.read_bytes()
            elif path.is_dir() and not any(path.iterdir()):
                files[f"{name}/"] = b""
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}; check the folder") from error
    return files


def _number(value: float) -> float | int:
    """The number as it is written for LIGGGHTS, which takes no 100.0 where it counts."""
    return int(value) if float(value).is_integer() and abs(value) < LARGEST_WHOLE else float(value)


def _stale(output: str, files: Collection[str]) -> str | None:
    """File of the folder that an output would be, or be in; None without any."""
    place = posixpath.normpath(output)
    there = (name for name in files if not name.endswith("/"))
    return next((n for n in there if place == "." or n == place or n.startswith(f"{place}/")), None)


def _mentioned(name: str, files: Mapping[str, bytes]) -> bool:
    """Whether a file has the name as a word, or as v_NAME."""
    word = re.compile(rf"(?<![A-Za-z0-9_])(v_)?{name}(?![A-Za-z0-9_])".encode())
    return any(word.search(content) for content in files.values())


def _require_included(top: Section, include: str, script: str, files: Mapping[str, bytes]) -> None:
    """Refuse an include that would come too late, or never."""
    place = posixpath.normpath(include)
    if place == posixpath.normpath(script):
        raise top.wrong(
            "include is the script itself, at whose end parameters come too late; name a file that the "
            "script includes at its beginning, or leave include out and set them by the command line",
            "include",
        )
    name = PurePosixPath(place).name.encode()
    if not any(name in content for other, content in files.items() if other != place):
        raise top.wrong(f"no file of the folder includes {include}; let the script do so", "include")


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
            section.section(name).only("unit", "plausible")
            units[name] = section.section(name).get("unit", "text")
        else:
            units[name] = section.get(name, "text")
    return units


def _reference(section: Section, parameters: Mapping[str, str]) -> dict[str, float]:
    """Values of all parameters at the reference point; empty where there is none."""
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
    if particles and not insist and (objection := RANGES["radius"].objection("radius", particles.radius)):
        raise section.wrong(objection, "radius")
    found = {
        name: known[name] for name, unit in parameters.items() if name in known and known[name].unit == unit
    }
    for name in parameters:
        given = top.section("parameters").data[name]
        if isinstance(given, dict) and "plausible" in given:
            found[name] = _range(top.section("parameters").section(name), parameters[name])
    return found


def _range(section: Section, unit: str) -> Range:
    ends = [section.typed(end, "number", "plausible") for end in section.get("plausible", "list")]
    if len(ends) != 2 or not ends[0] < ends[1]:
        raise section.wrong("plausible: write [lowest, highest]", "plausible")
    return Range(ends[0], ends[1], unit)


def _particles(section: Section, parameters: Mapping[str, str]) -> Particles:
    section.only("radius", "poissons_ratio", "density", "youngs_modulus")
    radius, poissons_ratio = (section.get(name, "number") for name in ("radius", "poissons_ratio"))
    if radius <= 0:
        raise section.wrong(f"radius is {radius:g} m; it must be positive", "radius")
    if not 0 <= poissons_ratio < 0.5:
        raise section.wrong(
            f"poissons_ratio is {poissons_ratio:g}; it must lie in [0; 0.5)", "poissons_ratio"
        )
    given: list[str | float] = []
    for name in ("density", "youngs_modulus"):
        value = section.data.get(name)
        if isinstance(value, str):
            if value not in parameters:
                known = ", ".join(parameters)
                raise section.wrong(f"{name} is {value!r}, which is none of the parameters ({known})", name)
            given.append(value)
            continue
        number = section.get(name, "number")
        if number <= 0:
            raise section.wrong(f"{name} is {number:g}; it must be positive", name)
        given.append(number)
    return Particles(radius, poissons_ratio, *given)


def _reader(section: Section, files: Mapping[str, bytes], particles: Particles | None, log: str) -> Reader:
    ways = [way for way in ("file", "log", "python", "silhouette") if way in section]
    if len(ways) != 1:
        raise section.wrong(
            f"response {section.keys[-1]} is read in {len(ways)} ways; "
            "give one of file, log, python, silhouette"
        )
    way, others = ways[0], (*RESPONSE_KEYS, "plausible")
    what = section.get(way, "text")
    if way == "log":
        section.only(way, *others)
        return NumberInLog(what, log)
    if way == "python":
        section.only(way, "reads", *others)
        source, _, function = what.partition(":")
        if source not in files or not function.isidentifier():
            raise section.wrong(f"{what!r} is no FILE:FUNCTION of the folder; write 'measure.py:angle'", way)
        reads = section.get("reads", "list")
        outputs = tuple(section.typed(name, "text", "reads", k) for k, name in enumerate(reads))
        text = files[source].decode(errors="replace")
        try:
            compile(text, source, "exec")
        except SyntaxError as error:
            raise section.wrong(f"{source}, line {error.lineno}: {error.msg}; correct it", way) from error
        if not re.search(rf"^(def {function}\b|{function}\s*=)", text, re.MULTILINE):
            raise section.wrong(f"{source} has no function {function}; correct the name", way)
        return PythonFunction(text, function, source, outputs)
    if not _inside(what):
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
        check_drawing(2 * particles.radius, *numbers)
    except InputError as error:
        raise section.wrong(
            str(error), "pixels_per_mm" if "pixels" in str(error) else "sphere_diameter"
        ) from error
    return Silhouette(what, 2 * particles.radius, *numbers)


def _inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts
