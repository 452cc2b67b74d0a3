import csv
import itertools
import threading

import numpy as np
import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.engines.queue import LocalExecutor
from calstudy.errors import InputError, SetupError, Stopped, StoreError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import REFERENCE
from calstudy.plan_file import load_plan
from calstudy.study.directory.lock import Lock
from calstudy.study.directory.store import write_table
from calstudy.study.sweep import DESIGN_COLUMNS, HEAPS, JOURNAL, RUNS, Line, read_design, sweep, write_design
from fake_liggghts import COMMAND

FIXED = load_plan().fixed
CHANGING = ["wall_time", "cpu_time", "host", "finished_at"]


@pytest.fixture(autouse=True)
def no_settings_from_outside(monkeypatch):
    for name in ("FAKE_LIGGGHTS", "FAKE_LIGGGHTS_SHARE", "FAKE_LIGGGHTS_SECONDS"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def program():
    return LIGGGHTS.find(COMMAND)


def lines(count=3, fidelity="tiny", label="here"):
    return [Line(label, fidelity, "ring", seed, REFERENCE) for seed in range(1, count + 1)]


def run(program, design, out, stop=None, keep_beads=False, heard=None, workers=2):
    def engine_of(fidelity, variant):
        return ProgramEngine(load_model(FIXED, fidelity, variant), program)

    def say(*words):
        if heard is not None:
            heard.append(words)

    executor = LocalExecutor(workers, stop or threading.Event())
    return sweep(design, engine_of, out, executor, say, keep_beads)


def same(one, other):
    pd.testing.assert_frame_equal(one.drop(columns=CHANGING), other.drop(columns=CHANGING))


def write(path, rows, header=DESIGN_COLUMNS):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(rows)
    return path


def test_every_line_of_the_design_is_a_line_of_the_table_in_its_order(program, tmp_path):
    design = [*lines(2, "coarse", "b"), *lines(3, "tiny", "a")]
    table = run(program, design, tmp_path / "out")
    assert list(table["label"]) == ["b", "b", "a", "a", "a"]
    assert list(table["seed"]) == [1, 2, 1, 2, 3]
    assert (table["outcome"] == "ok").all()
    same(pd.read_parquet(tmp_path / "out" / RUNS), table.reset_index(drop=True))
    assert not (tmp_path / "out" / JOURNAL).exists()


def test_progress_counts_up_and_the_time_left_down(program, tmp_path):
    heard = []
    run(program, lines(3), tmp_path / "out", heard=heard)
    assert [done for done, _, _ in heard] == [0, 1, 2, 3]
    assert {of for _, of, _ in heard} == {3}
    left = [seconds for _, _, seconds in heard]
    assert left == sorted(left, reverse=True)
    assert left[-1] == 0 < left[0] == 3 * load_model(FIXED, "tiny").expected_seconds


def test_a_grown_design_runs_only_what_is_new(program, tmp_path):
    run(program, lines(2), tmp_path / "out")
    heard = []
    table = run(program, lines(4), tmp_path / "out", heard=heard)
    assert [done for done, _, _ in heard] == [2, 3, 4]
    same(table.reset_index(drop=True), run(program, lines(4), tmp_path / "fresh").reset_index(drop=True))


def test_a_stopped_sweep_keeps_what_is_finished_and_goes_on(program, tmp_path, monkeypatch):
    stop = threading.Event()

    class StopAfterTwo(list):
        def append(self, words):
            if words[0] == 2:
                monkeypatch.setenv("FAKE_LIGGGHTS_SECONDS", "30")
                stop.set()

    with pytest.raises(Stopped, match="2 of 5 runs are in"):
        run(program, lines(5), tmp_path / "out", stop=stop, heard=StopAfterTwo(), workers=1)
    assert len(pd.read_parquet(tmp_path / "out" / RUNS)) == 2
    monkeypatch.delenv("FAKE_LIGGGHTS_SECONDS")
    table = run(program, lines(5), tmp_path / "out")
    same(table.reset_index(drop=True), run(program, lines(5), tmp_path / "fresh").reset_index(drop=True))


def test_what_is_said_costs_the_same_after_every_run(program, tmp_path, monkeypatch):
    asked = itertools.count()
    seconds = ProgramEngine.expected_seconds.fget
    monkeypatch.setattr(
        ProgramEngine, "expected_seconds", property(lambda engine: (next(asked), seconds(engine))[1])
    )
    heard = []
    run(program, lines(12), tmp_path / "out", heard=heard)
    assert len(heard) == 13
    # Once for each that is said, and once for each run's time limit; not once more for each run that is left.
    assert next(asked) == 13 + 12


def test_runs_that_ended_beside_the_one_that_ended_the_sweep_are_kept(program, tmp_path, monkeypatch):
    run_once = ProgramEngine.run

    def fail_once(engine, parameters, seed, *rest):
        if seed == 2:
            raise SetupError("the disk is full")
        return run_once(engine, parameters, seed, *rest)

    def worst_first(ended):
        return sorted((ended.get() for _ in range(4)), key=lambda job: job.exception() is None)

    monkeypatch.setattr(ProgramEngine, "run", fail_once)
    monkeypatch.setattr("calstudy.study.sweep._all_of", worst_first)
    with pytest.raises(SetupError, match="the disk is full"):
        run(program, lines(4), tmp_path / "out")
    assert list(pd.read_parquet(tmp_path / "out" / RUNS)["seed"]) == [1, 3, 4]


def test_what_a_dead_sweep_has_left_in_its_journal_is_taken(program, tmp_path, monkeypatch):
    done = run(program, lines(3), tmp_path / "whole", keep_beads=True)
    # Stop the tables from being written, as a kill would; the journal has all runs, the last one cut short.
    with monkeypatch.context() as patched:
        patched.setattr(
            "calstudy.study.sweep.write_table", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
        )
        with pytest.raises(KeyboardInterrupt):
            run(program, lines(3), tmp_path / "out", workers=1)
    journal = tmp_path / "out" / JOURNAL
    journal.write_bytes(journal.read_bytes()[:-50])
    heard = []
    table = run(program, lines(3), tmp_path / "out", heard=heard, keep_beads=True)
    assert [d for d, _, _ in heard] == [2, 3], "two of the three are there, the third is run again"
    same(table.reset_index(drop=True), done.reset_index(drop=True))
    one, other = (pd.read_parquet(tmp_path / n / HEAPS) for n in ("whole", "out"))
    order = ["run_id", "x", "y", "z"]
    pd.testing.assert_frame_equal(
        one.sort_values(order, ignore_index=True), other.sort_values(order, ignore_index=True)
    )


def test_a_failed_run_is_a_line_with_its_reason(program, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "error")
    table = run(program, lines(1), tmp_path / "out")
    assert table["outcome"].item() == "failed"
    assert "exit code 1" in table["reason"].item()
    assert np.isnan(table["bulk_density"].item())


def test_runs_of_another_version_of_the_model_are_refused(program, tmp_path):
    run(program, lines(1), tmp_path / "out")
    with pytest.raises(
        StoreError,
        match=r"holds 1 run\(s\) of another model .*: tiny fidelity, ring, version .*; choose another --out",
    ):
        run(program, lines(1, "coarse"), tmp_path / "out")


def test_a_run_that_is_asked_for_twice_is_refused(program, tmp_path):
    with pytest.raises(InputError, match="one DEM run twice"):
        run(program, [*lines(1), *lines(1)], tmp_path / "out")


GOOD = ["a", "tiny", "ring", 1, *REFERENCE.values()]


@pytest.mark.parametrize(
    ("rows", "header", "complaint"),
    [
        ([], DESIGN_COLUMNS, "holds no run"),
        ([GOOD], DESIGN_COLUMNS[1:], "the columns must be label,fidelity,variant,seed,DENS"),
        ([GOOD, GOOD[:-1]], DESIGN_COLUMNS, "line 3: has 9 cells; write 10"),
        ([[*GOOD[:4], "x", *GOOD[5:]]], DESIGN_COLUMNS, "line 2, DENS: 'x' is not a finite number"),
        ([[*GOOD, 1]], DESIGN_COLUMNS, "line 2: has 11 cells; write 10; decimals have a point"),
        (
            [[*GOOD[:3], -1, *GOOD[4:]]],
            DESIGN_COLUMNS,
            "line 2, seed: it is -1; give 0 to 9223372036854775807",
        ),
        (
            [[*GOOD[:3], 2**63, *GOOD[4:]]],
            DESIGN_COLUMNS,
            "line 2, seed: it is 9223372036854775808; give 0 to",
        ),
        ([[*GOOD[:4], 2.5, *GOOD[5:]]], DESIGN_COLUMNS, "line 2: DENS is 2.5 kg/m3, outside the plausible"),
        ([[*GOOD[:4], "2_500", *GOOD[5:]]], DESIGN_COLUMNS, "line 2, DENS: '2_500' is not a finite number"),
        (
            [[*GOOD[:5], "0,2", *GOOD[6:]]],
            DESIGN_COLUMNS,
            "line 2, MU_PP: '0,2' has a decimal comma; write 0.2",
        ),
    ],
)
def test_a_design_that_cannot_be_run_is_refused_with_its_line(tmp_path, rows, header, complaint):
    with pytest.raises(InputError, match=complaint):
        read_design(write(tmp_path / "design.csv", rows, header))


def test_a_design_as_a_spreadsheet_writes_it_is_read(tmp_path):
    write_design(tmp_path / "plain.csv", lines(2))
    text = (tmp_path / "plain.csv").read_text()
    (tmp_path / "sheet.csv").write_text(text.replace("\n", "\r\n"), encoding="utf-8-sig", newline="")
    assert read_design(tmp_path / "sheet.csv") == read_design(tmp_path / "plain.csv")
    (tmp_path / "other.csv").write_text(text.replace(",", ";"))
    with pytest.raises(InputError, match="has semicolons between them: write commas"):
        read_design(tmp_path / "other.csv")


def test_physics_and_names_are_checked_before_anything_is_run(program, tmp_path):
    wrong = Line("a", "tiny", "ring", 1, {**REFERENCE, "MU_PP": -1.0})
    with pytest.raises(InputError, match="MU_PP is -1"):
        run(program, [*lines(1), wrong], tmp_path / "out")
    with pytest.raises(InputError, match="variant 'round' is unknown"):
        run(program, [Line("a", "tiny", "round", 1, REFERENCE)], tmp_path / "out")
    with pytest.raises(InputError, match="MU_PP is nan"):
        run(program, [Line("a", "tiny", "ring", 1, {**REFERENCE, "MU_PP": float("nan")})], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_runs_a_design(tmp_path, capsys):
    design = write(tmp_path / "design.csv", [GOOD])
    assert main(["sweep", str(design), "--out", str(tmp_path / "out"), "--liggghts", COMMAND]) == 0
    said = capsys.readouterr()
    assert "1 runs, 0 not ok" in said.out
    assert "1 of 1 runs" in said.err


def test_journalled_runs_that_the_design_no_longer_has_are_kept(program, tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(
            "calstudy.study.sweep.write_table", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
        )
        with pytest.raises(KeyboardInterrupt):
            run(program, lines(3), tmp_path / "out")
    assert len(run(program, lines(1), tmp_path / "out")) == 1
    heard = []
    run(program, lines(3), tmp_path / "out", heard=heard)
    assert [done for done, _, _ in heard] == [3], "nothing is run again"
    assert not (tmp_path / "out" / JOURNAL).exists()


def failing_at(number, error):
    """In the place of `write_table`, ends in that call."""
    calls = itertools.count(1)

    def write_or_fail(*arguments):
        if next(calls) == number:
            raise error
        write_table(*arguments)

    return write_or_fail


def no_bead_twice(out):
    return not pd.read_parquet(out / HEAPS).duplicated().any()


def test_a_sweep_that_ends_between_its_tables_has_every_run_and_bead_once(program, tmp_path, monkeypatch):
    whole = run(program, lines(3), tmp_path / "whole", keep_beads=True)
    with monkeypatch.context() as patched:
        patched.setattr("calstudy.study.sweep.write_table", failing_at(2, SetupError("the disk is full")))
        with pytest.raises(SetupError, match="the disk is full"):
            run(program, lines(3), tmp_path / "out", keep_beads=True)
    heard = []
    table = run(program, lines(3), tmp_path / "out", keep_beads=True, heard=heard)
    assert [done for done, _, _ in heard] == [3]
    same(table, whole)
    assert no_bead_twice(tmp_path / "out")
    beads = [len(pd.read_parquet(tmp_path / name / HEAPS)) for name in ("whole", "out")]
    assert beads[0] == beads[1] > 0


def test_a_sweep_that_ends_before_its_journal_goes_has_every_run_and_bead_once(
    program, tmp_path, monkeypatch
):
    with monkeypatch.context() as patched:
        patched.setattr("calstudy.study.sweep._drop", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run(program, lines(2), tmp_path / "out", keep_beads=True)
    beads = len(pd.read_parquet(tmp_path / "out" / HEAPS))
    assert list(run(program, lines(2), tmp_path / "out", keep_beads=True)["seed"]) == [1, 2]
    assert len(pd.read_parquet(tmp_path / "out" / HEAPS)) == beads and no_bead_twice(tmp_path / "out")


def test_beads_are_those_of_the_runs_in_the_table(program, tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr("calstudy.study.sweep.write_table", failing_at(1, KeyboardInterrupt()))
        with pytest.raises(KeyboardInterrupt):
            run(program, lines(3), tmp_path / "out")
    for count in (1, 3):
        table = run(program, lines(count), tmp_path / "out", keep_beads=True)
        assert set(pd.read_parquet(tmp_path / "out" / HEAPS)["run_id"]) == set(table["run_id"])
    assert no_bead_twice(tmp_path / "out")


def test_a_sweep_that_was_taken_over_leaves_everything_to_the_other(program, tmp_path, monkeypatch):
    locks = []

    class Watched(Lock):
        def __init__(self, directory):
            super().__init__(directory)
            locks.append(self)

    class TakenOver(list):
        def append(self, words):
            if words[0] == 1:
                locks[0].lost.set()

    monkeypatch.setattr("calstudy.study.sweep.Lock", Watched)
    with pytest.raises(StoreError, match="taken over by another session"):
        run(program, lines(3), tmp_path / "out", heard=TakenOver(), workers=1)
    assert not (tmp_path / "out" / RUNS).exists()
    assert len((tmp_path / "out" / JOURNAL).read_bytes().splitlines()) == 1


def test_a_directory_that_cannot_be_used_is_said(program, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SetupError, match="choose another --out directory"):
        run(program, lines(1), tmp_path / "file" / "out")
