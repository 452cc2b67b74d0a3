"""Partial correlations of the calibrated parameters."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from calstudy.analysis.statistics.estimates import correlation
from calstudy.analysis.tables.partial_correlations import notes, partial_correlation, partial_correlations
from calstudy.plan import PARAMETERS
from calstudy.study.reading import read_study
from closed_form import run_study


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """A few rows, whose optima the tests replace."""
    directory = tmp_path_factory.mktemp("study")
    run_study(directory, (1, 2))
    return read_study(directory)


def with_optima(study, optima, calibrated=PARAMETERS):
    """The study with other DEM optima (n, 6), all of which come from rows that calibrated some parameters."""
    lines = study.calibrations.iloc[np.zeros(len(optima), int)].reset_index(drop=True)
    for k, name in enumerate(PARAMETERS):
        lines[f"calibrated_{name}"] = name in calibrated
        lines[f"dem_{name}"] = optima[:, k]
    return replace(study, calibrations=lines)


def table_of(study):
    return partial_correlations(study).set_index("pair")


def test_they_are_those_of_the_inverse_of_the_correlation_matrix(study):
    rng = np.random.default_rng(1)
    optima = rng.normal(size=(40, 6)) @ rng.normal(size=(6, 6)) * [1, 1, 1, 1, 1, 1e8]
    frame = table_of(with_optima(study, optima))
    inverse = np.linalg.inv(np.corrcoef(optima, rowvar=False))
    for (i, a), (j, b) in combinations(enumerate(PARAMETERS), 2):
        known = -inverse[i, j] / np.sqrt(inverse[i, i] * inverse[j, j])
        line = frame.loc[f"{a}:{b}"]
        assert line["partial"] == pytest.approx(known, abs=1e-10)
        assert line["correlation"] == pytest.approx(np.corrcoef(optima[:, i], optima[:, j])[0, 1])
        assert (line["n"], line["df"], line["why_not"]) == (40, 34, "")
        assert line["partial_low"] < line["partial"] < line["partial_high"]


def test_a_common_cause_makes_a_plain_correlation_and_no_partial_one(study):
    rng = np.random.default_rng(2)
    optima = rng.normal(size=(60, 6))
    optima[:, 1] += 3 * optima[:, 0]
    optima[:, 2] += 3 * optima[:, 0]
    a, b = PARAMETERS[1:3]
    line = table_of(with_optima(study, optima)).loc[f"{a}:{b}"]
    assert line["low"] > 0.5 and line["partial_low"] < 0 < line["partial_high"]


def test_without_others_it_is_the_plain_correlation():
    x, y = np.random.default_rng(3).normal(size=(2, 12))
    found, df = partial_correlation(x, y, np.empty((12, 0)))
    plain = correlation(x, y)
    assert (found.value, found.low, found.high) == pytest.approx((plain.value, plain.low, plain.high))
    assert df == 10


def test_the_interval_holds_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(4)
    held = []
    for _ in range(1000):
        z = rng.normal(size=(12, 3))
        x, y = z @ [1, 2, 3] + rng.normal(size=12), z @ [3, -2, 1] + rng.normal(size=12)
        found, _ = partial_correlation(x, y, z)
        held.append(found.low < 0 < found.high)
    assert 0.93 < np.mean(held) < 0.97


def test_others_that_are_constant_or_repeat_each_other_cost_no_degree_of_freedom(study):
    rng = np.random.default_rng(5)
    optima = rng.normal(size=(20, 6))
    optima[:, 5] = 4.175e8
    line = table_of(with_optima(study, optima)).loc[f"{PARAMETERS[0]}:{PARAMETERS[1]}"]
    assert line["df"] == 15 and PARAMETERS[5] not in line["given"]
    x, y, z = rng.normal(size=(3, 20))
    once, twice = (partial_correlation(x, y, np.column_stack(zs)) for zs in ([z], [z, 7 - 2 * z]))
    assert once[0].value == pytest.approx(twice[0].value) and once[1] == twice[1] == 17


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (0, "n = 0"),
        (2, "n = 2"),
        (6, "n = 6: a correlation given 4 others needs 7 rows"),
        (7, "n = 7: an interval given 4 others needs 8 rows"),
        (8, ""),
    ],
)
def test_too_few_rows_say_why(study, rows, reason):
    optima = np.random.default_rng(6).normal(size=(rows, 6))
    line = table_of(with_optima(study, optima)).iloc[0]
    assert line["why_not"].startswith(reason) and bool(line["why_not"]) == bool(reason)
    assert np.isnan(line["partial"]) == (rows < 7) and np.isnan(line["partial_low"]) == (rows < 8)


def test_a_parameter_that_the_others_determine_says_so(study):
    optima = np.random.default_rng(7).normal(size=(20, 6))
    optima[:, 0] = optima[:, 2:] @ [1, 2, 3, 4]
    line = table_of(with_optima(study, optima)).iloc[0]
    assert line["why_not"] == "determined by the others" and np.isnan(line["partial"])
    assert not np.isnan(line["correlation"])


def test_rows_that_calibrated_one_of_the_pair_alone_are_left_out(study):
    optima = np.random.default_rng(8).normal(size=(20, 6))
    frame = table_of(with_optima(study, optima, calibrated=PARAMETERS[:2]))
    assert (frame["n"] > 0).sum() == 1 and frame["n"].iloc[0] == 20
    assert "n = " in notes(study)[-1]
