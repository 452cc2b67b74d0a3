"""Two fidelities in one calibration, on functions whose offset is known."""

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calstudy.calibration import procedure
from calstudy.calibration.confirmation import WORTH, confirmed, tolerance_verdict
from calstudy.calibration.expected import most_further_runs, number_of_samples
from calstudy.calibration.fidelities.levels import Places, TwoLevels
from calstudy.calibration.fidelities.search import Disagreement, fit_two
from calstudy.calibration.fidelities.surrogates import Cheap, FidelityRuns, TwoSurrogates, offset_shape
from calstudy.calibration.kriging.covariance import Hyperparameters
from calstudy.calibration.kriging.predictor import Contrasts, Predictor
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import Refinement, mode_of
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Runs
from calstudy.cli.main import main
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, PROPORTIONAL
from calstudy.records import Evaluation, Outcome, Phase, Request
from calstudy.study.definition import example, read_definition
from calstudy.study.reading import read_result, read_study
from calstudy.study.settings import read_settings
from closed_form import ROBUST, Desk, responses, task_of

P = Hyperparameters(2.0, 2.5, (1.5, 2.5), 0.04)
NOISE = {ANGLE_OF_REPOSE: 0.25, BULK_DENSITY: 15.0}
CHEAP = Cheap(0.05, is_measured=False, noise=NOISE, overlaps=("YM", "DENS"))
TASK = replace(task_of(5, ROBUST), samples=None, noise=NOISE, cheap=CHEAP)
"""Three parameters: DENS, MU_PP, RF_PP."""
POINTS = np.random.default_rng(3).random((12, 2))


def places(U, is_expensive=False, shape=1.0):
    return Places.of(U, np.full(len(U), shape), is_expensive)


def together(cheap, expensive):
    """Places of cheap and of expensive runs, one after the other."""
    a, b = places(cheap), places(expensive, True)
    parts = ("U", "shape", "expensive")
    return Places(*(np.concatenate([getattr(a, name), getattr(b, name)]) for name in parts))


def shifted(by, scale=1.0):
    """Responses of the cheap fidelity: those of the closed form, moved and stretched about their middle."""

    def answer(parameters):
        found = responses(parameters)
        middle = {ANGLE_OF_REPOSE: 26.0, BULK_DENSITY: 1500.0}
        moved = {name: middle[name] + scale * (found[name] - middle[name]) + by[name] for name in middle}
        return found | moved

    return answer


class TwoDesks:
    """Answers cheap requests by one function, others by another."""

    def __init__(self, cheap, noise=0.0):
        self.cheap, self.expensive = Desk(cheap, noise=noise), Desk(noise=noise)

    def __call__(self, requests):
        return [
            (self.cheap if request.phase is Phase.CHEAP else self.expensive)([request])[0]
            for request in requests
        ]


# ---- a response at two levels --------------------------------------------------------------------


def test_cheap_runs_alone_are_universal_kriging():
    y, at = np.sin(3 * POINTS[:, 0]) + POINTS[:, 1], np.random.default_rng(1).random((5, 2))
    kriging = Predictor.of(Contrasts.of(POINTS, kind="constant"), y, P)
    level = TwoLevels.given(places(POINTS), y, np.full(12, P.noise_variance), P)
    mean, variance = kriging.mean_and_variance(at)
    assert level.mean(places(at)) == pytest.approx(mean, abs=1e-9)
    assert level.variance(places(at)) == pytest.approx(variance, abs=1e-9)


def test_an_offset_of_the_known_form_is_found_and_carried_everywhere():
    y = np.sin(3 * POINTS[:, 0]) + POINTS[:, 1]
    form = 1.0 + POINTS[:, 0]
    runs = together(POINTS, POINTS[:2])
    runs = Places(runs.U, np.concatenate([np.zeros(12), form[:2]]), runs.expensive)
    level = TwoLevels.given(runs, np.concatenate([y, y[:2] + 0.7 * form[:2]]), np.full(14, 1e-8), P)
    assert level.beta[1] == pytest.approx(0.7, abs=1e-3)
    assert level.varying == 0.0
    there = level.mean(Places.of(POINTS, form, True)) - level.mean(places(POINTS))
    assert there == pytest.approx(0.7 * form, abs=1e-3)


def test_without_an_expensive_run_the_offset_is_taken_as_nothing_and_with_one_it_is_as_doubtful_as_that_run():
    y = POINTS[:, 0]
    noise = np.full(13, P.noise_variance)
    none = TwoLevels.given(places(POINTS), y, noise[:12], P)
    assert none.mean(places(POINTS, True)) == pytest.approx(none.mean(places(POINTS)))
    one = TwoLevels.given(together(POINTS, POINTS[:1]), np.append(y, y[0] + 1.0), noise, P)
    sd = np.sqrt(one.doubt[1, 1])
    assert sd > np.sqrt(P.noise_variance)
    assert one.variance(places(POINTS[:1], True))[0] == pytest.approx(P.noise_variance, rel=1e-6)


@pytest.mark.parametrize("is_expensive", [False, True])
def test_what_a_run_is_said_to_take_off_the_variance_is_what_it_takes_off(is_expensive):
    space = TASK.space
    rng = np.random.default_rng(5)
    low, high, at = (space.box.from_unit(rng.random((n, 3))) for n in (16, 3, 1))

    def surrogates(points, more):
        given = [Desk(shifted({ANGLE_OF_REPOSE: 1.0, BULK_DENSITY: 20.0})), Desk()]
        runs = []
        for k, (desk, there) in enumerate(zip(given, points, strict=True)):
            there = np.vstack([there, at]) if more and (k == 1) == is_expensive else there
            values = [desk.engine.answer(space.complete(point)) for point in there]
            found = np.array([[value[name] for name in NOISE] for value in values])
            runs.append(FidelityRuns(there, found + rng.normal(0, 0.1, found.shape)))
        return TwoSurrogates.of(ROBUST.kriging, space, tuple(NOISE), CHEAP, tuple(runs), NOISE)

    before = surrogates((low, high), more=False)
    gain = before.gains(at[0])[is_expensive]
    for k, level in enumerate(before.levels):
        _, here = before._places(at, True)[k]
        _, there = before._places(at, is_expensive)[k]
        runs = level.runs
        joined = Places(
            *(np.concatenate([getattr(runs, n), getattr(there, n)]) for n in ("U", "shape", "expensive"))
        )
        factor = before._factors(at)[k, 0]
        sd = (before.run_noise[k] if is_expensive else before.diagnostics[before.names[k]].noise_sd) / factor
        K = level.L @ level.L.T
        own = np.diag(K) - level.parameters.variance * (1 + level.varying**2 * runs.expensive)
        noise = np.append(own, sd**2)
        after, _ = TwoLevels._at(joined, np.zeros(len(noise)), noise, level.parameters, level.varying)
        taken = level.variance(here)[0] - after.variance(here)[0]
        assert gain[k] == pytest.approx(taken * factor**2, rel=1e-6)


def test_averaged_over_hyperparameters_cheap_runs_alone_are_averaged_kriging_and_expensive_ones_narrow_it():
    space, rng, offset = TASK.space, np.random.default_rng(8), {ANGLE_OF_REPOSE: 1.0, BULK_DENSITY: 20.0}
    low, high, at = (space.box.from_unit(rng.random((n, 3))) for n in (16, 3, 6))
    runs = []
    for desk, points in ((Desk(shifted(offset)), low), (Desk(), high)):
        answers = [desk.engine.answer(space.complete(point)) for point in points]
        found = np.array([[answer[name] for name in NOISE] for answer in answers])
        runs.append(FidelityRuns(points, found + [*NOISE.values()] * rng.standard_normal(found.shape)))
    none = FidelityRuns(np.empty((0, 3)), np.empty((0, 2)))

    def two(expensive):
        return TwoSurrogates.of(ROBUST.kriging, space, tuple(NOISE), CHEAP, (runs[0], expensive), NOISE)

    one = Surrogates.fit(ROBUST.kriging, space, tuple(NOISE), runs[0].points, runs[0].responses, NOISE)
    mine, known = (s.averaged(1).predict_with_deviations(at) for s in (two(none), one))
    assert mine[0] == pytest.approx(known[0], rel=1e-5) and mine[1] == pytest.approx(known[1], rel=1e-5)
    both = two(runs[1])
    narrow, wide = (s.predict_with_deviations(at)[1] for s in (both, both.averaged(1)))
    assert wide.mean(axis=0) == pytest.approx(narrow.mean(axis=0), rel=0.7) and (wide > narrow).mean() > 0.5
    assert both.averaged(1).offsets == both.offsets


def test_a_response_per_density_has_the_offset_of_overlaps_and_others_a_constant_one():
    space = replace(task_of(14, ROBUST)).space
    box = space.box
    points = np.array([box.centre, box.centre])
    k, j = box.names.index("DENS"), box.names.index("YM")
    points[1, k], points[1, j] = 2600.0, 4.5e8
    quotient = (2600.0 / 4.5e8) / (box.centre[k] / box.centre[j])
    assert offset_shape(space, "DENS", CHEAP, points) == pytest.approx([1.0, quotient ** (2 / 3)])
    assert offset_shape(space, None, CHEAP, points) == pytest.approx([1.0, 1.0])
    plain = replace(CHEAP, overlaps=None)
    assert offset_shape(space, "DENS", plain, points) == pytest.approx([1.0, 1.0])


# ---- a whole calibration -------------------------------------------------------------------------


def test_a_shifted_cheap_fidelity_finds_the_optimum_with_three_expensive_runs():
    desks = TwoDesks(shifted({ANGLE_OF_REPOSE: 2.0, BULK_DENSITY: -40.0}))
    found = calibrate(TASK, desks)
    assert not found.alone
    runs = Counter(request.phase for request in desks.expensive.requests)
    assert runs.total() <= 3 and set(runs) == {Phase.START, Phase.TRIAL}
    assert {request.phase for request in desks.cheap.requests} == {Phase.CHEAP}
    assert len(desks.cheap.requests) <= 2 * 7 + most_further_runs(TASK)
    assert found.dem.sum_of_squares < 1e-4
    assert found.dem_evaluation.request.phase is not Phase.CHEAP


def test_a_cheap_fidelity_that_goes_the_other_way_is_given_up_openly():
    desks = TwoDesks(shifted({ANGLE_OF_REPOSE: 0.0, BULK_DENSITY: 0.0}, scale=-1.0))
    told = []
    found = calibrate(TASK, desks, warn=lambda message: told.append((message, len(desks.expensive.requests))))
    assert "correlate" in found.alone
    ((message, runs),) = told
    assert found.alone in message and runs <= 3, "before the expensive samples"
    phases = Counter(request.phase for request in desks.expensive.requests)
    assert phases[Phase.SAMPLING] > 0
    alone = Desk()
    one = calibrate(replace(TASK, cheap=None), alone)
    assert found.dem.sum_of_squares < max(2 * one.dem.sum_of_squares, 1e-4)


def test_expensive_runs_from_before_the_cheap_ones_were_given_up_serve_as_samples():
    desks = TwoDesks(shifted({ANGLE_OF_REPOSE: 0.0, BULK_DENSITY: 0.0}, scale=-1.0))
    calibrate(TASK, desks)
    phases = [request.phase for request in desks.expensive.requests]
    before = phases.index(Phase.SAMPLING)
    assert before > 0
    assert phases.count(Phase.SAMPLING) == 7 - before


def test_a_cheap_fidelity_that_gives_nothing_is_given_up():
    def nothing(parameters):
        return responses(parameters) | dict.fromkeys(NOISE, np.nan)

    found = calibrate(TASK, TwoDesks(nothing))
    assert "cannot be modelled" in found.alone and found.dem.sum_of_squares < 1e-3


def test_noise_alone_does_not_make_fidelities_disagree():
    by = {ANGLE_OF_REPOSE: 1.0, BULK_DENSITY: -20.0}
    given_up = sum(
        bool(calibrate(replace(TASK, seed=seed), TwoDesks(shifted(by), noise=0.01)).alone)
        for seed in range(12)
    )
    assert given_up == 0


def test_a_cheap_run_s_share_is_as_measured_to_a_power_of_two_and_as_expected_until_then():
    runs = Runs(replace(TASK, cheap=replace(CHEAP, is_measured=True)), lambda requests: [])
    assert runs.share == CHEAP.share
    evaluation = Desk().evaluation
    for phase, seconds in ((Phase.CHEAP, 11.0), (Phase.CHEAP, 9.0), (Phase.START, 85.0)):
        request = Request(1, phase, 0, TASK.space.complete(TASK.space.box.centre), 5)
        answer = evaluation(request)
        runs.answers.append(
            (TASK.space.box.centre, Evaluation(request, "", replace(answer.run, cpu_time=seconds)))
        )
    assert runs.share == 0.125
    before = {(Phase.CHEAP, 0): 40.0, (Phase.START, 0): 40.0}  # as it took when it was first done
    runs.task = replace(TASK, cheap=replace(CHEAP, is_measured=True, times=before))
    assert runs.share == 1.0
    runs.task = TASK
    assert runs.share == CHEAP.share


# ---- confirmation --------------------------------------------------------------------------------


def test_the_optimum_is_run_again_with_seeds_of_its_own_at_the_same_parameters():
    desk = Desk(noise=0.01)
    task = replace(TASK, cheap=None, confirm=4)
    found = calibrate(task, desk)
    again = [request for request in desk.requests if request.phase is Phase.CONFIRMATION]
    assert found.runs[Phase.CONFIRMATION] == len(again) in (4, 8)
    assert len({request.seed for request in desk.requests}) == len(desk.requests)
    last = again[-4:]
    assert len({tuple(request.parameters.items()) for request in last}) == 1


def test_an_optimum_need_not_be_known_better_than_its_confirmation_will_show():
    newest = mode_of("robust").second_optimisation
    assert [newest.before(k, 0).doubt for k in (0, 1, 4, 6, 100)] == [0.3, 0.5, 0.5, 6**-0.5, 0.3]
    assert newest.before(4, -1) == newest  # few runs doubt too little
    assert Refinement().before(4, 9) == Refinement()

    def second(version, confirm):
        mode = replace(mode_of("robust", procedure=version).knowing(PROPORTIONAL), design=ROBUST.design)
        known = {ANGLE_OF_REPOSE: 0.4, BULK_DENSITY: 30.0}
        task = replace(task_of(10, mode), noise=known, confirm=confirm)
        found = calibrate(task, Desk(noise=0.02)).runs
        return found[Phase.START] + found[Phase.TRIAL]

    assert second(3, confirm=4) < second(2, confirm=4)
    assert second(3, confirm=0) == second(2, confirm=0)


def test_fewer_samples_of_one_fidelity_leave_cheap_samples_and_checks_of_an_earlier_study_as_they_were():
    points = task_of(28).space.box.from_unit(np.random.default_rng(2).random((12, 6)))
    earlier = FidelityRuns(points, np.column_stack([np.arange(12), np.roll(np.arange(12), 5)]))
    for version, alone in ((2, 10), (3, 7)):
        task = replace(task_of(28, mode_of("robust", procedure=version)), samples=None)
        assert number_of_samples(task) == alone  # of six parameters
        assert number_of_samples(replace(task, cheap=CHEAP)) == 20
        checks = replace(task, cheap=Cheap.of_earlier(earlier)).checks
        assert len(checks) == 4  # two responses, each at both ends
    few = [mode_of("robust").samples(d) for d in range(1, 9)]
    assert few == [5, 6, 7, 7, 7, 7, 8, 9]


def test_without_confirmation_nothing_is_run_again():
    desk = Desk(noise=0.01)
    calibrate(replace(TASK, cheap=None), desk)
    assert all(request.phase is not Phase.CONFIRMATION for request in desk.requests)


def test_mode_paper_confirms_once_with_fresh_seeds_though_its_study_has_one():
    desk = Desk()
    calibrate(replace(task_of(1), confirm=3), desk)
    seeds = {
        p: {r.seed for r in desk.requests if (r.phase is Phase.CONFIRMATION) is p} for p in (False, True)
    }
    assert len(seeds[False]) == 1 and len(seeds[True]) == 3 and not seeds[False] & seeds[True]


def test_a_confirmation_that_contradicts_goes_on_to_another_point_within_the_budget():
    desk = Desk()
    answer = desk.engine.answer

    def lucky(request):
        """The second optimisation meets a lucky place; fresh seeds do not."""
        found = answer(request.parameters)
        if request.phase is Phase.CONFIRMATION and request.index < 4:
            return found | {ANGLE_OF_REPOSE: found[ANGLE_OF_REPOSE] + 6.0}
        return found

    def evaluate(requests):
        answers = []
        for request in requests:
            desk.engine.answer = lambda parameters, request=request: lucky(request)
            answers += desk([request])
        return answers

    task = replace(TASK, cheap=None, confirm=4)
    found = calibrate(task, evaluate)
    assert found.runs[Phase.CONFIRMATION] == 8
    again = [tuple(r.parameters.items()) for r in desk.requests if r.phase is Phase.CONFIRMATION]
    assert again[0] == again[3] != again[4] == again[7]
    second = sum(found.runs.get(phase, 0) for phase in (Phase.START, Phase.TRIAL))
    assert calibrate(replace(task, most=second + 4), evaluate).runs[Phase.CONFIRMATION] == 4


def spread(*responses):
    """Responses (k, 1) of four runs."""
    return np.array(responses)[:, None]


def test_a_confirmation_gives_the_mean_its_error_and_the_probability_of_being_within():
    bounds = (np.array([9.0]), np.array([11.0]))
    found = confirmed(spread(9.8, 10.2, 10.4, 9.6), bounds, np.array([0.4]))
    assert found.mean == pytest.approx([10.0]) and found.seen == pytest.approx([np.sqrt(0.4 / 3)])
    pooled = np.sqrt((0.4 + WORTH * 0.16) / (3 + WORTH) / 4)
    assert found.standard_error == pytest.approx([pooled])
    assert found.within == pytest.approx([1 - 2 * stats.t.sf(1.0 / pooled, 3 + WORTH)])
    assert found.all_within == pytest.approx(found.within[0])


def test_the_probability_falls_with_doubt_and_is_not_there_without_a_tolerance():
    bounds = (np.array([9.0]), np.array([11.0]))
    near, edge, far = (
        confirmed(spread(*(m + np.array([-0.3, 0.3, 0.1, -0.1]))), bounds, np.array([0.3])).all_within
        for m in (10.0, 11.0, 12.5)
    )
    assert near > 0.99 and edge == pytest.approx(0.5, abs=0.01) and far < 0.01
    none = confirmed(spread(1.0, 2.0), (np.array([np.nan]), np.array([np.nan])), np.array([0.3]))
    assert np.isnan(none.all_within)


def test_one_lucky_run_is_not_within_tolerance():
    """26.52 was reported for 26.34 +- 0.5; four fresh seeds gave 24.85 with an sd of 1.34."""
    bounds = (np.array([25.84]), np.array([26.84]))
    found = confirmed(24.85 + 1.34 * spread(-1.2, 0.4, 1.1, -0.3), bounds, np.array([1.1]))
    assert found.all_within < 0.1
    assert tolerance_verdict(26.52 - 26.34, 0.5, found.within[0]) == "outside tolerance"
    assert tolerance_verdict(26.52 - 26.34, 0.5, float("nan")) == "within tolerance"


def until_task(until):
    return replace(
        TASK, cheap=None, confirm=4, until=until, tolerances={ANGLE_OF_REPOSE: 0.5, BULK_DENSITY: 20.0}
    )


def test_until_confirms_until_the_probability_is_there():
    runs = {}
    for until in (0.0, 0.99):
        desk = Desk(noise=0.01)
        found = calibrate(until_task(until), desk)
        at = [r for r in desk.requests if r.parameters == found.dem.parameters]
        again = np.array(
            [
                [desk.evaluation(r).run.responses[n] for n in NOISE]
                for r in at
                if r.phase is Phase.CONFIRMATION
            ]
        )
        task = until_task(until)
        runs[until] = confirmed(again, task.good, np.array([*NOISE.values()])).all_within
    assert runs[0.99] >= 0.99


def test_until_ends_where_the_surrogates_promise_it_nowhere():
    desk = Desk()
    task = until_task(0.9)
    far = replace(
        task.cost, target=replace(task.cost.target, values={ANGLE_OF_REPOSE: 60.0, BULK_DENSITY: 1500.0})
    )
    found = calibrate(replace(task, cost=far), desk)
    assert found.runs[Phase.CONFIRMATION] == 4


def test_fidelities_that_a_confirmation_shows_to_disagree_end_at_the_expensive_one(monkeypatch):
    def fit(task, runs, before=None):
        if runs.counts().get(Phase.CONFIRMATION):
            raise Disagreement("seen late")
        return fit_two(task, runs, before)

    monkeypatch.setattr(procedure, "fit_two", fit)
    desks = TwoDesks(shifted({ANGLE_OF_REPOSE: 2.0, BULK_DENSITY: -40.0}))

    def evaluate(requests):
        answers = desks(requests)
        if requests[0].phase is not Phase.CONFIRMATION or requests[0].index > 3:
            return answers
        runs = [replace(a.run, responses=a.run.responses | {ANGLE_OF_REPOSE: 40.0}) for a in answers]
        return [replace(a, run=run) for a, run in zip(answers, runs, strict=True)]

    found = calibrate(replace(TASK, confirm=4), evaluate)
    assert found.alone == "seen late" and found.runs[Phase.SAMPLING] > 0
    assert found.runs[Phase.CONFIRMATION] >= 8


def test_an_optimum_whose_confirmation_gives_nothing_gives_way_to_the_last_point_that_was_run():
    desks = TwoDesks(shifted({ANGLE_OF_REPOSE: 2.0, BULK_DENSITY: -40.0}), noise=0.01)
    desks.expensive.fails = lambda request: Outcome.FAILED if request.phase is Phase.CONFIRMATION else None
    found = calibrate(replace(TASK, confirm=2), desks)
    assert np.isfinite(found.dem.sum_of_squares)
    assert found.dem_evaluation.request.phase in (Phase.START, Phase.TRIAL)


# ---- a study and the commands --------------------------------------------------------------------


EMULATORS = Path(__file__).parent.parent / "liggghts_models" / "angle_of_repose" / "emulators"
PLAN_RUN = [
    "plan",
    "run",
    "--rows",
    "10",
    "--mode",
    "robust",
    "--engine",
    "emulator",
    "--fidelity",
    "full",
    "--study",
    "both",
]


def test_rows_of_the_plan_are_calibrated_with_two_fidelities_and_each_run_says_which(
    capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    asked = [*PLAN_RUN, "--cheap", "soft", "--confirm", "2"]
    assert main([*asked, "--dry-run", "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)
    assert (planned["runs_sampling"], planned["runs_optimisation_expected"]) == (12, 3 + 2)
    of_liggghts = [word for word in asked if word not in ("--engine", "emulator")]
    assert main([*of_liggghts, "--dry-run", "--json", "--workers", "1"]) == 0
    on_liggghts = json.loads(capsys.readouterr().out)
    assert on_liggghts["elapsed_seconds_expected"] == (3 + 2) * 560 + (12 + 6) * 30
    assert on_liggghts["core_hours_expected"] == round(on_liggghts["elapsed_seconds_expected"] / 3600, 2)
    assert main(asked) in (0, 11)
    out = capsys.readouterr().out
    assert "cheap" in out and "2 confirmation" in " ".join(out.split())
    study = read_study("both")
    runs = study.evaluations
    at = {name: load_model(study.plan.fixed, name) for name in ("full", "soft")}
    for fidelity, of in runs.groupby("fidelity"):
        assert set(of["model_hash"]) == {at[fidelity].hash}
        assert set(of["phase"] == "cheap") == {fidelity == "soft"}
    line = study.calibrations.iloc[0]
    assert line["runs_cheap"] == (runs["phase"] == "cheap").sum() >= 12
    assert (line["fidelity"], line["runs_sampling"], line["runs_confirmation"]) == ("full", 0, 2)
    assert set(study.settings.cheap) == {at["soft"].hash}
    assert main([*PLAN_RUN]) == 6, "a study of two fidelities is not one of one"
    assert "the cheap fidelity" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--cheap", "full"), "both the cheap and the expensive"),
        (("--cheap", "soft", "--mode", "paper"), "mode paper knows one fidelity"),
        (("--cheap", "soft", "--replicates", "2"), "leave --cheap out"),
        (("--cheap", "softer"), "softer"),
    ],
)
def test_a_cheap_fidelity_that_cannot_be_is_refused_before_any_run(
    capsys, monkeypatch, tmp_path, words, reason
):
    monkeypatch.chdir(tmp_path)
    assert main([*PLAN_RUN, *words]) == 2
    assert reason in capsys.readouterr().err
    assert not Path("both").exists()


def beads(**changes):
    """The example's file with two fidelities."""
    text = example().replace('fidelity = "soft"', 'fidelity = "full"\ncheap = "soft"')
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    Path("beads.toml").write_text(text)
    return [
        "calibrate",
        "beads.toml",
        *(f"--emulator={EMULATORS / name}" for name in ("full-ring", "soft-ring")),
    ]


@pytest.mark.usefixtures("coarse_profiles")
def test_a_file_with_two_fidelities_is_calibrated_and_goes_on_where_it_stopped(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main([*beads(), "--json"]) in (0, 11)
    found = json.loads(capsys.readouterr().out)
    assert 0 <= found["probability_all_within"] <= 1
    angle = found["responses"][0]
    assert angle["again_error"] > 0 and angle["verdict"] in (
        "within tolerance",
        "not sure to be within",
        "outside tolerance",
    )
    assert found["runs_cheap"] >= 16 and found["runs_confirmation"] in (4, 8) and found["fidelity"] == "full"
    definition = read_definition(Path("beads.toml"))
    result = read_result(Path("studies/beads"), definition, read_settings(Path("studies/beads")))
    assert isinstance(result.surrogates, TwoSurrogates)
    expected = result.surrogates.predict(np.array([*result.optimum.values()])[None])[0]
    again = result.evaluations[result.evaluations["phase"] == "confirmation"]
    assert expected == pytest.approx(again[list(result.responses)].mean().to_numpy(), rel=0.05)
    before = (tmp_path / "studies" / "beads" / "calibrations" / "row-01.parquet").read_bytes()
    assert main([*beads(), "--json"]) in (0, 11)
    assert (tmp_path / "studies" / "beads" / "calibrations" / "row-01.parquet").read_bytes() == before


@pytest.mark.usefixtures("no_report")
def test_runs_of_both_fidelities_serve_another_calibration(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    main(beads())
    capsys.readouterr()
    main([*beads(seed=("seed = 1", "seed = 2")), "--study", "studies/again"])
    said = capsys.readouterr().err
    assert int(re.search(r"; (\d+) serve\(s\) as samples", said)[1]) >= 16
    runs = pd.read_parquet("studies/again/evaluations")
    known = set(pd.read_parquet("studies/beads/evaluations")["run_id"])
    assert set(runs[~runs["run_id"].isin(known)]["phase"]) <= {"cheap", "start", "trial", "confirmation"}
    assert runs["run_id"].isin(known).sum() >= 16


OWN = """
script = "in.cell"
expected_seconds = 60
[parameters]
DENS = "kg/m3"
[fixed]
beads = 100
[fidelity.fine]
[fidelity.coarse]
beads = 10
expected_seconds = 6
[responses.stress]
unit = "Pa"
log = "stress"
"""


def test_a_model_of_ones_own_has_a_cheap_fidelity_of_its_folder_or_in_another(tmp_path):
    for name, text in (("cell", OWN), ("small", OWN.replace("in.cell", "in.small"))):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model.toml").write_text(text)
        (tmp_path / name / f"in.{name}").write_text("print ${DENS}${beads}\n")
    file = tmp_path / "case.toml"

    def read(cheap):
        file.write_text(
            f'mode = "robust"\nseed = 1\nWRL = 0\n[[models]]\nname = "cell"\n{cheap}\n'
            "[parameters]\nDENS = [2400, 2600]\n[targets]\nstress = 5.0\n"
        )
        return read_definition(file, (tmp_path,))

    found = read('cheap = "coarse"')
    assert found.task.cheap.share == pytest.approx(0.1)
    assert [model.labels["fidelity"] for model, _ in found.programs] == ["fine", "coarse"]
    other = read('cheap = { name = "small", fidelity = "coarse" }')
    assert [model.name for model, _ in other.programs] == ["cell", "small"]
    with pytest.raises(InputError, match="softer"):
        read('cheap = "softer"')
    (tmp_path / "small" / "model.toml").write_text(
        OWN.replace('unit = "Pa"', 'unit = "kPa"').replace("in.cell", "in.small")
    )
    with pytest.raises(InputError, match="its responses are not those of"):
        read('cheap = { name = "small" }')
