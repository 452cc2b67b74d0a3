"""Sections 3.4 and 3.5: effects of WRL and SPP on each response and on the number of DEM runs.

The paper judges them by the boxplots of Figures 5 to 7. Here the plan's other factors are in the model.
"""

from __future__ import annotations

import math

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.labels import LABELS
from calstudy.analysis.statistics.linear_model import factor_effect
from calstudy.models.heap import RESPONSES, UNITS
from calstudy.plan import TESTS
from calstudy.study.reading import SWITCHES, Study

TITLE = "Effects of WRL and SPP: tests with the plan's other factors in the model"
COLUMNS = (
    Column("factor", "Factor"),
    Column("label", "Response"),
    Column("levels", "Levels"),
    Column("effect", "Effect [95 %]", ".3g", "low", "high"),
    Column("unit", "Unit"),
    Column("p", "p, all levels", "p"),
    Column("f", "F", ".3g"),
    Column("df", "df", "s"),
    Column("n", "n", "d"),
    Column("why_not", "Why not"),
)


def effects(study: Study) -> pd.DataFrame:
    """One line for each factor, response and pair of levels; the effect is the second level's minus the
    first's."""
    factors = study.factors()
    lines: list[dict[str, object]] = []
    tested = _tested(study)
    for factor in tested:
        others = [other for other in tested if other != factor]
        for response, label in LABELS.items():
            found = factor_effect(factors, response, factor, [*others, *SWITCHES])
            unit = UNITS.get(response.removeprefix("distance_"), "runs")
            shared = {
                "factor": factor,
                "response": response,
                "label": label,
                "unit": unit,
                "p": found.p,
                "f": found.f,
                "df": f"{found.num_df}, {found.den_df}" if not found.why_not else "",
                "n": found.n,
                "why_not": found.why_not,
            }
            nothing = {"levels": "", "effect": math.nan, "low": math.nan, "high": math.nan}
            lines += [
                shared | {"levels": f"{a:g} to {b:g}", "effect": e.value, "low": e.low, "high": e.high}
                for (a, b), e in found.differences.items()
            ] or [shared | nothing]
    return pd.DataFrame(lines)


def _tested(study: Study) -> list[str]:
    """Factors that are no switches."""
    return ["WRL", "SPP", *([TESTS] if study.plan.tests else [])]


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    tested = _tested(study)
    return [
        f"Least squares of each response on {', '.join(tested)} and the four switches of the plan, all as "
        "categories; p and F test all levels of the factor at once, given the other factors. Intervals are "
        f"those of one difference, not adjusted for their number; {len(tested) * len(LABELS)} joint tests at "
        "0.05 give a false "
        "alarm more often than one does.",
        f"Responses ({', '.join(LABELS[r] for r in RESPONSES)}) are those at the DEM optimum.",
        study.provenance(),
    ]
