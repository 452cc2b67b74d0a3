"""The ledger's rules on the paper's own printed numbers, where it prints what decides a statement."""

from __future__ import annotations

from calstudy.analysis.ledger import rules
from calstudy.analysis.published import CALIBRATED_ROWS, CALIBRATED_TOGETHER, ROWS, published
from calstudy.analysis.statistics.estimates import correlation_interval
from calstudy.analysis.statistics.verdicts import Requirement, exact
from calstudy.models.heap import RESPONSES
from calstudy.plan_file import load_plan


def paper_requirements() -> dict[str, list[Requirement]]:
    """What decides a statement, by statement; those without printed numbers are not in it."""
    plan = load_plan().published
    lengths = (plan.A3, plan.A4, plan.A5)
    optima = {
        line["parameter"]: correlation_interval(line["correlation"], CALIBRATED_ROWS[line["parameter"]])
        for line in published("table3").to_dict("records")
    }
    responses = {
        name: correlation_interval(r, ROWS)
        for name, r in zip(RESPONSES, published("table4")["correlation"], strict=True)
    }
    pairs = {
        line["pair"]: correlation_interval(line["correlation"], CALIBRATED_TOGETHER[line["pair"]])
        for line in published("table6").to_dict("records")
    }
    p_values = published("table5").to_dict("records")
    whole = exact(1.0, ROWS)
    minutes, mean_runs = 6.0, 51.0
    return {
        "C01": rules.c01(exact(0.75, ROWS)),
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
