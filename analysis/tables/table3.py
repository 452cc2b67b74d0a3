"""Table 3 (section 3.1): do the Kriging and the DEM optimisation end at the same parameters?

Pearson's correlation of both optima, for each parameter over the rows in which it was calibrated.
"""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.published import BETWEEN_DECKS, BY_JACKKNIFE, beside, published
from calstudy.analysis.published import COLUMNS as BESIDE
from calstudy.analysis.statistics.estimates import correlation, correlation_by_jackknife
from calstudy.study.reading import Study

TITLE = "Table 3: correlation of DEM optima with Kriging optima"
COLUMNS = (
    Column("parameter", "Parameter"),
    *BESIDE,
    Column("correlation_all_rows", "Over all rows", "z.4f"),
    Column("n_all_rows", "n, all", "d"),
)


def table3(study: Study) -> pd.DataFrame:
    """Published and found correlation, by parameter. The last columns include constant rows."""
    lines = []
    for line in published("table3").to_dict("records"):
        name = line["parameter"]
        rows = study.where_calibrated(name)
        found = correlation_by_jackknife(rows[f"kriging_{name}"], rows[f"dem_{name}"])
        everywhere = correlation(study.ok[f"kriging_{name}"], study.ok[f"dem_{name}"])
        lines.append(
            {"parameter": name}
            | beside(line["correlation"], found)
            | {"correlation_all_rows": everywhere.value, "n_all_rows": everywhere.n}
        )
    return pd.DataFrame(lines)


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        "n counts the rows in which the parameter was calibrated; the paper does not say over which rows it "
        f"took its coefficients. {BY_JACKKNIFE}",
        BETWEEN_DECKS,
        study.provenance(),
    ]
