"""Model folders by name, those asked for before the shipped ones, and what a shipped model declares."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Protocol

from calstudy.errors import InputError
from calstudy.records import Response
from calstudy.tomlfile import read_toml
from calstudy.written import choice

FILE = "model.toml"
BESIDE = "liggghts_models"
"""Folder beside a calibration's file that may hold its models."""
NOISE_FILE = "noise.csv"
NOTES_FILE = "NOTES.md"
EMULATORS = "emulators"
"""Folder of a model that may hold its emulators; they are no part of the model."""
EMULATOR_FILE = "emulator.json"
"""File that an emulator's directory is known by."""
RESPONSE_KEYS = ("unit", "proportional_to", "short", "quotient")
"""Keys of a response's section that say what it is, as fields of ``Response``."""
DEFAULT_MODEL = "angle_of_repose"
"""The model that is meant where none is named."""
SHIPPED = Path(str(resources.files("calstudy.liggghts_models")))


def model_folder(name: str, places: Sequence[Path] = ()) -> Path:
    """Folder of a model: the first of ``places`` that holds it, or else the shipped one.

    InputError for a name that is a path, which would lead out of these directories, and for a model that none
    of them holds.
    """
    if name in ("", ".", "..") or any(character in name for character in "/\\\0"):
        raise InputError(
            f"a model's name is the name of its folder, not a path such as {name!r}; "
            "write the name alone, and say where the folder is with --models DIR"
        )
    for place in (*places, SHIPPED):
        if (place / name / FILE).is_file():
            return place / name
    there = {found.parent.name for place in (*places, SHIPPED) for found in place.glob(f"*/{FILE}")}
    looked = "".join(f"{place}, " for place in dict.fromkeys(places))
    raise InputError(
        f"there is no model {name} in {looked}or among the shipped ones; say where it is with --models DIR, "
        f"or correct the name: {choice(name, sorted(there), 'there are')}"
    )


def refuse_ranks(ranks: int | None) -> None:
    """InputError for ranks of the default model, which runs on one core."""
    if ranks is not None and ranks > 1:
        raise InputError(f"--ranks {ranks}: the model {DEFAULT_MODEL} runs on one core; leave it out")


def shipped_noise(name: str) -> str:
    """Text of a shipped model's noise.csv; empty if it has none."""
    file = SHIPPED / name / NOISE_FILE
    return file.read_text() if file.is_file() else ""


class Declared(Protocol):
    """What is declared of a model: by the model itself, or by its model.toml."""

    @property
    def parameters(self) -> Mapping[str, str]:
        """Parameters with their units, in the order of every point."""

    @property
    def responses(self) -> tuple[Response, ...]:
        """What is measured in a DEM run."""

    @property
    def ratio(self) -> tuple[str, str] | None:
        """Two parameters that act through the quotient of the first by the second alone; or None."""


def ratios(model: Declared) -> dict[str, tuple[str, str]]:
    """Of each response the two parameters that act on it through their quotient alone; empty without such."""
    return {} if model.ratio is None else {response.name: model.ratio for response in model.responses}


@dataclass(frozen=True)
class Declaration:
    """Parameters and responses of a shipped model, which all its fidelities and variants share."""

    parameters: Mapping[str, str]
    """Names with their units, in the order of every point."""
    responses: tuple[Response, ...]
    ratio: tuple[str, str] | None
    """Two parameters that act through the quotient of the first by the second alone; or None."""
    reference: Mapping[str, float]
    """Parameters of its reference point, in SI units; empty where it has none."""


def shipped_models() -> list[str]:
    """Names of the shipped models, the default one first."""
    there = sorted(path.parent.name for path in SHIPPED.glob(f"*/{FILE}"))
    return [DEFAULT_MODEL, *(name for name in there if name != DEFAULT_MODEL)]


def fidelities(name: str, places: Sequence[Path] = ()) -> tuple[str, ...]:
    """Fidelities that a model's model.toml gives; none where there is no such model, or it is not TOML."""
    try:
        given = read_toml(model_folder(name, places) / FILE).data.get("fidelity")
    except InputError:
        return ()
    return tuple(given) if isinstance(given, dict) else ()


def is_shipped(name: str) -> bool:
    """Whether a model of that name comes with calstudy."""
    return (SHIPPED / name / FILE).is_file()


@cache
def declaration(name: str) -> Declaration:
    """Parameters, responses, ratio and reference point as a shipped model's model.toml gives them.

    InputError where no such model is shipped.
    """
    data = tomllib.loads((model_folder(name) / FILE).read_text())
    units = {
        n: given["unit"] if isinstance(given, dict) else given for n, given in data["parameters"].items()
    }
    responses = tuple(
        Response(n, **{key: given[key] for key in RESPONSE_KEYS if key in given})
        for n, given in data["responses"].items()
    )
    ratio = data.get("ratio")
    return Declaration(units, responses, tuple(ratio) if ratio else None, data.get("reference", {}))
