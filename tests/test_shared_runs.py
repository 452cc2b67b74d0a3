import threading
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from calstudy.calibration.sampling import latin_hypercube
from calstudy.errors import Stopped, StoreError
from calstudy.records import Outcome, Phase
from calstudy.study.directory.store import read_table
from campaigns import SMALL_PAPER, interrupt_after, on_disk
from closed_form import (
    PLAN,
    ClosedForm,
    run_study,
)
from same_tables import assert_same, tables

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
