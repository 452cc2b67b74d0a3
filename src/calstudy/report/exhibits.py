"""The tables and figures of a report: which of them can be made, and how."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from calstudy.analysis.contents import BY_NAME, EXHIBITS, Exhibit, Kind, Of, names
from calstudy.analysis.exhibit import Picture, Table, render
from calstudy.analysis.fresh_runs import runs_beside
from calstudy.errors import InputError
from calstudy.plan import FULL_FACTORIAL, MATERIAL_TESTS
from calstudy.report.replicated import has_entries
from calstudy.study.directory.store import finished_replicates
from calstudy.study.reading import Study
from calstudy.study.settings import read_settings
from calstudy.written import choice


def chosen(option: str, text: str | None, known: tuple[str, ...]) -> tuple[str, ...]:
    """Names in a comma-separated option, in the order of the known names; without the option all of them.

    InputError: a name is unknown.
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
    # Of a factor that the study's plan does not have there is no column.
    columns = tuple(column for column in module.COLUMNS if frame.empty or column.name in frame)
    return Table(name, module.TITLE, frame, columns, module.notes(study))


def picture(name: str, study: Study, formats: Sequence[str]) -> Picture:
    """Draw a figure as ``png`` or ``svg``."""
    exhibit = BY_NAME[name]
    files, module = render(exhibit.function(study), formats), exhibit.module
    return Picture(name, module.TITLE, files, module.notes(study))


def drawing_helper() -> ProcessPoolExecutor:
    """A second process for drawing. It loads its libraries while this one goes on."""
    # Spawned, not forked: threads of the numerical libraries do not survive a fork.
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_load)
    pool.submit(int)  # it starts with its first task
    return pool


def _load() -> None:
    """Import all modules of figures."""
    for name in names(kind=Kind.FIGURE):
        _ = BY_NAME[name].module


def _picture_of(name: str, pickled: bytes, formats: Sequence[str]) -> Picture:
    """Draw a figure of a pickled study, in the second process."""
    return picture(name, pickle.loads(pickled), formats)


class Drawing:
    """Figures that a second process draws while this one goes on.

    Drawing takes longer than computing, so two processes halve the time to the report.
    """

    def __init__(
        self, helper: ProcessPoolExecutor, names: Sequence[str], study: Study, formats: Sequence[str]
    ) -> None:
        self.study, self.formats = study, formats
        # Pickled here and now: the pool would do it in a thread, while this one adds cached values to it.
        pickled = pickle.dumps(study)
        self._begun = {name: helper.submit(_picture_of, name, pickled, formats) for name in names}

    def finish(self) -> dict[str, Picture]:
        """All pictures, in order. Those that the helper has not begun are drawn here, the last one first."""
        here = {
            name: picture(name, self.study, self.formats)
            for name, future in reversed(self._begun.items())
            if future.cancel()
        }
        return {name: here[name] if name in here else f.result() for name, f in self._begun.items()}


@dataclass(frozen=True, slots=True)
class Sources:
    """What a report is made from: a study, and perhaps a second one beside it."""

    source: Path
    emulated: bool
    full_factorial: bool
    several_tests: bool
    replicated: bool
    beside: Path | None
    numbers_alone: bool
    """Whether ``beside`` has only the numbers that `analyse` wrote about replicates, not the replicates."""
    confirmed: bool
    """Whether there are runs with fresh seeds at its DEM optima."""


def sources(source: Path, beside: Path | None = None) -> Sources:
    """Look at both studies. StoreError: one is not a study. InputError: ``beside`` has no replicates."""
    settings = read_settings(source)
    numbers_alone = beside is not None and has_entries(beside)
    if beside is not None and not numbers_alone:
        read_settings(beside)
        if not finished_replicates(beside):
            raise InputError(
                f"--beside compares with replicates, but {beside} has none; name a study with some"
            )
    return Sources(
        source,
        settings.is_emulated,
        settings.plan == FULL_FACTORIAL,
        settings.tests is not None,
        bool(finished_replicates(source)),
        beside,
        numbers_alone,
        runs_beside(source).is_file(),
    )


COMPARED = (Of.REPLICATES_BESIDE, Of.NUMBERS_BESIDE, Of.ROWS_BESIDE)
_MAKE_THEM = (
    "is made from replicates, and {source} has none that fit; make them with: "
    "calstudy plan run --engine emulator --replicates 100"
)
NEEDS: tuple[tuple[tuple[Of, ...], Callable[[Sources], bool], str], ...] = (
    (
        (Of.CONFIRMED,),
        lambda s: s.confirmed,
        "is of DEM optima that were run again, and beside {source} are no such runs; make them: python "
        "benchmarks/confirmed.py design {source}",
    ),
    (
        (Of.TESTS,),
        lambda s: s.several_tests,
        "compares numbers of material tests, and {source} has one; make a study of several: calstudy plan "
        f"run --plan {MATERIAL_TESTS} --engine emulator",
    ),
    (COMPARED, lambda s: s.beside is not None, "compares two studies; name the second one with --beside"),
    (
        (Of.NUMBERS_BESIDE, Of.ROWS_BESIDE),
        lambda s: not s.emulated,
        f"is about rows on a DEM model, but {{source}} is on an emulator; ask for "
        f"{names(Of.REPLICATES_BESIDE)[0]}, or name the study on the DEM model first",
    ),
    (
        (Of.ROWS_BESIDE,),
        lambda s: not s.numbers_alone,
        "is made from replicates, but {beside} has only their numbers; name the study with the replicates "
        "themselves",
    ),
    ((Of.REPLICATES, Of.REPLICATES_BESIDE), lambda s: s.replicated, _MAKE_THEM),
    (
        (Of.HALVES,),
        lambda s: s.replicated and s.full_factorial,
        f"{_MAKE_THEM} --plan {FULL_FACTORIAL}",
    ),
)
"""What exhibits need, by what they are made of, and the message if it is missing."""


def missing(exhibit: Exhibit, has: Sources) -> str:
    """Why an exhibit cannot be made from these sources; empty if it can."""
    for of, is_met, said in NEEDS:
        if exhibit.of in of and not is_met(has):
            return f"{exhibit.name} {said.format(source=has.source, beside=has.beside)}"
    return ""


def asked_for(source: Path, only: str | None, beside: Path | None = None) -> tuple[Exhibit, ...]:
    """Exhibits of ``--only``; without it, all that can be made from the study in ``source``.

    StoreError: ``source`` or ``beside`` is not a study. InputError: a name is unknown, or its exhibit cannot
    be made.
    """
    has = sources(source, beside)
    if only is None:
        return tuple(exhibit for exhibit in EXHIBITS if not missing(exhibit, has))
    asked = tuple(BY_NAME[name] for name in chosen("--only", only, names()))
    for exhibit in asked:
        if why := missing(exhibit, has):
            raise InputError(f"--only: {why}")
    return asked
