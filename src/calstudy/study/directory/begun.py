"""A study that is there already: whether it is the one that is asked for, and what it was begun with."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from calstudy import __version__
from calstudy.engines.choose import program_that_made
from calstudy.errors import StoreError
from calstudy.parameters import GRID
from calstudy.study.settings import CONFIRM, SETTINGS_FILE, StudySettings, changes, read_settings

GOES_ON_WITH = ("0.1.0", "0.2.0")
"""Earlier versions that give the same digits by the same settings; their studies keep their identity."""


def mismatch(
    directory: Path, settings: StudySettings, option: str = "--study", any_version: bool = False
) -> StoreError | None:
    """Error of a directory that holds a study with other settings; None where it holds none, or this one.

    ``option`` names the directory on the command line; ``any_version`` as in ``difference``.
    """
    differing = difference(directory, settings, any_version)
    if not differing:
        return None
    return StoreError(
        f"{directory} holds a study with other settings: {'; '.join(differing)}; to run this one beside it, "
        f"add {option} {shlex.quote(str(free_name(directory)))}; to go on with it, "
        f"{going_on(directory, settings)}"
    )


def difference(directory: Path, settings: StudySettings, any_version: bool = False) -> list[str]:
    """What differs from the study in a directory, in words; empty where it holds none, or this one.

    With ``any_version`` a program's version, which is not known yet in a dry run, is taken to be the
    study's. Raises StoreError where its settings are damaged.
    """
    if not (directory / SETTINGS_FILE).exists():
        return []
    there = read_settings(directory)
    program = program_that_made(settings.engine)
    if any_version and program and program == program_that_made(there.engine):
        settings = replace(settings, engine=there.engine)
    return [] if there == settings else changes(there.content, settings.content)


def free_name(directory: Path) -> Path:
    """Directory beside it that does not exist yet."""
    names = (directory.with_name(f"{directory.name}-{k}") for k in itertools.count(2))
    return next(name for name in names if not name.exists())


def going_on(directory: Path, settings: StudySettings) -> str:
    """What to do to go on with the study that is there."""
    began = read_settings(directory).calstudy
    return f"{'' if began == settings.calstudy else f'take calstudy {began} and '}ask for its settings"


def grid_there(directory: Path) -> int | None:
    """Grid of the study that is there, which goes on as it was begun; else that of new studies."""
    return read_settings(directory).grid if (directory / SETTINGS_FILE).exists() else GRID


def confirm_there(directory: Path) -> int:
    """DEM runs that confirm the optimum in the study that is there; else those of a new one."""
    return read_settings(directory).confirm if (directory / SETTINGS_FILE).exists() else CONFIRM


def procedure_there(directory: Path) -> int | None:
    """Version of the mode in the study that is there, which goes on as it was begun; None for the newest."""
    return read_settings(directory).procedure if (directory / SETTINGS_FILE).exists() else None


def start_there(directory: Path) -> Mapping[str, Any] | None:
    """What the study that is there has stored of an earlier one; None without any."""
    case = read_settings(directory).case if (directory / SETTINGS_FILE).exists() else None
    return None if case is None else case.definition.get("start")


def begun_with(directory: Path) -> tuple[int | None, int, int | None, Mapping[str, Any] | None]:
    """What a calibration goes on with in a directory.

    Its grid, runs that confirm the optimum, procedure, and what is stored of an earlier study.
    """
    there = grid_there(directory), confirm_there(directory), procedure_there(directory)
    return *there, start_there(directory)


def version_there(directory: Path) -> str:
    """Version of calstudy that began the study that is there, if this one goes on with it; else this one."""
    began = read_settings(directory).calstudy if (directory / SETTINGS_FILE).exists() else __version__
    return began if began in GOES_ON_WITH else __version__
