"""An earlier material's study as the prior of a calibration."""

import shutil
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.calibration.fidelities.surrogates import Cheap, FidelityRuns, TwoSurrogates
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.sampling import maximin_optimised
from calstudy.cli.main import main
from calstudy.errors import InputError
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.records import Evaluation, Outcome, Phase, Request, Run
from calstudy.report.calibration import facts, kriging_table
from calstudy.study import prior as prior_module
from calstudy.study.definition import read_definition
from calstudy.study.directory.begun import begun_with, difference
from calstudy.study.directory.store import read_table
from calstudy.study.prior import Prior, read_prior
from calstudy.study.run.definition import run_definition
from calstudy.study.run.taking import definition_work, settings_of, take_over
from calstudy.study.run.work import Running
from calstudy.study.settings import changes, read_settings
from closed_form import ROBUST, ClosedForm, Desk, responses, run_study, task_of

NOISE = {ANGLE_OF_REPOSE: 0.25, BULK_DENSITY: 15.0}
TASK = replace(task_of(5, ROBUST), samples=None, noise=NOISE, confirm=4)
"""Three parameters: DENS, MU_PP, RF_PP."""
MIDDLE = {ANGLE_OF_REPOSE: 26.0, BULK_DENSITY: 1500.0}


def material(scale=1.0, angle=0.0, density=0.0):
    """Responses of another material: those of the closed form, moved and stretched about their middle."""
    by = {ANGLE_OF_REPOSE: angle, BULK_DENSITY: density}

    def answer(parameters):
        found = responses(parameters)
        return found | {name: m + scale * (found[name] - m) + by[name] for name, m in MIDDLE.items()}

    return answer


def earlier(answer, number=18, noise=0.01):
    """Runs of a material over the box."""
    space, rng = TASK.space, np.random.default_rng(4)
    points = space.box.from_unit(maximin_optimised(number, 3, rng, steps=100))
    found = [[answer(space.complete(point))[name] for name in NOISE] for point in points]
    return FidelityRuns(points, np.array(found) * (1 + noise * rng.standard_normal((number, 2))))


# ---- the procedure -------------------------------------------------------------------------------


def after(answer, **changed):
    """The calibration, its requests and what it warned of, after a study of an earlier material."""
    desk, told = Desk(noise=0.01), []
    task = replace(TASK, cheap=Cheap.of_earlier(earlier(answer)), **changed)
    return calibrate(task, desk, warn=told.append), desk.requests, told


def test_a_related_material_saves_the_samples_but_those_that_check_it():
    found, requests, told = after(material(1.2, angle=3.0, density=-60.0))
    alone = Desk(noise=0.01)
    without = calibrate(TASK, alone)
    runs = Counter(request.phase for request in requests)
    assert not found.alone and not told
    assert runs[Phase.CHEAP] == 0 and runs[Phase.SAMPLING] <= (TASK.space.box.dimension + 4) // 2
    assert runs[Phase.START] + runs[Phase.TRIAL] <= 3
    assert len(requests) < len(alone.requests)
    exact = [np.sum(task_residuals(point) ** 2) for point in (found.dem.parameters, without.dem.parameters)]
    assert exact[0] < max(2 * exact[1], 2e-4)


def task_residuals(parameters):
    """Noise-free residuals of a parameter set."""
    exact = responses(parameters)
    at = TASK.space.point(parameters)
    return TASK.cost.residuals(at[None], np.array([[exact[name] for name in NOISE]]))[0]


def test_a_material_that_goes_the_other_way_is_given_up_openly_and_costs_no_more_than_none():
    found, requests, told = after(material(-1.0))
    assert "the earlier study is given up, the calibration goes on without it" in told[0]
    assert found.alone in told[0] and "from the earlier study varies" in found.alone
    alone = Desk(noise=0.01)
    calibrate(TASK, alone)
    samples = [sum(r.phase is Phase.SAMPLING for r in of) for of in (requests, alone.requests)]
    assert samples[0] == samples[1], "those that checked it serve as samples"
    assert np.sum(task_residuals(found.dem.parameters) ** 2) < 1e-3


def test_the_runs_that_check_it_are_where_its_responses_were_least_and_greatest():
    runs = earlier(responses, noise=0.0)
    task = replace(TASK, cheap=Cheap.of_earlier(runs))
    solid = runs.responses[:, 1] / runs.points[:, task.space.box.names.index("DENS")]
    ends = [int(find(of)) for of in (runs.responses[:, 0], solid) for find in (np.argmin, np.argmax)]
    ends = list(dict.fromkeys(ends))
    assert len(ends) >= 3
    assert task.checks == pytest.approx(runs.points[ends[:3]], rel=1e-5), "half of the 7 samples at most"
    assert len(replace(task, samples=40).checks) == len(ends)


def test_known_noise_of_a_run_is_not_mixed_with_the_scatter_of_the_earlier_study():
    runs = earlier(material(), noise=0.05)
    none = FidelityRuns(np.empty((0, 3)), np.empty((0, 2)))
    cheap, names = Cheap.of_earlier(runs), tuple(NOISE)
    found = TwoSurrogates.of(ROBUST.kriging, TASK.space, names, cheap, (runs, none), NOISE)
    assert found.noise == pytest.approx([*NOISE.values()])


# ---- from one study to another -------------------------------------------------------------------

FILE = """
mode = "robust"
seed = 3
WRL = 0.0
start = "studies/old"
[[models]]
name = "angle_of_repose"
fidelity = "tiny"
[parameters]
DENS = [2450.0, 2550.0]
MU_PP = [0.1, 0.3]
MU_PW = 0.25
RF_PP = [0.02, 0.08]
RF_PW = 0.01
YM = 5.06e8
[targets]
angle_of_repose_deg = 26.0
bulk_density = 1500.0
"""
OLD = Path("studies/old")


@pytest.fixture(autouse=True)
def project(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def old_study(tmp_path_factory):
    """A study of another material: a row of the plan with DENS, MU_PP and RF_PP in the plan's intervals."""
    directory = tmp_path_factory.mktemp("earlier") / "old"
    mode = replace(ROBUST, design=partial(maximin_optimised, steps=50))
    engine = ClosedForm(noise=0.005, answer=material(1.1, angle=2.0))
    run_study(directory, (5,), mode=mode, engine=engine, workers=1)
    return directory


@pytest.fixture
def old(old_study):
    shutil.copytree(old_study, OLD)


def read(*changed, directory=None):
    """The file's calibration, with lines changed."""
    text = FILE
    for was, now in changed:
        assert was in text
        text = text.replace(was, now)
    Path("new.toml").write_text(text)
    return read_definition(Path("new.toml"), (), False, *(begun_with(directory) if directory else ()))


NEW = Path("studies/new")


def run_new(definition):
    """Calibrate with the closed form; returns the result and what was said."""
    said, how = [], Running(workers=1)
    engine = ClosedForm(noise=0.005)
    work = definition_work(definition, [engine], NEW)
    return run_definition(definition, work, how.here(), how, say=said.append), said


def test_a_study_starts_from_an_earlier_one_says_so_and_does_without_it_afterwards(old):
    definition = read()
    assert len(definition.prior.runs) == len(definition.task.cheap.earlier.points) >= 7
    result, said = run_new(definition)
    told = f"{len(definition.prior.runs)} runs of the earlier study studies/old"
    assert any(line.startswith(f"Prior: {told}") for line in said)
    assert told in facts(result)["Prior"] and "which agreed" in facts(result)["Prior"]
    assert any("earlier study" in note for note in kriging_table(result).notes)
    assert isinstance(result.surrogates, TwoSurrogates) and result.line["runs_sampling"] <= 3
    settings = read_settings(NEW)
    shutil.rmtree(OLD)
    with pytest.raises(InputError, match=r"new\.toml, line 5: .*no study"):
        read()
    again = read(directory=NEW)
    assert again.prior == definition.prior and again.hash == definition.hash
    columns = ["phase", "index", "run_id", "seed", "MU_PP", ANGLE_OF_REPOSE]
    before = read_table(NEW, "evaluations", settings.quantities)[columns]
    for part in ("evaluations", "calibrations"):  # as if it had been stopped before its end
        shutil.rmtree(NEW / part)
    run_new(again)
    pd.testing.assert_frame_equal(read_table(NEW, "evaluations", settings.quantities)[columns], before)


def test_another_study_in_its_place_is_another_calibration(old):
    settings = settings_of(read(), "engine")
    NEW.mkdir()
    (NEW / "study.json").write_bytes(settings.file)
    shutil.move(OLD, "studies/moved")
    assert read(("studies/old", "studies/moved"), directory=NEW).hash == read(directory=NEW).hash
    run_study(OLD, (5,), mode=ROBUST, engine=ClosedForm(noise=0.005), workers=1, seed=8)
    told = difference(NEW, settings_of(read(directory=NEW), "engine", settings.calstudy))
    assert len(told) == 1 and told[0].startswith("the earlier study: ")
    without = settings_of(read(('start = "studies/old"\n', "")), "engine")
    assert changes(without.content, settings.content)[0].startswith("the earlier study: none → ")
    assert "start" not in without.case.definition


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ((('"robust"', '"paper"\nsamples_per_parameter = 4'),), "mode paper begins with samples of its own"),
        ((('"tiny"', '"soft"\ncheap = "tiny"'),), "a cheap fidelity tells already"),
        ((("studies/old", "studies/none"),), "studies/none is no study"),
        ((("studies/old", "."),), "is no study"),
        ((('"studies/old"', "3"),), "give a text"),
        ((("[0.1, 0.3]", "[0.5, 0.9]"),), "0 usable run"),
        ((("MU_PW = 0.25", "MU_PW = [0.1, 0.3]"),), "tells nothing of MU_PW"),
        (
            (("angle_of_repose_deg = 26", "angle_of_repose_flank_deg = 26"),),
            "studies/old has no such quantity: angle_of_repose_flank_deg in deg",
        ),
    ],
)
def test_an_earlier_study_that_cannot_be_a_prior_is_refused_with_the_line(old, changed, reason):
    with pytest.raises(InputError, match=reason) as error:
        read(*changed)
    assert str(error.value).startswith("new.toml, line ") and "\n" not in str(error.value)


def test_a_dry_run_says_which_prior_and_how_many_runs_check_it(old, capsys):
    runs = len(read().prior.runs)
    assert main(["calibrate", "new.toml", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert f"Prior: {runs} runs of the earlier study studies/old" in said and ": 3 sampling runs" in said


def test_runs_of_the_very_model_are_no_prior(old):
    definition, known = read(), ClosedForm()
    engine = ClosedForm()
    engine.model_hash = definition.models[0].model.hash
    same = []
    for number, run in enumerate(definition.prior.runs):
        request = Request(1, Phase.SAMPLING, number, run.parameters, 5)
        same.append(replace(run, run_id=request.run_id(engine.model_hash, known.identity)))
    found = replace(definition, prior=replace(definition.prior, runs=tuple(same)))
    assert take_over(found, [engine], NEW)[0].prior is found.prior
    settings = settings_of(read(('start = "studies/old"\n', "")), known.identity)
    journal_of(settings, definition, engine)
    with pytest.raises(InputError, match="of this very model and serve as samples without it"):
        take_over(found, [engine], NEW)


def journal_of(settings, definition, engine):
    """A study beside it with these runs of the model."""
    from calstudy.study.directory.store import Store

    with Store(Path("studies/beside"), settings) as store:
        for number, run in enumerate(definition.prior.runs):
            request = Request(1, Phase.SAMPLING, number, run.parameters, 5)
            answer = Run(Outcome.OK, "", dict(run.responses), 1.0, 1.0)
            run_id = request.run_id(engine.model_hash, engine.identity)
            store.record(Evaluation(request, run_id, answer, ""))


# ---- what is read of a study ---------------------------------------------------------------------


def made(monkeypatch, old, evaluations):
    """The prior of the file's calibration from runs that a study is said to have."""
    monkeypatch.setattr(prior_module, "evaluations_of", lambda *_: evaluations)
    task = read(('start = "studies/old"\n', "")).task
    units = {ANGLE_OF_REPOSE: "deg", BULK_DENSITY: "kg/m3"}
    return read_prior(OLD, "old", task.space, units, task.mode.kriging, 7), task


def evaluation(index, parameters, found, phase=Phase.SAMPLING, run_id=""):
    request = Request(1, phase, index, parameters, index)
    return Evaluation(request, run_id or f"{phase}{index}", Run(Outcome.OK, "", found, 1.0, 1.0))


def points(number, DENS=2500.0, **more):
    """Parameter sets over the intervals of both frictions."""
    u = maximin_optimised(number, 2, np.random.default_rng(1), steps=100)
    frictions = np.array([0.1, 0.02]) + u * [0.2, 0.06]
    base = {"DENS": DENS, "MU_PW": 0.2, "RF_PW": 0.01, "YM": 5.06e8, **more}
    return [base | {"MU_PP": float(a), "RF_PP": float(b)} for a, b in frictions]


def test_another_density_is_moved_and_the_bulk_density_with_it(old, monkeypatch):
    runs = [
        evaluation(k, p, {ANGLE_OF_REPOSE: 25.0, BULK_DENSITY: 630.0})
        for k, p in enumerate(points(9, 1050.0))
    ]
    with pytest.raises(InputError, match="tells nothing of DENS"):
        made(monkeypatch, old, runs)
    monkeypatch.setattr("calstudy.study.prior.evaluations_of", lambda *_: runs)
    task = read(('start = "studies/old"\n', ""), ("[2450.0, 2550.0]", "2500.0")).task
    units = {ANGLE_OF_REPOSE: "deg", BULK_DENSITY: "kg/m3"}
    found = read_prior(OLD, "old", task.space, units, task.mode.kriging, 7)
    assert {run.parameters["DENS"] for run in found.runs} == {2500.0}
    assert [run.responses[BULK_DENSITY] for run in found.runs] == pytest.approx([1500.0] * 9)
    assert {run.parameters["MU_PW"] for run in found.runs} == {0.25}, "fixed otherwise here"
    for k, run in enumerate(runs):
        run.request.parameters["YM"] = 4e8 + 2e7 * k
    stiff = read(('start = "studies/old"\n', ""), ("5.06e8", "[4.0e8, 6.0e8]")).task
    both = read_prior(OLD, "old", stiff.space, units, stiff.mode.kriging, 7).runs
    assert {run.parameters["DENS"] for run in both} == {2450.0}
    assert [run.parameters["YM"] for run in both] == [4e8 + 2e7 * k for k in range(9)], "as it was"


def test_of_two_fidelities_the_one_with_more_runs_is_taken_and_of_several_tests_all_responses(
    old, monkeypatch
):
    cheap, expensive = points(12), points(4)
    for k, p in enumerate([*cheap, *expensive]):
        p["DENS"] = 2450.0 + 7 * k
    both = {ANGLE_OF_REPOSE: 25.0, BULK_DENSITY: 1500.0}
    runs = [evaluation(k, p, both) for k, p in enumerate(expensive)]
    for k, p in enumerate(cheap):
        for part, (name, value) in zip("ab", both.items(), strict=True):
            lacks = dict.fromkeys(both, np.nan)
            runs.append(evaluation(k, p, lacks | {name: value}, Phase.CHEAP, f"{part}{k}"))
    found, _ = made(monkeypatch, old, runs)
    assert {run.run_id for run in found.runs} == {f"a{k}+b{k}" for k in range(12)}


def test_failed_runs_and_those_beyond_the_intervals_are_left_out_and_of_many_the_widest_spread_are_taken(
    old, monkeypatch
):
    sets = points(50)
    for k, p in enumerate(sets):
        p["DENS"] = 2450.0 + 2 * k
    both = {ANGLE_OF_REPOSE: 25.0, BULK_DENSITY: 1500.0}
    runs = [evaluation(k, p, both) for k, p in enumerate(sets)]
    runs[0] = evaluation(0, sets[0], both | {ANGLE_OF_REPOSE: np.nan})
    runs[1] = evaluation(1, sets[1] | {"MU_PP": 0.5}, both)
    found, task = made(monkeypatch, old, runs)
    assert len(found.runs) == 10 * task.space.box.dimension
    assert not {"sampling0", "sampling1"} & {run.run_id for run in found.runs}
    assert Prior.of_content(found.content, "old") == found
