"""Bands of Tables 3 to 6: each number over the replicates of a study, and the place of the published one."""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.published import BETWEEN_DECKS
from calstudy.analysis.replicates.entries import P_VALUES, TABLES
from calstudy.analysis.statistics.estimates import ALPHA, LEVELS, band, percentile
from calstudy.study.reading import Study

TITLE = "Bands of Tables 3 to 6: the study many times, on draws of the emulator"
COLUMNS = (
    Column("where", "Table"),
    Column("entry", "Entry"),
    Column("published", "Published", "z.4g"),
    Column("median", "Median [5 %; 95 %]", "z.4g", "low", "high"),
    Column("percentile", "Published lies at %", ".0f"),
    Column("significant", "Share with p < 0.05", ".2f"),
    Column("n", "Replicates", "d"),
    Column("undefined", "Undefined in", "d"),
)


def bands(study: Study) -> pd.DataFrame:
    """One line for each number of the tables; ``significant`` is for Table 5, over all replicates."""
    lines = replicated(study)
    return bands_of(lines[lines["rows"] == study.planned])


def replicated(study: Study) -> pd.DataFrame:
    """Entries of the study's replicates; there must be some."""
    assert study.replicated is not None, "the report asks for bands where there are replicates alone"
    return study.replicated


def bands_of(lines: pd.DataFrame) -> pd.DataFrame:
    """Bands of some replicates' entries of Tables 3 to 6."""
    found = []
    for (where, entry), of in lines[lines["where"].isin(TABLES)].groupby(["where", "entry"], sort=False):
        b = band(of["value"])
        published = float(of["published"].iloc[0])
        found.append(
            {
                "where": where,
                "entry": entry,
                "published": published,
                "median": b.median,
                "low": b.low,
                "high": b.high,
                "percentile": percentile(published, of["value"]),
                "significant": (of["value"] < ALPHA).mean() if where in P_VALUES else float("nan"),
                "n": b.n,
                "undefined": b.undefined,
            }
        )
    return pd.DataFrame(found)


def provenance(study: Study) -> str:
    """Origin of the bands, for captions."""
    lines, settings = replicated(study), study.settings
    each = lines[lines["rows"] == study.planned].drop_duplicates("replicate")
    first, last = (settings.seed + int(n) for n in (each["replicate"].min(), each["replicate"].max()))
    failed = f" {each['failed'].sum()} of their calibrations failed." if each["failed"].any() else ""
    return (
        f"{len(each)} replicates of {each['calibrations'].min()} of the plan's {study.planned} rows, each "
        f"with samples and noise of its own seed ({first} to {last}) on its own draw of {settings.engine}; "
        f"{settings.at}, {settings.mode} mode; target: "
        f"{settings.target.origin}.{failed}"
    )


def notes_on() -> str:
    """How to read a band."""
    low, high = (f"{100 * level:g}" for level in LEVELS)
    return (
        f"Bands reach from {low} to {high} % of the replicates in which the number exists; in the others it "
        "is undefined, such as a correlation with a constant column."
    )


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        f"{notes_on()} There it counts as not significant. Published lies at: share of the replicates below "
        "the published value, equal ones half. Table 5: p of the sequential MANOVA; a published p of 2.2e-16 "
        "is R's print limit. The paper prints none given all others.",
        BETWEEN_DECKS,
        provenance(study),
    ]
