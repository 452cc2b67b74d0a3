"""A rerun beside what was shipped: equal to the last digit, or where it first is not."""

from __future__ import annotations

import pandas as pd
import pytest

from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.records import Phase
from calstudy.study.reading import read_study
from calstudy.study.run.comparison import compare_row, requests_of
from closed_form import ClosedForm, chaotic_responses, other_last_digits, run_study

ROW = 31


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    directory = tmp_path_factory.mktemp("shipped") / "study"
    run_study(directory, (1, ROW), engine=ClosedForm(noise=0.01))
    return read_study(directory)


def changed(study, phase, index, column, by):
    """The study with one number of one run changed."""
    evaluations = study.evaluations.copy()
    at = (evaluations["row"] == ROW) & (evaluations["phase"] == phase) & (evaluations["index"] == index)
    assert at.sum() == 1
    evaluations.loc[at, column] += by
    return type(study)(study.settings, study.plan, study.calibrations, evaluations, study.heaps)


def test_the_same_settings_give_the_same_row(shipped, tmp_path):
    run_study(tmp_path, (ROW,), engine=ClosedForm(noise=0.01))
    found = compare_row(shipped, read_study(tmp_path), ROW)
    assert found.same and found.runs == found.runs_again == found.equal > 6
    assert found.largest == {ANGLE_OF_REPOSE: 0.0, BULK_DENSITY: 0.0}


def test_the_first_run_that_differs_is_named(shipped):
    found = compare_row(shipped, changed(shipped, Phase.SAMPLING, 3, ANGLE_OF_REPOSE, 0.25), ROW)
    assert not found.same and found.equal == 3 and found.first_difference == "sampling 3"
    assert found.largest[ANGLE_OF_REPOSE] == pytest.approx(0.25)
    assert found.largest[BULK_DENSITY] == 0.0


def test_a_last_digit_counts(shipped):
    found = compare_row(shipped, changed(shipped, Phase.TRIAL, 0, "DENS", 5e-13 * 2400), ROW)
    assert found.first_difference == "trial 0"


def test_a_run_that_is_missing_is_a_difference(shipped):
    evaluations = shipped.evaluations[:-1]
    shorter = type(shipped)(shipped.settings, shipped.plan, shipped.calibrations, evaluations, shipped.heaps)
    for found in (compare_row(shipped, shorter, ROW), compare_row(shorter, shipped, ROW)):
        assert found.equal == min(found.runs, found.runs_again) < max(found.runs, found.runs_again)
        assert found.first_difference.startswith("trial")


def test_equal_runs_with_another_result_differ(shipped):
    calibrations = shipped.calibrations.assign(kriging_DENS=shipped.calibrations["kriging_DENS"] + 1.0)
    other = type(shipped)(shipped.settings, shipped.plan, calibrations, shipped.evaluations, shipped.heaps)
    found = compare_row(shipped, other, ROW)
    assert found.equal == found.runs and found.first_difference == "kriging_DENS"


def test_who_ran_it_does_not_matter(shipped):
    elsewhere = shipped.evaluations.assign(host="another", engine="LIGGGHTS of another build", cpu_time=pd.NA)
    other = type(shipped)(shipped.settings, shipped.plan, shipped.calibrations, elsewhere, shipped.heaps)
    assert compare_row(shipped, other, ROW).same


# ---- on another processor ------------------------------------------------------------------------


def test_what_differs_in_last_digits_of_the_numerics_alone_comes_out_again(tmp_path):
    chaotic = ClosedForm(answer=chaotic_responses)
    with other_last_digits():
        run_study(tmp_path / "there", (ROW,), engine=chaotic)
    there = read_study(tmp_path / "there")
    samples = there.plan.row(ROW).samples
    run_study(tmp_path / "alone", (ROW,), engine=chaotic)
    alone = compare_row(there, read_study(tmp_path / "alone"), ROW)
    assert alone.equal == samples and alone.first_difference == "start 0"
    run_study(tmp_path / "again", (ROW,), engine=chaotic, follow=requests_of(there, [ROW]))
    found = compare_row(there, read_study(tmp_path / "again"), ROW)
    assert found.same and found.equal == found.runs > samples


@pytest.mark.parametrize(("share", "same"), [(9e-6, True), (2e-5, False)])
def test_an_optimum_that_lies_elsewhere_is_not_followed(tmp_path, share, same):
    with other_last_digits(share):
        run_study(tmp_path / "there", (ROW,))
    there = read_study(tmp_path / "there")
    run_study(tmp_path / "again", (ROW,), follow=requests_of(there, [ROW]))
    found = compare_row(there, read_study(tmp_path / "again"), ROW)
    assert (found.first_difference != "start 0") is same


@pytest.mark.parametrize(
    ("column", "by", "same"),
    [
        ("kriging_DENS", 9e-6 * 2500, True),
        ("kriging_DENS", 2e-5 * 2600, False),
        ("kriging_noise_bulk_density", 9e-6 * 1500, True),
        ("kriging_noise_bulk_density", 2e-5 * 1600, False),
        ("dem_sum_of_squares", 0.9e-9, True),
        ("dem_sum_of_squares", 1e-6, False),
    ],
)
def test_numbers_of_a_calibration_may_differ_in_last_digits(shipped, column, by, same):
    calibrations = shipped.calibrations.assign(**{column: shipped.calibrations[column] + by})
    other = type(shipped)(shipped.settings, shipped.plan, calibrations, shipped.evaluations, shipped.heaps)
    assert compare_row(shipped, other, ROW).first_difference == ("" if same else column)
