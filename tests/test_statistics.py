"""Estimates and their intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from calstudy.analysis.statistics.estimates import (
    LARGE,
    WIDENED,
    correlation,
    correlation_by_jackknife,
    correlation_interval,
    mean,
    median,
    noncentrality,
    partial_eta_squared,
)


def test_the_interval_of_a_small_correlation_at_18_rows_is_as_wide_as_known():
    found = correlation_interval(0.24, 18)
    assert (found.low, found.high) == (pytest.approx(-0.26, abs=0.006), pytest.approx(0.63, abs=0.006))


def test_correlation_is_scipys_in_any_units():
    rng = np.random.default_rng(1)
    x = rng.normal(size=30)
    y = 0.6 * x + rng.normal(size=30)
    known = stats.pearsonr(x, y)
    interval = known.confidence_interval(0.95)
    found = correlation(5e8 + 1e6 * x, 3e-5 + 1e-7 * y)
    assert found.value == pytest.approx(known.statistic, rel=1e-6)
    assert (found.low, found.high) == (pytest.approx(interval.low, rel=1e-6), pytest.approx(interval.high))


def test_the_jackknife_interval_is_that_of_the_pseudo_values_of_z():
    rng = np.random.default_rng(3)
    x = rng.normal(size=12)
    y = x + rng.normal(size=12)
    without = [np.arctanh(stats.pearsonr(np.delete(x, k), np.delete(y, k)).statistic) for k in range(12)]
    pseudo = 12 * np.arctanh(stats.pearsonr(x, y).statistic) - 11 * np.array(without)
    reach = WIDENED * stats.t.ppf(0.975, 11) * stats.sem(pseudo)
    found = correlation_by_jackknife(5e8 + 1e6 * x, 3e-5 + 1e-7 * y)
    assert found.value == pytest.approx(stats.pearsonr(x, y).statistic, rel=1e-6)
    for end, side in ((found.low, -reach), (found.high, reach)):
        assert end == pytest.approx(np.tanh(np.arctanh(found.value) + side), rel=1e-6)


def test_where_most_rows_agree_and_a_few_do_not_the_jackknife_covers_and_fishers_interval_does_not():
    """One row in five moves far, as optima do: the law of large numbers gives the correlation itself."""
    rng = np.random.default_rng(4)

    def optima(rows):
        x = rng.random(rows)
        return x, np.where(rng.random(rows) < 0.2, rng.random(rows), x + 0.01 * rng.standard_normal(rows))

    truth = np.corrcoef(*optima(1_000_000))[0, 1]
    drawn = [optima(36) for _ in range(500)]
    covered = {
        of: np.mean([e.low <= truth <= e.high for e in (of(x, y) for x, y in drawn)])
        for of in (correlation, correlation_by_jackknife)
    }
    # Chance makes 0.01 of 500.
    assert covered[correlation_by_jackknife] > 0.9
    assert covered[correlation] < 0.8


def test_the_jackknife_needs_rows_that_vary_without_any_one_of_them():
    assert "n = 3" in correlation_by_jackknife([1, 2, 3], [1, 3, 2]).why_not
    one = correlation_by_jackknife([0, 0, 0, 0, 1], [1, 2, 3, 4, 5])
    assert math.isnan(one.low) and not math.isnan(one.value) and "but for one row" in one.why_not
    same = correlation_by_jackknife([1, 2, 3, 5], [1, 2, 3, 5])
    assert (same.low, same.value, same.high) == (1.0, 1.0, 1.0)


def test_correlation_leaves_pairs_without_a_value_out():
    found = correlation([1, 2, 3, 4, math.nan], [2, 1, 4, 3, 9])
    assert (found.n, found.value) == (4, pytest.approx(0.6))


@pytest.mark.parametrize(
    ("x", "y", "reason"),
    [
        ([1.0, 2.0], [1.0, 3.0], "n = 2"),
        ([4.175e8] * 5, [1, 2, 3, 4, 5], "constant"),
        ([1, 2, 3, 4, 5], [0.1 + 0.2, 0.3, 0.3, 0.3, 0.3], "constant"),
        ([], [], "n = 0"),
    ],
)
def test_a_correlation_that_cannot_be_had_says_why(x, y, reason):
    found = correlation(x, y)
    assert math.isnan(found.value) and math.isnan(found.low) and reason in found.why_not


def test_three_rows_have_a_correlation_but_no_interval():
    found = correlation([1, 2, 3], [1, 3, 2])
    assert found.value == pytest.approx(0.5) and math.isnan(found.low) and "n = 3" in found.why_not


def test_a_perfect_correlation_has_an_interval_without_width():
    found = correlation_interval(1.0, 36)
    assert (found.low, found.high) == (1.0, 1.0)


@given(st.floats(-0.999, 0.999), st.integers(4, 200))
def test_a_correlation_lies_in_its_interval_which_more_rows_narrow(r, n):
    found, more = correlation_interval(r, n), correlation_interval(r, n + 50)
    assert -1 <= found.low <= r <= found.high <= 1
    assert more.high - more.low < found.high - found.low


def test_the_mean_has_students_interval():
    values = [48.0, 51, 55, 50, 46, 60]
    known = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    found = mean([*values, math.nan])
    assert (found.n, found.value) == (6, pytest.approx(np.mean(values)))
    assert (found.low, found.high) == (pytest.approx(known.low), pytest.approx(known.high))
    assert math.isnan(mean([3.0]).low) and mean([3.0]).value == 3.0 and mean([]).n == 0


@pytest.mark.parametrize(
    ("n", "low", "high"), [(6, 1, 6), (18, 5, 14), (25, 8, 18), (36, 12, 25), (72, 28, 45)]
)
def test_the_interval_of_a_median_lies_between_the_ranks_of_the_sign_test(n, low, high):
    found = median(np.random.default_rng(2).permutation(np.arange(1, n + 1)))
    assert (found.low, found.value, found.high) == (low, (n + 1) / 2, high)
    # One rank further in on both sides would cover the median too seldom.
    outside = stats.binom.cdf([low - 1, low], n, 0.5)
    assert 2 * outside[0] <= 0.05 < 2 * outside[1]


def test_the_interval_of_the_median_covers_it_as_often_as_it_says():
    rng = np.random.default_rng(2)
    found = [median(rng.exponential(size=25)) for _ in range(400)]
    covered = np.mean([e.low <= math.log(2) <= e.high for e in found])
    # 95.7 % at n = 25, give or take twice the chance of 400.
    assert 0.935 <= covered <= 0.98
    assert "6 rows" in median([1, 2, 3]).why_not


# ---- partial eta squared ---------------------------------------------------------------------------


@given(st.floats(0.5, 1e4), st.integers(1, 6), st.integers(4, 80))
def test_the_interval_of_an_effect_inverts_the_noncentral_f(f, num_df, den_df):
    for probability in (0.025, 0.975):
        found = noncentrality(f, num_df, den_df, probability)
        if found > 0:
            assert stats.ncf.cdf(f, num_df, den_df, found) == pytest.approx(probability, abs=1e-7)
        else:
            assert stats.f.cdf(f, num_df, den_df) <= probability


@pytest.mark.parametrize("den_df", [5, 48])
@pytest.mark.parametrize("probability", [0.025, 0.975])
def test_the_limit_of_large_f_joins_the_noncentral_f_without_a_step(den_df, probability):
    below, above = (
        noncentrality(f, 3, den_df, probability) for f in (LARGE / 3 * 0.9999, LARGE / 3 * 1.0001)
    )
    assert above / below == pytest.approx(1.0002, abs=5e-4)


def test_an_f_beyond_scipys_reach_still_has_an_interval():
    found = partial_eta_squared(1e12, 3, 48, 72)
    assert 0.999999 < found.low <= found.value <= 1 and found.high <= 1


def test_an_effect_is_the_noncentrality_over_itself_and_all_degrees_of_freedom():
    found = partial_eta_squared(8.0, 2, 30, 33)
    assert found.value == pytest.approx(16 / 46)
    low, high = (stats.ncf.cdf(8.0, 2, 30, e / (1 - e) * 33) for e in (found.low, found.high))
    assert (low, high) == (pytest.approx(0.975, abs=1e-7), pytest.approx(0.025, abs=1e-7))
