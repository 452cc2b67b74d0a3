import multiprocessing
import random
import signal
import threading
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calstudy.engine import Stopped
from calstudy.errors import SetupError
from calstudy.modes import MODES
from calstudy.progress import duration
from calstudy.records import Outcome, Phase
from calstudy.sampling import latin_hypercube
from calstudy.schema import TABLES, VARYING
from calstudy.store import Store, finished_rows, read_table
from closed_form import (
    PAPER,
    ClosedForm,
    run_study,
    run_study_slowly,
    study_settings,
    wait_for,
)

ROWS = (1, 53)
SMALL_PAPER = replace(PAPER, second_optimisation=replace(PAPER.second_optimisation, budget=20))


def tables(directory):
    """Tables of a study without the columns that may differ between equal studies."""
    return {name: read_table(directory, name).drop(columns=list(VARYING), errors="ignore") for name in TABLES}


def assert_same(found, expected):
    for name in TABLES:
        pd.testing.assert_frame_equal(found[name], expected[name], check_exact=True)


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


def test_the_order_of_the_rows_changes_nothing(undisturbed, tmp_path):
    for row in reversed(ROWS):
        run_study(tmp_path, (row,), engine=ClosedForm(noise=0.01))
    assert_same(tables(tmp_path), tables(undisturbed))


def test_another_seed_gives_other_tables(undisturbed, tmp_path):
    run_study(tmp_path, ROWS, engine=ClosedForm(noise=0.01), seed=8)
    with pytest.raises(AssertionError):
        assert_same(tables(tmp_path), tables(undisturbed))


def test_every_run_is_stored_once_and_counted(undisturbed):
    evaluations, calibrations = (read_table(undisturbed, name) for name in ("evaluations", "calibrations"))
    assert not evaluations.duplicated(["row", "phase", "index"]).any()
    for line in calibrations.to_dict("records"):
        runs = evaluations[evaluations["row"] == line["row"]]
        counted = {phase: line[f"runs_{phase}"] for phase in Phase}
        assert counted == {phase: int((runs["phase"] == phase).sum()) for phase in Phase}
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


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (59.4, "59 s"), (61, "1 min 01 s"), (3599.6, "1 h 00 min"), (7260, "2 h 01 min")],
)
def test_durations_are_said_in_two_units(seconds, words):
    assert duration(seconds) == words


def test_robust_mode_gives_the_same_tables_with_any_number_of_workers(tmp_path):
    quick = replace(MODES["robust"], design=lambda n, d, rng: latin_hypercube(n, d, rng))
    for workers in (1, 4):
        run_study(
            tmp_path / str(workers), (1, 31), mode=quick, engine=ClosedForm(noise=0.01), workers=workers
        )
    assert_same(tables(tmp_path / "4"), tables(tmp_path / "1"))


# ---- killed --------------------------------------------------------------------------------------


def test_a_study_killed_at_random_instants_ends_with_the_tables_of_an_undisturbed_one(tmp_path):
    whole, killed, log = tmp_path / "whole", tmp_path / "killed", tmp_path / "calls"
    run_study(whole, ROWS)
    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload(["calstudy.campaign", "calstudy.calibration"])
    instants = random.Random(4)
    kept, kills = set(), 0
    log.touch()
    while True:
        called = len(log.read_text().split())
        process = forks.Process(target=run_study_slowly, args=(killed, ROWS, 0.02, log))
        process.start()
        if kills < 10:
            # From the moment that it computes: most kills would otherwise meet a program that still starts.
            wait_for(lambda: len(log.read_text().split()) > called or not process.is_alive())  # noqa: B023
            process.join(instants.uniform(0.0, 0.1))
            process.kill()
        process.join()
        new = log.read_text().split()[called:]
        assert not kept & set(new), "a run that was durable has been run again"
        if process.exitcode == 0:
            break
        assert process.exitcode == -signal.SIGKILL
        kills += 1
        process.close()
        kept = on_disk(killed)
    assert kills >= 5
    assert_same(tables(killed), tables(whole))
    assert list((killed / "journal").iterdir()) == []
