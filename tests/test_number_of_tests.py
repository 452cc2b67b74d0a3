"""A plan with the number of material tests as a factor: who asks which test, and what is read of it."""

import numpy as np
import pandas as pd
import pytest

from calstudy.analysis.by_tests.by_tests import by_tests, jackknifed
from calstudy.analysis.by_tests.rows import rows
from calstudy.analysis.tables.table_b1 import table_b1
from calstudy.calibration.task import TRUTHS, cost_of, truth_of
from calstudy.cli.main import main
from calstudy.emulator.replicates import CALIBRATIONS, RUNS, read_replicate
from calstudy.errors import MISSED
from calstudy.plan import MATERIAL_TESTS
from calstudy.plan_check import check
from calstudy.plan_file import load_plan
from calstudy.records import Outcome, Target
from calstudy.report.exhibits import table
from calstudy.report.replicated import replicate_study, with_replicated_tests
from calstudy.study.directory.store import read_table
from calstudy.study.reading import read_study

PLAN = load_plan(MATERIAL_TESTS)
ONE, THREE = 1, 19
"""Rows of one and of three tests that differ in nothing else."""
RUN = ["plan", "run", "--plan", MATERIAL_TESTS]


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    at = tmp_path_factory.mktemp("tests") / "study"
    options = ["--engine", "emulator", "--rows", f"{ONE},{THREE}", "--share-samples", "--budget", "3"]
    assert main([*RUN, *options, "--replicates", "2", "--workers", "1", "--study", str(at)]) in (0, MISSED)
    return at


def test_the_plan_confounds_nothing_and_its_rows_grow_by_a_test_at_a_time():
    assert check(PLAN).ok and check(PLAN).word_lengths == pytest.approx([0.0] * 7)
    aims = {row.TESTS: PLAN.aims(row) for row in PLAN.rows}
    assert list(map(len, aims.values())) == [2, 4, 6, 8] and aims[4] == tuple(PLAN.targets)
    assert all(aims[k + 1][: len(aims[k])] == aims[k] for k in (1, 2, 3))
    target = Target(PLAN.targets, "set", "")
    assert all(cost_of(PLAN, row, target).responses == PLAN.aims(row) for row in PLAN.rows)


def test_a_plan_of_one_test_has_no_such_column_in_any_file():
    paper = load_plan()
    assert paper.header[-1] == "RF_PW" and all(row.TESTS is None for row in paper.rows)
    assert set(paper.cells(paper.rows[0])) == set(paper.header)
    study = read_study("reports/soft/paper")
    assert tuple(table_b1(study)) == (*paper.header, "state")
    assert [column.name for column in table("table_b1", study).columns] == [*paper.header, "state"]


@pytest.mark.slow
def test_a_row_asks_its_own_tests_alone_and_rows_share_runs_of_a_test(directory):
    settings = read_study(directory).settings
    runs = read_table(directory, "evaluations", settings.quantities)
    asked = runs.groupby("row")["model"].unique()
    assert set(asked[ONE]) == {"angle_of_repose"}
    assert set(asked[THREE]) == {"angle_of_repose", "draw_down", "uniaxial_compression"}
    heaps = runs[(runs["phase"] == "sampling") & (runs["model"] == "angle_of_repose")]
    assert (heaps.groupby("run_id")["row"].nunique() == 2).all()  # the same 18 points, run once
    lines = read_study(directory).calibrations.set_index("row")
    assert np.isnan(lines.loc[ONE, "dem_draw_down_discharged_mass"])
    assert lines.loc[THREE, "runs_total"] == (runs["row"] == THREE).sum()


@pytest.mark.slow
def test_a_study_is_read_with_one_line_for_each_parameter_set(directory):
    study = read_study(directory)
    parts = read_table(directory, "evaluations", study.settings.quantities)
    joined = study.evaluations[study.evaluations["row"] == THREE]
    assert 3 * len(joined) == (parts["row"] == THREE).sum()
    assert joined[list(PLAN.aims(PLAN.row(THREE)))].notna().all(axis=None)
    assert (joined["outcome"] == Outcome.OK).all()
    of_the_heap = parts[(parts["row"] == THREE) & (parts["model"] == "angle_of_repose")]
    assert set(joined["run_id"]) == set(of_the_heap["run_id"])  # by which its heap is found


@pytest.mark.slow
def test_its_rows_are_told_with_the_targets_that_they_have(directory, capsys):
    assert main(["plan", "status", "--study", str(directory)]) == 0
    said = capsys.readouterr().out
    assert "2 finished" in said and "nan" not in said.lower()


@pytest.mark.slow
def test_each_replicate_has_a_truth_of_its_own_that_its_targets_come_from(directory):
    study, seen = read_study(directory), []
    for number in (1, 2):
        again = replicate_study(study, read_replicate(directory, study.settings, number))
        truth = again.settings.target.truth
        assert truth == truth_of(PLAN, study.settings.seed + number)
        places = [(truth[p.name] - p.lower) / (p.upper - p.lower) for p in PLAN.parameters]
        assert TRUTHS[0] <= min(places) and max(places) <= TRUTHS[1]
        seen.append(again.settings.target.values["bulk_density"])
        by_row = rows(again).set_index("row")
        assert by_row.loc[THREE, "nats"] > 0 and by_row.loc[ONE, "runs"] == by_row.loc[ONE, "sets"]
        off = by_row.loc[THREE, "at_DENS"] - places[0]
        assert by_row.loc[THREE, "off_DENS"] == pytest.approx(off)
    assert seen[0] != seen[1]


@pytest.mark.slow
def test_the_table_pools_the_replicates(directory):
    study = with_replicated_tests(directory, read_study(directory), 1)
    assert set(study.replicated_tests["replicate"]) == {1, 2}
    table = by_tests(study).set_index(["quantity", "parameter"])
    runs = [read_replicate(directory, study.settings, n)[CALIBRATIONS]["runs_total"] for n in (1, 2)]
    assert table.loc[("DEM runs", ""), "tests_3"] == np.mean([of.iloc[1] for of in runs])
    sets = [len(read_replicate(directory, study.settings, n)[RUNS].query("row == @ONE")) for n in (1, 2)]
    assert table.loc[("parameter sets", ""), "tests_1"] == np.mean(sets)
    assert table["tests_2"].isna().all()  # no such row was run


def test_leaving_out_replicates_gives_the_standard_error_of_a_mean():
    values = np.array([3.0, 5.0, 4.0, 8.0])
    lines = pd.DataFrame({"replicate": range(4), "value": values})
    found = jackknifed(lines, lambda part: float(part["value"].mean()))
    error = values.std(ddof=1) / 2.0
    assert (found.value, found.low) == pytest.approx((5.0, 5.0 - 1.96 * error))
    assert np.isnan(jackknifed(lines[:1], lambda part: float(part["value"].mean())).low)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--model", "draw_down"], "leave --model out"),
        (["--cheap", "tiny"], "leave --cheap out"),
        (["--engine", "emulator", "--emulator", "mine"], "leave --emulator out"),
        (["--target", "paper"], "write twin, or leave it out"),
    ],
)
def test_what_is_about_one_model_is_refused_in_one_line(options, line, tmp_path, capsys):
    assert main([*RUN, *options, "--dry-run", "--study", str(tmp_path / "study")]) == 2
    said = capsys.readouterr().err
    assert line in said and said.count("\n") == 1


def test_a_study_of_one_test_has_no_table_of_tests(capsys, tmp_path):
    of_paper = ["analyse", "reports/soft/paper", "--only", "by_tests", "--out", str(tmp_path)]
    assert main(of_paper) == 2
    assert "--plan material-tests" in capsys.readouterr().err
