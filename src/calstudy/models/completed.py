"""The beads of a run of the angle-of-repose model that is proven complete."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calstudy.engines.liggghts import LOG, markers, read_dump
from calstudy.errors import RunError
from calstudy.parameters import Array
from calstudy.records import Beads

LARGEST_ENERGY = 100.0
"""Kinetic energy of a heap at the end over that of rest: one that still slides has a few times it, one that
a too long time-step shakes has thousands."""
SPEED_LIMIT = 20.0
"""m/s; a bead that falls the height of the box reaches 2 m/s, so a faster one was thrown by an error."""
LEAST_POURED = 0.99
"""Share of the beads asked for that must be there after pouring; insertion may fall short by one or two."""
LEAST_REMOVED = 0.01
"""Share of the poured beads that must have lain above the fill height, or the cylinder was not full."""
POSITION_LIMIT = 1.0
"""m; the box is smaller and LIGGGHTS deletes what leaves it, so a bead that far out is an error."""


def completed_run(
    directory: Path, *, asked: int, cylinder_diameter: float, fill_height: float, rest_energy: float
) -> tuple[Array, Beads, float]:
    """Positions (n, 3) in m, counts of beads and simulated time in s of a run that is proven complete.

    ``asked`` is the number of beads to pour; lengths in m. ``rest_energy`` in J is that below which the
    script takes a heap to be at rest. RunError for a run that is not complete, or in which beads were lost
    or thrown.
    """
    marks = markers(directory / LOG)
    if "finished" not in marks:
        raise RunError("LIGGGHTS ended with exit code 0 but did not reach the last line of its script")
    filled = read_dump(directory / "filled.dump")
    heap = read_dump(directory / "heap.dump")
    poured, simulated_time = _count(marks, "beads_poured"), _number(marks, "simulated_time")
    if (len(filled), len(heap)) != (_count(marks, "beads_filled"), _count(marks, "beads_heap")):
        raise RunError("the dumps hold other numbers of beads than the log")
    if len(heap) > len(filled):
        raise RunError(f"the heap has {len(heap)} beads, more than the {len(filled)} that it was made of")
    # Beads that an error throws out of the box are gone without a word, and few of them lie calmly.
    if poured < LEAST_POURED * asked:
        raise RunError(f"only {poured} of {asked} beads were left after pouring; the simulation exploded")
    removed = poured - len(filled)
    if removed < LEAST_REMOVED * poured:
        raise RunError(
            f"only {removed} of {poured} beads lay above {1e3 * fill_height:g} mm: the cylinder was not full"
        )
    if len(filled) and np.hypot(filled[:, 1], filled[:, 2]).max() > 0.5 * cylinder_diameter:
        raise RunError("filled.dump: a bead lies outside the cylinder; the simulation exploded")
    for name, frame in (("filled", filled), ("heap", heap)):
        if len(frame) and np.abs(frame[:, 1:4]).max() > POSITION_LIMIT:
            raise RunError(
                f"{name}.dump: a bead is more than {POSITION_LIMIT:g} m away; the simulation exploded"
            )
        if len(frame) and np.abs(frame[:, 4:7]).max() > SPEED_LIMIT:
            raise RunError(f"{name}.dump: a bead is faster than {SPEED_LIMIT:g} m/s; the simulation exploded")
    energy = _number(marks, "kinetic_energy")
    if not energy < LARGEST_ENERGY * rest_energy:
        raise RunError(
            f"the heap still shook at the end, with {energy / rest_energy:.0f} times the energy of rest: "
            "so high a friction needs a shorter time-step than this fidelity's; lower RF_PP and RF_PW, "
            "or set a time_step_share in [models.fixed]"
        )
    beads = Beads(poured=poured, filled=len(filled), on_plate=len(heap), lost=len(filled) - len(heap))
    # Positions are kept in single precision; measuring the same makes a stored heap measure the same.
    return heap[:, 1:4].astype(np.float32).astype(float), beads, simulated_time


def weighed(directory: Path) -> float:
    """Mass of the filling in kg, as LIGGGHTS weighed beads of several sizes; RunError if it is missing."""
    return _number(markers(directory / LOG), "mass_filled")


def _count(marks: Mapping[str, str], name: str) -> int:
    """Whole number that the script printed into its log; RunError when it is not there or none."""
    text = marks.get(name, "")
    if not re.fullmatch(r"[0-9]{1,9}", text):
        raise RunError(f"{LOG}: {name} is not there or no number")
    return int(text)


def _number(marks: Mapping[str, str], name: str) -> float:
    """Number, not negative, that the script printed into its log; RunError if it is missing."""
    try:
        number = float(marks.get(name, ""))
    except ValueError:
        number = math.nan
    if not 0 <= number < math.inf:
        raise RunError(f"{LOG}: {name} is not there or no number")
    return number
