"""Table 6 (section 3.3): are the friction coefficients of the DEM optima correlated with each other?

Pearson's correlation over the rows in which both were calibrated; beside it, over all rows.
"""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.published import BETWEEN_DECKS, beside, published
from calstudy.analysis.published import COLUMNS as BESIDE
from calstudy.analysis.statistics.estimates import correlation
from calstudy.study.reading import Study

TITLE = "Table 6: correlation of the friction coefficients at the DEM optima"
COLUMNS = (
    Column("pair", "Pair"),
    *BESIDE,
    Column("correlation_all_rows", "Over all rows [95 %]", "z.4f", "low_all_rows", "high_all_rows"),
    Column("n_all_rows", "n, all", "d"),
)


def table6(study: Study) -> pd.DataFrame:
    """Published and found correlation, by pair."""
    lines = []
    for line in published("table6").to_dict("records"):
        pair = line["pair"].split(":")
        both = study.where_calibrated(*pair)
        found = correlation(*(both[f"dem_{name}"] for name in pair))
        everywhere = correlation(*(study.ok[f"dem_{name}"] for name in pair))
        lines.append(
            {"pair": line["pair"]}
            | beside(line["correlation"], found)
            | {
                "correlation_all_rows": everywhere.value,
                "low_all_rows": everywhere.low,
                "high_all_rows": everywhere.high,
                "n_all_rows": everywhere.n,
            }
        )
    return pd.DataFrame(lines)


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        "n counts the rows in which both were calibrated. Over all rows a coefficient that is constant in "
        "half of them hides what the other half does. The paper does not say which it took. Intervals by "
        "Fisher's z.",
        BETWEEN_DECKS,
        study.provenance(),
    ]
