import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, kstest

from calstudy.calibration.cost import Cost
from calstudy.errors import InputError
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.parameters import Parameter, Space
from calstudy.rayleigh import Particles
from calstudy.records import Target
from closed_form import PLAN, cost_of

TARGET = Target({ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}, "paper", "section 2.2")
ROW_WITH_YM, ROW_WITHOUT_YM = 4, 10


def corner(cost, density_end, modulus_end):
    point = cost.space.box.centre
    for name, end in (("DENS", density_end), ("YM", modulus_end)):
        if name in cost.space.box.names:
            k = cost.space.box.names.index(name)
            point[k] = (cost.space.box.lower, cost.space.box.upper)[end][k]
    return point


def time_step_by_hand(density, modulus):
    shear_modulus = modulus / (2 * 1.22)
    return math.pi * 0.0025 * math.sqrt(density / shear_modulus) / (0.1631 * 0.22 + 0.8766)


def test_measured_residuals_are_relative_deviations_from_the_target():
    cost = cost_of(1, TARGET)
    residuals = cost.residuals(cost.space.box.centre, [23.1, 1470.0])
    assert residuals == pytest.approx([1.1 / 22.0, -30.0 / 1500.0, 0.0])


def test_time_step_residual_is_eq_10_by_hand():
    cost = cost_of(ROW_WITH_YM, TARGET)
    point = cost.space.box.centre
    slowest, fastest = time_step_by_hand(2400.0, 6.5e8), time_step_by_hand(2600.0, 4.175e8)
    here = time_step_by_hand(2500.0, 0.5 * (4.175e8 + 6.5e8))
    expected = 1.0 * (fastest - here) / (fastest - slowest)
    assert cost.residuals(point, [22.0, 1500.0]) == pytest.approx([0.0, 0.0, expected])


@pytest.mark.parametrize("row", [ROW_WITH_YM, ROW_WITHOUT_YM])
@pytest.mark.parametrize("weight", [0.5, 1.0])
def test_time_step_residual_is_zero_at_the_best_corner_and_the_weight_at_the_worst(row, weight):
    cost = replace(cost_of(row, TARGET), WRL=weight)
    best, worst = corner(cost, 1, 0), corner(cost, 0, 1)
    at_corners = cost.residuals([best, worst], [[22.0, 1500.0]] * 2)[:, 2]
    assert at_corners == pytest.approx([0.0, weight], abs=1e-14)


@given(unit=st.lists(st.floats(0.0, 1.0), min_size=5, max_size=5))
def test_time_step_residual_lies_between_zero_and_the_weight(unit):
    cost = cost_of(ROW_WITH_YM, TARGET)
    point = cost.space.box.from_unit(unit)
    assert -1e-12 <= cost.residuals(point, [22.0, 1500.0])[2] <= cost.WRL + 1e-12


def test_the_extremes_are_those_of_the_calibrated_intervals_only():
    with_modulus, without = cost_of(ROW_WITH_YM, TARGET), cost_of(ROW_WITHOUT_YM, TARGET)
    at_centre = [c.residuals(c.space.box.centre, [22.0, 1500.0])[2] for c in (with_modulus, without)]
    slowest, fastest = time_step_by_hand(2400.0, 5.06e8), time_step_by_hand(2600.0, 5.06e8)
    here = time_step_by_hand(2500.0, 5.06e8)
    assert at_centre[1] == pytest.approx((fastest - here) / (fastest - slowest))
    assert at_centre[0] != pytest.approx(at_centre[1], abs=0.01)


def test_without_weight_the_time_step_residual_is_zero_everywhere():
    cost = replace(cost_of(ROW_WITH_YM, TARGET), WRL=0.0)
    points = np.array([cost.space.box.lower, cost.space.box.centre, cost.space.box.upper])
    assert (cost.residuals(points, np.full((3, 2), 7.0))[:, 2] == 0.0).all()


def test_a_failed_run_has_no_measured_residual():
    cost = cost_of(ROW_WITH_YM, TARGET)
    residuals = cost.residuals(cost.space.box.centre, [np.nan, np.nan])
    assert np.isnan(residuals).tolist() == [True, True, False]


def test_residuals_of_many_points_are_those_of_each_point():
    cost = cost_of(ROW_WITH_YM, TARGET)
    points = cost.space.box.from_unit(np.random.default_rng(3).random((4, 3, 5)))
    measured = np.random.default_rng(4).uniform(20.0, 1600.0, (4, 3, 2))
    together = cost.residuals(points, measured)
    assert together.shape == (4, 3, 3)
    for place in np.ndindex(4, 3):
        assert together[place] == pytest.approx(cost.residuals(points[place], measured[place]))


def without_time_step():
    friction = Parameter("MU_PP", "-", 0.1, 0.3, 0.2)
    others = [replace(p, constant=p.constant or 2500.0) for p in PLAN.parameters if p.name != "MU_PP"]
    return Space((friction, *others), ("MU_PP",))


def test_a_weight_on_a_time_step_that_nothing_moves_is_refused():
    with pytest.raises(InputError, match="no calibrated parameter moves the Rayleigh time-step"):
        Cost(without_time_step(), TARGET, 0.5, (PLAN.fixed.particles,))


def test_without_weight_nothing_needs_to_move_the_time_step():
    cost = Cost(without_time_step(), TARGET, 0.0, (PLAN.fixed.particles,))
    assert cost.residuals([0.2], [22.0, 1500.0]) == pytest.approx([0.0, 0.0, 0.0])


@pytest.mark.parametrize("wrong", [0.0, math.nan, math.inf])
@pytest.mark.parametrize("name", [ANGLE_OF_REPOSE, BULK_DENSITY])
def test_a_target_that_is_zero_or_not_finite_is_refused(name, wrong):
    target = replace(TARGET, values={**TARGET.values, name: wrong})
    with pytest.raises(InputError, match=f"target {name} is .*; give"):
        cost_of(1, target)


# ---- errors, scales, weights, objectives -----------------------------------------------------------


def measured(**given):
    return Target({"angle": 22.0, "shift": 0.0, "image_error": 0.0}, "set", "three tests", **given)


SCALES = {"angle": 11.0, "shift": 2.0, "image_error": 0.5}


def of_responses(target, **noise):
    """Residuals of responses by a cost without a time-step."""
    cost = Cost(without_time_step(), target, 0.0, (PLAN.fixed.particles,), noise)
    return lambda *responses: cost.residuals([0.2], responses)[:-1]


def test_a_chosen_scale_stands_in_the_targets_place():
    residuals = of_responses(measured(scale=SCALES))
    assert residuals(33.0, -1.0, 0.25) == pytest.approx([1.0, -0.5, 0.5])
    relative = of_responses(
        replace(measured(scale=SCALES), scale={n: SCALES[n] for n in SCALES if n != "angle"})
    )
    assert relative(33.0, -1.0, 0.25) == pytest.approx([0.5, -0.5, 0.5])


def test_a_negative_target_is_divided_by_its_size():
    residuals = of_responses(Target({"suction": -5.0}, "set", "negative"))
    assert residuals(-4.0) == pytest.approx([0.2]) and residuals(-6.0) == pytest.approx([-0.2])


def test_a_weight_is_a_factor_of_the_square():
    plain, weighted = (of_responses(measured(scale=SCALES, weight=w)) for w in ({}, {"shift": 9.0}))
    assert weighted(33.0, -1.0, 0.25) ** 2 == pytest.approx(plain(33.0, -1.0, 0.25) ** 2 * [1.0, 9.0, 1.0])


def test_an_objective_costs_nothing_below_its_value():
    residuals = of_responses(measured(scale=SCALES, minimised=("image_error",)))
    assert residuals(22.0, 0.0, -0.3)[2] == 0.0 and residuals(22.0, 0.0, 0.3)[2] == pytest.approx(0.6)
    assert residuals(22.0, -1.0, 0.0)[1] == -0.5  # one that is not minimised has two sides


def test_squares_of_a_run_about_a_measured_value_are_a_chi_square():
    """Measured values scatter by their error, runs by their noise; what is left is standard normal."""
    rng = np.random.default_rng(7)
    cost = Cost(
        without_time_step(),
        Target({"angle": 22.0}, "set", "measured", sd={"angle": 0.8}),
        0.0,
        (PLAN.fixed.particles,),
        {"angle": 1.1},
    )
    runs = 22.0 + rng.normal(0.0, 0.8, 4000) + rng.normal(0.0, 1.1, 4000)
    squares = cost.residuals(np.full((4000, 1), 0.2), runs[:, None])[:, 0] ** 2
    assert kstest(squares, chi2(1).cdf).pvalue > 0.01
    without_noise = replace(cost, noise={}).residuals(np.full((4000, 1), 0.2), runs[:, None])[:, 0] ** 2
    assert kstest(without_noise, chi2(1).cdf).pvalue < 1e-6


def test_noise_alone_does_not_leave_eq_9():
    assert of_responses(Target({"angle": 20.0}, "set", "exact"), angle=5.0)(22.0) == pytest.approx([0.1])


def test_a_cost_without_a_target_is_refused():
    with pytest.raises(InputError, match="no response has a target"):
        cost_of(1, replace(TARGET, values={}))


def test_there_is_a_residual_for_each_target_whatever_responses_are_called():
    cost = cost_of(1, Target({"torque": 2.0, "mass_flow": 0.5, "angle_deg": 30.0}, "set", "three tests"))
    assert cost.responses == ("torque", "mass_flow", "angle_deg")
    residuals = cost.residuals(cost.space.box.centre, [2.2, 0.4, 30.0])
    assert residuals == pytest.approx([0.1, -0.2, 0.0, 0.0])


# ---- several models -------------------------------------------------------------------------------

SMALL_AND_SOFT = Particles(0.001, 0.3, "SMALL_DENS", "SMALL_YM")
OTHERS = (
    Parameter("SMALL_DENS", "kg/m3", 1000.0, 1400.0, None),
    Parameter("SMALL_YM", "Pa", 1e7, 4e8, None),
)


def two_models(WRL=1.0, calibrated=("DENS", "YM", "SMALL_DENS", "SMALL_YM")):
    space = Space(
        (*(replace(p, constant=p.constant or 2500.0) for p in PLAN.parameters), *OTHERS), calibrated
    )
    return Cost(space, TARGET, WRL, (PLAN.fixed.particles, SMALL_AND_SOFT))


def test_the_smallest_of_the_models_time_steps_counts():
    cost = two_models()
    points = cost.space.box.from_unit(np.random.default_rng(5).random((200, 4)))
    named = {name: points[:, k] for k, name in enumerate(cost.space.box.names)}
    each = np.array([p.rayleigh_time_step(named) for p in cost.particles])
    assert cost.rayleigh_time_step(points) == pytest.approx(each.min(axis=0))
    assert 0 < (each[0] < each[1]).mean() < 1  # either is the smaller one somewhere


def test_eq_10_is_normalised_by_the_extremes_of_the_smallest_time_step():
    cost = two_models()
    unit = np.random.default_rng(6).random((4000, 4)).round()  # corners, where the extremes are
    steps = cost.rayleigh_time_step(cost.space.box.from_unit(unit))
    residuals = cost.residuals(cost.space.box.from_unit(unit), np.tile([22.0, 1500.0], (4000, 1)))[:, 2]
    assert residuals == pytest.approx((steps.max() - steps) / (steps.max() - steps.min()), abs=1e-12)


def test_a_time_step_that_no_parameter_sets_is_a_constant():
    fixed = Particles(0.001, 0.3, 2500.0, 5e6)
    cost = Cost(PLAN.space(PLAN.row(1)), TARGET, 0.0, (fixed,))
    assert cost.rayleigh_time_step(cost.space.box.centre) == fixed.rayleigh_time_step({})
    with pytest.raises(InputError, match=r"no calibrated parameter moves .*; set WRL to 0"):
        replace(cost, WRL=0.5)


def test_one_parameter_cannot_be_density_and_stiffness():
    swapped = Particles(0.001, 0.3, "YM", "DENS")
    with pytest.raises(InputError, match=r"DENS is both a density and a Young's modulus"):
        Cost(PLAN.space(PLAN.row(4)), TARGET, 0.0, (PLAN.fixed.particles, swapped))


@pytest.mark.parametrize("weight", [-0.5, math.nan])
def test_a_negative_weight_is_refused(weight):
    with pytest.raises(InputError, match="WRL is"):
        replace(cost_of(1, TARGET), WRL=weight)
