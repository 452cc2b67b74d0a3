"""What the second optimisation gains, told apart from luck."""

from __future__ import annotations

import sys

import numpy as np
import pandas as pd
import pytest

from calstudy.analysis.tables.second_phase import notes, pairs, ratio, second_phase
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.records import Phase, Target
from calstudy.study.reading import Study, read_study
from closed_form import INTERVALS, PLAN, TRUTH, ClosedForm, responses, run_study, study_settings

ROWS = (1, 2, 31)
STEP = 1e-3
"""Of a parameter: the authors' difference step."""


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    directory = tmp_path_factory.mktemp("study")
    run_study(directory, ROWS, engine=ClosedForm(noise=0.02))
    return read_study(directory)


@pytest.fixture(scope="module")
def smooth(tmp_path_factory):
    directory = tmp_path_factory.mktemp("smooth")
    run_study(directory, (2,), engine=ClosedForm())
    return read_study(directory)


def by_hand(*runs):
    """A study whose row 1 (WRL = 0; DENS and RF_PP are calibrated) has these runs: phase and number, outcome,
    parameters, angle and density; 20 deg and 1500 kg/m3 are wanted."""
    lines = [
        {"row": 1, "phase": phase, "index": number, "outcome": outcome}
        | TRUTH
        | parameters
        | {ANGLE_OF_REPOSE: angle, BULK_DENSITY: density}
        for phase, number, outcome, parameters, angle, density in runs
    ]
    target = Target({ANGLE_OF_REPOSE: 20.0, BULK_DENSITY: 1500.0}, "set", "by hand")
    calibrations = pd.DataFrame({"row": [1], "outcome": ["ok"]})
    return Study(study_settings(target=target), PLAN, calibrations, pd.DataFrame(lines), pd.DataFrame())


def test_pairs_are_the_two_ends_of_a_central_difference(smooth):
    found = pairs(smooth)
    assert len(found) >= 2 and set(found["parameter"]) <= set(INTERVALS)
    for line in found.to_dict("records"):
        # The slope times two steps of 0.1 %, the response being all but linear between them.
        best = smooth.ok.iloc[0]
        at = {name: best[f"dem_{name}"] for name in INTERVALS}
        up, down = (
            responses(at | {line["parameter"]: at[line["parameter"]] * (1 + s * STEP)}) for s in (1, -1)
        )
        expected = up[ANGLE_OF_REPOSE] - down[ANGLE_OF_REPOSE]
        assert abs(line[ANGLE_OF_REPOSE]) == pytest.approx(abs(expected), rel=0.25, abs=1e-9)


def test_one_sided_differences_are_no_pairs(study):
    found = pairs(
        by_hand(
            ("start", 0, "ok", {}, 20.0, 1500.0),
            ("jacobian", 0, "ok", {"DENS": 2472.0}, 21.0, 1510.0),
            ("jacobian", 1, "ok", {"DENS": 2468.0}, 24.0, 1490.0),
            ("jacobian", 2, "ok", {"MU_PP": 0.2002}, 30.0, 1600.0),
            ("jacobian", 3, "ok", {"RF_PP": 0.0601}, 25.0, 1500.0),
            ("jacobian", 4, "ok", {"RF_PP": 0.0599}, 24.5, 1501.0),
            ("jacobian", 5, "ok", {"YM": 5.1e8}, 10.0, 1400.0),
            ("trial", 0, "ok", {}, 22.0, 1520.0),
        )
    )
    assert found.values.tolist() == [[1, "DENS", 3.0, -20.0], [1, "RF_PP", -0.5, 1.0]]
    runs = study.evaluations[study.evaluations["phase"] == Phase.JACOBIAN]
    one_sided = study.evaluations.drop(runs.index[1::2])
    alone = type(study)(study.settings, study.plan, study.calibrations, one_sided, study.heaps)
    assert len(pairs(study)) > len(pairs(alone)) == 0


def test_the_numbers_of_three_runs_are_those_worked_out_by_hand():
    study = by_hand(
        ("sampling", 0, "ok", {"DENS": 2600.0}, 40.0, 900.0),
        ("trial", 1, "ok", {"DENS": 2500.0, "RF_PP": 0.001}, 26.0, 1500.0),
        ("trial", 0, "ok", {"DENS": 2500.0, "RF_PP": 0.0109}, 20.0, 1530.0),
        ("start", 0, "ok", {"DENS": 2400.0, "RF_PP": 0.001}, 22.0, 1500.0),
        ("trial", 2, "failed", {"DENS": 2600.0}, np.nan, np.nan),
    )
    (line,) = second_phase(study).to_dict("records")
    assert line == pytest.approx(
        {
            "row": 1,
            "runs": 3,
            "reach": 100 / 200,  # RF_PP takes a tenth of its interval
            "angle_sd": (28 / 3) ** 0.5,
            "start": 0.1**2,
            "average": (0.1**2 + 0.02**2 + 0.3**2) / 3,
            "best": 0.02**2,
            "better": 1 / 2,
        }
    )


def test_numbers_are_those_of_the_runs(study):
    found = second_phase(study).set_index("row")
    assert set(found.index) == set(ROWS)
    for row, line in found.iterrows():
        runs = study.evaluations[
            (study.evaluations["row"] == row) & (study.evaluations["phase"] != Phase.SAMPLING)
        ]
        best = study.ok.set_index("row").loc[row]
        assert line["runs"] == len(runs) == best["runs_optimisation"]
        assert line["best"] == pytest.approx(best["dem_sum_of_squares"], rel=1e-9)
        assert line["angle_sd"] == pytest.approx(runs[ANGLE_OF_REPOSE].std())
        assert 0 <= line["reach"] <= 1 and 0 <= line["better"] <= 1
        assert line["best"] <= line["average"] and line["best"] <= line["start"]


def test_a_start_that_none_betters_is_said_so(study):
    # All later runs a hundred times further from the target than the first.
    evaluations = study.evaluations.copy()
    later = ~evaluations["phase"].isin([Phase.SAMPLING, Phase.START])
    evaluations.loc[later, ANGLE_OF_REPOSE] = 90.0
    spoilt = type(study)(study.settings, study.plan, study.calibrations, evaluations, study.heaps)
    assert (second_phase(spoilt)["better"] == 0).all()


def test_a_row_without_later_runs_is_left_out(study):
    evaluations = study.evaluations[study.evaluations["phase"].isin([Phase.SAMPLING, Phase.START])]
    short = type(study)(study.settings, study.plan, study.calibrations, evaluations, study.heaps)
    assert second_phase(short).empty and pairs(short).empty
    assert not any("pairs" in note for note in notes(short))


def test_noise_alone_gives_a_ratio_of_one():
    rng = np.random.default_rng(1)
    covered = 0
    for _ in range(400):
        differences = 1.3 * np.subtract(*rng.standard_normal((2, 40)))
        sd = float(np.std(1.3 * rng.standard_normal(9), ddof=1))
        value, low, high = ratio(differences, sd, 8)
        assert low < value < high
        covered += low <= 1 <= high
    # 95 % of 400, and four standard deviations of that.
    assert abs(covered - 380) <= 18


def test_a_slope_raises_the_ratio():
    differences = np.subtract(*np.random.default_rng(2).standard_normal((2, 50))) + 5.0
    assert ratio(differences, 1.0, 20)[1] > 2


def test_what_was_measured_with_few_runs_says_less():
    differences = np.subtract(*np.random.default_rng(3).standard_normal((2, 50)))
    few, many = (ratio(differences, 1.0, freedom) for freedom in (7, 700))
    assert few[0] == many[0] and few[1] < many[1] and few[2] > many[2]


def test_the_notes_name_the_model_whose_noise_is_not_known(study):
    assert any("not measured for this model" in note for note in notes(study))


def test_the_notes_give_the_ratio_where_the_noise_is_known(study, monkeypatch):
    # The package has the function under the module's name.
    module = sys.modules["calstudy.analysis.tables.second_phase"]
    monkeypatch.setattr(module, "known_noise", lambda *_: {ANGLE_OF_REPOSE: 0.5, BULK_DENSITY: 30.0})
    monkeypatch.setattr(module, "noise_freedom", lambda *_: 35)
    (said,) = [note for note in notes(study) if "pairs" in note]
    assert f"{len(pairs(study))} pairs" in said and "angle of repose" in said and "bulk density" in said


def test_a_failed_run_is_no_draw(study):
    evaluations = study.evaluations.copy()
    later = evaluations.index[evaluations["phase"] == Phase.TRIAL]
    evaluations.loc[later[0], "outcome"] = "failed"
    evaluations.loc[later[0], ANGLE_OF_REPOSE] = np.nan
    with_failure = type(study)(study.settings, study.plan, study.calibrations, evaluations, study.heaps)
    before, after = (second_phase(s).set_index("row")["runs"] for s in (study, with_failure))
    assert (before - after).sum() == 1
    assert not second_phase(with_failure).drop(columns="row").isna().any(axis=None)
