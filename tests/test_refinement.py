"""Both optimisations of ``robust``, with surrogates that are known."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from calstudy.calibration import procedure as calibration
from calstudy.calibration.modes import Refinement
from calstudy.calibration.optimise import Optimum
from calstudy.calibration.procedure import (
    calibrate,
    expected_residuals,
    fit,
    optimise_surrogates,
    proposals,
    refine,
)
from calstudy.calibration.task import Runs
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Phase, Stop
from closed_form import PAPER, ROBUST, Desk, identify, responses, task_of

TASK = task_of(1, ROBUST)
"""Two parameters, WRL 0."""
DESIRED, BOX = TASK.cost.desired, TASK.space.box
START, FAR = BOX.from_unit([0.4, 0.4]), BOX.from_unit([0.9, 0.1])


@dataclass
class Known:
    """Surrogates that are functions of points (k, 2) of the unit square, in shares of the target."""

    miss: Callable = lambda u: np.zeros_like(u)
    sd: Callable = lambda u: np.zeros_like(u)
    run_sd: float = 0.1
    """Of a single run's responses."""
    diagnostics: dict = field(default_factory=dict)
    success: None = None

    def likely_to_run(self, points):
        return np.ones(len(points), bool)

    @property
    def noise(self):
        return self.run_sd * DESIRED

    def predict(self, points):
        return (1 + self.miss(BOX.to_unit(points))) * DESIRED

    def predict_with_deviations(self, points):
        return self.predict(points), self.sd(BOX.to_unit(points)) * DESIRED


def everywhere(*shares):
    return lambda u: np.broadcast_to(shares, u.shape)


def optimum(point, sum_of_squares=0.0):
    residuals = np.array([np.sqrt(sum_of_squares)])
    return Optimum(point, residuals, point, residuals, 1, 1, Stop.IMPROVEMENT)


def proposing(monkeypatch, surrogates, *optima):
    """Let every fit give these surrogates, and their optima be these, the last one some times more."""
    proposals = iter([*optima, *[optima[-1]] * 5])
    monkeypatch.setattr(calibration, "fit", lambda *_: surrogates)
    monkeypatch.setattr(calibration, "optimise_surrogates", lambda *_: next(proposals))


# ---- what is minimised on the surrogates ---------------------------------------------------------


def test_what_surrogates_expect_is_their_mean_s_residuals_and_their_deviations_as_shares_of_the_target():
    points = BOX.from_unit([[0.2, 0.6], [1.0, 0.0]])
    surrogates = Known(miss=lambda u: u * [0.1, -0.2], sd=lambda u: (1 + u) * [0.03, 0.05])
    weighted = replace(TASK.cost, WRL=0.5)
    late = weighted.residuals(points, np.tile(DESIRED, (2, 1)))[:, 2]
    assert late[0] > 0.1 and late[1] == 0.0
    means = [[0.02, -0.12, late[0]], [0.1, 0.0, 0.0]]
    deviations = [[0.036, 0.08], [0.06, 0.05]]
    cautious, plain = (replace(task_of(1, mode), cost=weighted) for mode in (ROBUST, PAPER))
    expected = expected_residuals(cautious, surrogates, points)
    assert expected == pytest.approx(np.hstack([means, deviations]), abs=1e-12)
    assert expected_residuals(plain, surrogates, points) == pytest.approx(np.array(means), abs=1e-12)


@pytest.mark.parametrize(("cautious", "best"), [(True, [0.6, 0.58]), (False, [0.7, 0.7])])
def test_caution_draws_the_optimum_to_where_the_surrogates_are_sure(cautious, best):
    # Parabolas: each coordinate ends at the mean of 0.7 and 0.5, weighted by the squares of the slopes.
    surrogates = Known(
        miss=lambda u: (u - 0.7) * [0.3, 0.2], sd=lambda u: np.abs(u - 0.5) * [0.3, 0.2 * 1.5**0.5]
    )
    task = replace(TASK, mode=replace(ROBUST, cautious=cautious))
    runs = Runs(task, Desk())
    runs(Phase.SAMPLING, BOX.from_unit([[0.0, 0.0], [1.0, 1.0]]))
    found = optimise_surrogates(task, surrogates, runs)
    assert BOX.to_unit(found.best) == pytest.approx(best, abs=1e-3)


def starts_of(monkeypatch, task, surrogates, runs):
    """Where the searches on the surrogates began, in the unit square, and the optimum that was taken."""
    begun = []

    def from_start(start, *_):
        begun.append(BOX.to_unit(start))
        return optimum(start, 1.0 / len(begun))

    monkeypatch.setattr(calibration, "optimise_from", from_start)
    found = optimise_surrogates(task, surrogates, runs)
    return np.array(begun), BOX.to_unit(found.best)


def test_searches_on_the_surrogates_begin_at_the_best_of_the_centre_and_all_usable_runs(monkeypatch):
    desk = Desk()
    runs = Runs(TASK, desk)
    runs(Phase.SAMPLING, BOX.from_unit([[0.1, 0.2], [0.3, 0.3], [0.9, 0.9]]))
    runs(Phase.TRIAL, BOX.from_unit([[0.6, 0.4]]))
    desk.fails = lambda _: Outcome.FAILED
    runs(Phase.TRIAL, BOX.from_unit([[0.4, 0.4]]))

    towards = Known(miss=lambda u: u - [0.38, 0.38])
    begun, taken = starts_of(monkeypatch, TASK, towards, runs)
    assert begun == pytest.approx(np.array([[0.3, 0.3], [0.5, 0.5]]))
    assert taken == pytest.approx([0.5, 0.5])  # the better of the two ends
    more = replace(TASK, mode=replace(ROBUST, starts=3))
    assert starts_of(monkeypatch, more, towards, runs)[0][2] == pytest.approx([0.6, 0.4])
    centre = replace(TASK, mode=replace(ROBUST, starts=None))
    assert starts_of(monkeypatch, centre, towards, runs)[0] == pytest.approx(np.array([[0.5, 0.5]]))


# ---- when the refinement ends --------------------------------------------------------------------

SUM, NOISE = 0.01, 0.02
RULE = Refinement(budget=3, tolerance=0.05, doubt=0.3)
BY_NOISE, BY_LITTLE = 0.3**2 * NOISE, 0.05 * SUM


@pytest.mark.parametrize(
    ("gain", "doubt", "noise", "settles"),
    [
        (0.99 * BY_LITTLE, 0.99 * BY_NOISE, NOISE, True),
        (1.01 * BY_LITTLE, 0.99 * BY_NOISE, NOISE, False),
        (0.99 * BY_LITTLE, 1.01 * BY_NOISE, NOISE, False),
        (0.99 * BY_LITTLE, 0.99 * BY_LITTLE, 0.0, True),
        (0.99 * BY_LITTLE, 1.01 * BY_LITTLE, 0.0, False),
        (SUM, 0.0, NOISE, False),
        (-SUM, 0.99 * BY_NOISE, NOISE, True),
        (-SUM, 1.01 * BY_NOISE, NOISE, False),
    ],
)
def test_it_ends_when_little_is_gained_and_the_doubt_is_small_by_the_noise_or_by_the_sum(
    monkeypatch, gain, doubt, noise, settles
):
    off = np.sqrt((SUM - doubt) / 2)
    sure = np.sqrt(doubt / 2)
    surrogates = Known(everywhere(off, -off), everywhere(sure, sure), np.sqrt(noise / 2))
    proposing(monkeypatch, surrogates, optimum(FAR, SUM - gain))
    desk = Desk()
    found = refine(TASK, Runs(TASK, desk), None, START, RULE)
    expected = (1, Stop.IMPROVEMENT) if settles else (3, Stop.BUDGET)
    assert (len(desk.requests), found.stop) == (found.evaluations, found.stop) == expected


NEAR = [0.9 + 0.019, 0.1 - 0.019]


@pytest.mark.parametrize(
    ("phase", "failed", "ends"),
    [
        (Phase.START, [NEAR], True),
        (Phase.TRIAL, [NEAR], True),
        (Phase.TRIAL, [[0.0, 0.9], NEAR], True),
        (Phase.TRIAL, [[0.9 + 0.019, 0.1 - 0.021]], False),
        (Phase.TRIAL, [[0.9, 0.9], [0.1, 0.1]], False),
        (Phase.SAMPLING, [NEAR], False),
    ],
)
def test_it_ends_when_the_next_point_is_near_one_that_failed_in_the_second_phase(
    monkeypatch, phase, failed, ends
):
    desk = Desk(fails=lambda _: Outcome.FAILED)
    runs = Runs(TASK, desk)
    runs(phase, BOX.from_unit(failed))
    desk.fails = None
    proposing(monkeypatch, Known(everywhere(0.1, 0.1)), optimum(FAR))
    found = refine(TASK, runs, None, START, RULE)
    assert (found.evaluations, found.stop) == ((1, Stop.IMPROVEMENT) if ends else (3, Stop.BUDGET))


def test_each_fit_is_given_the_one_before_and_what_was_run_since(monkeypatch):
    given = []

    def refit(_, runs, before):
        given.append((before, len(runs.answers)))
        return Known(everywhere(0.1, 0.1), diagnostics={"fit": len(given)})

    proposing(monkeypatch, None, optimum(FAR))
    monkeypatch.setattr(calibration, "fit", refit)
    refine(TASK, Runs(TASK, Desk()), Known(diagnostics={"fit": 0}), START, RULE)
    assert [(before.diagnostics["fit"], runs) for before, runs in given] == [(0, 1), (1, 2), (2, 3)]


# ---- several runs at once ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("together", "budget", "rounds"), [(1, 3, [1, 1, 1]), (3, 8, [3, 3, 2]), (4, 3, [3])]
)
def test_a_round_s_runs_go_out_at_once_within_the_budget(together, budget, rounds):
    second = replace(RULE, together=together, budget=budget)
    noise = {ANGLE_OF_REPOSE: 0.2, BULK_DENSITY: 5.0}
    desk = Desk(noise=0.01)
    calibrate(replace(TASK, noise=noise, mode=replace(ROBUST, second_optimisation=second)), desk)
    asked = [batch for batch in desk.batches if batch[0].phase is not Phase.SAMPLING]
    assert [len(batch) for batch in asked] == rounds
    assert [batch[0].phase for batch in asked] == [Phase.START, *[Phase.TRIAL] * (len(rounds) - 1)]
    assert len({run.seed for batch in asked for run in batch}) == budget
    points = [tuple(TASK.space.point(run.parameters)) for batch in asked for run in batch]
    assert len({*points}) == budget, "the surrogates hold other answers possible, and so other optima"


def test_a_round_begins_with_the_surrogates_optimum_and_goes_on_from_answers_that_they_hold_possible():
    runs = Runs(TASK, Desk())
    u = np.random.default_rng(3).random((12, 2))
    runs(Phase.SAMPLING, BOX.from_unit(u))
    surrogates = fit(TASK, runs)
    first = optimise_surrogates(TASK, surrogates, runs).best
    one, two, four = (proposals(TASK, runs, surrogates, first, number) for number in (1, 2, 4))
    assert np.array_equal(one, [first])
    assert np.array_equal(two, four[:2]) and np.array_equal(four[0], first)
    assert np.array_equal(four, proposals(TASK, runs, surrogates, first, 4)), "the same seed, the same points"
    assert not np.array_equal(four, proposals(replace(TASK, seed=TASK.seed + 1), runs, surrogates, first, 4))
    assert len(runs.answers) == 12, "nothing was run"


def test_the_first_run_within_the_tolerances_is_the_result_of_its_round(monkeypatch):
    points = BOX.from_unit([[0.4, 0.4], [0.5, 0.5], [0.6, 0.6]])
    monkeypatch.setattr(calibration, "proposals", lambda *_: points)
    task = replace(TASK, tolerances=dict(zip(TASK.cost.responses, 0.02 * DESIRED, strict=True)))
    far = points[0]

    def answer(parameters):
        share = 1.05 if np.allclose(TASK.space.point(parameters), far) else 1.0
        return {name: share * value for name, value in TASK.cost.target.values.items()} | {
            RAYLEIGH_TIME_STEP: 1e-5
        }

    found = refine(task, Runs(task, Desk(answer=answer)), None, START, replace(RULE, together=3))
    assert np.array_equal(found.best, points[1])
    assert (found.stop, found.iterations, found.evaluations) == (Stop.TOLERANCE, 1, 3)


def test_a_round_in_which_one_run_answers_goes_on_and_one_in_which_none_does_is_no_start(monkeypatch):
    points = BOX.from_unit([[0.4, 0.4], [0.9, 0.5], [0.6, 0.6]])
    proposing(monkeypatch, Known(), optimum(points[1]))
    monkeypatch.setattr(calibration, "proposals", lambda *_: points)
    for failing, stop in ((points[[0, 2]], Stop.IMPROVEMENT), (points, Stop.START_FAILED)):
        lost = [TASK.space.complete(point) for point in failing]
        desk = Desk(fails=lambda request, lost=lost: Outcome.FAILED if request.parameters in lost else None)
        found = refine(TASK, Runs(TASK, desk), Known(), START, replace(RULE, together=3))
        assert (found.stop, found.evaluations) == (stop, 3)
        assert stop is Stop.START_FAILED or np.array_equal(found.best, points[1])


# ---- what it gives -------------------------------------------------------------------------------


def test_the_result_is_the_run_that_the_surrogates_think_best_and_not_the_luckiest(monkeypatch):
    # At FAR the run is on target, but the surrogates, and their doubts, are for START.
    def answer(parameters):
        lucky = parameters["RF_PP"] == TASK.space.complete(FAR)["RF_PP"]
        share = 1.0 if lucky else 1.05
        target = {name: share * value for name, value in TASK.cost.target.values.items()}
        return {**target, RAYLEIGH_TIME_STEP: 1e-5}

    def is_far(u):
        return u[..., :1] > 0.6

    surrogates = Known(
        miss=lambda u: np.where(is_far(u), 0.06, 0.05) * [1, 1],
        sd=lambda u: np.where(is_far(u), 0.05, 0.01) * [1, 1],
    )
    proposing(monkeypatch, surrogates, optimum(START), optimum(FAR), optimum(START, 0.0052))
    desk = Desk(answer=answer)
    found = calibrate(TASK, desk)
    first, lucky = (r for r in desk.requests if r.phase is not Phase.SAMPLING)
    assert found.dem_stop is Stop.IMPROVEMENT
    assert found.dem_evaluation.run_id == identify(first)
    assert found.dem.parameters == TASK.space.complete(START)
    assert found.dem.sum_of_squares == pytest.approx(2 * 0.05**2)
    assert found.last.parameters == lucky.parameters == TASK.space.complete(FAR)
    assert found.last.sum_of_squares == pytest.approx(0.0)


def test_a_refit_learns_from_the_runs_of_the_second_phase():
    def answer(parameters):
        """The closed form, with a heap in one corner that no sample is near."""
        exact = responses(parameters)
        u = BOX.to_unit(TASK.space.point(parameters))
        return {**exact, ANGLE_OF_REPOSE: exact[ANGLE_OF_REPOSE] + 4 * np.exp(-20 * np.sum((u - 1) ** 2))}

    task = replace(TASK, noise={ANGLE_OF_REPOSE: 0.01, BULK_DENSITY: 1.0})
    runs = Runs(task, Desk(answer=answer))
    samples = [[0.1, 0.3], [0.3, 0.9], [0.5, 0.1], [0.7, 0.5], [0.9, 0.2], [0.2, 0.6]]
    runs(Phase.SAMPLING, BOX.from_unit(samples))
    before = fit(task, runs)
    corner = BOX.from_unit([1.0, 1.0])
    measured = answer(task.space.complete(corner))[ANGLE_OF_REPOSE]
    assert measured - before.predict(corner)[0] > 2
    for phase in (Phase.START, Phase.TRIAL):
        runs(phase, corner[None])
    after = fit(task, runs, before)
    assert after.predict(corner)[0] == pytest.approx(measured, abs=0.1)
    assert after.predict_with_deviations(corner[None])[1][0, 0] < 0.1


# ---- seeds ---------------------------------------------------------------------------------------


def test_rows_that_share_their_samples_have_seeds_of_their_own_in_the_second_phase():
    seeds = {}
    for row in (1, 31):
        desk = Desk()
        runs = Runs(replace(task_of(row, ROBUST), sampled_as=1), desk)
        for phase in (Phase.SAMPLING, Phase.START, Phase.TRIAL):
            runs(phase, BOX.from_unit([[0.1, 0.2], [0.7, 0.3]]))
            runs(phase, BOX.from_unit([[0.5, 0.5]]))
        seeds[row] = {phase: [r.seed for r in desk.requests if r.phase is phase] for phase in Phase}
    assert seeds[1][Phase.SAMPLING] == seeds[31][Phase.SAMPLING]
    later = [s for row in (1, 31) for phase in (Phase.START, Phase.TRIAL) for s in seeds[row][phase]]
    assert len({*later, *seeds[1][Phase.SAMPLING]}) == 4 * 3 + 3
