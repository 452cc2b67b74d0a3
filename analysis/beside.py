"""A published correlation beside this study's: the line that Tables 3, 4 and 6 share."""

from __future__ import annotations

from typing import Any

from calstudy.statistics import Estimate
from calstudy.tables import Column

COLUMNS = (
    Column("published", "Published", "z.4f"),
    Column("correlation", "This study [95 %]", "z.4f", "low", "high"),
    Column("n", "n", "d"),
    Column("difference", "Difference", "+z.4f"),
    Column("why_not", "Why not"),
)


def beside(published: float, found: Estimate) -> dict[str, Any]:
    """Columns of a correlation beside the published one; the difference is this study's minus that."""
    return {
        "published": published,
        "correlation": found.value,
        "low": found.low,
        "high": found.high,
        "n": found.n,
        "difference": found.value - published,
        "why_not": found.why_not,
    }
