from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from calstudy.calibration.optimise import (
    LevenbergMarquardt,
    SequentialQuadratic,
    Stop,
    levenberg_marquardt,
    sequential_quadratic,
)
from calstudy.errors import InputError
from calstudy.parameters import Box
from calstudy.plan_file import load_plan
from calstudy.rayleigh import rayleigh_time_step
from calstudy.records import Phase
from strd import STRD

law = settings(max_examples=40, deadline=None)
FINE = LevenbergMarquardt(tolerance=1e-9, most_iterations=200)
START, JACOBIAN, TRIAL = Phase.START, Phase.JACOBIAN, Phase.TRIAL
seeds = st.integers(0, 2**32 - 1)


def box_of(lower, upper):
    return Box(tuple(f"p{k}" for k in range(len(lower))), tuple(map(float, lower)), tuple(map(float, upper)))


class Recorder:
    """Residuals of one point each, with all calls kept."""

    def __init__(self, residuals):
        self.residuals = residuals
        self.calls = []

    def __call__(self, phase, points):
        found = np.array([self.residuals(p) for p in points], float)
        self.calls.append((phase, points.copy(), found))
        return found

    @property
    def points(self):
        return np.concatenate([points for _, points, _ in self.calls])

    @property
    def phases(self):
        return [phase for phase, points, _ in self.calls for _ in points]

    def of(self, phase):
        return [(points, found) for p, points, found in self.calls if p is phase]


def linear(seed, d, m=None):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(m or d + 1, d))
    return A, rng.normal(size=m or d + 1)


def rosenbrock(p):
    return np.array([10.0 * (p[1] - p[0] ** 2), 1.0 - p[0]])


# ---- what it finds -------------------------------------------------------------------------------


@law
@given(seed=seeds, d=st.integers(1, 6))
def test_linear_least_squares_are_solved(seed, d):
    A, b = linear(seed, d)
    box = box_of([-1e3] * d, [1e3] * d)
    expected = np.linalg.lstsq(A, b, rcond=None)[0]
    found = levenberg_marquardt(lambda _, P: P @ A.T - b, np.full(d, 0.5), box, FINE)
    least = float(np.sum((A @ expected - b) ** 2))
    assert found.sum_of_squares <= least * (1 + 1e-4) + 1e-9


def test_the_valley_of_rosenbrock_is_followed_to_its_end():
    found = levenberg_marquardt(
        lambda _, P: np.array([rosenbrock(p) for p in P]),
        np.array([-1.2, 1.0]),
        box_of([-2, -2], [2, 2]),
        FINE,
    )
    assert found.best == pytest.approx([1.0, 1.0], abs=1e-4)


@law
@given(seed=seeds, d=st.integers(1, 5))
def test_an_optimum_on_the_bounds_is_found(seed, d):
    # Orthogonal columns: with others, a step that is shortened as a whole may end in front of the optimum.
    rng = np.random.default_rng(seed)
    A = np.linalg.qr(rng.normal(size=(d + 1, d)))[0] * rng.uniform(0.1, 10.0, d)
    outside = rng.uniform(-3.0, 3.0, d)
    b = A @ outside + 1.0
    box = box_of(rng.uniform(-1.5, -0.5, d), rng.uniform(0.5, 1.5, d))
    found = levenberg_marquardt(lambda _, P: P @ A.T - b, box.centre, box, FINE)
    best = lsq_linear(A, b, (box.lower, box.upper), tol=1e-14)
    assert found.sum_of_squares <= 2 * best.cost * (1 + 1e-6) + 1e-9


def test_a_bound_that_is_reached_is_reached_exactly():
    # Rounding would leave some of these a hair inside, where every next step would be shortened to nothing.
    rng = np.random.default_rng(2)
    for start, upper in zip(rng.uniform(0.1, 0.5, 100), rng.uniform(0.6, 0.9, 100), strict=True):
        found = levenberg_marquardt(
            lambda _, P: (P - [5.0, 0.2]) * [1.0, 3.0],
            np.array([start, 0.55]),
            box_of([0, 0], [upper, 1]),
            FINE,
        )
        assert found.best[0] == upper
        assert found.best[1] == pytest.approx(0.2, abs=1e-4)


def test_the_optimum_of_another_function_is_not_found():
    A, b = linear(1, 3)
    box = box_of([-50] * 3, [50] * 3)
    right = levenberg_marquardt(lambda _, P: P @ A.T - b, box.centre, box, FINE)
    wrong = levenberg_marquardt(lambda _, P: P @ A[::-1].T - b, box.centre, box, FINE)
    assert np.abs(right.best - wrong.best).max() > 0.1


@pytest.mark.parametrize("name", STRD)
@pytest.mark.parametrize("start", [0, 1])
def test_nist_problems_are_solved_from_both_starts(name, start):
    problem = STRD[name]
    b = np.array(problem.starts[start], float)
    box = box_of(np.minimum(b, problem.certified) / 10, np.maximum(b, problem.certified) * 10)
    found = levenberg_marquardt(
        lambda _, B: np.array([problem.residuals(row) for row in B]),
        b,
        box,
        LevenbergMarquardt(tolerance=1e-10, most_iterations=100),
    )
    assert found.sum_of_squares == pytest.approx(problem.sum_of_squares, rel=1e-9)
    assert found.best == pytest.approx(problem.certified, rel=1e-4)


@law
@given(seed=seeds, d=st.integers(1, 5))
def test_sequential_quadratic_programming_finds_an_optimum_on_the_bounds_from_anywhere(seed, d):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(d + 1, d))
    b = A @ rng.uniform(-3.0, 3.0, d) + 1.0
    box = box_of(rng.uniform(-1.5, -0.5, d), rng.uniform(0.5, 1.5, d))
    start = box.from_unit(rng.choice([0.0, 0.4, 1.0], d))
    found = sequential_quadratic(lambda P: P @ A.T - b, start, box, SequentialQuadratic())
    best = lsq_linear(A, b, (box.lower, box.upper), tol=1e-14)
    assert found.sum_of_squares <= 2 * best.cost * (1 + 1e-6) + 1e-6
    assert (found.best >= box.lower).all() and (found.best <= box.upper).all()


def test_sequential_quadratic_programming_does_not_stall_at_a_parameter_that_hardly_acts():
    # Where the authors' algorithm ends at once (golden/octave_optim.csv).
    box, residuals = heap(["DENS", "MU_PP", "RF_PP", "RF_PW", "YM"], 1.0, 1e-7)
    found = sequential_quadratic(lambda P: residuals(None, P), box.centre, box, SequentialQuadratic())
    assert found.sum_of_squares < 0.003
    stalled = levenberg_marquardt(residuals, box.centre, box)
    assert stalled.sum_of_squares > 0.3


def chained(points):
    """Rosenbrock's valley through all coordinates."""
    return np.hstack([10.0 * (points[:, 1:] - points[:, :-1] ** 2), 1.0 - points[:, :-1]])


@pytest.mark.parametrize(
    ("d", "tolerance", "stop"), [(2, 1e-8, Stop.IMPROVEMENT), (10, 1e-300, Stop.ITERATIONS)]
)
def test_sequential_quadratic_programming_says_whether_it_came_to_its_end(d, tolerance, stop):
    found = sequential_quadratic(
        chained, np.full(d, -1.2), box_of([-2] * d, [2] * d), SequentialQuadratic(tolerance)
    )
    assert found.stop is stop
    assert (found.iterations == 100) == (stop is Stop.ITERATIONS)


# ---- as the authors' solver does it --------------------------------------------------------------

OCTAVE = pd.read_csv(Path(__file__).parent / "golden" / "octave_optim.csv")
"""Ends of Octave's nonlin_residmin; its script is golden/octave_optim.m, whose function is `heap` here."""
PLAN = load_plan()


def heap(calibrated, WRL, effect):
    """Box and residuals (k, 3) of the closed form of golden/octave_optim.m."""
    names = [p.name for p in PLAN.parameters]
    lower, upper = (np.array([getattr(p, end) for p in PLAN.parameters]) for end in ("lower", "upper"))
    constant = np.array([p.constant or 0.0 for p in PLAN.parameters])
    chosen = [names.index(name) for name in calibrated]
    box = box_of(lower[chosen], upper[chosen])

    def full(points):
        values = np.tile(constant, (len(points), 1))
        values[:, chosen] = points
        return dict(zip(names, values.T, strict=True)), (values - lower) / (upper - lower)

    def step(values):
        return rayleigh_time_step(values["DENS"], values["YM"], radius=1.0, poissons_ratio=0.25)

    light = np.array([name == "DENS" for name in names])
    worst, best = np.where(light, lower, upper), np.where(light, upper, lower)
    slowest, fastest = step(full(np.array([worst, best])[:, chosen])[0])

    def residuals(_, points):
        values, u = full(points)
        u = dict(zip(names, u.T, strict=True))
        angle = 21.9 + 5.6 * u["MU_PP"] + 3.5 * u["RF_PP"]
        angle += effect * (u["MU_PW"] - u["RF_PW"] + 0.5 * u["DENS"] + 0.3 * u["YM"])
        solid = 0.62 - 0.03 * u["MU_PP"] - 0.005 * u["MU_PW"] - 0.005 * u["RF_PP"] ** 2
        late = (fastest - step(values)) / (fastest - slowest)
        return np.column_stack([angle / 26.4 - 1, values["DENS"] * solid / 1500 - 1, WRL * late])

    return box, residuals


@pytest.mark.parametrize("case", list(OCTAVE.itertuples()), ids=lambda case: f"case {case.Index}")
def test_it_goes_where_the_authors_solver_goes(case):
    box, residuals = heap(case.calibrated.split(), case.WRL, case.effect)
    calls = []

    def evaluate(phase, points):
        found = residuals(phase, points)
        calls.append((phase, points.copy(), found))
        return found

    found = levenberg_marquardt(evaluate, box.centre, box, LevenbergMarquardt(tolerance=case.tolerance))
    # Octave does not look at the points of its Jacobians, ours may return one of them.
    tried = [(float(r[0] @ r[0]), p[0]) for phase, p, r in calls if phase is not JACOBIAN]
    least, best = min(tried, key=lambda t: t[0])
    if 1e-12 < case.sum_of_squares < 1e-8:
        # Rounding left a parameter a hair inside its bound, which blocked Octave's last step.
        assert least < case.sum_of_squares
        return
    assert least == pytest.approx(case.sum_of_squares, rel=1e-4, abs=1e-12)
    if case.sum_of_squares > 1e-8:
        assert found.iterations == case.iterations
    if case.effect > 1e-6:  # where the solver puts a parameter without effect is rounding
        octave = np.array([float(value) for value in case.optimum.split()])
        assert box.to_unit(best) == pytest.approx(box.to_unit(octave), abs=1e-3)


# ---- where it evaluates --------------------------------------------------------------------------


@law
@given(seed=seeds, d=st.integers(1, 5), curvature=st.floats(0.0, 3.0))
def test_every_evaluation_lies_inside_the_box(seed, d, curvature):
    rng = np.random.default_rng(seed)
    A, b = linear(seed, d)
    lower = rng.uniform(-3.0, 1.0, d)
    box = box_of(lower, lower + 10.0 ** rng.uniform(-3.0, 1.0, d))
    seen = Recorder(lambda p: A @ p - 5.0 * b + curvature * np.sin(A @ p))
    levenberg_marquardt(seen, box.from_unit(rng.choice([0.0, 0.3, 1.0], d)), box)
    assert (seen.points >= box.lower).all() and (seen.points <= box.upper).all()


def test_a_start_outside_is_moved_into_the_box():
    seen = Recorder(lambda p: p)
    levenberg_marquardt(seen, np.array([9.0, -9.0]), box_of([1, 1], [2, 2]))
    assert seen.points[0].tolist() == [2.0, 1.0]


@pytest.mark.parametrize(("value", "step"), [(2500.0, 2.5), (-0.2, 2e-4), (0.0, 1e-7), (1e-5, 1e-7)])
def test_difference_step_is_a_thousandth_of_the_parameter_or_of_its_least_magnitude(value, step):
    seen = Recorder(lambda p: np.array([p[0] + 1.5]))
    box = box_of([value - 9.0], [value + 9.0])
    levenberg_marquardt(seen, np.array([value]), box, LevenbergMarquardt(most_iterations=1))
    (points, _), *_ = seen.of(JACOBIAN)
    assert sorted(points[:, 0]) == pytest.approx([value - step, value + step], rel=1e-12, abs=1e-15)


def test_a_jacobian_takes_two_runs_a_parameter_in_one_call():
    seen = Recorder(lambda p: np.array([p.sum() + 1.0, p[0]]))
    levenberg_marquardt(
        seen, np.full(4, 0.5), box_of([0] * 4, [1] * 4), LevenbergMarquardt(most_iterations=1)
    )
    assert [phase for phase, *_ in seen.calls][:3] == [START, JACOBIAN, TRIAL]
    (points, _), *more = seen.of(JACOBIAN)
    assert points.shape == (8, 4) and not more
    assert ((points != 0.5).sum(axis=1) == 1).all()


def test_on_a_bound_the_difference_is_one_sided_and_uses_the_residuals_there():
    seen = Recorder(lambda p: np.array([3.0 * p[0] + 1.0, p[1] - 4.0]))
    box = box_of([0.5, 0.0], [1.0, 2.0])
    found = levenberg_marquardt(seen, np.array([0.5, 1.0]), box, LevenbergMarquardt(most_iterations=1))
    (points, _), *_ = seen.of(JACOBIAN)
    assert len(points) == 3
    assert sorted(points[:, 0]) == pytest.approx([0.5, 0.5, 0.5005])
    assert found.best[0] == 0.5 and found.best[1] > 1.0


def test_steps_clipped_at_a_bound_are_divided_by_the_distance_they_really_span():
    seen = Recorder(lambda p: np.array([p[0] - 4.0]))
    start = np.array([1.9999])
    undamped = LevenbergMarquardt(ladder=(1e-7,), most_iterations=1, tolerance=0.0)
    levenberg_marquardt(seen, start, box_of([0], [2]), undamped)
    (points, _), *_ = seen.of(JACOBIAN)
    assert points[:, 0].tolist() == [2.0, pytest.approx(1.9979001)]
    assert seen.of(TRIAL)[0][0].tolist() == [[2.0]]


# ---- damping -------------------------------------------------------------------------------------


def trials_by_iteration(seen):
    counts = []
    for phase, points, _ in seen.calls:
        if phase is JACOBIAN:
            counts.append(0)
        elif phase is TRIAL:
            assert len(points) == 1
            counts[-1] += 1
    return counts


@law
@given(seed=seeds, d=st.integers(1, 4), tolerance=st.sampled_from([0.002, 0.02, 0.2]))
def test_at_most_five_trials_an_iteration_and_only_the_last_is_below_the_tolerated_sum(seed, d, tolerance):
    A, b = linear(seed, d)
    seen = Recorder(lambda p: np.sin(A @ p) * 2.0 - b)
    box = box_of([-2] * d, [2] * d)
    found = levenberg_marquardt(seen, np.full(d, 0.3), box, LevenbergMarquardt(tolerance=tolerance))
    counts = trials_by_iteration(seen)
    assert max(counts, default=0) <= 5
    old = None
    rejected = []
    for phase, _, residuals in seen.calls:
        total = float(residuals[-1] @ residuals[-1])
        if phase is START:
            old = total
        elif phase is TRIAL:
            if total < (1 - tolerance) * old:
                old, rejected = total, []
            else:
                rejected.append(total)
        else:
            assert not rejected, "a Jacobian was taken though the last trial was not accepted"
    if found.stop is Stop.IMPROVEMENT and counts[-1]:
        assert len(rejected) == counts[-1]


def test_dampings_climb_the_ladder_from_the_last_accepted_one():
    # With one parameter the step is r / J / sqrt(1 + damping), so the dampings can be read off the trials.
    answers = iter([9.0, 9.0, np.nan, 9.0, 4.0, 9.0, 3.0])
    seen = Recorder(lambda p: p)

    def evaluate(phase, points):
        found = seen(phase, points)
        return np.array([[next(answers)]]) if phase is TRIAL else found

    twice = LevenbergMarquardt(most_iterations=2)
    found = levenberg_marquardt(evaluate, np.array([5.0]), box_of([-100], [100]), twice)
    at = np.array([points[0, 0] for points, _ in seen.of(TRIAL)])
    first = (5.0 / (5.0 - at[:5])) ** 2 - 1
    second = (4.0 / (at[4] - at[5:])) ** 2 - 1
    assert first == pytest.approx([0.1, 1.0, 1e2, 1e4, 1e6], rel=1e-6)
    assert second == pytest.approx([1e5, 1e6], rel=1e-6)
    assert (found.stop, found.sum_of_squares) == (Stop.ITERATIONS, 9.0)


def test_the_damping_has_a_least_value():
    # Each step is accepted at the first damping, a tenth of the last, until it is as low as it may be.
    seen = Recorder(lambda p: p)
    answers = iter(5.0 * 0.5 ** np.arange(1, 11))

    def evaluate(phase, points):
        found = seen(phase, points)
        return np.array([[next(answers)]]) if phase is TRIAL else found

    settings = LevenbergMarquardt(most_iterations=10, least_damping=1e-3)
    levenberg_marquardt(evaluate, np.array([5.0]), box_of([-1e3], [1e3]), settings)
    at = np.array([5.0, *(points[0, 0] for points, _ in seen.of(TRIAL))])
    dampings = (5.0 * 0.5 ** np.arange(10) / (at[:-1] - at[1:])) ** 2 - 1
    assert dampings[:4] == pytest.approx([1e-1, 1e-2, 1e-3, 1e-3], rel=1e-6)


@law
@given(seed=seeds, together=st.integers(2, 5), d=st.integers(1, 4))
def test_trials_run_at_once_give_the_same_result_for_at_least_as_many_evaluations(seed, together, d):
    A, b = linear(seed, d)
    box = box_of([-2] * d, [2] * d)

    def find(together):
        seen = Recorder(lambda p: np.sin(A @ p) * 2.0 - b)
        found = levenberg_marquardt(seen, np.full(d, 0.3), box, LevenbergMarquardt(together=together))
        return found, seen

    (one, one_seen), (many, many_seen) = find(1), find(together)
    assert many.best.tolist() == one.best.tolist() and many.last.tolist() == one.last.tolist()
    assert (many.stop, many.iterations) == (one.stop, one.iterations)
    assert many.evaluations == len(many_seen.points) >= one.evaluations
    assert len(many_seen.of(TRIAL)) <= len(one_seen.of(TRIAL))


@pytest.mark.parametrize("budget", range(4, 12))
def test_trials_run_at_once_keep_the_budget(budget):
    seen = Recorder(lambda p: 2.0 + np.abs(p - 0.5))
    settings = LevenbergMarquardt(together=5, budget=budget)
    found = levenberg_marquardt(seen, np.array([0.5]), box_of([0], [1]), settings)
    assert found.evaluations == len(seen.points) <= budget


def test_a_flat_function_ends_as_flat():
    seen = Recorder(lambda p: np.array([1.0, 2.0]))
    found = levenberg_marquardt(seen, np.array([0.5, 0.5]), box_of([0, 0], [1, 1]))
    assert found.stop is Stop.FLAT
    assert seen.phases == [START] + [JACOBIAN] * 4
    assert found.best.tolist() == [0.5, 0.5]


def test_a_parameter_without_effect_stays_where_it_is():
    found = levenberg_marquardt(
        lambda _, P: P[:, :1] - 0.25, np.array([0.5, 0.7]), box_of([0, 0], [1, 1]), FINE
    )
    assert found.best == pytest.approx([0.25, 0.7], abs=1e-6)
    assert found.best[1] == 0.7


def test_a_zero_sum_of_squares_ends_as_exact():
    found = levenberg_marquardt(lambda _, P: P - 0.5, np.array([0.5]), box_of([0], [1]))
    assert (found.stop, found.evaluations, found.sum_of_squares) == (Stop.EXACT, 1, 0.0)


def test_iterations_are_limited():
    few = LevenbergMarquardt(tolerance=1e-9, most_iterations=3)
    found = levenberg_marquardt(
        lambda _, P: np.array([rosenbrock(p) for p in P]),
        np.array([-1.2, 1.0]),
        box_of([-2, -2], [2, 2]),
        few,
    )
    assert (found.stop, found.iterations) == (Stop.ITERATIONS, 3)


@pytest.mark.parametrize("factor", [1e-3, 1e3, 1e6])
def test_rescaling_a_parameter_and_its_interval_gives_the_same_path(factor):
    scale = np.array([1.0, factor])
    A, b = linear(3, 2)

    def path(scale):
        seen = Recorder(lambda p: np.tanh(A @ (p / scale)) - 0.3 * b)
        levenberg_marquardt(seen, np.array([1.5, 1.7]) * scale, box_of(np.ones(2) * scale, 3.0 * scale))
        return seen

    plain, scaled = path(np.ones(2)), path(scale)
    assert plain.phases == scaled.phases and len(plain.points) > 10
    assert scaled.points / scale == pytest.approx(plain.points, rel=1e-9)


# ---- the budget, the best point, failures --------------------------------------------------------


@law
@given(budget=st.integers(1, 40), seed=seeds)
def test_the_budget_is_never_exceeded_and_all_evaluations_are_counted(budget, seed):
    A, b = linear(seed, 3)
    seen = Recorder(lambda p: np.sin(A @ p) - 2 * b)
    limited = LevenbergMarquardt(tolerance=1e-6, budget=budget)
    found = levenberg_marquardt(seen, np.zeros(3), box_of([-2] * 3, [2] * 3), limited)
    assert found.evaluations == len(seen.points) <= budget
    free = levenberg_marquardt(
        Recorder(seen.residuals), np.zeros(3), box_of([-2] * 3, [2] * 3), LevenbergMarquardt(tolerance=1e-6)
    )
    assert (found.stop is Stop.BUDGET) == (free.evaluations > budget)


def test_a_budget_of_one_returns_the_start():
    found = levenberg_marquardt(
        lambda _, P: P - 0.2, np.array([0.5]), box_of([0], [1]), LevenbergMarquardt(budget=1)
    )
    assert (found.stop, found.evaluations, found.best.tolist()) == (Stop.BUDGET, 1, [0.5])


@pytest.mark.parametrize("budget", [0, -3])
def test_a_budget_without_any_evaluation_is_refused(budget):
    with pytest.raises(InputError, match="allows no evaluation"):
        levenberg_marquardt(
            lambda _, P: P, np.array([0.5]), box_of([0], [1]), LevenbergMarquardt(budget=budget)
        )


@law
@given(seed=seeds, failing=st.sets(st.integers(1, 40), max_size=12), d=st.integers(1, 4))
def test_the_result_is_the_best_point_seen_whatever_fails(seed, failing, d):
    A, b = linear(seed, d)
    count = iter(range(10_000))

    def residuals(p):
        found = np.sin(3 * A @ p) - b
        return found * np.nan if next(count) in failing else found

    seen = Recorder(residuals)
    found = levenberg_marquardt(seen, np.full(d, 0.1), box_of([-2] * d, [2] * d))
    totals = np.concatenate([np.sum(r**2, axis=1) for _, _, r in seen.calls])
    assert found.sum_of_squares == pytest.approx(np.nanmin(totals), rel=1e-12)
    assert found.best.tolist() == seen.points[np.nanargmin(totals)].tolist()


def test_the_best_point_is_kept_when_the_last_one_is_worse():
    seen = Recorder(lambda p: np.array([1.0 + (p[0] - 0.5) * (1.0 if abs(p[0] - 0.5) < 0.01 else -9.0)]))
    found = levenberg_marquardt(seen, np.array([0.5]), box_of([0], [1]))
    last = seen.calls[-1]
    assert found.last.tolist() == last[1][-1].tolist()
    assert found.last_residuals @ found.last_residuals > found.sum_of_squares


def test_a_failed_trial_is_rejected_and_the_next_damping_tried():
    trials = iter([True, True, False])
    seen = Recorder(lambda p: np.array([p[0] - 0.2]))

    def evaluate(phase, points):
        found = seen(phase, points)
        return found * np.nan if phase is TRIAL and next(trials, False) else found

    found = levenberg_marquardt(evaluate, np.array([0.9]), box_of([0], [1]))
    assert trials_by_iteration(seen)[0] == 3
    assert found.best.tolist() == pytest.approx([0.2], abs=1e-2)


@pytest.mark.parametrize(
    ("missed", "best"), [([0.9, 0.2, 0.5, 0.7], 1), ([5.0, 0.9, 5.0, 0.8], 3), ([0.1, np.nan, 5.0, 0.3], 0)]
)
def test_of_several_points_that_are_good_enough_the_best_is_the_result_and_the_last(missed, best):
    seen = Recorder(lambda p: np.array([5.0]))

    def evaluate(phase, points):
        found = seen(phase, points)
        return np.array(missed)[:, None] if phase is JACOBIAN else found

    found = levenberg_marquardt(
        evaluate, np.full(2, 0.5), box_of([0, 0], [1, 1]), enough=lambda r: abs(r[0]) < 1
    )
    assert (found.stop, found.evaluations) == (Stop.TOLERANCE, 5)
    assert found.best.tolist() == found.last.tolist() == seen.points[1 + best].tolist()
    assert found.best_residuals.tolist() == found.last_residuals.tolist() == [missed[best]]


def test_a_failed_start_is_said():
    seen = Recorder(lambda p: p * np.nan)
    found = levenberg_marquardt(seen, np.array([0.5]), box_of([0], [1]))
    assert (found.stop, found.evaluations) == (Stop.START_FAILED, 1)
    assert np.isnan(found.sum_of_squares)


@pytest.mark.parametrize("side", ["forward", "backward"])
def test_a_failed_jacobian_point_makes_its_difference_one_sided(side):
    sign = 1 if side == "forward" else -1

    def evaluate(phase, points):
        found = 2.0 * points - [0.4, 0.4]
        if phase is JACOBIAN:
            found[(points[:, 0] - 0.5) * sign > 0] = np.nan
        return found

    undamped = LevenbergMarquardt(ladder=(1e-7,), most_iterations=1)
    found = levenberg_marquardt(evaluate, np.array([0.5, 0.5]), box_of([0, 0], [1, 1]), undamped)
    assert found.best == pytest.approx([0.2, 0.2], abs=1e-5)


def test_a_parameter_whose_jacobian_points_both_failed_stays_put():
    def evaluate(phase, points):
        found = 2.0 * points - [0.4, 0.4]
        if phase is JACOBIAN:
            found[points[:, 0] != 0.5] = np.nan
        return found

    once = LevenbergMarquardt(ladder=(1e-7,), most_iterations=1)
    found = levenberg_marquardt(evaluate, np.array([0.5, 0.5]), box_of([0, 0], [1, 1]), once)
    assert found.best[0] == 0.5
    assert found.best[1] == pytest.approx(0.2, abs=1e-5)
