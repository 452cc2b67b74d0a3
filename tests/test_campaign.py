import hashlib
import json
import shutil
import threading
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.calibration.modes import MODES
from calstudy.calibration.sampling import latin_hypercube
from calstudy.engines.queue import LocalExecutor, Queue
from calstudy.errors import OutOfTime, SetupError, Stopped, StoreError
from calstudy.models.heap import PROPORTIONAL, RESPONSES
from calstudy.plan import PARAMETERS
from calstudy.records import OF_EVERY_CALIBRATION, Outcome, Phase
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign
from calstudy.study.directory.session import duration, read_sessions
from calstudy.study.directory.store import Store, finished_rows, read_table
from calstudy.study.schema import TABLES
from closed_form import (
    PAPER,
    PLAN,
    ROBUST,
    ClosedForm,
    chaotic_responses,
    other_last_digits,
    run_study,
    study_settings,
    task_of,
    wait_for,
)
from same_tables import assert_same, tables

ROWS = (1, 53)
QUICK_ROBUST = replace(
    MODES["robust"].knowing(PROPORTIONAL), design=lambda n, d, rng: latin_hypercube(n, d, rng)
)
SMALL_PAPER = replace(PAPER, second_optimisation=replace(PAPER.second_optimisation, budget=20))


def on_disk(directory, rows=ROWS):
    """Identities of all runs that are durable."""
    ids = set(read_table(directory, "evaluations")["run_id"])
    for row in rows:
        ids |= {evaluation.run_id for evaluation in Store(directory, study_settings()).journal(row)}
    return ids


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    directory = tmp_path_factory.mktemp("studies") / "study"
    run_study(directory, ROWS, engine=ClosedForm(noise=0.01), workers=1)
    return directory


# ---- the same answer, however it was run ---------------------------------------------------------


@pytest.mark.parametrize("workers", [4])
def test_any_number_of_workers_gives_the_same_tables(undisturbed, tmp_path, workers):
    run_study(tmp_path, ROWS, engine=ClosedForm(noise=0.01), workers=workers)
    assert_same(tables(tmp_path), tables(undisturbed))


def test_a_study_from_before_goes_on(undisturbed):
    """Identities that calstudy gave before models other than the plan's could be calibrated."""
    assert replace(study_settings(), model="closed_form").id == "f654fd96a0f4"
    assert replace(study_settings(share_samples=True), model="closed_form").id == "89bed6d983cb"
    runs = read_table(undisturbed, "evaluations")
    sampled = runs[runs["phase"] == "sampling"]  # what follows has the last digits of the processor
    assert (len(sampled), sampled["seed"].iloc[0]) == (15, 1041839917)
    assert hashlib.sha256(" ".join(sampled["run_id"]).encode()).hexdigest()[:16] == "e15d32e551885131"
    assert "case" not in json.loads((undisturbed / "study.json").read_text())


def test_the_order_of_the_rows_changes_nothing(undisturbed, tmp_path):
    for row in reversed(ROWS):
        run_study(tmp_path, (row,), engine=ClosedForm(noise=0.01))
    assert_same(tables(tmp_path), tables(undisturbed))


@pytest.mark.parametrize("rows", [ROWS, ROWS[::-1]])
def test_runs_of_earlier_rows_go_first(tmp_path, monkeypatch, rows):
    asked, submit = [], Queue.submit

    def counted(self, job, rank=0):
        asked.append(rank)
        return submit(self, job, rank)

    monkeypatch.setattr(Queue, "submit", counted)
    samples = sum(PLAN.row(row).samples for row in rows)
    engine = ClosedForm(on_call=lambda number: number or wait_for(lambda: len(asked) >= samples))
    run_study(tmp_path, rows, engine=engine, workers=1)
    runs = read_table(tmp_path, "evaluations")
    sampled = runs[runs["phase"] == "sampling"].groupby("row")["run_id"].agg(set)
    first, *others = list(engine.calls)[:samples]
    began = sampled[rows[0]] - {first}
    assert began == set(others[: len(began)])


def test_another_seed_gives_other_tables(undisturbed, tmp_path):
    run_study(tmp_path, ROWS, engine=ClosedForm(noise=0.01), seed=8)
    with pytest.raises(AssertionError):
        assert_same(tables(tmp_path), tables(undisturbed))


def test_every_run_is_stored_once_and_counted(undisturbed):
    evaluations, calibrations = (read_table(undisturbed, name) for name in ("evaluations", "calibrations"))
    assert not evaluations.duplicated(["row", "phase", "index"]).any()
    for line in calibrations.to_dict("records"):
        runs = evaluations[evaluations["row"] == line["row"]]
        counted = {phase: line[f"runs_{phase}"] for phase in OF_EVERY_CALIBRATION}
        assert counted == {phase: int((runs["phase"] == phase).sum()) for phase in OF_EVERY_CALIBRATION}
        assert line["runs_total"] == len(runs)
        assert line["runs_optimisation"] == len(runs) - counted[Phase.SAMPLING]
        assert line["dem_run_id"] in set(runs["run_id"])


def test_the_stored_heap_is_that_of_the_dem_optimum(undisturbed):
    calibrations, heaps = (read_table(undisturbed, name) for name in ("calibrations", "heaps"))
    for line in calibrations.to_dict("records"):
        heap = heaps[heaps["row"] == line["row"]]
        assert set(heap["run_id"]) == {line["dem_run_id"]} and len(heap) == 40


# ---- interrupted and resumed ---------------------------------------------------------------------


def interrupt_after(calls, stop):
    return lambda number: stop.set() if number == calls else None


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


# ---- equal runs ----------------------------------------------------------------------------------


TWINS = (1, 31)
"""Two rows that differ in WRL alone."""


def one_design(n, d, _):
    """The same Latin hypercube for every row."""
    return latin_hypercube(n, d, np.random.default_rng(3))


SHARING = replace(SMALL_PAPER, design=one_design)


@pytest.mark.parametrize("workers", [1, 4])
def test_a_run_that_two_rows_ask_for_is_run_once_and_stored_for_both(tmp_path, workers):
    engine = ClosedForm(seconds=0.002)
    campaign, _ = run_study(tmp_path, TWINS, engine=engine, mode=SHARING, workers=workers)
    assert max(engine.calls.values()) == 1
    evaluations = read_table(tmp_path, "evaluations")
    sampled = evaluations[evaluations["phase"] == Phase.SAMPLING].set_index("row")["run_id"]
    assert sampled[1].tolist() == sampled[31].tolist() and len(sampled) == 12
    assert campaign.progress.runs_reused >= 6
    assert campaign.progress.runs_reused + campaign.progress.runs_done == len(evaluations)


def test_rows_with_designs_of_their_own_share_no_sample(tmp_path):
    engine = ClosedForm()
    campaign, _ = run_study(tmp_path, TWINS, engine=engine, mode=SMALL_PAPER)
    assert campaign.progress.runs_reused == 0
    assert engine.calls.total() == len(read_table(tmp_path, "evaluations"))


@pytest.mark.parametrize("calls", [3, 10])
def test_rows_that_share_runs_survive_an_interruption(tmp_path, calls):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    run_study(whole, TWINS, mode=SHARING)
    stop = threading.Event()
    with pytest.raises(Stopped):
        engine = ClosedForm(on_call=interrupt_after(calls, stop), seconds=0.001)
        run_study(broken, TWINS, engine=engine, mode=SHARING, stop=stop)
    kept = on_disk(broken, TWINS)
    again = ClosedForm()
    run_study(broken, TWINS, engine=again, mode=SHARING)
    assert_same(tables(broken), tables(whole))
    assert not kept & set(again.calls) and max(again.calls.values()) == 1


def test_a_start_that_is_a_sample_keeps_its_heap_over_an_interruption(tmp_path):
    # With one seed, the best sample is the same DEM run when the second optimisation starts there.
    run_study(tmp_path / "plain", (1,))
    evaluations = read_table(tmp_path / "plain", "evaluations")
    samples = evaluations[evaluations["phase"] == Phase.SAMPLING]
    sampled = set(zip(samples["DENS"], samples["RF_PP"], strict=True))

    def fails(_, parameters):
        return None if (parameters["DENS"], parameters["RF_PP"]) in sampled else Outcome.FAILED

    run_study(tmp_path / "whole", (1,), engine=ClosedForm(fails=fails))
    expected = tables(tmp_path / "whole")
    assert set(expected["heaps"]["run_id"]) <= set(expected["evaluations"]["run_id"][:6])
    assert len(expected["heaps"]) == 40
    stop = threading.Event()
    with pytest.raises(Stopped):
        engine = ClosedForm(fails=fails, on_call=interrupt_after(5, stop))
        run_study(tmp_path / "broken", (1,), engine=engine, workers=1, stop=stop)
    run_study(tmp_path / "broken", (1,), engine=ClosedForm(fails=fails))
    assert_same(tables(tmp_path / "broken"), expected)


def test_runs_of_finished_rows_serve_later_commands(tmp_path):
    run_study(tmp_path / "whole", TWINS, mode=SHARING)
    for row in TWINS:
        engine = ClosedForm()
        run_study(tmp_path / "apart", (row,), mode=SHARING, engine=engine)
    runs = read_table(tmp_path / "apart", "evaluations").set_index("row")["run_id"]
    earlier, later = (set(runs[row]) for row in TWINS)
    assert set(engine.calls) == later - earlier and len(later & earlier) >= 6
    assert_same(tables(tmp_path / "apart"), tables(tmp_path / "whole"))


def test_journals_go_when_no_row_is_left_that_could_ask_for_their_runs(tmp_path):
    plan = replace(PLAN, rows=tuple(PLAN.row(row) for row in TWINS))
    run_study(tmp_path, TWINS[:1], plan=plan)
    assert [path.name for path in (tmp_path / "journal").iterdir()] == ["row-01.jsonl"]
    run_study(tmp_path, TWINS, plan=plan)
    assert list((tmp_path / "journal").iterdir()) == []
    engine = ClosedForm()
    run_study(tmp_path, TWINS, plan=plan, engine=engine)
    assert engine.calls.total() == 0


def test_the_paper_s_plan_has_1152_shared_samples_of_1728():
    groups = {PLAN.sampled_as(row.run): row.samples for row in PLAN.rows}
    assert (sum(groups.values()), PLAN.total_samples) == (1152, 1728)
    for row in PLAN.rows:
        alike = PLAN.row(PLAN.sampled_as(row.run))
        assert replace(row, run=alike.run, WRL=alike.WRL) == alike and alike.run <= row.run


@pytest.mark.parametrize("workers", [1, 4])
def test_shared_samples_are_run_once_whatever_the_order(tmp_path, workers):
    mode = replace(SMALL_PAPER, one_seed=False)
    for name, orders in {"at once": [TWINS], "apart": [TWINS[1:], TWINS[:1]]}.items():
        calls = Counter()
        for rows in orders:
            engine = ClosedForm(noise=0.01)
            run_study(tmp_path / name, rows, mode=mode, engine=engine, workers=workers, share_samples=True)
            calls += engine.calls
        assert max(calls.values()) == 1
    sampled = read_table(tmp_path / "apart", "evaluations").query("phase == 'sampling'").set_index("row")
    assert sampled["run_id"][1].tolist() == sampled["run_id"][31].tolist()
    assert_same(tables(tmp_path / "apart"), tables(tmp_path / "at once"))


def test_shared_samples_are_another_study(tmp_path):
    run_study(tmp_path, (1,))
    with pytest.raises(StoreError, match="whether rows share samples: no → yes"):
        run_study(tmp_path, (1,), share_samples=True)


# ---- a finished row that is damaged ----------------------------------------------------------------


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


# ---- out of time -----------------------------------------------------------------------------------


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


# ---- failures ------------------------------------------------------------------------------------


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


# ---- what it leaves and says ---------------------------------------------------------------------


def test_scratch_is_emptied_after_usable_runs_and_kept_for_failed_ones(tmp_path):
    engine = ClosedForm(writes=True, fails=lambda n, _: Outcome.FAILED if n in (1, 4) else None)
    run_study(tmp_path, (1,), engine=engine, workers=1)
    evaluations = read_table(tmp_path, "evaluations")
    failed = set(evaluations["run_id"][evaluations["outcome"] == "failed"])
    assert len(failed) == 2
    assert {path.name for path in (tmp_path / "runs").iterdir()} == failed


def test_what_a_killed_session_left_in_the_scratch_is_removed_and_nothing_else(tmp_path):
    scratch = tmp_path / "shared"
    with Store(tmp_path / "study", study_settings()) as store:
        killed = store.lock.session
    (tmp_path / "study" / "sessions.jsonl").write_bytes(replace(killed, state="killed").line)
    dead, others = f"0123456789abcdef.{killed.token}.0f", "0123456789abcdef.aaaaaaaaaaaa.0f"
    for name in (dead, others, "fedcba9876543210", "my.own.notes"):
        (scratch / name).mkdir(parents=True)
    run_study(tmp_path / "study", (1,), engine=ClosedForm(writes=True), scratch=scratch)
    assert {path.name for path in scratch.iterdir()} == {others, "fedcba9876543210", "my.own.notes"}


def test_all_runs_are_kept_on_request(tmp_path):
    run_study(tmp_path, (1,), engine=ClosedForm(writes=True), keep_runs=True)
    kept = {path.name for path in (tmp_path / "runs").iterdir()}
    assert kept == set(read_table(tmp_path, "evaluations")["run_id"])


def test_progress_ends_complete(tmp_path):
    campaign, _ = run_study(tmp_path, ROWS)
    progress = campaign.progress
    assert (progress.rows_done, progress.rows) == (2, 2) and campaign.queue.idle
    asked = progress.runs_done + progress.runs_reused
    assert asked == len(read_table(tmp_path, "evaluations")) == progress.expected_runs
    did = campaign.activity()
    assert (did.runs_left, did.runs_running, did.runs_waiting, did.seconds_left) == (0, 0, 0, 0.0)


def test_the_time_left_counts_cheap_runs_as_what_they_take_of_an_expensive_one(tmp_path):
    # 16 cheap samples, then 3 expensive runs and 5 cheap ones one by one, then 4 that confirm.
    task = replace(task_of(5, ROBUST), samples=16, cheap=Cheap(0.05, is_measured=False), confirm=4)
    tests, left = [MaterialTest(ClosedForm(), PARAMETERS)], {}
    settings = study_settings(mode="robust", cheap={"cheap": {}}, confirm=4)
    with Store(tmp_path, settings) as store:
        executor = LocalExecutor(1, threading.Event())
        campaign = Campaign({5: task}, tests, store, executor, scratch=tmp_path / "runs", cheap=tests)
        campaign.answers.ended = lambda e: left.setdefault(e.request.phase, campaign._weight_left(1)[1])
        campaign.run([5])
    assert left[Phase.CHEAP] == pytest.approx(7 + 0.05 * (16 + 5))
    assert left[Phase.START] == pytest.approx(7 + 0.05 * 5)
    assert left[Phase.CONFIRMATION] < 7


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (59.4, "59 s"), (61, "1 min 01 s"), (3599.6, "1 h 00 min"), (7260, "2 h 01 min")],
)
def test_durations_are_said_in_two_units(seconds, words):
    assert duration(seconds) == words


def test_robust_mode_gives_the_same_tables_with_any_number_of_workers(tmp_path):
    for workers in (1, 4):
        run_study(
            tmp_path / str(workers),
            (1, 31),
            mode=QUICK_ROBUST,
            engine=ClosedForm(noise=0.01),
            workers=workers,
        )
    assert_same(tables(tmp_path / "4"), tables(tmp_path / "1"))
