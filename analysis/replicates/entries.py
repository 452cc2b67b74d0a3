"""All numbers of a study that the paper has, too, as one list. Replicates are compared by them.

An entry is a number of Tables 3 to 6, or a figure that decides a claim of the ledger.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pandas as pd

from calstudy.analysis.ledger.claims import requirements, requirements_before
from calstudy.analysis.ledger.of_the_paper import paper_requirements, paper_requirements_before
from calstudy.analysis.published import published
from calstudy.analysis.statistics.verdicts import Requirement, decide
from calstudy.analysis.tables.table3 import table3
from calstudy.analysis.tables.table4 import table4
from calstudy.analysis.tables.table5 import tests
from calstudy.analysis.tables.table6 import table6
from calstudy.plan_file import load_plan
from calstudy.study.reading import OPTIMA, Study

GIVEN_OTHERS = "Table 5, given all others"
P_VALUES = ("Table 5", GIVEN_OTHERS)
TABLES = ("Table 3", "Table 4", *P_VALUES, "Table 6")
CHANGED = "{}, changed"
"""Name of a claim by its new rule."""
ALL_ROWS = "{}, all rows"
"""A correlation over all rows, constants included: the paper does not say which rows it took."""


def entries(study: Study) -> pd.DataFrame:
    """One line for each entry.

    Columns: ``where`` (table or number of the claim), ``entry``, ``published``, ``value``, ``low`` and
    ``high`` (its interval; NaN where there is none); of a claim's figures besides ``least`` and ``most``
    (limits), ``met`` (whether the value itself lies between them) and ``verdict`` (on the whole claim,
    by its rule). A claim whose rule was changed is there twice.
    """
    lines = [*_correlations(study), *_p_values(study)]
    first, paper_first = requirements_before(study), paper_requirements_before()
    paper = paper_requirements()
    for claim, required in requirements(study).items():
        where = claim
        if claim in first:
            # The number of a claim stands for its first rule, the only one that earlier replicates know.
            lines += _decisive(claim, first[claim], paper_first.get(claim, []))
            where = CHANGED.format(claim)
        lines += _decisive(where, required, paper.get(claim, []))
    return pd.DataFrame(lines)


def _decisive(where: str, required: list[Requirement], paper: list[Requirement]) -> list[dict[str, object]]:
    printed = {r.name: value_of(r) for r in paper}
    verdict = str(decide(required))
    return [
        {
            "where": where,
            "entry": r.name,
            "published": printed.get(r.name, math.nan),
            "value": value_of(r),
            "low": r.figure.low,
            "high": r.figure.high,
            "least": r.least,
            "most": r.most,
            "met": r.least <= value_of(r) <= r.most,
            "verdict": verdict,
        }
        for r in required
    ]


def value_of(required: Requirement) -> float:
    """The value that a reader without intervals would compare with the limits."""
    figure = required.figure
    # A figure without width is its own bound, even if it is the end of another figure's interval.
    return figure.low if figure.low == figure.high else figure.value


def half_of(study: Study) -> Study:
    """The paper's rows of a study on the full factorial, as a study."""
    plan = load_plan()
    return replace(study.only({row.run for row in plan.rows}), plan=plan)


def _correlations(study: Study) -> list[dict[str, object]]:
    lines: list[dict[str, object]] = []
    tables = ((table3, "parameter"), (table4, "response"), (table6, "pair"))
    for where, (table, names) in zip(("Table 3", "Table 4", "Table 6"), tables, strict=True):
        for line in table(study).to_dict("records"):
            name, common = line.get("label", line[names]), {"where": where, "published": line["published"]}
            interval = {"low": line["low"], "high": line["high"]}
            lines.append({**common, "entry": name, "value": line["correlation"], **interval})
            if "correlation_all_rows" in line:
                over_all = {"entry": ALL_ROWS.format(name), "value": line["correlation_all_rows"]}
                lines.append({**common, **over_all})
    return sorted(lines, key=lambda line: (line["where"], str(line["entry"]).endswith("all rows")))


def _p_values(study: Study) -> list[dict[str, object]]:
    lines: list[dict[str, object]] = []
    for model, data in OPTIMA.items():
        found = tests(study, model)
        for where, of in zip(P_VALUES, (found.sequential, found.marginal), strict=True):
            for line in published("table5").to_dict("records"):
                term = line["term"]
                value = of[term].p if term in of else math.nan
                # The paper prints the sequential ones.
                printed = math.nan if where == GIVEN_OTHERS else line[f"p_{model}"]
                entry = {"entry": f"{data}: {term}", "published": printed, "value": value}
                lines.append({"where": where, **entry})
    return lines
