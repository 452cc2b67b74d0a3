"""What the half fraction cost: the bands of the paper's 72 rows beside those of all 144, same replicates."""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.published import ROWS
from calstudy.analysis.replicates.bands import provenance, replicated
from calstudy.analysis.replicates.bands_beside import side_by_side
from calstudy.analysis.replicates.entries import P_VALUES
from calstudy.study.reading import Study

TITLE = "What the half fraction cost: 72 rows beside all 144"
COLUMNS = (
    Column("where", "Where"),
    Column("entry", "Entry"),
    Column("published", "Published", "z.4g"),
    Column("median_half", "72 rows: median [5 %; 95 %]", "z.4g", "low_half", "high_half"),
    Column("median_full", "144 rows: median [5 %; 95 %]", "z.4g", "low_full", "high_full"),
    Column("width_ratio", "Width, 144 over 72", ".2f"),
    Column("share_half", "72 rows: share", ".2f"),
    Column("share_full", "144 rows: share", ".2f"),
)


def half_fraction(study: Study) -> pd.DataFrame:
    """One line for each number of Tables 3 to 6, then one for each claim; ``share`` as ``side_by_side``."""
    lines = replicated(study)
    half, full = lines[lines["rows"] == ROWS], lines[lines["rows"] == study.planned]
    two = side_by_side(half, full, ("half", "full"))
    width_half, width_full = (two[f"high_{name}"] - two[f"low_{name}"] for name in ("half", "full"))
    is_correlation = ~two["where"].isin(P_VALUES)  # the width of a p-value's band says nothing
    two["width_ratio"] = width_full / width_half.where((width_half > 0) & is_correlation)
    return two[[name for c in COLUMNS for name in (c.name, c.low, c.high) if name]]


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        "The 72 rows are those of the same replicates, so that both bands share samples, noise and draws. A "
        "number that only varies by chance has a band narrower by the square root of 2, 0.71, on twice the "
        "rows; where the medians differ by more, the half fraction is biased. Share: replicates with p < "
        "0.05 (Table 5), or in which a claim's figures all lie within its limits.",
        provenance(study),
    ]
