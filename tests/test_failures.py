import threading

import numpy as np
import pytest

from calstudy.errors import SetupError, Stopped
from calstudy.records import Outcome, Phase
from calstudy.study.directory.store import finished_rows, read_table
from campaigns import ROWS, interrupt_after, on_disk
from closed_form import (
    ClosedForm,
    run_study,
)
from same_tables import assert_same, tables


def row_1_fails(_, parameters):
    """Of rows 1 and 5, row 1 alone holds MU_PP constant."""
    return Outcome.TIMED_OUT if parameters["MU_PP"] == 0.2 else None


def test_a_row_that_fails_is_stored_with_its_reason_and_the_others_go_on(tmp_path):
    campaign, summary = run_study(tmp_path, (1, 5), engine=ClosedForm(fails=row_1_fails))
    assert (summary.finished, summary.failed) == ((1, 5), (1,))
    calibrations = read_table(tmp_path, "calibrations").set_index("row")
    assert calibrations["outcome"].tolist() == ["failed", "ok"]
    assert "only 0 of 6 sampling runs are usable" in calibrations["reason"][1]
    assert (calibrations["runs_failed"][1], calibrations["samples_left_out"][1]) == (6, 6)
    assert np.isnan(calibrations["dem_DENS"][1]) and calibrations["dem_DENS"][5] > 0
    evaluations = read_table(tmp_path, "evaluations")
    assert set(evaluations["outcome"][evaluations["row"] == 1]) == {"timed_out"}
    assert evaluations["bulk_density"][evaluations["row"] == 1].isna().all()
    assert campaign.progress.rows_failed == 1 and campaign.progress.runs_failed == 6
    assert set(read_table(tmp_path, "heaps")["row"]) == {5}


def test_a_failed_row_is_tried_again_on_request_and_only_what_broke_is_run_again(tmp_path):
    rows = (1, 5)
    run_study(tmp_path / "whole", rows)
    broken = ClosedForm(fails=lambda n, p: row_1_fails(n, p) if p["RF_PP"] > 0.05 else None)
    run_study(tmp_path / "study", rows, engine=broken)
    assert read_table(tmp_path / "study", "calibrations")["outcome"].tolist() == ["failed", "ok"]
    idle = ClosedForm()
    run_study(tmp_path / "study", rows, engine=idle)
    assert idle.calls.total() == 0, "without the option a failed row stays as it is"
    again = ClosedForm()
    _, summary = run_study(tmp_path / "study", rows, engine=again, retry_failed=True)
    assert summary.failed == ()
    evaluations = read_table(tmp_path / "whole", "evaluations").query("row == 1")
    sampled = evaluations["phase"] == Phase.SAMPLING
    assert 0 < (evaluations["RF_PP"][sampled] > 0.05).sum() < sampled.sum()
    spared = set(evaluations["run_id"][sampled & (evaluations["RF_PP"] <= 0.05)])
    assert set(again.calls) == set(evaluations["run_id"]) - spared
    assert_same(tables(tmp_path / "study"), tables(tmp_path / "whole"))


def test_a_failed_run_is_not_repeated_when_the_study_goes_on(tmp_path):
    stop = threading.Event()
    with pytest.raises(Stopped):
        engine = ClosedForm(
            fails=lambda n, _: Outcome.FAILED if n == 2 else None, on_call=interrupt_after(4, stop)
        )
        run_study(tmp_path, (1,), engine=engine, workers=1, stop=stop)
    kept = on_disk(tmp_path)
    again = ClosedForm()
    run_study(tmp_path, (1,), engine=again)
    assert not kept & set(again.calls)
    assert read_table(tmp_path, "calibrations")["samples_left_out"].tolist() == [1]


def test_on_request_a_failed_run_of_a_row_under_way_is_run_again(undisturbed, tmp_path):
    def until(calls, **how):
        stop = threading.Event()
        engine = ClosedForm(noise=0.01, on_call=interrupt_after(calls, stop), **how)
        with pytest.raises(Stopped):
            run_study(tmp_path, ROWS, engine=engine, workers=1, stop=stop, retry_failed="fails" not in how)

    until(4, fails=lambda n, _: Outcome.FAILED if n == 2 else None)
    until(3)
    # Without the option now: what was run again is what counts.
    run_study(tmp_path, ROWS, engine=ClosedForm(noise=0.01))
    assert_same(tables(tmp_path), tables(undisturbed))


def machine_breaks(at):
    def on_call(number):
        if number == at:
            raise SetupError("the disk is full; free space")

    return on_call


@pytest.mark.parametrize(("at", "workers"), [(0, 3), (4, 1), (20, 3)])
def test_an_error_of_the_machine_ends_the_campaign_and_keeps_what_is_finished(
    undisturbed, tmp_path, at, workers
):
    engine = ClosedForm(noise=0.01, on_call=machine_breaks(at))
    with pytest.raises(SetupError, match="the disk is full"):
        run_study(tmp_path, ROWS, engine=engine, workers=workers)
    kept = on_disk(tmp_path)
    assert at - workers < len(kept) <= engine.calls.total()
    again = ClosedForm(noise=0.01)
    run_study(tmp_path, ROWS, engine=again)
    assert_same(tables(tmp_path), tables(undisturbed))
    assert not kept & set(again.calls)


def test_an_error_of_the_machine_ends_the_runs_under_way(tmp_path):
    def on_call(number):
        if number == 1:
            raise SetupError("no LIGGGHTS")

    stop = threading.Event()
    with pytest.raises(SetupError):
        run_study(tmp_path, (1,), engine=ClosedForm(seconds=30.0, on_call=on_call), workers=2, stop=stop)
    assert stop.is_set() and on_disk(tmp_path) == set()


def test_an_unforeseen_error_is_not_taken_for_a_failed_row(tmp_path):
    def broken(parameters):
        raise ZeroDivisionError("a bug")

    with pytest.raises(ZeroDivisionError):
        run_study(tmp_path, ROWS, engine=ClosedForm(answer=broken))
    assert finished_rows(tmp_path) == set()


def test_a_journal_that_cannot_be_written_ends_the_campaign(tmp_path):
    (tmp_path / "journal" / "row-01.jsonl").mkdir(parents=True)
    (tmp_path / "journal" / "row-01.jsonl").rmdir()
    place = tmp_path / "journal" / "row-01.jsonl"
    engine = ClosedForm(on_call=lambda number: place.mkdir() if number == 0 else None)
    with pytest.raises(SetupError, match=r"row-01\.jsonl: cannot be written"):
        run_study(tmp_path, ROWS, engine=engine)
    assert not any(thread.name.startswith(("dem", "row")) for thread in threading.enumerate())
