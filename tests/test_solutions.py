"""What the surrogates say of reach, bounds and other solutions, on responses known in closed form."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calstudy.calibration.cost import Cost
from calstudy.calibration.kriging.surrogates import Kriging, Surrogates
from calstudy.calibration.kriging.universal import Diagnostics
from calstudy.calibration.modes import MODES
from calstudy.calibration.sampling import maximin_optimised
from calstudy.calibration.solutions import (
    errors_of,
    forecast,
    in_the_way,
    left_free,
    nearness,
    noise_of,
    reach,
    solve,
)
from calstudy.calibration.task import Task
from calstudy.models.heap import PROPORTIONAL
from calstudy.parameters import Parameter, Space
from calstudy.records import Target
from closed_form import PLAN

SPACE = Space(tuple(Parameter(name, "-", 0.0, 1.0, None) for name in "ABC"), ("A", "B", "C"))
UNEVEN = Space(
    (
        Parameter("DENS", "kg/m3", 2400.0, 2600.0, None),
        Parameter("MU", "-", 0.0, 0.01, None),
        Parameter("YM", "Pa", 4e8, 6e8, None),
    ),
    ("DENS", "MU", "YM"),
)
UNITS = {"sum": "N", "product": "J"}


def exact(points):
    """A + B and 1 + A B: C decides nothing, and A and B make up for each other."""
    a, b, _ = points.T
    return np.stack([1 + a + b, 1 + a * b], axis=1)


def task_of(target, tolerances=None, WRL=0.0, particles=PLAN.fixed.particles, space=SPACE, noise=None):
    still = replace(particles, density=2500.0, youngs_modulus=5e8) if WRL == 0 else particles
    cost = Cost(space, Target(target, "set", "closed form"), WRL, (still,))
    return Task(
        1,
        space,
        6,
        cost,
        MODES["robust"].knowing(PROPORTIONAL),
        1,
        1,
        noise=noise,
        tolerances=tolerances or {},
    )


def knowing_density(noise_sd=0.0, data_range=(1.5, 1.5), names=("sum",), sd=0.0):
    """Surrogates of responses that are 1 at the lower end of DENS and 2 at the upper one, known to ``sd``."""
    diagnostics = Diagnostics(0.0, 0.0, noise_sd, (), True, data_range)

    def predict(points):
        return np.repeat(np.asarray(points)[:, :1] / 200 - 11, len(names), axis=1)

    return SimpleNamespace(
        predict=predict,
        predict_with_deviations=lambda points: (predict(points), np.full((len(points), len(names)), sd)),
        diagnostics=dict.fromkeys(names, diagnostics),
        success=None,
        likely_to_run=lambda points: np.ones(len(points), bool),
    )


@pytest.fixture(scope="module")
def surrogates():
    """Fits of both responses, one of the sum, and one of a response that only noise moves."""
    points = maximin_optimised(24, 3, np.random.default_rng(1), steps=200)
    kriging = Kriging(hyperparameters="robust", trend="constant")
    return {
        names: Surrogates.fit(kriging, SPACE, names, points, exact(points)[:, : len(names)])
        for names in (("sum", "product"), ("sum",))
    }


def of(task, surrogates):
    return surrogates[task.cost.responses]


def test_a_target_inside_the_reach_is_reachable_and_one_outside_is_not(surrogates):
    for target, reachable in ((2.0, True), (2.9, True), (3.5, False), (0.5, False)):
        task = task_of({"sum": target}, {"sum": 0.05})
        (found,) = reach(task, of(task, surrogates))
        assert found.reachable == reachable
        assert (found.low, found.high) == pytest.approx((1, 3), abs=0.1)


def test_what_is_out_of_reach_is_said_before_the_second_phase(surrogates):
    task = task_of({"sum": 3.5, "product": 1.5}, {"sum": 0.05, "product": 0.05})
    lines = forecast(task, of(task, surrogates), np.array([1.0, 1.0, 0.5]), UNITS)
    assert lines[0].startswith("WARNING sum: 3.5 N is OUT OF REACH inside the intervals, mean from 1.0")
    assert lines[1].startswith("product: 1.5 J is within reach")


def test_what_one_noisy_sample_gave_is_not_in_reach():
    """Reach is a statement on the mean: neither the samples' range nor a run's noise widens it."""
    task = task_of({"sum": 2.5}, {"sum": 0.05}, space=UNEVEN)
    (found,) = reach(task, knowing_density(noise_sd=0.4, data_range=(0.5, 2.5)))
    assert (found.low, found.high) == (1.0, 2.0) and not found.reachable
    (found,) = reach(task_of({"sum": 2.5}, space=UNEVEN), knowing_density(noise_sd=0.4))
    assert not found.reachable


@pytest.mark.parametrize(
    ("target", "reachable", "said"),
    [
        (1.85, True, "within reach"),
        (1.95, True, "AT THE EDGE"),
        (2.05, False, "AT THE EDGE"),
        (2.15, False, "OUT OF REACH"),
        (0.85, False, "OUT OF REACH"),
        (0.95, False, "AT THE EDGE"),
    ],
)
def test_within_a_deviation_of_the_ranges_end_a_target_is_said_to_be_at_the_edge(target, reachable, said):
    task = task_of({"sum": target}, space=UNEVEN)
    surrogates = knowing_density(sd=0.1)
    (found,) = reach(task, surrogates)
    assert (found.low, found.high, found.low_sd, found.high_sd) == (1.0, 2.0, 0.1, 0.1)
    assert found.reachable == reachable and found.is_sure == (said != "AT THE EDGE")
    first, *_ = forecast(task, surrogates, np.array([2500.0, 0.005, 5e8]), UNITS)
    assert said in first and first.startswith("WARNING") == (said == "OUT OF REACH")


def test_the_ends_of_a_range_are_looked_for_on_the_bounds():
    for bound, expected in ((0.0, 1.0), (1.0, 3.0)):
        task = task_of({"sum": expected})
        exactly = SimpleNamespace(
            predict_with_deviations=lambda at: (exact(at)[:, :1], np.zeros((len(at), 1))),
            diagnostics={"sum": Diagnostics(0.0, 0.0, 0.0, (), True, (1.5, 1.5))},
            likely_to_run=lambda at: np.ones(len(at), bool),
        )
        (found,) = reach(task, exactly)
        assert (found.low if bound == 0.0 else found.high) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("target", "reachable"), [(2.045, True), (2.055, False), (0.955, True), (0.945, False)]
)
def test_a_target_beyond_the_reach_by_less_than_its_tolerance_is_reachable(target, reachable):
    (found,) = reach(task_of({"sum": target}, {"sum": 0.05}, space=UNEVEN), knowing_density())
    assert found.reachable == reachable


@pytest.mark.parametrize(("off", "said"), [(0.099, False), (0.101, True), (-0.099, False), (-0.101, True)])
def test_a_target_is_missed_where_the_optimum_is_further_off_than_its_nearness(off, said):
    task = task_of({"sum": 1.5}, {"sum": 0.1}, space=UNEVEN)
    lines = forecast(task, knowing_density(), np.array([2500 + 200 * off, 0.005, 5e8]), UNITS)
    assert (lines[1:] == ["WARNING not all at once: at the surrogates' optimum sum is missed"]) == said


def test_targets_that_exclude_each_other_are_said_to(surrogates):
    # With a sum of 2 the product is 1.25 at least where A and B are 0.5, and never 1.8.
    task = task_of({"sum": 2.0, "product": 1.8}, {"sum": 0.02, "product": 0.02})
    lines = forecast(task, of(task, surrogates), np.array([0.8, 0.8, 0.5]), UNITS)
    assert any(line.startswith("WARNING not all at once") for line in lines)
    assert not any("OUT OF REACH" in line for line in lines)


def test_a_tolerance_below_the_noise_is_said_to_be_a_matter_of_chance(surrogates):
    for noise, tolerance, said in ((0.2, 0.1, True), (0.05, 0.1, False), (0.2, 0.0, False)):
        task = task_of({"sum": 2.0}, {"sum": tolerance})
        found = of(task, surrogates)
        noisy = {"sum": replace(found.diagnostics["sum"], noise_sd=noise)}
        lines = forecast(task, replace(found, diagnostics=noisy), np.array([0.5, 0.5, 0.5]), UNITS)
        assert any(line.startswith("WARNING sum: the tolerance, 0.1 N, is below") for line in lines) == said


def test_a_bound_is_in_the_way_where_the_target_lies_beyond_it(surrogates):
    task = task_of({"sum": 3.5})
    found = in_the_way(task, of(task, surrogates), np.array([1.0, 1.0, 0.5]))
    assert [(b.parameter, b.end, b.bound) for b in found] == [("A", "upper", 1.0), ("B", "upper", 1.0)]
    assert str(found[0]) == "the upper bound of A, 1, is in the way of the targets"


def test_the_time_step_is_no_response_that_a_bound_is_in_the_way_of():
    # A lower DENS would come nearer the target; a lower YM would make the time-step larger, and no more.
    task = task_of({"sum": 0.8}, WRL=1.0, space=UNEVEN)
    (found,) = in_the_way(task, knowing_density(), np.array([2400.0, 0.0, 4e8]))
    assert str(found) == "the lower bound of DENS, 2400, is in the way of the targets"


def test_a_bound_that_the_optimum_touches_by_chance_is_in_nobodys_way(surrogates):
    task = task_of({"sum": 2.0})
    assert in_the_way(task, of(task, surrogates), np.array([1.0, 0.0, 0.0])) == []


def test_a_bound_is_not_in_the_way_where_the_target_lies_inside(surrogates):
    task = task_of({"sum": 2.0})
    assert in_the_way(task, of(task, surrogates), np.array([1.0, 1.0, 1.0])) == []
    assert [b.end for b in in_the_way(task, of(task, surrogates), np.array([0.0, 0.0, 0.0]))] == []


def drawn(task, surrogates):
    return solve(task, surrogates, errors_of(task, {}))


def test_solutions_scatter_about_the_targets_by_their_errors_and_the_surrogates_doubts(surrogates):
    task = task_of({"sum": 2.0, "product": 1.2}, {"sum": 0.1, "product": 0.06})
    found = drawn(task, of(task, surrogates))
    assert found.errors == {"sum": 0.05, "product": 0.03}
    off = (found.responses - task.cost.desired) / np.hypot(found.doubts, [0.05, 0.03])
    assert np.abs(off).max() < 5 and off.std(axis=0) == pytest.approx([1, 1], abs=0.2)
    true = np.abs(exact(found.points) - task.cost.desired) <= [0.15, 0.1]
    assert true.all(axis=1).mean() > 0.95
    assert found.weights.sum() == pytest.approx(1.0)


def test_a_parameter_that_decides_nothing_is_left_free_and_others_are_not(surrogates):
    task = task_of({"sum": 2.0, "product": 1.25}, {"sum": 0.05, "product": 0.02})
    assert left_free(task, drawn(task, of(task, surrogates))) == ["C"]


def test_what_is_left_free_is_a_share_of_the_interval_however_wide_that_is():
    task = task_of({"sum": 1.5}, {"sum": 0.05}, space=UNEVEN)
    found = drawn(task, knowing_density())
    low, high = found.interval(0)
    assert (low, high) == pytest.approx((2500 - 1.645 * 5, 2500 + 1.645 * 5), abs=1)
    assert found.share == pytest.approx(5 * np.sqrt(2 * np.pi * np.e) / 200, rel=0.1)  # a normal's entropy
    assert left_free(task, found) == ["MU", "YM"]


def test_parameters_that_make_up_for_each_other_are_correlated(surrogates):
    task = task_of({"sum": 2.0}, {"sum": 0.05})
    correlations = drawn(task, of(task, surrogates)).correlations
    assert correlations[0, 1] < -0.95 and abs(correlations[0, 2]) < 0.1


def test_a_target_out_of_reach_leaves_what_comes_nearest(surrogates):
    task = task_of({"sum": 3.5}, {"sum": 0.05})
    found = drawn(task, of(task, surrogates))
    assert found.interval(0)[0] > 0.9 and found.interval(1)[0] > 0.9


def test_where_nothing_is_known_nothing_is_excluded():
    task = task_of({"sum": 1.5}, {"sum": 0.01}, space=UNEVEN)
    assert drawn(task, knowing_density()).share < 0.05
    found = drawn(task, knowing_density(sd=100.0))
    assert found.share > 0.99 and left_free(task, found) == ["DENS", "MU", "YM"]


def test_a_measured_value_has_its_own_error_or_else_that_of_a_run_or_half_its_tolerance():
    task = task_of({"sum": 2.0, "product": 1.5}, {"sum": 0.3})
    assert errors_of(task, {}) == {"sum": 0.15, "product": 0.0015}
    assert errors_of(task, {"sum": 0.1, "product": 0.2}) == {"sum": 0.15, "product": 0.2}
    assert errors_of(task, {"sum": 0.4}) == {"sum": 0.4, "product": 0.0015}
    known = replace(task.cost, target=replace(task.cost.target, sd={"sum": 0.02}, scale={"product": 1.0}))
    assert errors_of(replace(task, cost=known), {"sum": 0.4, "product": 0.2}) == {"sum": 0.02, "product": 0.2}


def test_solutions_are_the_same_for_the_same_fit(surrogates):
    task = task_of({"sum": 2.0}, {"sum": 0.05})
    first, second = (drawn(task, of(task, surrogates)) for _ in range(2))
    assert np.array_equal(first.points, second.points)


def test_nearness_is_the_tolerance_or_else_the_noise_or_else_little():
    task = task_of({"sum": 2.0, "product": 1.5}, {"sum": 0.1})
    assert nearness(task, {"sum": 5.0, "product": 0.2}) == {"sum": 0.1, "product": 0.4}
    assert nearness(task, {}) == {"sum": 0.1, "product": pytest.approx(0.0015)}


def test_known_noise_counts_before_what_kriging_estimates():
    names = ("sum", "product")
    task = task_of({"sum": 1.5, "product": 1.5}, space=UNEVEN, noise={"sum": 0.2})
    estimated = knowing_density(noise_sd=0.05, names=names)
    assert noise_of(task, estimated) == {"sum": 0.2, "product": 0.05}
    assert [one.nearness for one in reach(task, estimated)] == [0.4, 0.1]
