import shutil

import pytest

from calstudy.errors import StoreError
from calstudy.study.directory.store import read_table
from calstudy.study.schema import TABLES
from campaigns import ROWS
from closed_form import (
    ClosedForm,
    run_study,
)
from same_tables import assert_same, tables


@pytest.mark.slow
@pytest.mark.parametrize("table", TABLES)
@pytest.mark.parametrize("damage", ["cut", "flipped", "gone"])
def test_damaged_tables_are_made_again_from_the_journal_without_a_run(undisturbed, tmp_path, table, damage):
    shutil.copytree(undisturbed, tmp_path / "study")
    path = tmp_path / "study" / table / "row-01.parquet"
    content = bytearray(path.read_bytes())
    content[len(content) // 4] ^= 4
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(content if damage == "flipped" else content[: len(content) // 2])
    engine = ClosedForm(noise=0.01)
    campaign, _ = run_study(tmp_path / "study", ROWS, engine=engine)
    assert engine.calls.total() == 0
    assert_same(tables(tmp_path / "study"), tables(undisturbed))
    if damage != "gone":
        assert len(campaign.store.notes) == 1 and "row 1 is made again" in campaign.store.notes[0]


def test_a_damaged_row_is_made_again_whichever_rows_are_asked_for(undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "study")
    path = tmp_path / "study" / "calibrations" / "row-01.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    other = next(row for row in ROWS if row != 1)
    engine = ClosedForm(noise=0.01)
    run_study(tmp_path / "study", (other,), engine=engine)
    assert engine.calls.total() == 0
    assert_same(tables(tmp_path / "study"), tables(undisturbed))


def test_damaged_tables_without_a_journal_are_refused_by_name(undisturbed, tmp_path):
    shutil.copytree(undisturbed, tmp_path / "study")
    path = tmp_path / "study" / "heaps" / "row-01.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    (tmp_path / "study" / "journal" / "row-01.jsonl").unlink()
    with pytest.raises(StoreError, match=r"heaps/row-01\.parquet is damaged"):
        run_study(tmp_path / "study", ROWS)
    assert len(read_table(tmp_path / "study", "calibrations")) == 2
