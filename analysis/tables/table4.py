"""Table 4 (section 3.1): do the Kriging and the DEM model give the same responses at their own optima?"""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.labels import LABELS
from calstudy.analysis.published import BETWEEN_DECKS, BY_JACKKNIFE, beside, published
from calstudy.analysis.published import COLUMNS as BESIDE
from calstudy.analysis.statistics.estimates import correlation_by_jackknife
from calstudy.models.heap import RESPONSES
from calstudy.study.reading import Study

TITLE = "Table 4: correlation of the responses of the DEM model with those of the Kriging models"
COLUMNS = (Column("label", "Response"), *BESIDE)


def table4(study: Study) -> pd.DataFrame:
    """Published and found correlation, by response."""
    # The paper's names lack the units that this program's names carry.
    names = dict(zip(published("table4")["response"], RESPONSES, strict=True))
    return pd.DataFrame(
        [
            {"response": names[line["response"]], "label": LABELS[names[line["response"]]]}
            | beside(
                line["correlation"],
                correlation_by_jackknife(
                    study.ok[f"kriging_{names[line['response']]}"], study.ok[f"dem_{names[line['response']]}"]
                ),
            )
            for line in published("table4").to_dict("records")
        ]
    )


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        f"Each model's response is that at its own optimum. {BY_JACKKNIFE}",
        BETWEEN_DECKS,
        study.provenance(),
    ]
