"""The ledger's rules on the paper's own numbers and on made-up ones, and the published data."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from calstudy.analysis.ledger import before, rules
from calstudy.analysis.ledger.of_the_paper import paper_requirements, paper_requirements_before
from calstudy.analysis.published import CALIBRATED_ROWS, CALIBRATED_TOGETHER, published
from calstudy.analysis.statistics.estimates import Estimate, correlation_interval, impossible
from calstudy.analysis.statistics.manova import terms_of
from calstudy.analysis.statistics.verdicts import (
    Requirement,
    Verdict,
    decide,
    exact,
    largest_of_plan,
    p_value,
    share_of_plan,
    smallest_of_plan,
)
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP

HOLDS, FAILS, OPEN = Verdict.HOLDS, Verdict.FAILS, Verdict.UNDECIDED


def between(low, high, n=72):
    return Estimate((low + high) / 2, low, high, n)


# ---- verdicts ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("figure", "verdict"),
    [
        (between(0.2, 0.4), HOLDS),
        (between(0.6, 0.9), FAILS),
        (between(-0.9, -0.1), FAILS),
        (between(0.4, 0.6), OPEN),
        (between(-1, 2), OPEN),
        (impossible(3, "n = 3", 0.3), OPEN),
        (exact(0.5, 72), HOLDS),
    ],
)
def test_an_interval_inside_holds_one_outside_fails_the_rest_is_open(figure, verdict):
    assert Requirement("x", figure, 0.0, 0.5).verdict is verdict


def test_one_failure_fails_and_one_open_figure_opens():
    good, bad, open_ = (Requirement("x", e, 0, 1) for e in (exact(0.5, 9), exact(2, 9), between(0.5, 2)))
    assert decide([good]) is HOLDS
    assert decide([good, open_]) is OPEN
    assert decide([good, open_, bad]) is FAILS
    assert decide([]) is OPEN


def test_rows_that_are_not_finished_keep_a_count_open():
    again = exact(1.0, 72)
    assert rules.c01(share_of_plan(12, 12, 72), again)[0].verdict is OPEN
    assert rules.c01(share_of_plan(54, 60, 72), again)[0].verdict is HOLDS
    assert rules.c01(share_of_plan(30, 50, 72), again)[0].verdict is FAILS
    assert rules.c01(share_of_plan(0, 0, 72), again)[0].verdict is OPEN
    assert decide(rules.c14(smallest_of_plan(12, 10, 72), largest_of_plan(30, 10, 72))) is OPEN
    assert decide(rules.c14(smallest_of_plan(12, 72, 72), largest_of_plan(30, 72, 72))) is HOLDS
    assert decide(rules.c14(smallest_of_plan(12, 10, 72), largest_of_plan(80, 10, 72))) is FAILS


def test_a_lack_of_significance_counts_on_a_nearly_complete_plan_alone():
    assert p_value(0.3, 70, 72).low == 0.3
    assert (p_value(0.3, 20, 72).low, p_value(0.3, 20, 72).high) == (0.0, 1.0)
    assert p_value(0.01, 20, 72).high == 0.01
    assert math.isnan(p_value(math.nan, 72, 72).low)


# ---- the paper's own numbers ---------------------------------------------------------------------------


def test_the_rules_hold_on_the_papers_own_numbers_where_they_decide():
    found = {claim: decide(required) for claim, required in paper_requirements().items()}
    assert found.pop("C21") is FAILS  # the abstract contradicts Table 6
    # No optimum was run again; an interval that covers needs the rows; 18 rows do not tell 0.24 from 0.66.
    assert {found.pop(claim) for claim in ("C01", "C06", "C07", "C10")} == {OPEN}
    assert set(found) == {"C03", "C08", "C09", "C14", "C17", "C19", "C20"}
    assert set(found.values()) == {HOLDS}


def test_the_changed_rules_were_decided_otherwise_on_the_papers_own_numbers():
    found = {claim: decide(required) for claim, required in paper_requirements_before().items()}
    assert found == {"C01": HOLDS, "C06": HOLDS, "C07": HOLDS, "C10": OPEN, "C21": FAILS}


def test_the_abstract_contradicts_the_strong_pair_alone():
    required = {r.name: r.verdict for r in paper_requirements()["C21"]}
    assert required.pop("MU_PP:RF_PP") is FAILS
    assert FAILS not in required.values()


def test_the_strong_pair_is_decided_and_the_others_are_open():
    first, *others = paper_requirements()["C10"]
    assert first.name == "MU_PP:RF_PP" and first.verdict is HOLDS
    assert FAILS not in {r.verdict for r in others} and OPEN in {r.verdict for r in others}


@pytest.mark.parametrize(("claim", "term", "p"), [("C08", "MU_PW", 0.3), ("C08", "DENS:YM", 1e-4)])
def test_a_changed_p_value_changes_the_verdict_on_the_kriging_data(claim, term, p):
    values = published("table5").set_index("term")["p_kriging"].to_dict()
    assert decide(rules.c08(values, 72, 72)) is HOLDS
    assert decide(rules.c08(values | {term: p}, 72, 72)) is FAILS


def test_one_of_fifteen_interactions_just_significant_decides_nothing():
    values = published("table5").set_index("term")["p_kriging"].to_dict()
    assert decide(rules.c08(values | {"DENS:YM": 0.03}, 72, 72)) is OPEN
    assert decide(rules.c08(values | {"DENS:YM": math.nan}, 72, 72)) is OPEN
    assert decide(rules.c08(values | {"MU_PW": 0.3}, 30, 72)) is OPEN


@pytest.mark.parametrize(
    ("change", "n", "verdict"),
    [
        ({}, 72, HOLDS),
        ({"DENS:YM": 0.2}, 72, FAILS),
        ({"DENS:YM": 0.2}, 40, OPEN),
        ({"MU_PW": 0.01}, 40, FAILS),
    ],
)
def test_the_verdict_on_the_dem_data_follows_its_p_values(change, n, verdict):
    values = published("table5").set_index("term")["p_dem"].to_dict()
    assert decide(rules.c09(values | change, n, 72)) is verdict


# ---- each rule in each direction -------------------------------------------------------------------------

R = correlation_interval
ALL = dict.fromkeys(PARAMETERS, R(0.99, 72))
RESPONSES = {ANGLE_OF_REPOSE: R(0.7, 72), BULK_DENSITY: R(0.95, 72), RAYLEIGH_TIME_STEP: R(0.99, 72)}
PAIRS = dict.fromkeys(CALIBRATED_TOGETHER, R(0.0, 500)) | {"MU_PP:RF_PP": R(-0.7, 36)}
DOWN, UP, WIDE = between(-3, -1), between(1, 3), between(-4, 4)


def shares(at_5, at_10):
    return {0.05: exact(at_5, 72), 0.1: exact(at_10, 72)}


def walls(one, other):
    return {"MU_PW": exact(one, 36), "RF_PW": exact(other, 36)}


@pytest.mark.parametrize(
    ("required", "verdict"),
    [
        (rules.c01(exact(0.95, 72), between(0.8, 0.9)), HOLDS),
        (rules.c01(exact(0.95, 72), between(0.6, 0.8)), OPEN),
        (rules.c01(exact(0.95, 72), between(0.5, 0.7)), FAILS),
        (rules.c01(exact(0.95, 72), impossible(0, "no optimum was run again")), OPEN),
        (rules.c02(shares(0.95, 1), shares(0.92, 1)), HOLDS),
        (rules.c02(shares(0.4, 1), shares(0.92, 1)), OPEN),
        (rules.c02(shares(0.4, 0.8), shares(0.92, 1)), FAILS),
        (rules.c03(exact(1.0, 72), exact(71 / 72, 72)), FAILS),
        (rules.c04({0.0: between(0.6, 0.9), 1.0: between(0.8, 1)}, {0.0: between(0, 0.1)}), HOLDS),
        (rules.c04({0.0: between(0.2, 0.4), 1.0: between(0.8, 1)}, {0.0: between(0, 0.1)}), FAILS),
        (rules.c04({0.0: between(0.6, 0.9)}, {0.0: between(0, 1), 1.0: between(0, 0.1)}), OPEN),
        (rules.c05(walls(0.5, 0.4), walls(0.1, 0.5)), HOLDS),
        (rules.c05(walls(0.5, 0.2), walls(0.1, 0.1)), FAILS),
        (rules.c05(walls(1.0, 1.0), walls(0.6, 0.4)), FAILS),
        (rules.c05(walls(1.0, 1.0), dict.fromkeys(rules.WALLS, share_of_plan(2, 9, 36))), OPEN),
        (rules.c06(ALL), HOLDS),
        (rules.c06(ALL | {"YM": R(0.92, 10)}), OPEN),
        (rules.c06(ALL | {"YM": R(0.3, 36)}), FAILS),
        (rules.c07(RESPONSES), HOLDS),
        (rules.c07(RESPONSES | {ANGLE_OF_REPOSE: R(0.99, 72)}), FAILS),
        (rules.c07(RESPONSES | {ANGLE_OF_REPOSE: R(0.93, 72)}), OPEN),
        (rules.c10(PAIRS), HOLDS),
        (rules.c10(PAIRS | {"MU_PW:RF_PW": R(0.95, 500)}), FAILS),
        (rules.c10(PAIRS | {"MU_PP:RF_PP": R(0.1, 500)}), FAILS),
        (rules.c10(PAIRS | {"MU_PW:RF_PW": R(0.5, 18)}), OPEN),
        (rules.c11(UP, UP), HOLDS),
        (rules.c11(UP, DOWN), FAILS),
        (rules.c11(UP, WIDE), OPEN),
        (rules.no_effect("WRL", exact(0.4, 72), {"0 to 1": between(-1, 1)}, 2.0), HOLDS),
        (rules.no_effect("WRL", exact(0.4, 72), {"0 to 1": between(-1, 3)}, 2.0), OPEN),
        (rules.no_effect("WRL", exact(0.01, 72), {"0 to 1": between(0.1, 1)}, 2.0), FAILS),
        (rules.c13(between(10, 60), 1500), HOLDS),
        (rules.c13(between(-60, -10), 1500), FAILS),
        (rules.c13(between(80, 100), 1500), FAILS),
        (rules.c13(between(-10, 60), 1500), OPEN),
        (rules.c15({0.0: DOWN, 0.5: DOWN, 1.0: WIDE}, 72, 72), HOLDS),
        (rules.c15({0.0: DOWN, 0.5: DOWN, 1.0: WIDE}, 64, 72), OPEN),
        (rules.c15({0.0: DOWN, 0.5: DOWN, 1.0: DOWN}, 27, 72), FAILS),
        (rules.c15({0.0: UP, 0.5: DOWN, 1.0: WIDE}, 72, 72), FAILS),
        (rules.c15({0.0: WIDE, 0.5: DOWN, 1.0: WIDE}, 72, 72), OPEN),
        (rules.c16(UP, UP), HOLDS),
        (rules.c16(UP, DOWN), FAILS),
        (rules.c16(UP, WIDE), OPEN),
        (rules.c17(between(48, 54)), HOLDS),
        (rules.c17(between(60, 66)), FAILS),
        (rules.c17(between(40, 54)), OPEN),
        (rules.c19((0.0, 0.2667, 0.489), 2, (0.0, 0.27, 0.49)), HOLDS),
        (rules.c19((0.0, 0.3, 0.489), 2, (0.0, 0.27, 0.49)), FAILS),
        (rules.c20(between(5, 7), between(300, 400)), HOLDS),
        (rules.c20(between(0.5, 0.7), between(30, 40)), FAILS),
        (rules.c20(impossible(9, "soft", 0.8), impossible(9, "soft", 40)), OPEN),
        (rules.c21(PAIRS | {"MU_PP:RF_PP": R(0.0, 500)}), HOLDS),
        (rules.c21(PAIRS | {"MU_PP:RF_PP": R(0.0, 36)}), OPEN),
        (rules.c21(PAIRS), FAILS),
        (rules.c22(DOWN, DOWN, DOWN), HOLDS),
        (rules.c22(DOWN, UP, DOWN), FAILS),
        (rules.c22(DOWN, between(-1, 0), DOWN), OPEN),
        (rules.c23({ANGLE_OF_REPOSE: between(-1, 1), BULK_DENSITY: between(-9, 9)}, 1500), HOLDS),
        (rules.c23({ANGLE_OF_REPOSE: between(3, 4), BULK_DENSITY: between(-9, 9)}, 1500), FAILS),
        (rules.c23({ANGLE_OF_REPOSE: between(-1, 4), BULK_DENSITY: between(-9, 9)}, 1500), OPEN),
    ],
)
def test_each_rule_gives_each_verdict(required, verdict):
    assert decide(required) is verdict


def test_the_rules_that_were_changed_can_be_met_by_the_plans_rows():
    """With the paper's own strong pair and no other correlation; the rule before could not be met by any."""
    none = {pair: R(0.0, n) for pair, n in CALIBRATED_TOGETHER.items()}
    found = none | {"MU_PP:RF_PP": R(-0.659, 36)}
    assert decide(rules.c10(found)) is HOLDS
    assert decide(before.c10(found)) is OPEN
    # What no data of 18 or 36 rows can show is said to be so, and 62 rows are enough.
    assert {r.figure.why_not[:21] for r in rules.c21(none)} == {"undecidable by design"}
    assert decide(rules.c21(dict.fromkeys(none, R(0.0, 61)))) is OPEN
    assert decide(rules.c21(dict.fromkeys(none, R(0.0, 62)))) is HOLDS


def test_a_weaker_correlation_is_told_by_the_difference_of_magnitudes():
    first, *others = rules.c10({"MU_PP:RF_PP": R(-0.659, 36), "MU_PP:MU_PW": R(-0.239, 18)})
    (other,) = others
    assert first.figure.value == -0.659
    gap = other.figure
    assert gap.value == pytest.approx(0.239 - 0.659)
    # Zou (2007): each side from the distances to the ends of the two intervals.
    weak, strong = R(0.239, 18), R(0.659, 36)
    assert gap.high - gap.value == pytest.approx(math.hypot(weak.high - 0.239, 0.659 - strong.low))
    assert gap.value - gap.low == pytest.approx(math.hypot(0.239 - 0.0, strong.high - 0.659))


def test_points_spread_evenly_are_spread_and_optima_at_the_bounds_are_not():
    rng = np.random.default_rng(5)
    even = rng.random((4000, 36))
    apart = np.subtract(*np.quantile(even, (0.75, 0.25), axis=1))
    assert 0.95 < (apart >= rules.SPREAD).mean() < 0.99
    # The range that decided before is 0.9 for as many of them as it is for what lies at the bounds alone.
    assert (np.ptp(even, axis=1) >= 0.9).mean() == pytest.approx(0.89, abs=0.02)


def test_every_changed_rule_says_when_and_why_and_what_it_was():
    changed = published("changed_rules").set_index("claim")
    assert set(changed.index) == set(before.BEFORE)
    words = published("claims").set_index("claim")["rule"]
    for claim, line in changed.iterrows():
        assert line["changed"] and line["reason"] and line["rule_before"] != words[claim]


# ---- the published data ---------------------------------------------------------------------------------


def test_the_published_tables_are_whole():
    sizes = {name: len(published(name)) for name in ("table3", "table4", "table5", "table6", "claims")}
    assert sizes == {"table3": 6, "table4": 3, "table5": 21, "table6": 6, "claims": 23}


def test_the_published_correlations_are_those_of_tables_3_4_and_6():
    def column(name, key):
        return published(name).set_index(key)["correlation"].to_dict()

    assert column("table3", "parameter") == {
        "DENS": 0.9465,
        "MU_PP": 0.9987,
        "MU_PW": 0.9999,
        "RF_PP": 0.9999,
        "RF_PW": 1.0,
        "YM": 0.9969,
    }
    assert column("table4", "response") == {
        "angle_of_repose": 0.7186,
        "bulk_density": 0.9413,
        "rayleigh_time_step": 0.9943,
    }
    assert column("table6", "pair") == {
        "MU_PP:MU_PW": 0.239,
        "MU_PP:RF_PP": -0.659,
        "MU_PP:RF_PW": 0.121,
        "MU_PW:RF_PP": 0.083,
        "MU_PW:RF_PW": 0.184,
        "RF_PP:RF_PW": 0.229,
    }


def test_the_published_p_values_that_statements_rest_on_are_those_of_table_5():
    p = published("table5").set_index("term")
    assert list(p.index) == terms_of(PARAMETERS)
    largest = {"DENS": 2.2e-16, "MU_PP": 2.2e-16, "RF_PP": 2.2e-16, "YM": 2.2e-16}
    assert p.loc[list(PARAMETERS), "p_kriging"].to_dict() == largest | {"MU_PW": 0.0219, "RF_PW": 0.0001}
    assert p.loc[list(PARAMETERS), "p_dem"].to_dict() == largest | {"MU_PW": 0.0969, "RF_PW": 8.98e-9}
    significant = {"DENS:MU_PP": 5.52e-6, "DENS:RF_PP": 0.0323, "DENS:YM": 0.0207, "MU_PP:RF_PP": 4.99e-10}
    assert p.loc[list(significant), "p_dem"].to_dict() == significant
    others = p.loc[list(rules.INTERACTIONS), "p_dem"].drop(list(significant))
    assert (others.min(), others.max()) == (0.0763, 0.6465)
    on_kriging = p.loc[list(rules.INTERACTIONS), "p_kriging"]
    assert (on_kriging.min(), on_kriging.max()) == (0.1087, 0.9745)


def test_the_rows_behind_the_published_correlations_are_the_plans():
    rows = load_plan().rows
    for name, n in CALIBRATED_ROWS.items():
        assert sum(name in row.calibrated for row in rows) == n
    for pair, n in CALIBRATED_TOGETHER.items():
        assert sum(set(pair.split(":")) <= set(row.calibrated) for row in rows) == n


def test_limits_in_words_are_those_of_the_code():
    words = published("claims").set_index("claim")["rule"]
    stated = {
        "C01": [rules.ANGLE_TOLERANCE, 0.75],
        "C02": [*(100 * t for t in rules.DENSITY_TOLERANCES), 0.9],
        "C10": [rules.NEGLIGIBLE],
        "C12": [rules.MARGINS[ANGLE_OF_REPOSE]],
        "C14": [10 * (1 - rules.TENTH), 55 * (1 + rules.TENTH)],
        "C21": [rules.NEGLIGIBLE],
    }
    for claim, limits in stated.items():
        numbers = {float(x) for x in re.findall(r"\d+\.?\d*", words[claim])}
        assert {round(limit, 6) for limit in limits} <= numbers, claim
