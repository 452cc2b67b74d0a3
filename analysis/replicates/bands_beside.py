"""Bands of two studies side by side, for example of two decks: which numbers their difference decides."""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.replicates.bands import bands_of, notes_on, provenance, replicated
from calstudy.analysis.replicates.bands_claims import shares_of
from calstudy.study.reading import Study

TITLE = "Bands of two studies side by side"
COLUMNS = (
    Column("where", "Where"),
    Column("entry", "Entry"),
    Column("published", "Published", "z.4g"),
    Column("median_here", "This study: median [5 %; 95 %]", "z.4g", "low_here", "high_here"),
    Column("median_beside", "Beside it: median [5 %; 95 %]", "z.4g", "low_beside", "high_beside"),
    Column("apart", "Bands are"),
    Column("share_here", "This study: share", ".2f"),
    Column("share_beside", "Beside it: share", ".2f"),
)
BAND = ["median", "low", "high"]


def bands_beside(study: Study) -> pd.DataFrame:
    """One line for each number of Tables 3 to 6, then one for each claim; ``share`` as ``side_by_side``."""
    other = beside(study)
    here, there = (lines[lines["rows"] == s.planned] for s, lines in _both(study, other))
    two = side_by_side(here, there, ("here", "beside"))
    is_apart = (two["low_here"] > two["high_beside"]) | (two["high_here"] < two["low_beside"])
    is_band = two["median_here"].notna() & two["median_beside"].notna()
    two["apart"] = is_apart.map({True: "apart", False: "overlapping"}).where(is_band, "")
    return two[[name for c in COLUMNS for name in (c.name, c.low, c.high) if name]]


def _both(study: Study, other: Study) -> list[tuple[Study, pd.DataFrame]]:
    return [(study, replicated(study)), (other, replicated(other))]


def beside(study: Study) -> Study:
    """The study that stands beside this one; there must be one."""
    assert study.beside is not None, "the report asks for it where there are two studies alone"
    return study.beside


def side_by_side(first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str]) -> pd.DataFrame:
    """Bands of two lists of entries in the columns ``median``, ``low``, ``high`` and ``share`` of each name.

    ``share`` is that of replicates with p < 0.05 (Table 5), or in which the values alone make the claim.
    """
    tables, met = [], []
    for lines, name in zip((first, second), names, strict=True):
        columns = {**{key: f"{key}_{name}" for key in BAND}, "significant": f"share_{name}"}
        tables.append(
            bands_of(lines).rename(columns=columns)[["where", "entry", "published", *columns.values()]]
        )
        met.append(shares_of(lines)["met"].rename(f"share_{name}"))
    two = tables[0].merge(tables[1].drop(columns="published"), on=["where", "entry"])
    statements = pd.concat(met, axis=1).rename_axis("where").reset_index().assign(entry="values alone hold")
    return pd.concat([two, statements], ignore_index=True)


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        f"{notes_on()} Apart: no value is in both bands, so that what differs between the studies decides "
        "the number. Share: replicates with p < 0.05 (Table 5), or in which a claim's figures all lie "
        "within its limits.",
        f"This study: {provenance(study)}",
        f"Beside it: {provenance(beside(study))}",
    ]
