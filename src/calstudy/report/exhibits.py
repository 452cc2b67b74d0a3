"""The tables and figures of a report: which there are, and each one's title, content and notes."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from calstudy.analysis.contents import BY_NAME, Kind, Of, names
from calstudy.analysis.exhibit import Picture, Table, render
from calstudy.errors import InputError
from calstudy.plan import FULL_FACTORIAL
from calstudy.report.replicated import (
    has_entries,
)
from calstudy.study.reading import Study
from calstudy.study.settings import read_settings
from calstudy.study.store import finished_replicates
from calstudy.written import choice

TABLES = names(Of.STUDY, kind=Kind.TABLE)
FIGURES = names(Of.STUDY, kind=Kind.FIGURE)
NAMES = names(Of.STUDY)
HALF_FRACTION = names(Of.HALVES)[0]
BESIDE = names(Of.REPLICATES_BESIDE)[0]
REPLICATED = names(Of.REPLICATES, Of.HALVES, Of.REPLICATES_BESIDE)
NUMBERS_BESIDE = names(Of.NUMBERS_BESIDE)
ROWS_BESIDE = names(Of.NUMBERS_BESIDE, Of.ROWS_BESIDE)
EVERY = names()
PICTURES = names(kind=Kind.FIGURE)


def chosen(option: str, text: str | None, known: tuple[str, ...]) -> tuple[str, ...]:
    """Names of a comma-separated option in the order of the known ones, all without it.

    Raises InputError for a name that is none.
    """
    if text is None:
        return known
    asked = {part.strip() for part in text.split(",")}
    for name in sorted(asked - set(known)):
        raise InputError(f"{option}: {name!r} is unknown; {choice(name, known, 'choose of')}")
    return tuple(name for name in known if name in asked)


def table(name: str, study: Study) -> Table:
    """Make a table."""
    exhibit = BY_NAME[name]
    frame, module = exhibit.function(study), exhibit.module
    return Table(name, module.TITLE, frame, module.COLUMNS, module.notes(study))


def picture(name: str, study: Study, formats: Sequence[str]) -> Picture:
    """Draw a figure as ``png`` or ``svg``."""
    exhibit = BY_NAME[name]
    files, module = render(exhibit.function(study), formats), exhibit.module
    return Picture(name, module.TITLE, files, module.notes(study))


def drawing_helper() -> ProcessPoolExecutor:
    """A second process for drawings, which loads what it needs while this one goes on."""
    # Spawned, not forked: threads of the numerical libraries do not outlive a fork.
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_load)
    pool.submit(int)  # it starts with its first task
    return pool


def _load() -> None:
    for name in PICTURES:
        _ = BY_NAME[name].module


def _picture_of(name: str, pickled: bytes, formats: Sequence[str]) -> Picture:
    return picture(name, pickle.loads(pickled), formats)


class Drawing:
    """Figures that are drawn by a second process while this one goes on.

    Drawing takes longer than computing, so both processes together halve the time to the report.
    """

    def __init__(
        self, helper: ProcessPoolExecutor, names: Sequence[str], study: Study, formats: Sequence[str]
    ) -> None:
        self.study, self.formats = study, formats
        # Pickled here and now: the pool would do it in a thread, while this one adds cached values to it.
        pickled = pickle.dumps(study)
        self._begun = {name: helper.submit(_picture_of, name, pickled, formats) for name in names}

    def finish(self) -> dict[str, Picture]:
        """All pictures, in their order; what the helper has not begun is drawn here, the last one first."""
        here = {
            name: picture(name, self.study, self.formats)
            for name, future in reversed(self._begun.items())
            if future.cancel()
        }
        return {name: here[name] if name in here else f.result() for name, f in self._begun.items()}


def asked_names(source: Path, only: str | None, beside: Path | None = None) -> tuple[str, ...]:
    """Tables and figures of ``--only``; without it, all that the study in ``source`` has.

    StoreError where it or the one ``beside`` it is no study, InputError for a name that is none, or for what
    needs replicates.
    """
    settings = read_settings(source)
    has = {*NAMES, *(REPLICATED if finished_replicates(source) else ())}
    if not settings.is_emulated:
        has |= set(ROWS_BESIDE)
    if settings.plan != FULL_FACTORIAL:
        has.discard(HALF_FRACTION)
    if beside is None:
        has -= {BESIDE, *ROWS_BESIDE}
    elif has_entries(beside):
        has -= set(ROWS_BESIDE) - set(NUMBERS_BESIDE)
    else:
        read_settings(beside)
        if not finished_replicates(beside):
            raise InputError(
                f"--beside compares with replicates, and {beside} has none; name a study that has, or leave "
                "it out"
            )
    if only is None:
        return tuple(name for name in EVERY if name in has)
    names = chosen("--only", only, EVERY)
    for name in names:
        if name not in has:
            plan = " --plan full-factorial" if name == HALF_FRACTION else ""
            if beside is None and name in (BESIDE, *ROWS_BESIDE):
                raise InputError(f"--only: {name} compares two studies; name the other one with --beside")
            if name in ROWS_BESIDE and not settings.is_emulated:
                raise InputError(
                    f"--only: {name} is made from replicates, and {beside} has their numbers alone; name the "
                    "study with the replicates themselves"
                )
            if name in ROWS_BESIDE:
                raise InputError(
                    f"--only: {name} is of rows on a DEM model, and {source} is of an emulator; ask for "
                    f"{BESIDE}, or name the study on the DEM model first"
                )
            raise InputError(
                f"--only: {name} is made from replicates, and {source} has none that fit; make them: "
                f"calstudy plan run --engine emulator --replicates 100{plan}"
            )
    return names
