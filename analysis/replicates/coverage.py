"""Does a 95 % interval hold what it should in 95 % of the replicates? For each interval that is printed.

What it should hold is taken to be the median over the replicates. Each of them has its own draw of the
emulator, so that what the draws differ in counts against the intervals, too.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.published import CALIBRATED_ROWS, CALIBRATED_TOGETHER, ROWS
from calstudy.analysis.replicates.bands import provenance, replicated
from calstudy.analysis.replicates.entries import CHANGED
from calstudy.analysis.statistics.estimates import correlation_interval
from calstudy.study.reading import Study

TITLE = "Coverage: share of the replicates whose 95 % interval holds the median of all"
COLUMNS = (
    Column("where", "Where"),
    Column("entry", "Entry"),
    Column("median", "Median", "z.4g"),
    Column("scatter", "Standard deviation over the replicates", ".3g"),
    Column("error", "By the intervals", ".3g"),
    Column("coverage", "Coverage", ".2f"),
    Column("fisher", "Fisher's interval", ".2f"),
    Column("n", "Replicates", "d"),
)
BOUNDS = ("share within", "smallest of")
"""Entries whose low and high ends are what a tolerance, or a correction, can make of them."""
NORMAL = 1.96
"""Half-width of a 95 % interval over the standard error, roughly."""


def coverage(study: Study) -> pd.DataFrame:
    """One line an interval; that of a figure which a table has, too, is there once."""
    lines = replicated(study)
    return coverage_of(lines[lines["rows"] == study.planned])


def coverage_of(lines: pd.DataFrame) -> pd.DataFrame:
    """The same of some replicates' entries (columns of `entries`)."""
    is_there = (lines["low"] < lines["high"]) & lines["value"].between(lines["low"], lines["high"])
    is_bound = lines["entry"].str.startswith(BOUNDS)
    is_replaced = lines["where"].map(CHANGED.format).isin(lines["where"])
    found = []
    for (where, entry), of in lines[is_there & ~is_bound & ~is_replaced].groupby(
        ["where", "entry"], sort=False
    ):
        median = float(of["value"].median())
        found.append(
            {
                "where": where,
                "entry": entry,
                "median": median,
                "scatter": float(of["value"].std(ddof=1)),
                "error": float((of["high"] - of["low"]).median() / (2 * NORMAL)),
                "coverage": _covering(of["low"], of["high"], median),
                "fisher": _fisher(str(where), str(entry), of, median),
                "n": len(of),
            }
        )
    table = pd.DataFrame(found, columns=[column.name for column in COLUMNS])
    # Figures of the ledger that are numbers of a table, by the same interval.
    return table.drop_duplicates(["median", "scatter", "error"], ignore_index=True)


def _covering(low: pd.Series, high: pd.Series, value: float) -> float:
    return float(((low <= value) & (value <= high)).mean())


def _fisher(where: str, entry: str, lines: pd.DataFrame, median: float) -> float:
    """Coverage of Fisher's interval of the same correlations; NaN for what is no correlation of a table."""
    rows = {
        "Table 3": CALIBRATED_ROWS.get(entry),
        "Table 4": ROWS,
        "Table 6": CALIBRATED_TOGETHER.get(entry),
    }.get(where)
    if rows is None:
        return float("nan")
    # The full factorial has twice the rows of the paper's plan, of each kind.
    n = rows * int(lines["rows"].iloc[0]) // ROWS
    found = [correlation_interval(value, n) for value in lines["value"]]
    return float(np.mean([e.low <= median <= e.high for e in found]))


def notes(study: Study) -> list[str]:
    """What the table's reader must know."""
    n = replicated(study)["replicate"].nunique()
    chance = np.sqrt(0.05 * 0.95 / max(n, 1))
    return [
        "Standard deviation: of the values over the replicates, beside the one that the intervals imply "
        f"(their width over {2 * NORMAL}). Chance makes {chance:.2f} of a coverage of 0.95. Bounds of a "
        "count are no intervals, and not here.",
        provenance(study),
    ]
