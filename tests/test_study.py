"""Reading a study for analysis: finished rows alone, and refusals in one line."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from calstudy.analysis.figures.heap import exemplary_row
from calstudy.errors import InputError, StoreError
from calstudy.models.heap import ANGLE_OF_REPOSE
from calstudy.plan_export import export
from calstudy.plan_file import load_plan
from calstudy.records import Outcome
from calstudy.study.directory.store import read_table
from calstudy.study.reading import read_study
from closed_form import PLAN, ClosedForm, resettle, run_study, target_of

ROWS = (1, 2, 31, 53)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    directory = tmp_path_factory.mktemp("study") / "sound"
    run_study(directory, ROWS, engine=ClosedForm(noise=0.01))
    return directory


@pytest.fixture
def directory(finished, tmp_path):
    return Path(shutil.copytree(finished, tmp_path / "study"))


def test_a_study_is_its_finished_rows(finished):
    study = read_study(finished)
    assert list(study.ok["row"]) == list(ROWS) and study.failed.empty
    assert study.unfinished == [row.run for row in PLAN.rows if row.run not in ROWS]
    assert set(study.heaps["row"]) == set(study.evaluations["row"]) == set(ROWS)
    assert study.provenance().startswith("n = 4 rows of 72; exact fidelity")
    assert "68 of 72 rows are not finished" in study.left_out()


def test_a_row_that_is_being_finished_is_not_there_yet(directory):
    # Its evaluations and heap are written first; the calibration makes it finished.
    (directory / "calibrations" / "row-02.parquet").unlink()
    study = read_study(directory)
    assert list(study.ok["row"]) == [1, 31, 53]
    assert set(study.evaluations["row"]) == set(study.heaps["row"]) == {1, 31, 53}


def test_files_of_others_among_the_rows_are_nobodys(directory):
    from calstudy.study.directory.store import finished_rows, journals

    before = finished_rows(directory)
    (directory / "calibrations" / "row-01 copy.parquet").write_bytes(b"")
    (directory / "journal").mkdir(exist_ok=True)
    (directory / "journal" / "row-abc.jsonl").write_text("")
    (directory / "journal" / "row-99.jsonl").mkdir()
    assert finished_rows(directory) == before and 99 not in journals(directory)
    assert len(read_study(directory).calibrations) == len(before)


def test_a_failed_row_is_left_out_with_its_reason(tmp_path):
    def row_1_fails(_, parameters):
        return Outcome.FAILED if parameters["MU_PP"] == 0.2 else None

    run_study(tmp_path, (1, 2), engine=ClosedForm(fails=row_1_fails))
    study = read_study(tmp_path)
    assert list(study.ok["row"]) == [2] and list(study.failed["row"]) == [1]
    assert "calibration failed: row 1 (only 0 of 6" in study.left_out()


def test_deviations_are_from_the_studys_own_target(finished):
    study = read_study(finished)
    expected = study.ok[f"dem_{ANGLE_OF_REPOSE}"] - target_of().values[ANGLE_OF_REPOSE]
    assert np.array_equal(study.deviation(ANGLE_OF_REPOSE), expected)


def test_a_position_is_taken_over_the_rows_that_calibrated_the_parameter(finished):
    study = read_study(finished)
    rows = study.ok[study.ok["calibrated_MU_PP"]]
    assert list(rows["row"]) == [2]
    assert study.position("MU_PP") == pytest.approx((rows["dem_MU_PP"] - 0.1) / 0.2)


def test_the_exemplary_row_has_the_median_angle(finished):
    study = read_study(finished)
    angles = study.ok.set_index("row")[f"dem_{ANGLE_OF_REPOSE}"].sort_values()
    assert exemplary_row(study) == angles.index[1]


# ---- refusals ----------------------------------------------------------------------------------------


def test_a_directory_that_is_no_study_is_refused(tmp_path):
    with pytest.raises(StoreError, match=r"is no study: study\.json is missing"):
        read_study(tmp_path)
    with pytest.raises(StoreError, match="is no study"):
        read_study(tmp_path / "nowhere")


@pytest.mark.parametrize("table", ["calibrations", "evaluations", "heaps"])
def test_a_damaged_table_is_refused_by_file(directory, table):
    path = directory / table / "row-02.parquet"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(StoreError, match=f"{table}/row-02.parquet"):
        read_study(directory)


def test_a_missing_column_is_refused_by_file(directory):
    path = directory / "calibrations" / "row-31.parquet"
    whole = read_table(directory, "calibrations")
    whole[whole["row"] == 31].drop(columns="dem_YM").to_parquet(path)
    with pytest.raises(StoreError, match=r"row-31\.parquet: columns are not those of this version"):
        read_study(directory)


def test_a_finished_row_without_evaluations_is_refused(directory):
    (directory / "evaluations" / "row-31.parquet").unlink()
    with pytest.raises(StoreError, match="evaluations lacks row 31"):
        read_study(directory)


def test_another_plan_is_refused_until_it_is_named(directory, tmp_path):
    lines = export(PLAN, "csv").splitlines()
    lines[5], lines[6] = "5,0.5,9,0,0,0,1", "6,0,9,1,0,0,0"
    file = tmp_path / "other.csv"
    file.write_text("\n".join(lines) + "\n")
    resettle(directory, plan_hash=load_plan(file).hash)
    with pytest.raises(InputError, match=r"made with another plan .* name its file with --plan"):
        read_study(directory)
    assert list(read_study(directory, file).ok["row"]) == list(ROWS)


def test_a_row_that_the_plan_has_not_is_refused(directory):
    for table in ("calibrations", "evaluations", "heaps"):
        path = directory / table / "row-53.parquet"
        import pyarrow as pa
        import pyarrow.parquet as pq

        part = pq.read_table(path)
        k = part.schema.get_field_index("row")
        part = part.set_column(k, part.schema.field(k), pa.array([99] * len(part), pa.int64()))
        path.unlink()
        pq.write_table(part, path.with_name("row-99.parquet"))
    with pytest.raises(StoreError, match="holds row 99, which the plan has not"):
        read_study(directory)
