"""The emulator as a whole: fitted to runs of a known model, stored, validated, and asked as an engine."""

import json
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from calstudy.cli.main import main
from calstudy.emulator.design import Choice, emulator_design, fresh_design
from calstudy.emulator.emulator import fit_emulator, read_emulator, write_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.emulator.similarity import inputs_of
from calstudy.emulator.validation import coverage, cross_validated, fresh_points, fresh_summary, left_out
from calstudy.errors import MISSED, InputError, NumericsError, Stopped, StoreError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import REFERENCE
from calstudy.records import Outcome
from calstudy.study.directory.store import write_table
from calstudy.study.schema import schema_of
from fake_liggghts import COMMAND
from shipped_model import SIMILARITY, SWEEP
from synthetic_runs import (
    BOX,
    CHEAP,
    EXPENSIVE,
    FRACTION_NOISE,
    PLAN,
    angle,
    angle_noise,
    solid_fraction,
    synthetic_runs,
)

pytestmark = pytest.mark.slow

PARAMETERS = PLAN.parameters
CHOICE = Choice(CHEAP, EXPENSIVE, "ring", 1)
DESIGN = emulator_design(PARAMETERS, CHOICE, 80, SIMILARITY)
FRESH = fresh_design(PARAMETERS, Choice(CHEAP, EXPENSIVE, "ring", 2017), 12, SIMILARITY)
MODEL = load_model(PLAN.fixed, EXPENSIVE)
HERE = BOX.to_unit(inputs_of(pd.DataFrame([REFERENCE]), SIMILARITY))


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def emulator():
    with threadpool_limits(1):
        return fit_emulator(synthetic_runs(DESIGN), PARAMETERS, SIMILARITY)


@pytest.fixture(scope="module")
def jumping():
    """Angles that jump where RF_PW is least, one of them unmeasurable."""

    def response(u):
        return angle(u) + 12.0 * (u[:, 3] < 0.06)

    first = next(line.label for line in DESIGN if line.parameters["RF_PW"] < 0.002)
    with threadpool_limits(1):
        return fit_emulator(synthetic_runs(DESIGN, response, left_out=[first]), PARAMETERS, SIMILARITY)


def ask(engine, parameters=REFERENCE, seed=1):
    return engine.run(parameters, seed, None, threading.Event())


# ---- fit and store ---------------------------------------------------------------------------------


def test_what_is_emulated_is_the_expensive_fidelity(emulator):
    assert (emulator.origin.fidelity, emulator.origin.cheap) == (EXPENSIVE, CHEAP)
    assert emulator.origin.model_hash == MODEL.hash
    found = {r.name: r.process.mean(HERE)[0] for r in emulator.responses}
    assert found["angle_of_repose_deg"] == pytest.approx(angle(HERE)[0], abs=0.6)
    assert found["solid_fraction"] == pytest.approx(solid_fraction(HERE)[0], abs=0.0015)


def test_an_emulator_read_predicts_what_it_did_when_written(emulator, tmp_path):
    write_emulator(tmp_path / "made", emulator)
    again = read_emulator(tmp_path / "made")
    assert again.version == emulator.version
    somewhere = np.random.default_rng(0).random((20, 5))
    for one, other in zip(emulator.responses, again.responses, strict=True):
        for a, b in zip(
            one.process.mean_and_sd(somewhere), other.process.mean_and_sd(somewhere), strict=True
        ):
            np.testing.assert_allclose(b, a, rtol=1e-12)
        drawn = (e.draw(3)[one.name].noise_free(somewhere) for e in (emulator, again))
        np.testing.assert_allclose(*drawn, rtol=1e-12)
    assert {p.suffix for p in (tmp_path / "made").iterdir()} == {".json", ".parquet"}
    assert sum(p.stat().st_size for p in (tmp_path / "made").iterdir()) < 2_000_000


def test_the_same_runs_make_the_same_version_and_others_another(emulator):
    runs = synthetic_runs(DESIGN)
    assert fit_emulator(runs, PARAMETERS, SIMILARITY).version == emulator.version
    assert fit_emulator(synthetic_runs(DESIGN, seed=1), PARAMETERS, SIMILARITY).version != emulator.version


def _change_json(directory):
    path = directory / "emulator.json"
    content = json.loads(path.read_text())
    content["responses"]["angle_of_repose_deg"]["centre"] += 1.0
    path.write_text(json.dumps(content))


def _change_runs(directory):
    path = directory / "runs.parquet"
    runs = pd.read_parquet(path)
    runs.loc[3, "bulk_density"] += 1.0
    write_table(path, runs, schema_of(SWEEP, "runs"))


def _cut_json(directory):
    path = directory / "emulator.json"
    path.write_text(path.read_text()[:-200])


def _lose_a_key(directory):
    path = directory / "emulator.json"
    content = json.loads(path.read_text())
    del content["responses"]["solid_fraction"]
    path.write_text(json.dumps(content))


def _lose_the_version(directory):
    path = directory / "emulator.json"
    path.write_text(json.dumps({k: v for k, v in json.loads(path.read_text()).items() if k != "version"}))


def _lose_the_members(directory):
    path = directory / "emulator.json"
    content = json.loads(path.read_text())
    content["responses"]["solid_fraction"]["settings"] = []
    path.write_text(json.dumps(content))


@pytest.mark.parametrize(
    "damage", [_change_json, _change_runs, _cut_json, _lose_a_key, _lose_the_version, _lose_the_members]
)
def test_what_was_changed_is_not_used(emulator, tmp_path, damage):
    write_emulator(tmp_path, emulator)
    damage(tmp_path)
    with pytest.raises(StoreError, match="fit it again"):
        read_emulator(tmp_path)


def test_where_there_is_no_emulator_the_remedy_is_named(tmp_path):
    with pytest.raises(InputError, match="holds no emulator; make one: calstudy emulator sample"):
        read_emulator(tmp_path / "none")


@pytest.mark.parametrize(
    ("column", "value", "complaint"),
    [
        ("deck", 1, "more than one deck: 1, 2"),
        ("engine", "LIGGGHTS 3.9", "more than one engine"),
        ("variant", "wide", "more than one variant: ring, wide"),
        ("model_hash", "0" * 64, "two versions of the model"),
        ("MU_PP", 0.5, "1 run.s. lie outside the box"),
    ],
)
def test_runs_that_do_not_belong_together_are_refused(column, value, complaint):
    runs = synthetic_runs(DESIGN[:30])
    runs.loc[4, column] = value
    with pytest.raises(InputError, match=complaint):
        fit_emulator(runs, PARAMETERS, SIMILARITY)


def test_too_few_runs_are_refused_by_the_response_they_lack():
    with pytest.raises(NumericsError, match="angle_of_repose_deg: 6 runs are too few"):
        fit_emulator(synthetic_runs(DESIGN[:6]), PARAMETERS, SIMILARITY)
    with pytest.raises(InputError, match="no run has the fidelity full; there is tiny, coarse"):
        fit_emulator(synthetic_runs(DESIGN), PARAMETERS, SIMILARITY, "full")


# ---- validation -------------------------------------------------------------------------------------


def test_intervals_hold_runs_that_were_not_fitted(emulator):
    for table in (left_out(emulator), cross_validated(emulator, 4)):
        of = coverage(table)
        assert len(of) == 4
        assert of["runs"].sum() == 2 * len(DESIGN)
        assert 0.88 <= of["inside"].sum() / of["runs"].sum() <= 0.99


def test_fresh_points_judge_the_mean_with_their_own_noise_taken_off(emulator):
    found = {f.response: f for f in fresh_summary(fresh_points(emulator, synthetic_runs(FRESH, seed=9)))}
    angles, fractions = found["angle_of_repose_deg"], found["solid_fraction"]
    assert angles.points == 12 and angles.inside >= 10 and fractions.inside >= 10
    assert angles.noise == pytest.approx(angle_noise(np.full((1, 5), 0.5))[0], rel=0.5)
    assert fractions.noise == pytest.approx(FRACTION_NOISE, rel=0.5)
    assert angles.error < angles.noise and fractions.error < fractions.noise
    assert angles.error < angles.rms_error and fractions.error < fractions.rms_error


def test_of_a_point_with_three_seeds_the_mean_is_judged(emulator):
    point = [line for line in FRESH if line.label == FRESH[0].label]
    runs = synthetic_runs(point, seed=9)
    unit = np.clip(BOX.to_unit(inputs_of(runs[:1], SIMILARITY)), 0.0, 1.0)
    found = fresh_points(emulator, runs).iloc[0]
    angles = runs["angle_of_repose_deg"].to_numpy()
    assert len(angles) == found["seeds"] == 3
    measured = angles.sum() / 3
    assert found["measured"] == pytest.approx(measured)
    assert found["measured_variance"] == pytest.approx(((angles - measured) ** 2).sum() / 2)
    process = emulator.responses[0].process
    (mean,), (sd,) = process.mean_and_sd(unit)
    assert found["predicted"] == pytest.approx(mean)
    assert found["sd"] == pytest.approx((sd**2 + process.noise_sd(unit)[0] ** 2 / 3) ** 0.5)


def test_the_noise_of_three_seeds_is_taken_off_the_error_and_that_of_one_seed_whole():
    points = pd.DataFrame(
        {
            "response": "angle_of_repose_deg",
            "seeds": [3, 3, 2, 1],
            "measured": [21.0, 24.0, 26.0, 30.0],
            "measured_variance": [0.6, 0.2, 0.9, np.nan],
            "predicted": [22.0, 26.0, 25.0, 30.0],
            "inside": [True, False, True, True],
        }
    )
    (found,) = fresh_summary(points)
    noise = (2 * 0.6 + 2 * 0.2 + 1 * 0.9) / 5
    squared = (1.0 + 4.0 + 1.0 + 0.0) / 4
    of_noise = (noise / 3 + noise / 3 + noise / 2 + noise) / 4
    assert (found.points, found.inside) == (4, 3)
    assert found.noise == pytest.approx(noise**0.5)
    assert found.rms_error == pytest.approx(squared**0.5)
    assert found.error == pytest.approx((squared - of_noise) ** 0.5)


def test_an_emulator_that_is_wrong_is_found_out(emulator):
    runs = synthetic_runs(FRESH, lambda u: angle(u) + 2.0 * np.sin(9.0 * u[:, 0]), seed=9)
    wrong = next(f for f in fresh_summary(fresh_points(emulator, runs)) if f.response.startswith("angle"))
    assert wrong.error > wrong.noise
    assert wrong.inside < 10


def test_fresh_runs_that_all_broke_judge_nothing(emulator):
    runs = synthetic_runs(FRESH, seed=9).assign(outcome="failed")
    with pytest.raises(InputError, match="no fresh run is ok"):
        fresh_points(emulator, runs)


def test_runs_that_were_fitted_or_are_of_another_model_judge_nothing(emulator):
    runs = synthetic_runs(DESIGN)
    with pytest.raises(InputError, match="was fitted to some of the fresh runs"):
        fresh_points(emulator, runs[runs["fidelity"] == EXPENSIVE])
    with pytest.raises(InputError, match="are not of angle_of_repose, coarse fidelity"):
        fresh_points(emulator, runs)


# ---- the engine --------------------------------------------------------------------------------------


def test_an_answer_is_the_same_whenever_it_is_asked(emulator):
    one, other = (ask(EmulatorEngine(MODEL, emulator)).responses for _ in range(2))
    assert one == other
    assert ask(EmulatorEngine(MODEL, emulator), seed=2).responses != one


def test_answers_scatter_as_runs_do(emulator):
    engine = EmulatorEngine(MODEL, emulator)
    angles = np.array([ask(engine, seed=s).responses["angle_of_repose_deg"] for s in range(400)])
    process = emulator.responses[0].process
    assert angles.mean() == pytest.approx(process.mean(HERE)[0], abs=4 * process.noise_sd(HERE)[0] / 20)
    assert angles.std() == pytest.approx(process.noise_sd(HERE)[0], rel=0.15)
    # A thousandth of a parameter makes another packing of the same seed.
    steps = [REFERENCE | {"MU_PP": 0.2 * (1 + 1e-3 * k)} for k in range(100)]
    stepped = np.array([ask(engine, p).responses["angle_of_repose_deg"] for p in steps])
    assert stepped.std() == pytest.approx(process.noise_sd(HERE)[0], rel=0.3)


def test_density_acts_by_itself_and_stiffness_by_the_time_step(emulator):
    engine = EmulatorEngine(MODEL, emulator)
    heavy = REFERENCE | {"DENS": 2550.0, "YM": REFERENCE["YM"] * 2550.0 / 2500.0}
    runs = [[ask(engine, p, seed) for seed in range(50)] for p in (REFERENCE, heavy)]
    light, dense = (np.mean([r.responses["bulk_density"] for r in of]) for of in runs)
    assert dense / light == pytest.approx(1.02, abs=0.001)
    assert runs[0][0].responses["rayleigh_time_step"] == pytest.approx(
        runs[1][0].responses["rayleigh_time_step"]
    )


def test_draws_are_engines_of_their_own(emulator):
    mean, one, two = (EmulatorEngine(MODEL, emulator, draw) for draw in (None, 1, 2))
    assert mean.identity == f"emulator {emulator.version}"
    assert len({mean.identity, one.identity, two.identity}) == 3
    answers = {e.identity: ask(e).responses["angle_of_repose_deg"] for e in (mean, one, two)}
    assert len(set(answers.values())) == 3


def test_one_response_s_draw_tells_nothing_of_the_other_s(emulator):
    normal = SimpleNamespace(draw=lambda rng: (rng.standard_normal(), None))
    both = replace(emulator, responses=tuple(replace(r, process=normal) for r in emulator.responses))
    drawn = np.array([[of.noise_free for of in both.draw(k).values()] for k in range(1000)])
    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.1
    assert len(np.unique(drawn)) == 2000


@pytest.mark.parametrize(
    ("change", "name"), [({"MU_PP": 0.31}, "MU_PP"), ({"RF_PW": 0.0}, "RF_PW"), ({"YM": 9e8}, "YM/DENS")]
)
def test_outside_its_box_the_emulator_says_nothing(emulator, change, name):
    with pytest.raises(InputError, match=f"{name} is .*, outside the emulator's"):
        ask(EmulatorEngine(MODEL, emulator), REFERENCE | change)


def test_an_emulator_answers_for_its_own_model_alone(emulator):
    with pytest.raises(InputError, match=r"is of coarse fidelity, ring; asked for tiny, ring"):
        EmulatorEngine(load_model(PLAN.fixed, CHEAP), emulator)
    runs = synthetic_runs(DESIGN).assign(deck=1)
    runs["model_hash"] = runs["model_hash"].str[::-1]
    with pytest.raises(InputError, match="another version of angle_of_repose"):
        EmulatorEngine(MODEL, fit_emulator(runs, PARAMETERS, SIMILARITY))


def test_near_a_jump_a_run_says_so_instead_of_a_number(jumping):
    engine = EmulatorEngine(MODEL, jumping)
    run = ask(engine, REFERENCE | {"RF_PW": 0.001})
    assert run.outcome is Outcome.UNMEASURABLE
    assert np.isnan(run.responses["angle_of_repose_deg"])
    assert "the angle_of_repose_deg jumps near here" in run.reason
    assert run.responses["bulk_density"] == pytest.approx(1500, rel=0.1), "the packing does not jump"
    assert ask(engine, REFERENCE | {"RF_PW": 0.06}).outcome is Outcome.OK


def test_a_stopped_engine_leaves_no_record(emulator):
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        EmulatorEngine(MODEL, emulator).run(REFERENCE, 1, None, stop)


# ---- the commands --------------------------------------------------------------------------------------


def test_the_commands_fit_and_validate(jumping, tmp_path, capsys):
    made = tmp_path / "made"
    for name, runs in (
        ("runs", jumping.runs),
        ("fresh", synthetic_runs(FRESH, seed=9)),
    ):
        (tmp_path / name).mkdir()
        write_table(tmp_path / name / "runs.parquet", runs, schema_of(SWEEP, "runs"))
    assert main(["emulator", "fit", str(tmp_path / "runs"), "--out", str(made)]) == 0
    said = capsys.readouterr().out
    assert f"emulator {jumping.version}: angle_of_repose" in said
    assert "angle_of_repose_deg JUMPS" in said
    arguments = ["--folds", "2", "--fresh", str(tmp_path / "fresh"), "--out", str(tmp_path / "v.png")]
    assert main(["emulator", "validate", str(made), *arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["version"] == jumping.version
    assert {f["response"] for f in found["fresh"]} == {"angle_of_repose_deg", "solid_fraction"}
    assert (tmp_path / "v.png").read_bytes().startswith(b"\x89PNG")


def test_an_emulator_can_be_made_of_one_fidelity_of_a_table(tmp_path, capsys):
    runs = synthetic_runs(DESIGN)
    write_table(tmp_path / "runs.parquet", runs, schema_of(SWEEP, "runs"))
    command = ["emulator", "fit", str(tmp_path), "--out", str(tmp_path / "made"), "--variant", "ring"]
    assert main([*command, "--fidelity", CHEAP, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["fidelity"], found["cheap"]) == (CHEAP, "")
    assert found["runs"] == {CHEAP: int((runs["fidelity"] == CHEAP).sum())}
    made = read_emulator(tmp_path / "made")
    assert made.responses[0].process.mean(HERE)[0] == pytest.approx(angle(HERE)[0] - 1.2, abs=0.6)
    assert ask(EmulatorEngine(load_model(PLAN.fixed, CHEAP), made, draw=1)).outcome is Outcome.OK
    assert main([*command[:-1], "wide"]) == 2
    assert "--variant wide: no run has wide; there is ring" in capsys.readouterr().err
    assert main([*command, "--fidelity", f"{CHEAP},full"]) == 2
    assert f"no run has full; there is {EXPENSIVE}, {CHEAP}" in capsys.readouterr().err
    assert main([*command, "--fidelity", f"{CHEAP},{EXPENSIVE}", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cheap"] == CHEAP


def test_the_design_is_run_and_goes_on(tmp_path, capsys):
    arguments = [
        *("emulator", "sample", "--fidelity", CHEAP, "--reference", EXPENSIVE, "--out", str(tmp_path)),
        *("--liggghts", COMMAND),
    ]
    assert main([*arguments, "--points", "2", "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["runs"] == {EXPENSIVE: 1, CHEAP: 2}
    assert list(tmp_path.iterdir()) == []
    assert main([*arguments, "--points", "2"]) == 0
    assert main([*arguments, "--points", "4"]) == 0
    assert "3 of 5 runs" in capsys.readouterr().err, "only what is new is run"
    assert main([*arguments, "--points", "4", "--seed", "2"]) == 2
    assert "is another design: it holds" in capsys.readouterr().err


def test_the_similarity_check_reports_both_responses(tmp_path, capsys):
    arguments = ["emulator", "similarity", "--seeds", "2", "--out", str(tmp_path), "--liggghts", COMMAND]
    assert main([*arguments, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [line["response"] for line in found] == ["angle_of_repose_deg", "solid_fraction"]
    assert all(line["doubled_pairs"] == 5 for line in found)


# ---- a study -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(emulator, tmp_path_factory):
    directory = tmp_path_factory.mktemp("emulator")
    write_emulator(directory, emulator)
    return directory


def plan_run(made, study, *more):
    arguments = ["plan", "run", "--rows", "1,2", "--study", str(study), "--budget", "12"]
    return main([*arguments, "--engine", "emulator", "--emulator", str(made), *more])


def test_a_study_is_labelled_wherever_it_is_seen(emulator, made, tmp_path, capsys):
    identity = f"emulator {emulator.version}"
    assert plan_run(made, tmp_path / "study") in (0, MISSED)
    assert emulator.version in capsys.readouterr().out
    for table in ("calibrations", "evaluations"):
        frame = pd.read_parquet(tmp_path / "study" / table)
        assert set(frame["engine"]) == {identity}
        assert set(frame["fidelity"]) == {EXPENSIVE}
    origin = pd.read_parquet(tmp_path / "study" / "calibrations")["target_origin"]
    assert all(text.endswith(f"; responses of {identity}") for text in origin)
    report = ["--only", "table4,figure3,figure9", "--format", "html,csv", "--out", str(tmp_path / "report")]
    assert main(["analyse", str(tmp_path / "study"), *report]) == 0
    assert identity in next((tmp_path / "report").glob("*.html")).read_text()


def test_what_a_study_will_cost_is_what_the_emulator_costs(made, tmp_path, capsys):
    assert plan_run(made, tmp_path / "study", "--dry-run", "--json") == 0
    assert json.loads(capsys.readouterr().out)["core_hours_expected"] == 0.0


def test_a_study_is_the_same_whatever_its_workers(made, tmp_path):
    for name, workers in (("one", "1"), ("two", "3")):
        assert plan_run(made, tmp_path / name, "--workers", workers) in (0, MISSED)
    one, two = (pd.read_parquet(tmp_path / n / "calibrations").sort_values("row") for n in ("one", "two"))
    changing = ["wall_time", "cpu_time", "host", "finished_at"]
    pd.testing.assert_frame_equal(one.drop(columns=changing), two.drop(columns=changing))


def test_a_study_of_another_emulator_is_another_study(made, tmp_path, capsys):
    assert plan_run(made, tmp_path / "study") in (0, MISSED)
    write_emulator(tmp_path / "other", fit_emulator(synthetic_runs(DESIGN, seed=1), PARAMETERS, SIMILARITY))
    assert plan_run(tmp_path / "other", tmp_path / "study") == 6
    assert "holds a study with other settings: the engine: emulator " in capsys.readouterr().err


def test_a_dry_run_notices_other_settings_and_counts_all_rows(made, tmp_path, capsys):
    assert plan_run(made, tmp_path / "study") in (0, MISSED)
    asked = ("--target", "angle_of_repose_deg=25,bulk_density=1500", "--budget", "9", "--dry-run", "--json")
    assert plan_run(made, tmp_path / "study", "--dry-run") == 0
    capsys.readouterr()
    assert plan_run(made, tmp_path / "study", *asked) == 6
    out, err = capsys.readouterr()
    assert json.loads(out)["rows_finished"] == 0 and json.loads(out)["rows"] > 0
    assert "the budget of the second optimisation: 12 → 9; the target of angle_of_repose_deg: 22 → 25" in err
    assert f"add --study {tmp_path}/study-2" in err and "{" not in err


def test_a_twin_of_the_emulator_is_its_own_mean(emulator, made, tmp_path):
    assert plan_run(made, tmp_path / "study", "--target", "twin") == 0
    line = pd.read_parquet(tmp_path / "study" / "calibrations").iloc[0]
    process = emulator.responses[0].process
    assert line["target_angle_of_repose_deg"] == pytest.approx(process.mean(HERE)[0])
    assert line["target_origin"].startswith(f"twin: noise-free responses of emulator {emulator.version}")


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (
            ["--engine", "emulator", "--fidelity", "tiny"],
            "no emulator of tiny fidelity, ring, is shipped (coarse-ring, fast-ring, full-ring, soft-ring",
        ),
        (["--engine", "emulator", "--emulator", "nowhere"], "nowhere holds no emulator; make one"),
        (["--engine", "edem"], "engine 'edem' is unknown; choose one of liggghts, lammps, yade, emulator"),
        (["--engine", "yade"], "the model angle_of_repose is written for liggghts; leave the engine out"),
        (["--emulator", "MADE"], "--emulator is for --engine emulator"),
        (["--engine", "emulator", "--emulator", "MADE", "--fidelity", "tiny"], "asked for tiny, ring"),
        (["--engine", "emulator", "--emulator", "MADE", "--variant", "wide"], "asked for coarse, wide"),
        (["--engine", "emulator", "--emulator", "MADE", "--scheduler", "tcp://x:1"], "leave --scheduler out"),
    ],
)
def test_an_emulator_is_chosen_by_name_and_never_stands_in(made, tmp_path, capsys, arguments, complaint):
    given = [str(made) if word == "MADE" else word for word in arguments]
    assert main(["plan", "run", "--study", str(tmp_path / "study"), "--dry-run", *given]) == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "study").exists()
