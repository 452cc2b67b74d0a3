"""Table 5 (section 3.2): MANOVA of the three responses on the six parameters and their interactions.

As R's ``manova``: sequential, Pillai's trace, once on the Kriging and once on the DEM optima.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.labels import LABELS
from calstudy.analysis.published import BETWEEN_DECKS, published
from calstudy.analysis.statistics.manova import Manova, manova
from calstudy.plan import PARAMETERS
from calstudy.study.reading import OPTIMA, Study

TITLE = "Table 5: MANOVA of angle of repose, bulk density and Rayleigh time-step on the parameters"
COLUMNS = (
    Column("data", "Data"),
    Column("term", "Factor"),
    Column("p_published", "p published", "p"),
    Column("p", "p, sequential", "p"),
    Column("pillai", "Pillai", ".4f"),
    Column("f", "F", ".4g"),
    Column("df", "df", "s"),
    Column("partial_eta_squared", "Partial eta² [95 %]", ".3f", "low", "high"),
    Column("p_given_all_others", "p given all others", "p"),
    Column("pillai_given_all_others", "Pillai given all others", ".4f"),
    Column("n", "n", "d"),
    Column("why_not", "Why not"),
)
NUMBERS = (
    *("p", "pillai", "f", "partial_eta_squared", "low", "high"),
    *("p_given_all_others", "pillai_given_all_others"),
)


def table5(study: Study) -> pd.DataFrame:
    """One line for each term and data set. A term that cannot be tested has the reason instead of numbers."""
    lines = []
    for model, data in OPTIMA.items():
        found = tests(study, model)
        for line in published("table5").to_dict("records"):
            beside = {"data": data, "term": line["term"], "p_published": line[f"p_{model}"]}
            lines.append(beside | _numbers(found, line["term"]))
    return pd.DataFrame(lines)


@lru_cache(maxsize=2 * len(OPTIMA))
def tests(study: Study, model: str) -> Manova:
    """MANOVA on one model's optima; of main effects only, if there are too few rows for more."""
    parameters, responses = study.optima(model)
    found = manova(parameters, responses)
    if found.sequential:
        return found
    alone = manova(parameters, responses, PARAMETERS)
    return replace(alone, untested={**found.untested, **alone.untested}) if alone.sequential else found


def _numbers(found: Manova, term: str) -> dict[str, object]:
    if term not in found.sequential:
        untested = {"df": "", "n": found.n, "why_not": found.untested[term]}
        return dict.fromkeys(NUMBERS, math.nan) | untested
    test, given_others = found.sequential[term], found.marginal[term]
    effect = test.partial_eta_squared(found.n)
    return {
        "p": test.p,
        "pillai": test.pillai,
        "f": test.f,
        "df": f"{test.num_df}, {test.den_df}",
        "partial_eta_squared": effect.value,
        "low": effect.low,
        "high": effect.high,
        "p_given_all_others": given_others.p,
        "pillai_given_all_others": given_others.pillai,
        "n": found.n,
        "why_not": "",
    }


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    said = [
        "Sequential: each term after those above it, as R's manova tests it; given all others: type III on "
        "centred and scaled columns, whatever the order. A published p of 2.2e-16 is R's print limit and "
        "means less than that. Partial eta squared with the interval of the noncentral F distribution.",
    ]
    said.append(
        "The parameters are optima, not settings of the plan, so they are correlated, and sequential tests "
        "depend on the order of the terms. DENS and YM make up the Rayleigh time-step (Eq. 1), which has "
        "nearly no residual: a term before YM is credited with what it shares with YM by chance. Read both "
        "columns of p."
    )
    if len(study.failed) or study.unfinished:
        said.append(
            f"With {len(study.ok)} of {study.planned} rows the plan is unbalanced: the order matters more."
        )
    for model, data in OPTIMA.items():
        found = tests(study, model)
        if found.sequential and found.sequential.keys() <= set(PARAMETERS):
            said.append(f"{data}: main effects alone, for the rows do not allow the paper's whole model.")
        said += [
            f"{data}: {LABELS[name]} is not among the responses: {why}."
            for name, why in found.left_out.items()
        ]
    return [*said, BETWEEN_DECKS, study.provenance()]
