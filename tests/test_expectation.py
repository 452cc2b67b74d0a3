"""What a dry run expects is what the shipped studies took."""

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from calstudy.calibration.expected import expected_batches, expected_optimisation_runs
from calstudy.calibration.modes import mode_of
from calstudy.calibration.task import tasks_of
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, PROPORTIONAL
from calstudy.plan_file import load_plan
from calstudy.records import Target
from calstudy.study.reading import read_study

REPORTS = Path(__file__).parent.parent / "reports"
STUDIES = ("soft/paper", "soft/robust", "fast/paper", "coarse-rows/paper", "coarse-rows/robust")
SWEEPS = (
    *("angle_of_repose/noise", "angle_of_repose/plate", "angle_of_repose/choices"),
    *("coarse-rows/again", "emulator/full-ring", "emulator/full-ring-fresh", "emulator/soft-ring"),
    *("emulator/soft-wide", "soft/again"),
)
# Not soft/least: 140 runs near one point, 15 s each on the fastest processor so far.
MACHINES = 1.5
"""Factor between the processors that ran the shipped studies and the one whose seconds are expected."""


@pytest.fixture(scope="module")
def studies():
    return {name: read_study(REPORTS / name) for name in STUDIES}


def tasks_of_study(study):
    s = study.settings
    return tasks_of(
        study.plan,
        s.target,
        mode_of(s.mode, s.budget, procedure=s.procedure).knowing(PROPORTIONAL),
        s.seed,
        s.share_samples,
        s.noise,
    )


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factor"), [(n, 1.4 if n == "fast/paper" else 1.3) for n in STUDIES])
def test_expected_runs_are_those_that_a_study_took(studies, name, factor):
    study, tasks = studies[name], tasks_of_study(studies[name])
    rows = study.ok["row"]
    expected = sum(expected_optimisation_runs(tasks[row]) for row in rows)
    assert 1 / factor < expected / study.ok["runs_optimisation"].sum() < factor


def test_fewer_points_are_expected_before_a_confirmation():
    def expected(version, row, **changed):
        target = Target({ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}, "paper", "the paper's targets")
        tasks = tasks_of(load_plan(), target, mode_of("robust", procedure=version), 1)
        return expected_batches(replace(tasks[row], **changed))[0]

    assert expected(3, 28, samples=None, confirm=4) == [7, 1, 1, 1, 1, 4]  # six parameters
    assert expected(3, 1, confirm=4) == [6, 1, 1, 1, 4]
    assert expected(3, 1) == expected(2, 1) == [6, 1, 1, 1, 1, 1]
    assert expected(2, 28, samples=None, confirm=4) == [10, 1, 1, 1, 1, 1, 4]


def test_all_72_rows_are_expected_to_take_what_they_took(studies):
    study, tasks = studies["soft/paper"], tasks_of_study(studies["soft/paper"])
    assert len(study.ok) == 72
    expected = sum(sum(expected_batches(task)[0]) for task in tasks.values())
    assert expected == pytest.approx(study.ok["runs_total"].sum(), rel=0.02)


@pytest.mark.parametrize(
    ("mode", "batches"), [("robust", {1: 4, 2: 3, 3: 2}), ("paper", {1: 10, 2: 7, 5: 7})]
)
def test_points_that_run_together_are_expected_in_fewer_batches(mode, batches):
    target = Target({ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}, "paper", "the paper's targets")
    samples = {"robust": None, "paper": 36}[mode]
    task = replace(tasks_of(load_plan(), target, mode_of(mode), 1)[28], samples=samples, confirm=4)
    for together, number in batches.items():
        each = replace(task, mode=mode_of(mode, together=together))
        _, *second, again = expected_batches(each)[0]
        assert (len(second), again) == (number, 4)
        assert expected_optimisation_runs(each) == sum(second) + again
        assert max(second) == (together if mode == "robust" else 2 * task.space.box.dimension)


@pytest.mark.parametrize("name", STUDIES)
def test_expected_seconds_are_those_that_a_run_of_a_study_took(studies, name):
    study = studies[name]
    model = load_model(study.plan.fixed, study.settings.fidelity, study.settings.variant)
    taken = study.evaluations.drop_duplicates("run_id")["cpu_time"].mean()
    assert 1 / MACHINES < model.expected_seconds / taken < MACHINES


@pytest.mark.parametrize("name", SWEEPS)
def test_expected_seconds_are_those_that_a_run_of_a_sweep_took(studies, name):
    runs = pd.read_parquet(REPORTS / name / "runs.parquet")
    for (fidelity, variant), group in runs[runs["outcome"] == "ok"].groupby(["fidelity", "variant"]):
        model = load_model(studies["soft/paper"].plan.fixed, fidelity, variant)
        assert 1 / MACHINES < model.expected_seconds / group["cpu_time"].mean() < MACHINES, (
            fidelity,
            variant,
        )
