import threading

import pytest

from calstudy.errors import OutOfTime, Stopped
from calstudy.models.heap import RESPONSES
from calstudy.plan import PARAMETERS
from calstudy.study.directory.session import read_sessions
from calstudy.study.directory.store import finished_rows, read_table
from campaigns import QUICK_ROBUST, ROWS, interrupt_after, on_disk
from closed_form import (
    PAPER,
    PLAN,
    ClosedForm,
    chaotic_responses,
    other_last_digits,
    run_study,
)
from same_tables import assert_same, tables


@pytest.mark.parametrize(("calls", "workers"), [(0, 1), (1, 3), (6, 3), (16, 1), (23, 3), (33, 1)])
def test_an_interrupted_study_goes_on_to_the_same_tables(undisturbed, tmp_path, calls, workers):
    stop = threading.Event()
    first = ClosedForm(noise=0.01, on_call=interrupt_after(calls, stop))
    with pytest.raises(Stopped):
        run_study(tmp_path, ROWS, engine=first, workers=workers, stop=stop)
    kept = on_disk(tmp_path)
    assert calls <= len(kept) <= first.calls.total() <= calls + 1 + workers
    second = ClosedForm(noise=0.01)
    run_study(tmp_path, ROWS, engine=second, workers=workers)
    assert_same(tables(tmp_path), tables(undisturbed))
    assert not kept & set(second.calls)
    assert max(second.calls.values()) == 1


@pytest.mark.parametrize("mode", [PAPER, QUICK_ROBUST], ids=lambda mode: mode.name)
def test_a_row_that_goes_on_on_another_processor_loses_no_run(tmp_path, mode):
    row = 53
    calls = PLAN.row(row).samples + 3
    stop = threading.Event()
    first = ClosedForm(answer=chaotic_responses, on_call=interrupt_after(calls, stop))
    with other_last_digits(), pytest.raises(Stopped):
        run_study(tmp_path, (row,), engine=first, mode=mode, workers=1, stop=stop)
    kept = on_disk(tmp_path, (row,))
    assert len(kept) >= calls
    second = ClosedForm(answer=chaotic_responses)
    campaign, _ = run_study(tmp_path, (row,), engine=second, mode=mode, workers=1)
    runs = read_table(tmp_path, "evaluations")
    assert kept < set(runs["run_id"]) and campaign.progress.runs_reused == len(kept)
    (line,) = read_table(tmp_path, "calibrations").to_dict("records")
    best = runs[runs["run_id"] == line["dem_run_id"]].iloc[0]
    assert all(line[f"dem_{name}"] == best[name] for name in (*PARAMETERS, *RESPONSES))


def test_a_study_interrupted_again_and_again_ends_with_the_same_tables(undisturbed, tmp_path):
    times = 0
    while True:
        stop = threading.Event()
        kept = on_disk(tmp_path) if times else set()
        engine = ClosedForm(noise=0.01, on_call=interrupt_after(8, stop))
        try:
            run_study(tmp_path, ROWS, engine=engine, stop=stop)
            break
        except Stopped:
            times += 1
        finally:
            assert not kept & set(engine.calls)
    assert times > 3
    assert_same(tables(tmp_path), tables(undisturbed))


def test_a_stop_ends_runs_under_way_without_a_record(tmp_path):
    stop = threading.Event()
    engine = ClosedForm(seconds=60.0, on_call=interrupt_after(1, stop))
    with pytest.raises(Stopped):
        run_study(tmp_path, ROWS, engine=engine, stop=stop)
    assert on_disk(tmp_path) == set() and finished_rows(tmp_path) == set()


def test_finished_rows_are_not_run_again(undisturbed, tmp_path):
    run_study(tmp_path, ROWS, engine=ClosedForm(noise=0.01))
    engine = ClosedForm(noise=0.01)
    _, summary = run_study(tmp_path, ROWS, engine=engine)
    assert (engine.calls.total(), summary.finished) == (0, ROWS)


def test_damaged_lines_of_a_journal_cost_their_runs_alone(undisturbed, tmp_path):
    stop = threading.Event()
    with pytest.raises(Stopped):
        engine = ClosedForm(noise=0.01, on_call=interrupt_after(5, stop))
        run_study(tmp_path, (1,), engine=engine, workers=1, stop=stop)
    journal = tmp_path / "journal" / "row-01.jsonl"
    content = bytearray(journal.read_bytes())
    content[content.index(b"\n") + 200] ^= 1
    journal.write_bytes(content)
    kept = on_disk(tmp_path)
    assert len(kept) >= 4
    second = ClosedForm(noise=0.01)
    run_study(tmp_path, ROWS, engine=second)
    assert_same(tables(tmp_path), tables(undisturbed))
    assert not kept & set(second.calls)


def test_a_time_limit_ends_between_runs_and_the_study_goes_on(undisturbed, tmp_path):
    first = ClosedForm(noise=0.01, seconds=0.1)
    with pytest.raises(OutOfTime):
        run_study(tmp_path, ROWS, engine=first, time_limit=0.6)
    kept = on_disk(tmp_path)
    assert 0 < len(kept) < 30
    assert kept == set(first.calls), "every run that was begun has been finished"
    assert read_sessions(tmp_path)[-1].state.startswith("the time limit")
    second = ClosedForm(noise=0.01)
    run_study(tmp_path, ROWS, engine=second, time_limit=600.0)
    assert_same(tables(tmp_path), tables(undisturbed))
    assert not kept & set(second.calls)


def test_a_limit_too_short_for_any_run_starts_none(tmp_path):
    engine = ClosedForm(seconds=5.0)
    with pytest.raises(OutOfTime):
        run_study(tmp_path, ROWS, engine=engine, time_limit=1.0)
    assert engine.calls.total() == 0


def test_runs_that_take_longer_than_the_limit_are_ended_at_the_limit(tmp_path):
    class Slow(ClosedForm):
        expected_seconds = 0.1

    engine = Slow(seconds=60.0)
    with pytest.raises(OutOfTime, match="before all DEM runs under way had ended"):
        run_study(tmp_path, ROWS, engine=engine, time_limit=0.5)
    assert engine.calls.total() == 2 and on_disk(tmp_path) == set()
