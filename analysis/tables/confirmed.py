"""What each DEM optimum is worth: the responses as reported, and those of fresh runs at its parameters.

The second optimisation reports the best of many noisy runs, so its responses are better than its parameters
are on average. This goes beyond the paper, which did not run its optima again.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.fresh_runs import in_words
from calstudy.analysis.labels import LABELS
from calstudy.analysis.statistics.estimates import Estimate, mean
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, UNITS
from calstudy.study.reading import Study

TITLE = "The DEM optima run again: as reported, and as confirmed by runs with fresh seeds"
QUANTITIES = (ANGLE_OF_REPOSE, BULK_DENSITY, "sum_of_squares")
COLUMNS = (
    Column("row", "Row", "d"),
    Column("runs", "Fresh runs", "d"),
    Column(f"reported_{ANGLE_OF_REPOSE}", "Angle of repose in deg, reported", ".2f"),
    Column(f"confirmed_{ANGLE_OF_REPOSE}", "run again, mean", ".2f"),
    Column(f"reported_{BULK_DENSITY}", "Bulk density in kg/m3, reported", ".1f"),
    Column(f"confirmed_{BULK_DENSITY}", "run again, mean", ".1f"),
    Column("reported_sum_of_squares", "Sum of squares, reported", ".5f"),
    Column("confirmed_sum_of_squares", "run again, mean", ".5f"),
)


def confirmed(study: Study) -> pd.DataFrame:
    """One line for each row whose optimum was run again."""
    if study.confirmed is None:
        return pd.DataFrame(columns=[column.name for column in COLUMNS])
    rows = study.ok[study.ok["confirmed_runs"] > 0]
    columns = {"row": rows["row"], "runs": rows["confirmed_runs"]}
    for name in QUANTITIES:
        columns |= {f"reported_{name}": rows[f"dem_{name}"], f"confirmed_{name}": rows[f"confirmed_{name}"]}
    return pd.DataFrame(columns).reset_index(drop=True)


def luck(study: Study) -> dict[str, Estimate]:
    """Mean over the rows of the reported value minus the mean of the fresh runs, by quantity."""
    lines = confirmed(study)
    return {name: mean(lines[f"reported_{name}"] - lines[f"confirmed_{name}"]) for name in QUANTITIES}


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    if study.confirmed is None:
        return ["No optimum of this study was run again.", study.provenance()]
    lines = confirmed(study)
    differences = ", ".join(
        f"{LABELS.get(name, 'sum of squares')} {e.value:+.3g} [{e.low:+.3g}; {e.high:+.3g}]"
        + (f" {UNITS[name]}" if name in UNITS else "")
        for name, e in luck(study).items()
    )
    totals = [np.mean(lines[f"{which}_sum_of_squares"]) for which in ("reported", "confirmed")]
    return [
        f"{in_words(study)} A sum of squares of a fresh run has the noise of one run, as a reported one has.",
        f"Reported less run again, mean over the rows with its 95 % interval: {differences}. Mean sum of "
        f"squares: {totals[0]:.4f} as reported, {totals[1]:.4f} run again.",
        study.provenance(),
    ]
