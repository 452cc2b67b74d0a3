"""The tables and figures of a report: which there are, and each one's title, content and notes."""

from __future__ import annotations

import io
import pickle
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context

from matplotlib import rc_context
from matplotlib.figure import Figure

from calstudy.errors import InputError
from calstudy.study import Study
from calstudy.tables import Table
from calstudy.written import choice

TABLES = (
    *("claims", "table1", "table2", "table3", "table4", "table5", "table6"),
    *("effects", "second_phase", "table_b1"),
)
FIGURES = tuple(f"figure{k}" for k in range(1, 10))
NAMES = (*TABLES, *FIGURES)
REPLICATED_TABLES = ("bands", "bands_claims")
HALF_FRACTION = "half_fraction"
BESIDE = "bands_beside"
REPLICATED_FIGURES = ("bands_figure",)
REPLICATED = (*REPLICATED_TABLES, HALF_FRACTION, BESIDE, *REPLICATED_FIGURES)
"""Of studies that were replicated on an emulator; `HALF_FRACTION` on the full factorial alone, `BESIDE` with
another such study."""
NUMBERS_BESIDE = ("numbers_beside", "numbers_beside_figure")
ROWS_BESIDE = (*NUMBERS_BESIDE, "rows_beside", "rows_beside_figure")
"""Of a study on a DEM model, with one on its emulator that was replicated."""
EVERY = (*NAMES, *REPLICATED, *ROWS_BESIDE)
PICTURES = (*FIGURES, *REPLICATED_FIGURES, NUMBERS_BESIDE[1], ROWS_BESIDE[-1])
PIXELS_PER_INCH = 200


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawn figure: its files' contents by format, title and notes."""

    name: str
    title: str
    files: Mapping[str, bytes]
    notes: Sequence[str]


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
    module = import_module(f"calstudy.analysis.{name}")
    frame = getattr(module, name)(study)
    return Table(name, module.TITLE, frame, module.COLUMNS, module.notes(study))


def picture(name: str, study: Study, formats: Sequence[str]) -> Picture:
    """Draw a figure as ``png`` or ``svg``."""
    module = import_module(f"calstudy.analysis.{name}")
    return Picture(name, module.TITLE, render(getattr(module, name)(study), formats), module.notes(study))


def render(figure: Figure, formats: Sequence[str]) -> dict[str, bytes]:
    """Contents of a figure's files; the same figure gives the same bytes each time."""
    made = {}
    # Laid out once, at one resolution, so that no format depends on which others are asked for.
    figure.set_dpi(PIXELS_PER_INCH)
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)  # "none" would be one that draws everything once more for nothing
    # Without these the SVG's ids are random and its date is now.
    with rc_context({"svg.hashsalt": "calstudy"}):
        for name in formats:
            sink = io.BytesIO()
            metadata = {"Date": None} if name == "svg" else {}
            figure.savefig(sink, format=name, dpi=PIXELS_PER_INCH, metadata=metadata)
            made[name] = sink.getvalue()
    return made


def drawing_helper() -> ProcessPoolExecutor:
    """A second process for drawings, which loads what it needs while this one goes on."""
    # Spawned, not forked: threads of the numerical libraries do not outlive a fork.
    pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_load)
    pool.submit(int)  # it starts with its first task
    return pool


def _load() -> None:
    for name in PICTURES:
        import_module(f"calstudy.analysis.{name}")


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
