"""A model's folder as the engine runs it."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from calstudy.disk.files import content_hash
from calstudy.disk.kept import MOST_OF_RUN
from calstudy.engines.choose import DEFAULT, profile_of
from calstudy.engines.interface import Inputs, Linked, Reading
from calstudy.engines.liggghts import LOG, insertion_seeds
from calstudy.engines.program import Profile
from calstudy.errors import InputError, MeasurementError, RunError
from calstudy.models.folder.content import placeholders, read_apart
from calstudy.models.folder.curves import Curve, PointOfCurve, points_of
from calstudy.models.folder.handing import Handing, OwnCommand, fill
from calstudy.models.measurement import VERSION as MEASUREMENT_VERSION
from calstudy.models.readers import Reader, Silhouette, said, tell
from calstudy.plausible import Range
from calstudy.rayleigh import Particles
from calstudy.records import Outcome, Response, proportional

LARGEST_TEXT = 1_000_000
"""Bytes of a file whose lines can be told."""


@dataclass(frozen=True)
class FolderModel:
    """A model read from a folder."""

    name: str
    script: str
    files: Mapping[str, bytes]
    """All files of the folder but model.toml, noise.csv and NOTES.md, by relative name; an empty folder's
    name ends with /."""
    parameters: Mapping[str, str]
    """Names with units, in the order of every point."""
    handing: Handing
    """How they reach the script."""
    seeds: tuple[str, ...]
    """Variables that take a prime above 10000 drawn from the run's seed."""
    particles: Particles | None
    """None where no Rayleigh time-step can be computed."""
    readers: Mapping[str, Reader]
    responses: tuple[Response, ...]
    finished: str | None
    """What the log must say, for the run to count."""
    program: str | Profile = field(default=DEFAULT, kw_only=True)
    """Program that runs the script, by its name in the table of engines, or one's own."""
    ranks: int = field(default=1, kw_only=True)
    """MPI ranks of a run."""
    threads: int = field(default=1, kw_only=True)
    """Threads of each rank."""
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
    curves: Mapping[str, Curve] = field(default_factory=dict)
    """What may be compared with a measured curve; in the hash only where it is, as responses."""
    keep: float = MOST_OF_RUN
    """Bytes of a run's results that are kept, to be read anew; not in the hash."""
    links: Mapping[str, Linked] = field(default_factory=dict)
    """Files that are linked into a run's directory."""
    templates: tuple[str, ...] = ()
    """Files in which {{ NAME }} stands for a variable, which is handed over in no other way then."""
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Of parameters that are a choice: what the script is given for 1, 2 and so on."""
    deck: int = 1

    @cached_property
    def hash(self) -> str:
        """SHA-256 of all that decides the responses, or what is made of them, but the parameters, the seed
        and the engine."""
        files = {name: content.hex() for name, content in self.files.items()}
        return content_hash(self.content | {"files": files})

    @property
    def content(self) -> dict[str, Any]:
        """The same but for the files."""
        # What came later is left out where it has its default, so that older folders keep their hash.
        later: dict[str, Any] = {"fixed": dict(self.fixed)} if self.fixed else {}
        if self.ranks > 1:
            later["ranks"] = self.ranks
        if self.threads > 1:
            later["threads"] = self.threads
        if self.links:
            later["links"] = {name: linked.sha256 for name, linked in self.links.items()}
        if self.templates:
            later["templates"] = list(self.templates)
        if self.texts:
            later["texts"] = {name: list(texts) for name, texts in self.texts.items()}
        if isinstance(self.handing, OwnCommand):
            later["command"] = list(self.handing.arguments)
        return later | {
            "script": self.script,
            "include": self.handing.include,
            "style": self.handing.style,
            "parameters": list(self.parameters),
            "seeds": list(self.seeds),
            "proportional": proportional(self.responses),
            "readers": {name: _content(of) for name, of in self.readers.items()},
            "finished": self.finished,
            "particles": None if self.particles is None else asdict(self.particles),
            "measurement": MEASUREMENT_VERSION,
        }

    def measured_at(self, places: Mapping[str, Sequence[float]]) -> FolderModel:
        """The model with a response for each place, in the abscissa's unit, at which a curve was measured."""
        readers, responses = dict(self.readers), list(self.responses)
        for name, at in places.items():
            curve = self.curves[name]
            for point, x in zip(points_of(name, len(at)), at, strict=True):
                readers[point] = PointOfCurve(curve.columns, float(x))
                responses.append(Response(point, curve.unit))
        return replace(self, readers=readers, responses=tuple(responses))

    @property
    def told(self) -> dict[str, Any]:
        """What it is in JSON's types, so that a change of it can be told by file and line."""
        files = {name: _text(content) for name, content in self.files.items()}
        return {"files": files, "says": self.content}

    @property
    def particle_diameter(self) -> float:
        """Diameter of the particles in m; NaN where model.toml does not give a number."""
        return math.nan if self.particles is None else self.particles.diameter

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
        given = () if of is None else (of.density, of.youngs_modulus, of.radius)
        positive = {*given, *proportional(self.responses).values(), *(self.ratio or ())}
        for name, value in parameters.items():
            if not math.isfinite(value):
                raise InputError(f"{name} is {value}; give a finite number")
            if name in positive and value <= 0:
                raise InputError(f"{name} is {value:g}; it must be positive")
            if of is not None and name == of.poissons_ratio and not 0 <= value < 0.5:
                raise InputError(f"{name} is {value:g}; a Poisson's ratio lies in [0; 0.5)")
            if name in self.texts and value not in range(1, len(self.texts[name]) + 1):
                there = ", ".join(f"{k} = {text}" for k, text in enumerate(self.texts[name], start=1))
                raise InputError(f"{name} is {value:g}; choose one of {there}")

    def script_lines(self, parameters: Mapping[str, float]) -> list[str]:
        """None: the folder's own script says what it makes of them."""
        return []

    def engine_time_step(self, parameters: Mapping[str, float]) -> float:
        """NaN: the script alone knows its time-step."""
        return math.nan

    def expected_seconds_at(self, parameters: Mapping[str, float]) -> float:
        """The time of model.toml, which does not depend on the parameters."""
        return self.expected_seconds

    def inputs(self, parameters: Mapping[str, float], seed: int) -> Inputs:
        """The folder's files, and all variables with all their digits where the script looks for them."""
        values = self.variables(parameters)
        values |= dict(zip(self.seeds, insertion_seeds(seed), strict=False))
        files = dict(self.files) | {name: fill(self.files[name], values) for name in self.templates}
        if not isinstance(self.handing, OwnCommand):
            filled = {name for file in self.templates for name in placeholders(self.files[file])}
            values = {name: value for name, value in values.items() if name not in filled}
        found = self.handing.inputs(self.script, files, values)
        return replace(found, of_readers=self.of_readers, links=self.links)

    def variables(self, parameters: Mapping[str, float]) -> dict[str, float | str]:
        """What the script is given, but for the seeds: parameters, a choice as its word, fixed variables."""
        values: dict[str, float | str] = {name: parameters[name] for name in self.parameters}
        values |= {name: texts[round(parameters[name]) - 1] for name, texts in self.texts.items()}
        return values | dict(self.fixed)

    @cached_property
    def of_readers(self) -> frozenset[str]:
        """Files that its readers use and its program does not."""
        arguments = self.handing.arguments if isinstance(self.handing, OwnCommand) else ()
        sources = {source for reader in self.readers.values() for source in reader.sources}
        return read_apart(self.files, sources, (self.script, *arguments))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Files of a run that its readers read, the logs among them."""
        profile = profile_of(self.program)
        read = [name for reader in self.readers.values() for name in reader.files]
        return tuple(dict.fromkeys((profile.log, profile.output, *read)))

    def ended(self, directory: Path) -> bool:
        """Whether the run said its mark of the end; a model without one cannot tell."""
        texts = [text for _, text in said(directory, profile_of(self.program).log)]
        return self.finished is not None and any(self.finished in text for text in texts)

    def read(self, directory: Path, parameters: Mapping[str, float]) -> Reading:
        """Read every response; what is missing, or no finite number, is NaN and the reading's reason."""
        if self.finished is not None and not self.ended(directory):
            log = profile_of(self.program).log
            raise RunError(f"{log} does not say {self.finished!r}, so the script did not reach its end")
        tell(directory, self.variables(parameters))
        reading = Reading(dict.fromkeys(self.readers, math.nan))
        responses, wrong = dict(reading.responses), []
        for name, reader in self.readers.items():
            try:
                if isinstance(reader, Silhouette):
                    positions, found = reader.measure(directory)
                    reading = replace(reading, positions=positions)
                    if found.stands:
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


def _text(content: bytes) -> str:
    """Text of a file; of a large one, or one that is no text, its hash."""
    try:
        if len(content) <= LARGEST_TEXT:
            return content.decode()
    except UnicodeDecodeError:
        pass
    return f"sha256 {hashlib.sha256(content).hexdigest()}"


def _content(reader: Reader) -> dict[str, object]:
    """What decides how a response is read."""
    told = {"way": reader.way} | asdict(reader)
    return {key: value for key, value in told.items() if (key, value) != ("log", LOG)}
