"""The probability that a run gives responses, and what search, reach and solution space make of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import calstudy as cs
from calstudy.calibration.kriging.success import LIKELY, Success
from calstudy.calibration.procedure import expected_costs
from calstudy.calibration.sampling import maximin_optimised
from calstudy.calibration.solutions import failing_share, reach
from calstudy.parameters import Array
from calstudy.records import OPTIMISATION
from calstudy.report.solution_space import solutions_in_words
from calstudy.study.reading import Result


def fitted(points: Array, usable: NDArray[np.bool_]) -> Success:
    found = Success.of(points, usable)
    assert found is not None
    return found


def test_without_failed_runs_or_without_others_there_is_nothing_to_learn() -> None:
    points = np.random.default_rng(1).random((10, 3))
    assert Success.of(points, np.ones(10, bool)) is None
    assert Success.of(points, np.zeros(10, bool)) is None


@pytest.mark.parametrize("dimension", [2, 3, 6])
def test_a_half_of_the_box_where_all_runs_fail_is_found(dimension: int) -> None:
    right = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        points = maximin_optimised(dimension + 8, dimension, rng, steps=200)
        found = fitted(points, points[:, 0] <= 0.5)
        elsewhere = rng.random((1000, dimension))
        right.append(np.mean((found(elsewhere) >= LIKELY) == (elsewhere[:, 0] <= 0.5)))
    assert np.mean(right) > 0.85


def test_a_hole_in_the_middle_is_found_too() -> None:
    points = maximin_optimised(40, 2, np.random.default_rng(3), steps=300)
    found = fitted(points, np.linalg.norm(points - 0.5, axis=1) > 0.3)
    middle, corner = found(np.array([[0.5, 0.5], [0.05, 0.05]]))
    assert middle < 0.3 and corner > 0.8


def test_one_failed_run_among_many_bars_its_neighbourhood_alone() -> None:
    points = maximin_optimised(16, 3, np.random.default_rng(4), steps=300)
    usable = np.ones(16, bool)
    usable[0] = False
    found = fitted(points, usable)
    likely = found(np.random.default_rng(5).random((2000, 3))) >= LIKELY
    assert likely.mean() > 0.85 and (found(points[1:]) > LIKELY).all()


def test_probabilities_turn_round_with_the_outcomes() -> None:
    points = np.random.default_rng(6).random((12, 2))
    usable = points[:, 1] > 0.4
    elsewhere = np.random.default_rng(7).random((50, 2))
    one, other = fitted(points, usable)(elsewhere), fitted(points, ~usable)(elsewhere)
    assert one == pytest.approx(1.0 - other, abs=1e-9)


# ---- a calibration whose target lies where every run fails ------------------------------------------


@pytest.fixture(scope="module")
def failing() -> Result:
    """Every run with mu above 0.5 fails; the target would be met at 0.6."""

    def cell(mu: float, cohesion: float) -> dict[str, float]:
        if mu > 0.5:
            raise ValueError("the cell is empty")
        return {"stress": 100 + 400 * mu + cohesion}

    return cs.calibrate(cell, {"mu": (0.0, 1.0), "cohesion": (0.0, 10.0)}, {"stress": 345.0}, budget=8)


def test_the_optimum_does_not_propose_again_where_all_fail(failing: Result) -> None:
    tried = failing.evaluations[failing.evaluations["phase"].isin([str(phase) for phase in OPTIMISATION])]
    failed = tried["mu"][tried["mu"] > 0.5].to_numpy()
    assert len(failed) <= 3 and (np.diff(failed) < 0).all()  # nearer to the others each time
    assert 0.45 < failing.optimum["mu"] <= 0.5


def test_reach_and_solutions_leave_out_where_all_fail(failing: Result) -> None:
    task, surrogates = failing.definition.task, failing.surrogates
    (stress,) = reach(task, surrogates)
    assert stress.high < 345 and not stress.reachable
    assert failing_share(task, surrogates) == pytest.approx(0.5, abs=0.1)
    assert (failing.solutions.points[:, 0] < 0.6).all()
    assert "% of the box, where runs are expected to fail." in solutions_in_words(failing)


def test_a_sure_failure_promises_no_gain(failing: Result) -> None:
    task, surrogates = failing.definition.task, failing.surrogates
    points = np.array([[0.4, 5.0], [0.6, 5.0]])
    fine, lost = expected_costs(task, surrogates, points)
    _, promised = expected_costs(task, replace(surrogates, success=None), points)
    assert promised < lost < fine
