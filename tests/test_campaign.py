import hashlib
import json
import threading
from dataclasses import replace

import pytest

from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.engines.queue import LocalExecutor, Queue
from calstudy.errors import SetupError
from calstudy.plan import PARAMETERS
from calstudy.records import OF_EVERY_CALIBRATION, Outcome, Phase
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign
from calstudy.study.directory.session import duration
from calstudy.study.directory.store import Store, read_table
from campaigns import QUICK_ROBUST, ROWS
from closed_form import (
    PLAN,
    ROBUST,
    ClosedForm,
    run_study,
    study_settings,
    task_of,
    wait_for,
)
from same_tables import assert_same, tables


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


def test_no_run_begins_after_one_that_could_not_be_stored(tmp_path, monkeypatch):
    """The disk is full and stays so: each further run would be lost, too."""
    record, stored, engine = Store.record, [], ClosedForm()

    def full(store, evaluation):
        if len(stored) == 3:
            raise SetupError("the disk is full")
        stored.append(evaluation)
        record(store, evaluation)

    monkeypatch.setattr(Store, "record", full)
    with pytest.raises(SetupError, match="the disk is full"):
        run_study(tmp_path, (1, 5), engine=engine, workers=1)
    assert engine.calls.total() == len(stored) + 1
