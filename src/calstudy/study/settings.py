"""What a study is: settings that decide its results."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from calstudy.disk.files import content_hash, content_of
from calstudy.errors import StoreError
from calstudy.models.find import declaration, is_shipped
from calstudy.records import OF_EVERY_CALIBRATION, Phase, Response, Target
from calstudy.study.schema import Quantities
from calstudy.written import is_missing, json_of

SAID: tuple[tuple[str, str], ...] = (
    (r"target\.values\.(.+)", "the target of {}"),
    (r"target\.sd\.(.+)", "the measurement's error of {}"),
    (r"target\.scale\.(.+)", "the scale of {}"),
    (r"target\.weight\.(.+)", "the weight of {}"),
    (r"target\.minimised", "what is minimised"),
    (r"case\.definition\.parameters\.(.+)", "{}"),
    (r"case\.definition\.tolerances\.(.+)", "the tolerance of {}"),
    (r"(?:case\.definition\.)?noise\.(.+)", "the noise of {}"),
    (r"case\.definition\.constraints", "the constraints"),
    (r"case\.definition\.holdout\.(.+)", "the hold-out {}"),
    (r"case\.definition\.WRL", "WRL"),
    (r"case\.definition\.until", "the probability that is asked for"),
    (r"case\.definition\.together", "the parameter sets that run together"),
    (r"case\.definition\.stored", "the runs that were taken over as samples"),
    (r"case\.definition\.start\.study", "the earlier study"),
    (r"case\.definition\.samples", "the number of samples"),
    (r"confirm", "the runs that confirm the optimum"),
    (r"cheap.*", "the cheap fidelity"),
    (r"tests.*", "the material tests"),
    (r"budget", "the budget of the second optimisation"),
    (r"mode", "the mode"),
    (r"seed", "the seed"),
    (r"fidelity", "the fidelity"),
    (r"variant", "the variant"),
    (r"plan", "the plan or file"),
    (r"model", "the model"),
    (r"deck", "the model's deck"),
    (r"engine", "the engine"),
    (r"calstudy", "the version of calstudy"),
    (r"grid", "the grid of the DEM model's parameters"),
    (r"procedure", "the version of the mode"),
    (r"share_samples", "whether rows share samples"),
)
"""Settings by their dotted names, and what they are called."""

MODEL_CHANGED = "the model's files or fixed inputs are others"
IMPLIED: tuple[tuple[str, str], ...] = (
    (
        r"case\.definition\.models\..+|model_hash|case\.models\..+",
        MODEL_CHANGED,
    ),
    (r"case\.definition\.start\.(of|runs)", "the runs of the earlier study are others"),
    (r"plan_hash", "the plan's rows or definitions are others"),
    (r"target\..+", "the target comes from elsewhere"),
    (r"noise|case\.definition\.noise", "the known noise is another"),
    (r"case\.parameters\..+|case\.responses\..+|units.*", "units of parameters or responses are others"),
)
"""Settings that follow from others. They are told where nothing that they follow from has changed."""
CAUSES: Mapping[str, tuple[str, ...]] = {
    MODEL_CHANGED: (
        "the fidelity",
        "the variant",
        "the model:",
        "the model's deck",
    ),
    "the target comes from elsewhere": ("the target of", "the engine", "the fidelity", "the variant"),
    "the runs of the earlier study are others": ("the earlier study",),
    "the known noise is another": ("the fidelity", "the variant", "the model:", "the mode:", "the noise of"),
}


def changes(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Each setting that differs, as "the target of angle_of_repose_deg: 22 → 25"; empty for equal ones.

    ``was`` and ``now`` are settings as a study stores them.
    """
    before, after = _flat(was), _flat(now)
    differing = [name for name in before | after if before.get(name) != after.get(name)]
    told: list[str] = []
    implied: list[str] = []
    for name in differing:
        if subject := _called(name, SAID):
            told.append(_in_words(subject, before.get(name), after.get(name)))
        elif subject := _called(name, IMPLIED):
            implied.append(subject)
        else:
            told.append(_in_words(name, before.get(name), after.get(name)))
    if "case" in was and "case" in now:  # its hash follows from it
        implied = [subject for subject in implied if subject != "the plan's rows or definitions are others"]
    more = [s for s in dict.fromkeys(implied) if not any(t.startswith(CAUSES.get(s, ())) for t in told)]
    return [*told, *more]


def _called(name: str, table: tuple[tuple[str, str], ...]) -> str:
    for pattern, subject in table:
        if found := re.fullmatch(pattern, name):
            return subject.format(*found.groups())
    return ""


def _in_words(subject: str, was: Any, now: Any) -> str:
    if isinstance(was, list) and isinstance(now, list) and subject != "the constraints":
        subject = f"the interval of {subject}"
    shown, shown_now = _value(was), _value(now)
    if shown == shown_now:
        shown, shown_now = repr(was), repr(now)
    return f"{subject}: {shown} → {shown_now}"


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested content by dotted names."""
    flat: dict[str, Any] = {}
    for name, value in content.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return flat


SETTINGS_FILE = "study.json"
FORMAT = 2
"""Format of a study. From 2 on its file of settings names the format and the study's identity."""
LARGEST = 100e6
"""Bytes of a file of settings."""
CONFIRM = 4
"""DEM runs with fresh seeds at the optimum of a calibration, unless it says otherwise."""


@dataclass(frozen=True, slots=True)
class Case:
    """A calibration that is not a row of a plan, in JSON's own types, because it is stored as it is."""

    parameters: Mapping[str, str]
    """All parameters, with their units."""
    responses: Mapping[str, str]
    """All that the models give, with their units."""
    models: Mapping[str, Mapping[str, Any]]
    """Of each model hash: columns that say which model it is."""
    definition: Mapping[str, Any]
    """Intervals, constants, tolerances, and all else that decides what is computed."""


@dataclass(frozen=True, slots=True)
class StudySettings:
    """What makes two studies the same."""

    plan: str
    plan_hash: str
    model: str
    deck: int
    model_hash: str
    fidelity: str
    variant: str
    engine: str
    calstudy: str
    mode: str
    budget: int | None
    """Most DEM runs of a row's second optimisation."""
    seed: int
    target: Target
    share_samples: bool = False
    """Whether rows that differ in WRL alone have the same samples."""
    case: Case | None = None
    """None for rows of a plan."""
    noise: Mapping[str, float] | None = None
    """Known noise for a plan's rows; None if unknown, or if the mode ignores it. A case has its own."""
    grid: int | None = None
    """Steps of each interval between the points that the DEM model is run at; None where any point is."""
    units: Mapping[str, Mapping[str, str]] | None = None
    """``parameters`` and ``responses`` with their units, of a plan's model that is not shipped; else None."""
    cheap: Mapping[str, Mapping[str, Any]] | None = None
    """Of the model hash of each cheap model: columns that say which model it is. None for one fidelity."""
    confirm: int = 0
    """DEM runs with fresh seeds at each optimum."""
    procedure: int = 1
    """Which of the mode's versions it is."""
    tests: Mapping[str, Mapping[str, Any]] | None = None
    """Of the model hash of each further material test of a plan's rows: columns that say which model it is.
    None for one test."""

    @property
    def quantities(self) -> Quantities:
        """What the tables have columns for."""
        return replace(self._quantities, phases=self.phases)

    @property
    def phases(self) -> tuple[Phase, ...]:
        """What asks for DEM runs."""
        more = ((Phase.CHEAP, self.cheap), (Phase.CONFIRMATION, self.confirm))
        return (*OF_EVERY_CALIBRATION, *(phase for phase, is_there in more if is_there))

    @property
    def _quantities(self) -> Quantities:
        targets = tuple(self.target.values)
        if self.units is not None:
            responses = tuple(Response(*given) for given in self.units["responses"].items())
            return Quantities(tuple(self.units["parameters"].items()), responses, targets)
        if self.case is None:
            return replace(Quantities.of(declaration(self.model)), targets=targets)
        shipped = [m["model"] for m in self.case.models.values() if is_shipped(m["model"])]
        known = {(r.name, r.unit): r for name in shipped for r in declaration(name).responses}
        responses = tuple(known.get(given, Response(*given)) for given in self.case.responses.items())
        return Quantities(tuple(self.case.parameters.items()), responses, targets)

    @property
    def at(self) -> str:
        """Fidelity with the variant in brackets; the name of a model that lacks a variant comes first."""
        model = "" if self.variant else self.model
        fidelity = f"{self.fidelity} fidelity" if self.fidelity else ""
        words = ", ".join(filter(None, (model, fidelity)))
        return f"{words} ({self.variant})" if self.variant else words

    def aims(self, line: Mapping[str, Any]) -> dict[str, str]:
        """Unit of each response that a row calibrated to, by its line of the table of calibrations."""
        targeted = self.quantities.targeted
        # Of a test that a row does without there is no target.
        return {name: unit for name, unit in targeted.items() if not is_missing(line[f"target_{name}"])}

    @property
    def is_emulated(self) -> bool:
        """Whether an emulator answered, and no DEM program."""
        return self.engine.startswith("emulator ")

    @property
    def content(self) -> dict[str, Any]:
        """The settings as they are stored."""
        content = asdict(self)
        for name in ("case", "noise", "grid", "units", "cheap", "confirm", "tests"):
            if content[name] in (None, 0):
                del content[name]  # so that studies from before there was such a thing keep their id
        if self.procedure == 1:
            del content["procedure"]  # for the same reason, as below
        for name in ("sd", "scale", "weight", "minimised"):
            if not content["target"][name]:
                del content["target"][name]
        return content

    @property
    def file(self) -> bytes:
        """Content of the study's file of settings."""
        content = {"format": FORMAT, "id": self.id, **self.content}
        return json.dumps(content, indent=2).encode() + b"\n"

    @classmethod
    def of_content(cls, content: Mapping[str, Any]) -> StudySettings:
        """The settings that are stored as ``content``; KeyError or TypeError where it is damaged."""
        case = {"case": Case(**content["case"])} if "case" in content else {}
        target = Target(**content["target"])
        target = replace(target, minimised=tuple(target.minimised))
        return cls(**{**content, "target": target, **case})

    @property
    def id(self) -> str:
        """Identity of the study by content."""
        content = self.content
        if not self.share_samples:
            del content["share_samples"]  # so that studies from before there was the choice keep their id
        return content_hash(content)[:12]

    @property
    def provenance(self) -> dict[str, Any]:
        """Columns that every stored line carries, but the row."""
        return {
            "study": self.id,
            "model": self.model,
            "deck": self.deck,
            "model_hash": self.model_hash,
            "fidelity": self.fidelity,
            "variant": self.variant,
            "engine": self.engine,
            "calstudy": self.calstudy,
            "mode": self.mode,
        }

    def provenance_of(self, model_hash: str) -> dict[str, Any]:
        """The same, of one of the models that share the study."""
        models = {} if self.case is None else self.case.models
        models = {**models, **(self.cheap or {}), **(self.tests or {})}
        if model_hash not in models:
            return self.provenance
        return self.provenance | {"model_hash": model_hash, **models[model_hash]}


def read_settings(directory: Path) -> StudySettings:
    """Settings of a study; StoreError if the directory is not a study or its settings are damaged."""
    path = directory / SETTINGS_FILE
    try:
        content = json_of(content_of(path, LARGEST))
        written_as, identity = content.pop("format", 1), content.pop("id", None)
        if written_as > FORMAT:
            raise StoreError(
                f"{path} has format {written_as}, of a later version of calstudy; read it with that one"
            )
        settings = StudySettings.of_content(content)
        if identity not in (None, settings.id):
            raise ValueError(f"its settings are not those of the study {identity}")
        return settings
    except (FileNotFoundError, NotADirectoryError) as error:
        raise StoreError(
            f"{directory} is no study: {SETTINGS_FILE} is missing; check the directory's name"
        ) from error
    except OSError as error:
        raise StoreError(f"{path} cannot be read: {error.strerror}; check its permissions") from error
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{path} is damaged ({error}); restore it, or start a new study") from error
