"""Bands of the ledger: how often each claim would have been made, and what decides it."""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.published import BETWEEN_DECKS, published
from calstudy.analysis.replicates.bands import provenance, replicated
from calstudy.analysis.replicates.entries import TABLES
from calstudy.analysis.statistics.estimates import band, percentile
from calstudy.analysis.statistics.verdicts import Verdict
from calstudy.study.reading import Study

TITLE = "Bands of the ledger: how often each of the paper's claims would have been made"
COLUMNS = (
    Column("where", "No."),
    Column("statement", "Claim, in our words"),
    Column("holds", "Holds", ".2f"),
    Column("open", "Cannot be decided", ".2f"),
    Column("fails", "Does not hold", ".2f"),
    Column("met", "Values alone hold", ".2f"),
    Column("entry", "Figure"),
    Column("limits", "Limits"),
    Column("published", "Published", "z.4g"),
    Column("median", "Median [5 %; 95 %]", "z.4g", "low", "high"),
    Column("percentile", "Published lies at %", ".0f"),
    Column("n", "Replicates", "d"),
    Column("undefined", "Undefined in", "d"),
)


def bands_claims(study: Study) -> pd.DataFrame:
    """One line for each figure that decides a claim. The shares of the claim stand in its first line."""
    lines = replicated(study)
    return bands_claims_of(lines[lines["rows"] == study.planned])


def bands_claims_of(lines: pd.DataFrame) -> pd.DataFrame:
    """The same from some replicates' entries."""
    statements = published("claims").set_index("claim")["statement"]
    shares = shares_of(lines)
    found: list[dict[str, object]] = []
    for (where, entry), of in lines[~lines["where"].isin(TABLES)].groupby(["where", "entry"], sort=False):
        b = band(of["value"])
        said = float(of["published"].iloc[0])
        is_first = not any(line["where"] == where for line in found)
        found.append(
            {
                "where": where,
                "statement": statements[str(where).split(",")[0]] if is_first else "",
                **{
                    name: shares.loc[str(where), name] if is_first else float("nan")
                    for name in shares.columns
                },
                "entry": entry,
                "limits": _limits(float(of["least"].iloc[0]), float(of["most"].iloc[0])),
                "published": said,
                "median": b.median,
                "low": b.low,
                "high": b.high,
                "percentile": percentile(said, of["value"]),
                "n": b.n,
                "undefined": b.undefined,
            }
        )
    return pd.DataFrame(found)


def shares_of(lines: pd.DataFrame) -> pd.DataFrame:
    """Shares of the replicates by claim: ``holds``, ``open``, ``fails``; ``met`` by the values alone."""
    of_claims = lines[~lines["where"].isin(TABLES)].astype({"met": bool})
    each = of_claims.groupby(["where", "replicate"]).agg(verdict=("verdict", "first"), met=("met", "all"))
    named = {"holds": Verdict.HOLDS, "open": Verdict.UNDECIDED, "fails": Verdict.FAILS}
    for name, verdict in named.items():
        each[name] = each["verdict"] == str(verdict)
    return each.groupby("where")[[*named, "met"]].mean()


def _limits(least: float, most: float) -> str:
    if most == float("inf"):
        return f"above {least:.4g}"
    if least == -float("inf"):
        return f"below {most:.4g}"
    return f"{least:.4g} to {most:.4g}"


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        "Shares of the replicates. Holds, cannot be decided, does not hold: the ledger's verdict, by its "
        "intervals. "
        "Values alone hold: all figures lie within the limits, whatever their intervals; this is how often "
        "somebody who looks at the numbers would have made the claim. A figure that does not exist meets "
        "no limits. Changed: by the rule that the claim has since data were seen.",
        BETWEEN_DECKS,
        provenance(study),
    ]
