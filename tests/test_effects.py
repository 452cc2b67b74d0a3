"""Effects of the plan's factors, other factors in the model."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm

from calstudy.analysis.statistics.linear_model import factor_effect, linear_effects, slopes
from calstudy.plan import FACTORS
from calstudy.plan_file import load_plan

PLAN = load_plan()
OTHERS = [name for name in FACTORS if name != "WRL"]


@pytest.fixture
def frame():
    """The plan's 72 rows; WRL adds 0, 3, 5 to the response, MU_PP 10."""
    levels = pd.DataFrame([row.levels for row in PLAN.rows], columns=list(FACTORS))
    noise = np.random.default_rng(4).normal(size=72)
    y = levels["WRL"].map({0.0: 0.0, 0.5: 3.0, 1.0: 5.0}) + 10 * levels["MU_PP"] + noise
    return levels.assign(y=y, noise=noise)


def test_an_effect_is_found_with_its_size(frame):
    found = factor_effect(frame, "y", "WRL", OTHERS)
    assert (found.n, found.num_df, found.den_df) == (72, 2, 63) and found.p < 1e-20
    for pair, size in {(0.0, 0.5): 3.0, (0.0, 1.0): 5.0, (0.5, 1.0): 2.0}.items():
        e = found.differences[pair]
        assert e.low < size < e.high and e.value == pytest.approx(size, abs=0.8)


def test_the_test_is_the_comparison_of_nested_models(frame):
    full = pd.get_dummies(frame[list(FACTORS)].astype(str), drop_first=True).astype(float)
    small = full[[c for c in full if not c.startswith("WRL")]]
    f, p, _ = (
        sm.OLS(frame["y"], sm.add_constant(full))
        .fit()
        .compare_f_test(sm.OLS(frame["y"], sm.add_constant(small)).fit())
    )
    found = factor_effect(frame, "y", "WRL", OTHERS)
    assert (found.f, found.p) == (pytest.approx(f), pytest.approx(p))


def test_other_factors_sharpen_the_test(frame):
    assert factor_effect(frame, "y", "WRL", OTHERS).f > 10 * factor_effect(frame, "y", "WRL", []).f


@pytest.mark.slow
def test_noise_has_no_effect_more_often_than_chance(frame):
    rng = np.random.default_rng(5)
    p = [
        factor_effect(frame.assign(y=rng.permutation(frame["noise"])), "y", "SPP", ["WRL", *OTHERS[1:]]).p
        for _ in range(200)
    ]
    assert 0.01 < np.mean(np.array(p) < 0.05) < 0.1


def test_a_part_of_the_plan_gives_wider_intervals_or_says_why_not(frame):
    whole, part = factor_effect(frame, "y", "WRL", OTHERS), factor_effect(frame.head(30), "y", "WRL", OTHERS)
    widths = [e.differences[(0.0, 1.0)].high - e.differences[(0.0, 1.0)].low for e in (whole, part)]
    assert widths[1] > widths[0]


@pytest.mark.parametrize(
    ("rows", "change", "reason"),
    [
        (slice(0, 0), {}, "n = 0"),
        (slice(0, 1), {}, "one level of WRL"),
        (slice(0, 4), {}, "confounded"),
        (slice(0, 72), {"y": 7.0}, "is the same in all 72 rows"),
        (slice(0, 72), {"WRL": 0.5}, "one level of WRL"),
    ],
)
def test_what_cannot_be_tested_says_why(frame, rows, change, reason):
    found = factor_effect(frame.iloc[rows].assign(**change), "y", "WRL", OTHERS)
    assert reason in found.why_not and math.isnan(found.p) and found.differences == {}


def test_a_factor_that_follows_another_is_confounded(frame):
    copy = frame.assign(SPP=frame["WRL"])
    assert "confounded" in factor_effect(copy, "y", "WRL", OTHERS).why_not


def test_an_exact_fit_has_nothing_to_test_against(frame):
    exact = frame.assign(y=3.0 * frame["WRL"] + frame["MU_PP"])
    assert "fitted exactly" in factor_effect(exact, "y", "WRL", OTHERS).why_not


def test_slopes_are_found_within_each_level(frame):
    truth = {0.0: -2.0, 0.5: 1.0, 1.0: 0.0}
    # The levels differ by far more than the slopes do: each has its own intercept.
    y = frame["WRL"].map(truth) * frame["SPP"] + 20 * frame["WRL"] + frame["noise"] + 5 * frame["YM"]
    found = slopes(frame.assign(y=y), "y", "SPP", "WRL", ["MU_PP", "MU_PW", "YM", "RF_PW"])
    for level, slope in truth.items():
        assert found[level].low < slope < found[level].high
        assert found[level].high - found[level].low < 1


def test_slopes_of_too_few_rows_say_why(frame):
    assert all("vary enough" in e.why_not for e in slopes(frame.head(2), "y", "SPP", "WRL", []).values())
    few = slopes(frame.iloc[:7], "y", "SPP", "WRL", ["MU_PP", "MU_PW", "YM", "RF_PW"])
    assert all(e.why_not for e in few.values())


def test_linear_effects_are_slopes_with_the_others_in_the_model():
    rng = np.random.default_rng(6)
    a = rng.uniform(size=50)
    b = 0.7 * a + rng.uniform(size=50)
    frame = pd.DataFrame({"a": a, "b": b, "y": 1500 + 2 * a + rng.normal(scale=0.1, size=50)})
    found = linear_effects(frame, "y", ["a", "b"])
    known = np.linalg.lstsq(np.column_stack([np.ones(50), a, b]), frame["y"], rcond=None)[0]
    assert [found[name].value for name in "ab"] == pytest.approx(known[1:])
    assert found["a"].low < 2 < found["a"].high and found["b"].low < 0 < found["b"].high
    assert linear_effects(frame.head(2), "y", ["a", "b"])["a"].why_not
    assert "fitted exactly" in linear_effects(frame.assign(y=a), "y", ["a", "b"])["a"].why_not
