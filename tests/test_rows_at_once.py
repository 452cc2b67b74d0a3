"""Rows in flight are bounded, and the bound changes nothing but memory."""

import threading

import pytest

from calstudy.study import campaign
from closed_form import PLAN, ClosedForm, run_study
from same_tables import assert_same, tables

pytestmark = pytest.mark.slow

ROWS = (1, 2, 3, 5, 7, 31)


@pytest.fixture
def rows_in_flight(monkeypatch):
    """Numbers of rows that were in flight when one began."""
    seen: list[int] = []
    guard, under_way = threading.Lock(), set()
    calibrate = campaign.Campaign._calibrate

    def counted(self, row):
        with guard:
            under_way.add(row)
            seen.append(len(under_way))
        try:
            calibrate(self, row)
        finally:
            with guard:
                under_way.discard(row)

    monkeypatch.setattr(campaign.Campaign, "_calibrate", counted)
    return seen


@pytest.mark.parametrize("bound", [1, 2])
def test_few_rows_at_once_calibrate_as_all_at_once(tmp_path, monkeypatch, rows_in_flight, bound):
    run_study(tmp_path / "all", ROWS, engine=ClosedForm(noise=0.01), workers=1)
    assert max(rows_in_flight) > 2
    rows_in_flight.clear()
    monkeypatch.setattr(campaign, "LEAST_ROWS_AT_ONCE", bound)
    monkeypatch.setattr(campaign, "ROWS_FOR_A_SLOT", 1)
    _, summary = run_study(tmp_path / "few", ROWS, engine=ClosedForm(noise=0.01), workers=1)
    assert len(rows_in_flight) == len(ROWS) and max(rows_in_flight) == bound
    assert summary.finished == ROWS
    assert_same(tables(tmp_path / "few"), tables(tmp_path / "all"))


def test_a_slot_more_brings_rows_more(tmp_path, monkeypatch, rows_in_flight):
    monkeypatch.setattr(campaign, "LEAST_ROWS_AT_ONCE", 1)
    run_study(tmp_path / "study", ROWS, engine=ClosedForm(seconds=0.002), workers=2)
    assert max(rows_in_flight) == 2 * campaign.ROWS_FOR_A_SLOT


@pytest.mark.parametrize("again", [False, True], ids=["in one session", "in another session"])
def test_finished_rows_take_no_memory_and_share_their_runs_by_their_journals(tmp_path, monkeypatch, again):
    rows = tuple(row.run for row in PLAN.rows if PLAN.sampled_as(row.run) == 1)
    options = {"share_samples": True, "workers": 1}
    engine, another = ClosedForm(noise=0.01), ClosedForm(noise=0.01)
    run_study(tmp_path / "at once", rows, engine=engine, **options)
    monkeypatch.setattr(campaign, "LEAST_ROWS_AT_ONCE", 1)
    monkeypatch.setattr(campaign, "ROWS_FOR_A_SLOT", 1)
    if again:
        run_study(tmp_path / "study", rows[:1], engine=another, **options)
    done, _ = run_study(tmp_path / "study", rows, engine=another, **options)
    assert another.calls == engine.calls, "a run on disk was run again"
    assert not done.answers._known and not done.answers._stored and not done.answers._of_row
    assert_same(tables(tmp_path / "study"), tables(tmp_path / "at once"))
