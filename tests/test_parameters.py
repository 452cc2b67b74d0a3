import math

import numpy as np
import pytest
from hypothesis import given

from boxes import boxes_and_unit_points
from calstudy.errors import InputError
from calstudy.parameters import Box, Grid, Parameter, Space
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan

A = Parameter("A", "-", 1.0, 3.0, 2.0)
B = Parameter("B", "kg", -5.0, -1.0, None)
C = Parameter("C", "Pa", 1e7, 1e9, 5e8)


@given(boxes_and_unit_points())
def test_to_the_box_and_back_changes_nothing(case):
    box, unit = case
    real = box.from_unit(unit)
    np.testing.assert_allclose(box.to_unit(real), unit, atol=1e-9)
    np.testing.assert_allclose(box.from_unit(box.to_unit(real)), real, rtol=1e-9, atol=1e-12)


@given(boxes_and_unit_points())
def test_no_point_of_the_unit_cube_leaves_the_box(case):
    box, unit = case
    real = box.from_unit(unit)
    assert (real >= box.lower).all()
    assert (real <= box.upper).all()


@pytest.mark.parametrize("run", [1, 72])
def test_corners_of_the_cube_are_the_plans_bounds_to_the_last_digit(run):
    plan = load_plan()
    box = plan.space(plan.row(run)).box
    assert tuple(box.from_unit(np.zeros(box.dimension))) == box.lower
    assert tuple(box.from_unit(np.ones(box.dimension))) == box.upper


def test_rounding_does_not_lead_out_of_the_box():
    lower, upper = 0.3, 0.9
    assert lower + 1.0 * (upper - lower) > upper
    assert Box(("p",), (lower,), (upper,)).from_unit([1.0]) == upper


def test_scaling_is_linear_in_each_parameter_on_its_own():
    box = Box.of([A, B])
    np.testing.assert_array_equal(box.from_unit([[0.25, 0.5], [0.5, 0.25]]), [[1.5, -3.0], [2.0, -4.0]])
    np.testing.assert_array_equal(box.to_unit([2.5, -5.0]), [0.75, 0.0])


def test_centre_is_the_middle_of_the_cube():
    box = Box.of([A, B, C])
    np.testing.assert_array_equal(box.centre, [2.0, -3.0, 5.05e8])
    np.testing.assert_allclose(box.to_unit(box.centre), 0.5)
    np.testing.assert_array_equal(box.width, [2.0, 4.0, 9.9e8])


def test_a_point_outside_is_seen_outside():
    assert (Box.of([A]).to_unit([3.5]) > 1).all()
    assert (Box.of([A]).to_unit([0.5]) < 0).all()


def test_complete_joins_calibrated_values_and_constants():
    space = Space((A, B, C), ("C", "B"))
    assert space.box.names == ("B", "C"), "the parameters' order, whatever the order of the choice"
    assert space.complete([-2.0, 3e8]) == {"A": 2.0, "B": -2.0, "C": 3e8}


def test_complete_gives_plain_numbers():
    values = Space((A, B, C), ("B",)).complete(np.array([-2.0]))
    assert {type(value) for value in values.values()} == {float}


@pytest.mark.parametrize("run", [1, 4, 41, 72])
def test_point_undoes_complete_in_every_row(run):
    plan = load_plan()
    space = plan.space(plan.row(run))
    point = space.box.from_unit(np.linspace(0.1, 0.9, space.box.dimension))
    values = space.complete(point)
    assert tuple(values) == PARAMETERS
    np.testing.assert_array_equal(space.point(values), point)
    assert space.box.names == plan.row(run).calibrated
    assert all(math.isfinite(value) for value in values.values())


@pytest.mark.parametrize("point", [[], [-2.0], [-2.0, 3e8, 1.0]])
def test_a_point_of_another_length_is_refused(point):
    with pytest.raises(ValueError, match="zip"):
        Space((A, B, C), ("B", "C")).complete(point)


def test_an_unknown_parameter_is_refused_by_name():
    with pytest.raises(InputError, match="parameter D is unknown; known: A, B, C"):
        Space((A, B, C), ("B", "D"))


def test_calibrating_nothing_is_refused():
    with pytest.raises(InputError, match="no parameter is calibrated"):
        Space((A, C), ())


def test_a_parameter_without_constant_must_be_calibrated():
    with pytest.raises(InputError, match="parameter B has no constant value"):
        Space((A, B, C), ("A",))


@pytest.mark.parametrize(
    ("lower", "upper"), [(1.0, 1.0), (2.0, 1.0), (math.nan, 1.0), (0.0, math.inf), (-math.inf, 0.0)]
)
def test_an_interval_that_is_none_is_refused(lower, upper):
    with pytest.raises(InputError, match="parameter X: interval"):
        Parameter("X", "-", lower, upper, None)


@pytest.mark.parametrize("constant", [math.nan, math.inf])
def test_a_constant_that_is_no_number_is_refused(constant):
    with pytest.raises(InputError, match="parameter X: constant"):
        Parameter("X", "-", 0.0, 1.0, constant)


def test_a_parameter_that_counts_is_run_at_whole_numbers_alone():
    box = Box(("n", "mu"), (100.0, 0.1), (160.0, 0.6))
    grid = Grid(box, 1_000_000, (True, False))
    points = grid.nearest(box.from_unit(np.random.default_rng(1).random((50, 2))))
    assert (points[:, 0] == np.rint(points[:, 0])).all()
    assert len(np.unique(points[:, 1])) == 50
    assert grid.nearest([[100.0, 0.1], [160.0, 0.6]]).tolist() == [[100.0, 0.1], [160.0, 0.6]]
