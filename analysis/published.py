"""The paper's numbers, as data: Tables 3 to 6 and the list of its claims, in our own words."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.statistics.estimates import Estimate

ROWS = 72
"""Rows of the paper's study."""
CALIBRATED_ROWS = {"DENS": 72, "RF_PP": 72, "MU_PP": 36, "MU_PW": 36, "RF_PW": 36, "YM": 36}
"""Rows of Table B-1 in which each parameter is calibrated."""
CALIBRATED_TOGETHER = {
    "MU_PP:MU_PW": 18,
    "MU_PP:RF_PP": 36,
    "MU_PP:RF_PW": 18,
    "MU_PW:RF_PP": 36,
    "MU_PW:RF_PW": 18,
    "RF_PP:RF_PW": 36,
}
"""Rows of Table B-1 in which both friction coefficients are calibrated."""

BY_JACKKNIFE = (
    "Intervals by leaving out one row at a time, on Fisher's z with Student's t, widened by a half: Fisher's "
    "own are too narrow where rows agree but for a few."
)
"""Note on the intervals of correlations of two optima."""

BETWEEN_DECKS = (
    "Intervals are those of this deck. Two decks that were written independently from the same description "
    "differ by 5 to 9 kg/m3 of bulk density and by up to 0.5 deg of the angle of repose, which no interval "
    "here has in it."
)
"""Uncertainty of what is held against the paper, whose deck is not this one."""


def published(name: str) -> pd.DataFrame:
    """Published values of ``table3`` to ``table6``, the ``claims``, or ``changed_rules``."""
    with (files("calstudy.analysis") / "published" / f"{name}.csv").open() as handle:
        return pd.read_csv(handle, keep_default_na=False, na_values=["-"])


COLUMNS = (
    Column("published", "Published", "z.4f"),
    Column("correlation", "This study [95 %]", "z.4f", "low", "high"),
    Column("n", "n", "d"),
    Column("difference", "Difference", "+z.4f"),
    Column("why_not", "Why not"),
)


def beside(published: float, found: Estimate) -> dict[str, Any]:
    """Columns of a correlation beside the published one. The difference is this study minus published."""
    return {
        "published": published,
        "correlation": found.value,
        "low": found.low,
        "high": found.high,
        "n": found.n,
        "difference": found.value - published,
        "why_not": found.why_not,
    }
