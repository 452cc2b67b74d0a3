"""The points that a DEM model is run at: on the grid, whatever asks for them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from boxes import boxes_and_unit_points
from calstudy.calibration import procedure as calibration
from calstudy.calibration.modes import MODES, mode_of, on_grid
from calstudy.calibration.optimise import (
    LevenbergMarquardt,
    SequentialQuadratic,
    levenberg_marquardt,
    sequential_quadratic,
)
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.sampling import maximin_optimised, maximin_search
from calstudy.calibration.task import Task
from calstudy.models.heap import PROPORTIONAL
from calstudy.parameters import GRID, Box, Grid
from calstudy.records import Evaluation, Phase, Target
from calstudy.study.directory.begun import grid_there
from calstudy.study.directory.store import Store
from closed_form import PLAN, ClosedForm, chaotic_responses, cost_of, study_settings

law = settings(max_examples=40, deadline=None)
MODES_ON_GRID = {
    "paper": replace(mode_of("paper"), design=partial(maximin_search, designs_per_dimension=20)),
    "robust": replace(mode_of("robust").knowing(PROPORTIONAL), design=partial(maximin_optimised, steps=100)),
}
"""Short searches for their designs."""
both = pytest.mark.parametrize("mode", MODES_ON_GRID.values(), ids=MODES_ON_GRID)
ROWS = (1, 31)


# ---- the grid ------------------------------------------------------------------------------------


@given(boxes_and_unit_points(), st.sampled_from([1, 7, 1000, GRID]))
def test_a_point_of_the_grid_is_its_own_nearest_and_none_is_further_than_half_a_step(case, steps):
    box, unit = case
    grid = Grid(box, steps)
    points = box.from_unit(unit)
    nearest = grid.nearest(points)
    np.testing.assert_array_equal(grid.nearest(nearest), nearest)
    assert (np.abs(nearest - points) <= 0.5 * grid.step + 1e-12 * np.abs(points) + 1e-9 * box.width).all()


@given(boxes_and_unit_points())
def test_a_coordinate_is_what_the_formula_says_in_plain_doubles(case):
    box, unit = case
    nearest = Grid(box, GRID).nearest(box.from_unit(unit))
    for point, shares in zip(nearest, np.rint(unit * GRID), strict=True):
        for value, k, lower, upper in zip(point, shares, box.lower, box.upper, strict=True):
            wanted = {lower + (float(k) + side) / GRID * (upper - lower) for side in (-1, 0, 1)}
            assert min(max(lower, value), upper) == value
            assert value in wanted | {lower, upper}


@given(boxes_and_unit_points())
def test_bounds_are_points_of_the_grid_to_the_last_digit(case):
    box, _ = case
    corners = Grid(box, GRID).nearest([box.lower, box.upper])
    assert tuple(corners[0]) == box.lower and tuple(corners[1]) == box.upper


@pytest.mark.parametrize("row", [1, 72])
def test_numbers_that_differ_in_their_last_digits_are_equal_on_the_grid(row):
    grid = Grid(PLAN.space(PLAN.row(row)).box, GRID)
    points = grid.nearest(grid.box.from_unit(np.random.default_rng(row).random((500, grid.box.dimension))))
    for share in (-1e-9, 1e-9):
        np.testing.assert_array_equal(grid.nearest(points * (1.0 + share)), points)


def test_without_steps_every_point_stays_where_it_is():
    box = Box(("p",), (0.0,), (1.0,))
    assert Grid(box, None).nearest([1 / 3]) == [1 / 3] and Grid(box, None).step == [0.0]


# ---- the optimisers ------------------------------------------------------------------------------


@law
@given(seed=st.integers(0, 2**32 - 1), d=st.integers(1, 4), steps=st.sampled_from([20, 1000, GRID]))
def test_every_evaluation_of_levenberg_marquardt_is_on_the_grid_and_no_trial_is_asked_twice(seed, d, steps):
    rng = np.random.default_rng(seed)
    A, b = rng.normal(size=(d + 1, d)), rng.normal(size=d + 1)
    box = Box(tuple(f"p{k}" for k in range(d)), (0.0,) * d, tuple(10.0 ** rng.uniform(-3.0, 1.0, d)))
    grid, calls = Grid(box, steps), []

    def evaluate(phase, points):
        calls.append((phase, points))
        return points @ A.T - b

    start = box.from_unit(rng.choice([0.0, 0.3, 1.0], d))
    found = levenberg_marquardt(evaluate, start, box, LevenbergMarquardt(tolerance=1e-6), steps=steps)
    for _, points in calls:
        np.testing.assert_array_equal(grid.nearest(points), points)
    np.testing.assert_array_equal(grid.nearest(found.best), found.best)
    last = calls[0][1]
    for phase, points in calls[1:]:
        if phase is Phase.TRIAL:
            assert not np.array_equal(points, last)
            last = points


def test_a_difference_step_does_not_vanish_on_the_grid():
    # At zero it is 1e-7, a tenth of a step of the grid.
    box, asked = Box(("p",), (0.0,), (1.0,)), []

    def evaluate(phase, points):
        asked.append((phase, points))
        return points - 0.5

    found = levenberg_marquardt(evaluate, np.zeros(1), box, steps=GRID)
    assert asked[1][0] is Phase.JACOBIAN and asked[1][1].tolist() == [[1e-6]]
    assert found.best == pytest.approx([0.5], abs=0.1)


def test_a_settled_search_comes_to_one_end_from_every_start():
    def residuals(points):
        return np.column_stack(
            [10.0 * (points[:, 1] - points[:, 0] ** 2), 1.0 - points[:, 0], 0.1 * points[:, 1]]
        )

    box = Box(("a", "b"), (-2.0, -1.0), (2.0, 3.0))
    settled = MODES_ON_GRID["robust"].first_optimisation
    assert isinstance(settled, SequentialQuadratic) and settled.settled

    def apart(settings):
        starts = ([-1.0, 1.0], [0.5, 2.5], [2.0, -1.0])
        ends = [sequential_quadratic(residuals, np.array(s), box, settings).best for s in starts]
        return np.ptp(ends, axis=0).max()

    assert apart(settled) < 1e-9 < 1e-6 < apart(MODES["robust"].first_optimisation)


# ---- the procedure -------------------------------------------------------------------------------


def calibrated(mode, row, answer=chaotic_responses):
    """A row's calibration, and its DEM runs."""
    engine, asked = ClosedForm(answer=answer), []

    def evaluate(requests):
        asked.extend(requests)
        return [Evaluation(r, "", engine.run(r.parameters, r.seed, NOWHERE, None)) for r in requests]

    cost = cost_of(row)
    task = Task(row, cost.space, PLAN.row(row).samples, cost, mode, 7, row)
    return calibrate(task, evaluate), asked


class Nowhere:
    name = ""


NOWHERE = Nowhere()


@both
@pytest.mark.parametrize("row", ROWS)
def test_every_dem_run_is_on_the_grid_and_what_is_recorded_is_what_was_run(mode, row):
    found, asked = calibrated(mode, row)
    space = PLAN.space(PLAN.row(row))
    points = np.array([space.point(request.parameters) for request in asked])
    np.testing.assert_array_equal(Grid(space.box, GRID).nearest(points), points)
    start = next(request for request in asked if request.phase is Phase.START)
    assert found.kriging.parameters == start.parameters
    assert found.dem.parameters == found.dem_evaluation.request.parameters
    for p in space.parameters:
        if p.name not in space.calibrated:
            assert {request.parameters[p.name] for request in asked} == {p.constant}


def other_ends(patch, share):
    """Let each optimisation on the surrogates end elsewhere by a share of the parameters."""
    here = calibration.optimise_from

    def elsewhere(start, task, surrogates):
        end, box = here(start, task, surrogates), task.space.box
        return replace(end, best=np.clip(end.best * (1.0 + share), box.lower, box.upper))

    patch.setattr(calibration, "optimise_from", elsewhere)


@pytest.mark.slow
@both
@pytest.mark.parametrize("row", ROWS)
def test_last_digits_of_an_optimum_reach_no_dem_run(mode, row, monkeypatch):
    free = replace(mode, grid=None)
    before, before_free = (calibrated(m, row)[1] for m in (mode, free))
    other_ends(monkeypatch, 1e-12)
    assert calibrated(mode, row)[1] == before
    assert calibrated(free, row)[1] != before_free


@pytest.mark.slow
@both
def test_starts_that_end_equally_well_leave_the_choice_to_their_order(mode, monkeypatch):
    found, _ = calibrated(mode, 1)
    here = calibration.optimise_from

    def best_but_for_rounding(start, task, surrogates):
        end = here(start, task, surrogates)
        best_but_for_rounding.calls += 1
        return replace(end, best_residuals=end.best_residuals * (1.0 - 1e-12 * best_but_for_rounding.calls))

    best_but_for_rounding.calls = 0
    monkeypatch.setattr(calibration, "optimise_from", best_but_for_rounding)
    assert calibrated(mode, 1)[0].kriging.parameters == found.kriging.parameters


# ---- settings ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODES)
def test_a_mode_without_a_grid_is_the_one_that_shipped_studies_were_made_with(name):
    assert mode_of(name, grid=None) == MODES[name] and MODES[name].grid is None
    assert mode_of(name) == on_grid(MODES[name], GRID) and mode_of(name).grid == GRID


def test_the_grid_is_part_of_a_study_and_studies_without_one_keep_their_id():
    without, with_grid = study_settings(), study_settings(grid=GRID)
    assert "grid" not in without.content and with_grid.content["grid"] == GRID
    assert without.id != with_grid.id
    assert type(with_grid).of_content(with_grid.content) == with_grid


def test_a_study_goes_on_with_its_own_grid_and_a_new_one_has_that_of_today(tmp_path):
    assert grid_there(tmp_path / "new") == GRID
    for name, grid in (("before", None), ("coarse", 1000)):
        with Store(tmp_path / name, study_settings(grid=grid)):
            assert grid_there(tmp_path / name) == grid


def test_a_target_of_a_study_may_be_any_number():
    # The grid is of parameters alone: what is calibrated to keeps its digits.
    target = Target({"angle_of_repose_deg": 22.123456789}, "set", "")
    assert study_settings(target=target, grid=GRID).target.values["angle_of_repose_deg"] == 22.123456789
