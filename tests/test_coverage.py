"""Do the intervals that are printed cover? By the replicates that are shipped with their intervals."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.analysis.replicates.coverage import coverage, coverage_of
from calstudy.report.replicated import read_entries

SHIPPED = Path(__file__).parent.parent / "reports" / "emulated" / "soft-ring"


@pytest.fixture(scope="module")
def table():
    return coverage(read_entries(SHIPPED)).set_index(["where", "entry"])


def made_up(half_width, count=2000, seed=2):
    """Values that scatter by 1 about 5, with intervals of a half-width about each."""
    value = 5 + np.random.default_rng(seed).standard_normal(count)
    return pd.DataFrame(
        {
            "where": "C17",
            "entry": "mean",
            "value": value,
            "low": value - half_width,
            "high": value + half_width,
        }
    )


@pytest.mark.parametrize(("half_width", "expected"), [(1.96, 0.95), (1.0, 0.683), (0.2, 0.159)])
def test_coverage_is_the_share_of_intervals_that_hold_the_median(half_width, expected):
    (line,) = coverage_of(made_up(half_width)).to_dict("records")
    # Three times what chance makes of 2000.
    assert line["coverage"] == pytest.approx(expected, abs=3 * math.sqrt(expected * (1 - expected) / 2000))
    assert line["scatter"] == pytest.approx(1.0, abs=0.08) and line["n"] == 2000
    assert line["error"] == pytest.approx(half_width / 1.96)


def test_bounds_of_a_count_are_no_intervals():
    counted = made_up(0.0)
    assert coverage_of(counted).empty


def test_the_intervals_of_tables_3_and_4_cover_where_fishers_do_not(table):
    optima = table.loc[["Table 3", "Table 4"]]
    assert len(optima) == 9
    assert optima["coverage"].min() >= 0.85 and optima["coverage"].mean() >= 0.9
    # Fisher's interval of the very same correlations: this is what was printed before.
    assert optima["fisher"].median() < 0.6 and optima.loc["Table 3", "fisher"].max() < 0.75


def test_fishers_intervals_of_table_6_cover(table):
    pairs = table.loc["Table 6"]
    pairs = pairs[~pairs.index.str.endswith("all rows")]
    assert len(pairs) == 6
    assert pairs["coverage"].min() >= 0.85
