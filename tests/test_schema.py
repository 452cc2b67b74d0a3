from dataclasses import replace

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calstudy.models.heap import RESPONSES
from calstudy.plan import PARAMETERS
from calstudy.records import OF_EVERY_CALIBRATION, Beads, Outcome, Phase
from calstudy.study.schema import BEAD_COUNTS, MEANINGS, TABLES, VARYING, arrow_schema, tables_of
from closed_form import run_study
from shipped_model import COLUMNS, QUANTITIES


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    directory = tmp_path_factory.mktemp("studies") / "study"
    run_study(directory, (1,))
    return directory


@pytest.mark.parametrize("table", TABLES)
def test_every_stored_column_carries_its_unit_and_meaning(study, table):
    stored = pq.read_schema(study / table / "row-01.parquet")
    assert stored.names == [column.name for column in COLUMNS[table]]
    for column in COLUMNS[table]:
        metadata = stored.field(column.name).metadata
        assert metadata[b"unit"].decode() == column.unit
        assert metadata[b"meaning"].decode() == column.meaning != ""
    assert stored.metadata[b"table"].decode() == table


@pytest.mark.parametrize("table", TABLES)
def test_stored_types_are_the_documented_ones(study, table):
    stored = pq.read_schema(study / table / "row-01.parquet")
    assert stored.types == arrow_schema(table, QUANTITIES).types


@pytest.mark.parametrize("table", TABLES)
def test_every_number_has_a_unit_and_nothing_else_has_one(table):
    for column in COLUMNS[table]:
        numeric = not (pa.types.is_string(column.type) or pa.types.is_boolean(column.type))
        assert bool(column.unit) == numeric, column.name


@pytest.mark.parametrize("table", TABLES)
def test_no_column_stands_twice(table):
    names = [column.name for column in COLUMNS[table]]
    assert len(names) == len(set(names))
    assert MEANINGS[table]


def test_a_unit_that_is_not_si_is_part_of_the_name():
    for columns in COLUMNS.values():
        for column in columns:
            if column.unit == "deg":
                assert "_deg" in column.name
            else:
                assert column.unit in ("", "-", "1", "m", "s", "Pa", "kg/m3", "1/s", "%")


def test_whatever_differs_between_equal_studies_is_a_column():
    every = {column.name for columns in COLUMNS.values() for column in columns}
    assert set(VARYING) <= every


def test_evaluations_have_all_parameters_responses_phases_and_beads():
    columns = {column.name: column for column in COLUMNS["evaluations"]}
    assert set(BEAD_COUNTS.values()) == set(Beads.__annotations__)
    assert {*PARAMETERS, *RESPONSES, *(f"beads_{name}" for name in BEAD_COUNTS)} <= set(columns)
    assert all(phase in columns["phase"].meaning for phase in OF_EVERY_CALIBRATION)
    assert all(outcome in columns["outcome"].meaning for outcome in Outcome)
    assert {f"runs_{phase}" for phase in OF_EVERY_CALIBRATION} <= {
        column.name for column in COLUMNS["calibrations"]
    }


@pytest.mark.parametrize("table", TABLES)
def test_a_calibration_leaves_no_column_empty(study, table):
    # A column that no code fills would be a promise that the tables do not keep.
    frame = pd.read_parquet(study / table)
    assert [name for name in frame if frame[name].isna().all()] == []


def test_a_study_without_a_cheap_fidelity_and_confirmation_has_the_columns_it_always_had():
    more = replace(QUANTITIES, phases=tuple(Phase))
    with_both = {column.name for column in tables_of(more)["calibrations"]}
    assert with_both - {column.name for column in COLUMNS["calibrations"]} == {
        "runs_cheap",
        "runs_confirmation",
    }
    assert "runs_cheap" not in {column.name for column in COLUMNS["calibrations"]}
