"""Models of a calibration, with its names for their parameters and responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

from calstudy.calibration.modes import Mode
from calstudy.engines.interface import Described
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import DEFAULT_MODEL, DEFAULT_VARIANT, load_model
from calstudy.models.fidelity import check_physics
from calstudy.models.find import model_folder, ratios, refuse_ranks
from calstudy.models.folder import NAME, FolderModel, load_folder
from calstudy.models.material.file import KEYS, material_in
from calstudy.models.material.folder import of_material
from calstudy.models.material.heap import APPARATUS, heap_of
from calstudy.models.noise import noise_in
from calstudy.models.photograph.rules import RULES
from calstudy.plan import FixedInputs
from calstudy.plan_file import load_plan
from calstudy.plausible import Range
from calstudy.records import proportional
from calstudy.tomlfile import Section


@dataclass(frozen=True)
class Chosen:
    """A model of the calibration."""

    model: Described
    label: str
    """Its label in the file, or the name of the model."""
    prefix: str
    """Prefix of the names of its responses; empty without a label."""
    cheap: Described | None = None
    """The same test at the cheap fidelity; None for one fidelity."""

    @property
    def is_seeded(self) -> bool:
        """Whether a run's seed changes its responses."""
        return bool(getattr(self.model, "seeds", True))

    @property
    def responses(self) -> dict[str, str]:
        """Units of its responses by their names in the calibration."""
        return {f"{self.prefix}{response.name}": response.unit for response in self.model.responses}

    @property
    def parameters(self) -> Mapping[str, str]:
        """Units of its parameters by name."""
        return self.model.parameters

    @property
    def proportional(self) -> dict[str, str]:
        """Parameter to which a response is proportional, by the name of the response in the calibration."""
        return {f"{self.prefix}{name}": p for name, p in proportional(self.model.responses).items()}

    @property
    def ratios(self) -> dict[str, tuple[str, str]]:
        """Two parameters that act on a response through their quotient alone, likewise."""
        return {f"{self.prefix}{name}": ratio for name, ratio in ratios(self.model).items()}

    @property
    def plausible(self) -> dict[str, Range]:
        """Known plausible ranges of its parameters and responses by their names in the calibration."""
        responses = {response.name: f"{self.prefix}{response.name}" for response in self.model.responses}
        called = {name: name for name in self.parameters} | responses
        ranges = self.model.plausible
        return {call: ranges[name] for name, call in called.items() if name in ranges}

    @property
    def fidelity(self) -> str:
        """Its fidelity; empty if it has none."""
        return self.model.labels["fidelity"]

    @property
    def variant(self) -> str:
        """Its variant; empty if it has none."""
        return self.model.labels["variant"]

    @property
    def noise(self) -> dict[str, float]:
        """Measured standard deviations of its responses from seed to seed."""
        known = noise_in(self.model.noise_table, self.model.hash) or {}
        return {f"{self.prefix}{name}": sd for name, sd in known.items() if math.isfinite(sd) and sd > 0}


def chosen_models(
    top: Section, folders: Sequence[Path], insist: bool, ranks: int | None = None
) -> tuple[Chosen, ...]:
    """Models of the file of a calibration, looked for in ``folders``; InputError with the line.

    ``ranks`` are MPI ranks in place of the models' own.
    """
    sections = top.sections("models")
    if not sections:
        raise top.wrong(f"no model is named; add [[models]] with name = '{DEFAULT_MODEL}'")
    targets = (*top.section("targets"), *top.section("holdout"))
    models = tuple(_model(section, folders, insist, targets, ranks) for section in sections)
    if len({chosen.model.hash for chosen in models}) < len(models):
        raise sections[-1].wrong("the same model stands here twice; remove one")
    seen: dict[str, str] = {}
    for chosen, section in zip(models, sections, strict=True):
        for name in chosen.responses:
            if name in seen:
                raise section.wrong(
                    f"{seen[name]} and {chosen.label} both give {name}; "
                    "tell them apart with label = '...' in each model's section"
                )
            seen[name] = chosen.label
    return models


def _model(
    section: Section, folders: Sequence[Path], insist: bool, targets: Sequence[str], ranks: int | None
) -> Chosen:
    name = section.get("name", "text")
    label = section.get("label", "text") if "label" in section else ""
    if label and not NAME.fullmatch(label):
        raise section.wrong(f"label {label!r} is none; use letters, digits and _", "label")
    prefix = f"{label}_" if label else ""
    material = material_in(section.section("material"), insist)
    if name != DEFAULT_MODEL:
        try:
            folder = model_folder(name, folders)
        except InputError as error:
            raise section.wrong(str(error), "name") from error
        section.only("name", "label", "fidelity", "cheap", "fixed", "material")
        own = load_folder(folder, insist, ranks=ranks)
        at = section.get("fidelity", "text") if "fidelity" in section else None
        given = section.section("fixed")
        changes = {key: given.get(key, "number") for key in given}
        try:
            own = load_folder(folder, insist, at, changes, ranks) if at or changes else own
            own = of_material(own, material)
        except InputError as error:
            key = (
                "material" if "[models.material]" in str(error) else str(error).partition(" ")[0].rstrip(":")
            )
            within = ("fixed",) if key in changes else ("material",) if key in KEYS else ()
            raise section.wrong(str(error), *within, key) from error
        cheap = None
        if "cheap" in section:
            cheap = of_material(_cheap_folder(section, folder, folders, insist, changes), material)
        return Chosen(own, label or own.name, prefix, cheap)
    section.only("name", "label", "fidelity", "cheap", "variant", "fixed", "material")
    refuse_ranks(ranks)
    fidelity = section.get("fidelity", "text")
    variant = section.get("variant", "text") if "variant" in section else DEFAULT_VARIANT
    given = section.section("fixed")
    fixed = _fixed(given)
    apparatus = {key: given.get(key, "number") for key in APPARATUS if key in given}
    try:
        model = heap_of(load_model(fixed, fidelity, variant), material, apparatus)
    except InputError as error:
        key = str(error).partition(" ")[0]
        raise section.wrong(str(error), *(("fixed", key) if key in APPARATUS else (key,))) from error
    also = tuple(name for name in RULES if f"{prefix}{name}" in targets)
    cheaper = None
    if "cheap" in section:
        try:
            of_fidelity = load_model(fixed, section.get("cheap", "text"), variant)
            cheaper = replace(heap_of(of_fidelity, material, apparatus), also=also)
        except InputError as error:
            raise section.wrong(str(error), "cheap") from error
    return Chosen(replace(model, also=also), label or model.name, prefix, cheaper)


def _cheap_folder(
    section: Section, folder: Path, folders: Sequence[Path], insist: bool, changes: Mapping[str, float]
) -> FolderModel:
    """The cheap fidelity of a model of one's own: a fidelity of the same folder, or another folder.

    ``cheap = "coarse"``, or ``cheap = { name = "heap_coarse", fidelity = "..." }``.
    """
    try:
        if not isinstance(section.data["cheap"], dict):
            return load_folder(folder, insist, section.get("cheap", "text"), changes)
        other = section.section("cheap")
        other.only("name", "fidelity")
        at = other.get("fidelity", "text") if "fidelity" in other else None
        return load_folder(model_folder(other.get("name", "text"), folders), insist, at)
    except InputError as error:
        raise section.wrong(str(error), "cheap") from error


def _fixed(section: Section) -> FixedInputs:
    """The fixed inputs of the paper, with the changes of the file."""
    if "particle_radius" in section:
        raise section.wrong(
            "particle_radius: [models.material] has the beads' size, as diameter or sizes; write it there",
            "particle_radius",
        )
    own = [f.name for f in fields(FixedInputs) if f.name != "particle_radius"]
    section.only(*own, *APPARATUS)
    fixed = replace(
        load_plan().fixed, **{name: section.get(name, "number") for name in own if name in section}
    )
    try:
        check_physics({}, fixed)
    except InputError as error:
        raise section.wrong(str(error), str(error).partition(" ")[0]) from error
    return fixed


def knowing(mode: Mode, models: Sequence[Chosen], curves: tuple[tuple[str, ...], ...] = ()) -> Mode:
    """The mode for what the models say of their responses, and for the points of ``curves``."""
    proportional = {name: p for chosen in models for name, p in chosen.proportional.items()}
    ratios = {name: ratio for chosen in models for name, ratio in chosen.ratios.items()}
    return mode.knowing(proportional, curves, ratios)
