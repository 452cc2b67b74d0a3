"""The ledger's rules on the paper's own printed numbers, where it prints what decides a claim."""

from __future__ import annotations

from calstudy.analysis.ledger import before, rules
from calstudy.analysis.published import CALIBRATED_ROWS, CALIBRATED_TOGETHER, ROWS, published
from calstudy.analysis.statistics.estimates import Estimate, correlation_interval, impossible
from calstudy.analysis.statistics.verdicts import Requirement, exact
from calstudy.models.heap import RESPONSES
from calstudy.plan_file import load_plan

NO_ROWS = "Fisher's interval is too narrow here, and another one needs the rows"
"""Of correlations of two optima, which the paper prints as numbers alone."""


def paper_requirements() -> dict[str, list[Requirement]]:
    """Requirements of each claim for which the paper prints numbers."""
    plan = load_plan().published
    lengths = (plan.A3, plan.A4, plan.A5)
    optima = {
        line["parameter"]: impossible(CALIBRATED_ROWS[line["parameter"]], NO_ROWS, line["correlation"])
        for line in published("table3").to_dict("records")
    }
    responses = {
        name: impossible(ROWS, NO_ROWS, r)
        for name, r in zip(RESPONSES, published("table4")["correlation"], strict=True)
    }
    pairs = _pairs()
    p_values = published("table5").to_dict("records")
    whole = exact(1.0, ROWS)
    minutes, mean_runs = 6.0, 51.0
    return {
        "C01": rules.c01(exact(0.75, ROWS), impossible(0, "the paper ran no optimum again")),
        "C03": rules.c03(whole, whole),
        "C06": rules.c06(optima),
        "C07": rules.c07(responses),
        "C08": rules.c08({line["term"]: line["p_kriging"] for line in p_values}, ROWS, ROWS),
        "C09": rules.c09({line["term"]: line["p_dem"] for line in p_values}, ROWS, ROWS),
        "C10": rules.c10(pairs),
        "C14": rules.c14(exact(10.0, ROWS), exact(55.0, ROWS)),
        "C17": rules.c17(exact(mean_runs, ROWS)),
        "C19": rules.c19(lengths, plan.decimals, lengths),
        "C20": rules.c20(exact(minutes, ROWS), exact(mean_runs * ROWS * minutes / 60, ROWS)),
        "C21": rules.c21(pairs),
    }


def paper_requirements_before() -> dict[str, list[Requirement]]:
    """The same by the old rules, of those claims whose rule was changed."""
    optima = {
        line["parameter"]: correlation_interval(line["correlation"], CALIBRATED_ROWS[line["parameter"]])
        for line in published("table3").to_dict("records")
    }
    responses = {
        name: correlation_interval(r, ROWS)
        for name, r in zip(RESPONSES, published("table4")["correlation"], strict=True)
    }
    return {
        "C01": [Requirement("share within 15 %", exact(0.75, ROWS), 0.75, 1.0)],
        "C06": rules.c06(optima),
        "C07": rules.c07(responses),
        "C10": before.c10(_pairs()),
        "C21": before.c21(_pairs()),
    }


def _pairs() -> dict[str, Estimate]:
    return {
        line["pair"]: correlation_interval(line["correlation"], CALIBRATED_TOGETHER[line["pair"]])
        for line in published("table6").to_dict("records")
    }
