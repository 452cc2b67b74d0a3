"""Model folders by name: in the directories that are asked for, then among the shipped ones."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from calstudy.errors import InputError
from calstudy.written import choice

FILE = "model.toml"
BESIDE = "liggghts_models"
"""Folder beside a calibration's file that may hold its models."""
NOISE_FILE = "noise.csv"
NOTES_FILE = "NOTES.md"
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


def shipped_noise(name: str) -> str:
    """Text of a shipped model's noise.csv; empty where there is none."""
    file = SHIPPED / name / NOISE_FILE
    return file.read_text() if file.is_file() else ""
