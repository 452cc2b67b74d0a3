"""Two parameters that act through their quotient alone are one input of the surrogates."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.calibration.fidelities.surrogates import FidelityRuns, TwoSurrogates
from calstudy.calibration.kriging.coordinates import Coordinates
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES, mode_of
from calstudy.calibration.procedure import expected_costs, optimise_from
from calstudy.models.heap import MEASURED, PROPORTIONAL
from calstudy.parameters import Parameter, Space
from calstudy.parameters.expression import Expression
from calstudy.plan import PARAMETERS
from calstudy.study.definition import example, read_definition
from calstudy.study.directory.begun import procedure_there
from calstudy.study.directory.store import Store
from calstudy.study.reading import read_result
from calstudy.study.settings import read_settings
from closed_form import PLAN, study_settings

RATIO = ("YM", "DENS")
KNOWN = dict.fromkeys(MEASURED, RATIO)
ALL = Space(PLAN.parameters, tuple(PARAMETERS))
STORED = Path(__file__).parent / "golden" / "coarse_and_tiny.csv"


def test_the_quotient_is_an_input_in_place_of_the_two_and_fills_its_interval():
    inputs = Coordinates.of(ALL, RATIO)
    assert inputs.box.names == ("MU_PP", "MU_PW", "RF_PP", "RF_PW", "YM/DENS")
    corners = ALL.box.from_unit(np.array(np.meshgrid(*[[0.0, 1.0]] * 6)).reshape(6, -1).T)
    unit = inputs.to_unit(corners)
    assert unit.min(axis=0) == pytest.approx(np.zeros(5)) and unit.max(axis=0) == pytest.approx(np.ones(5))
    both = ALL.box.names.index("DENS"), ALL.box.names.index("YM")
    heavier = np.where(np.isin(np.arange(6), both), 1.03, 1.0) * ALL.box.centre
    assert inputs(heavier[None]) == pytest.approx(inputs(ALL.box.centre[None]), rel=1e-14)


def test_the_inputs_are_the_parameters_where_one_of_the_two_is_held_or_followed_or_nothing_is_known():
    held = PLAN.space(PLAN.row(1))
    assert "YM" not in held.box.names and Coordinates.of(held, RATIO).box == held.box
    wall = Parameter("WALL", "Pa", 0.0, 0.0, None, formula=Expression("2 * YM"))
    followed = Space((*PLAN.parameters, wall), tuple(PARAMETERS))
    assert Coordinates.of(followed, RATIO).box == followed.box
    assert Coordinates.of(ALL, None).box == ALL.box


def test_points_of_one_quotient_have_one_prediction_but_for_the_density_that_a_response_is_proportional_to():
    rng = np.random.default_rng(1)
    points = ALL.box.from_unit(rng.random((14, 6)))
    responses = np.column_stack([rng.normal(25, 2, 14), rng.normal(0.6, 0.01, 14) * points[:, 0]])
    settings = MODES["robust"].knowing(PROPORTIONAL, ratios=KNOWN).kriging
    model = Surrogates.fit(settings, ALL, MEASURED, points, responses)
    light = ALL.box.from_unit(np.full((1, 6), 0.4))
    heavy = light * np.where(np.isin(ALL.box.names, RATIO), 1.04, 1.0)
    (mean, sd), (heavier, its_sd) = (model.predict_with_deviations(at) for at in (light, heavy))
    assert heavier / mean == pytest.approx(np.array([[1.0, 1.04]]), rel=1e-9)
    assert its_sd / sd == pytest.approx(np.array([[1.0, 1.04]]), rel=1e-6)


@pytest.mark.parametrize(("cheap", "expensive"), [(16, 0), (16, 1), (16, 3), (22, 3), (22, 7)])
def test_real_runs_of_two_fidelities_with_an_angle_out_of_reach_still_give_the_bulk_density(
    cheap, expensive, tmp_path
):
    # With DENS and YM as two inputs the calibration that made them ended at 1563 kg/m3: noise in the angle
    # looked like an effect of DENS.
    file = tmp_path / "beads.toml"
    file.write_text(example().replace('fidelity = "soft"', 'fidelity = "coarse"\ncheap = "tiny"'))
    task = read_definition(file).task
    stored = pd.read_csv(STORED)
    names = list(task.space.box.names)
    runs = []
    for fidelity, count in (("tiny", cheap), ("coarse", expensive)):
        of = stored[stored["fidelity"] == fidelity][:count]
        runs.append(FidelityRuns(of[names].to_numpy(), of[list(task.cost.responses)].to_numpy()))
    settings = task.mode.kriging
    found = TwoSurrogates.of(
        settings, task.space, task.cost.responses, task.cheap, (runs[0], runs[1]), task.noise
    )
    starts = np.vstack([task.centre[None], runs[0].points, runs[1].points])
    starts = starts[np.argsort(expected_costs(task, found, starts))[:2]]
    best = min((optimise_from(s, task, found) for s in starts), key=lambda o: o.sum_of_squares).best
    assert found.predict(best[None])[0, 1] == pytest.approx(1500.0, abs=1.0)
    assert 2440 < best[names.index("DENS")] < 2490


def test_a_study_goes_on_with_the_version_of_the_mode_that_it_was_begun_with(tmp_path):
    before, now = (mode_of("robust", procedure=version) for version in (1, None))
    assert before.kriging.ratios is None and now.kriging.ratios == {} and now.procedure > 1
    assert before.knowing(PROPORTIONAL, ratios=KNOWN).kriging.ratios is None
    assert mode_of("paper", procedure=now.procedure) == mode_of("paper")
    assert "procedure" not in study_settings().content
    assert procedure_there(tmp_path / "new") is None
    for version in (1, 2, 3):
        with Store(tmp_path / str(version), study_settings(procedure=version)):
            assert procedure_there(tmp_path / str(version)) == version


def test_what_is_reported_of_a_calibration_knows_the_quotient_as_its_search_does():
    study = Path(__file__).parents[1] / "reports" / "glass_beads" / "study"
    definition = read_definition(Path(__file__).parents[1] / "plans" / "glass_beads.toml")
    result = read_result(study, definition, read_settings(study))
    assert [inputs.box.names for inputs in result.surrogates.coordinates] == [
        ("MU_PP", "RF_PP", "YM/DENS")
    ] * 2
