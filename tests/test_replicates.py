"""A study repeated on an emulator: what a replicate is, and that nothing about its making shows in it."""

import shutil
import threading
from multiprocessing import resource_tracker

import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from calstudy.calibration.modes import mode_of
from calstudy.calibration.task import tasks_of
from calstudy.cli.main import main
from calstudy.cli.options.choices import parse_target
from calstudy.emulator.design import Choice, emulator_design
from calstudy.emulator.emulator import fit_emulator, write_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.emulator.replicates import Replicates, Replication, read_replicate
from calstudy.engines.queue import LocalExecutor
from calstudy.errors import MISSED, OutOfTime, SetupError, Stopped, StoreError
from calstudy.models.angle_of_repose import load_model
from calstudy.plan import PARAMETERS
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign
from calstudy.study.directory.store import Store, finished_replicates, write_table
from calstudy.study.schema import MEANINGS, schema_of
from calstudy.study.settings import StudySettings
from closed_form import wait_for
from shipped_model import REPLICATED, SIMILARITY
from synthetic_runs import CHEAP, EXPENSIVE, PLAN, synthetic_runs

pytestmark = pytest.mark.slow

DESIGN = emulator_design(PLAN.parameters, Choice(CHEAP, EXPENSIVE, "ring", 1), 80, SIMILARITY)
MODEL = load_model(PLAN.fixed, EXPENSIVE)
MODE = mode_of("paper", 8)
ROWS = (1, 2)
SEED = 20


@pytest.fixture(scope="module")
def emulator():
    with threadpool_limits(1):
        return fit_emulator(synthetic_runs(DESIGN), PLAN.parameters, SIMILARITY)


@pytest.fixture(scope="module")
def of(emulator):
    settings = StudySettings(
        plan=PLAN.name,
        plan_hash=PLAN.hash,
        model=MODEL.name,
        deck=MODEL.deck,
        model_hash=MODEL.hash,
        fidelity=EXPENSIVE,
        variant="ring",
        engine=EmulatorEngine(MODEL, emulator).identity,
        calstudy="test",
        mode="paper",
        budget=8,
        seed=SEED,
        target=parse_target("paper", PLAN, MODEL, ""),
        grid=MODE.grid,
    )
    return Replication(settings, PLAN, ROWS, MODE, MODEL, emulator)


def run(of, directory, count, stop=None, workers=2, **options):
    with Store(directory, of.settings) as store:
        replicates = Replicates(of, count, store, workers=workers, **options)
        replicates.run(stop or threading.Event())
        return replicates, store.notes


@pytest.fixture(scope="module")
def three(of, tmp_path_factory):
    directory = tmp_path_factory.mktemp("three") / "study"
    replicates, _ = run(of, directory, 3)
    assert replicates.in_words() == "3 of 3 replicates finished"
    return directory


def contents(directory):
    return {
        path.relative_to(directory): path.read_bytes()
        for name in REPLICATED
        for path in sorted((directory / name).iterdir())
    }


# ---- what a replicate is -------------------------------------------------------------------------------


def test_a_replicate_is_the_study_of_its_seed_on_its_own_draw(of, emulator, three, tmp_path):
    number = 2
    engine = EmulatorEngine(MODEL, emulator, draw=SEED + number, rounded=True)
    stop = threading.Event()
    with Store(tmp_path / "study", of.settings) as store:
        tasks = tasks_of(PLAN, of.settings.target, MODE, SEED + number)
        tests, executor = [MaterialTest(engine, PARAMETERS)], LocalExecutor(2, stop)
        Campaign(tasks, tests, store, executor, scratch=tmp_path, stop=stop).run(ROWS)
    tables = read_replicate(three, of.settings, number)
    for mine, name in (("calibrations", "replicates"), ("evaluations", "replicate_runs")):
        there = pd.read_parquet(tmp_path / "study" / mine).sort_values(["row"], kind="stable")
        found = tables[name]
        if name == "replicate_runs":
            there, found = (t.sort_values(["row", "phase", "index"]) for t in (there, found))
        same = [c.name for c in REPLICATED[name] if c.name not in ("engine", "replicate", "seed")]
        pd.testing.assert_frame_equal(
            found[same].reset_index(drop=True), there[same].reset_index(drop=True), check_dtype=False
        )


def test_replicates_differ_in_samples_noise_and_draw(of, emulator, three):
    runs = pd.concat(read_replicate(three, of.settings, r)["replicate_runs"] for r in (1, 2, 3))
    assert sorted(runs["seed"].unique()) == [SEED + 1, SEED + 2, SEED + 3]
    assert set(runs["engine"]) == {f"emulator {emulator.version}, draw {SEED + r}" for r in (1, 2, 3)}
    first = runs[(runs["row"] == 1) & (runs["phase"] == "sampling") & (runs["index"] == 0)]
    assert first["DENS"].nunique() == 3


def test_every_line_belongs_to_the_study_and_every_column_is_filled(of, three):
    for name, columns in REPLICATED.items():
        frame = pd.read_parquet(three / name)
        assert list(frame) == [column.name for column in columns]
        assert set(frame["study"]) == {of.settings.id}
        # No calibration failed, no hyperparameter need end at a bound; a column of texts may be empty.
        assert [c for c in frame if frame[c].isna().all()] == []
        assert MEANINGS[name] and all(
            bool(c.unit) == (str(c.type) not in ("string", "bool")) for c in columns
        )


# ---- nothing about its making shows in it --------------------------------------------------------------


def test_workers_and_order_change_nothing(of, three, tmp_path):
    run(of, tmp_path / "alone", 2, workers=1)
    run(of, tmp_path / "alone", 3, workers=1)  # goes on
    assert contents(tmp_path / "alone") == contents(three)


def test_an_interruption_leaves_whole_replicates_and_changes_nothing(of, three, tmp_path):
    directory, stop = tmp_path / "study", threading.Event()

    def interrupt():
        wait_for(lambda: finished_replicates(directory), 60)
        stop.set()

    threading.Thread(target=interrupt).start()
    with pytest.raises(Stopped):
        run(of, directory, 40, stop, workers=1)
    done = finished_replicates(directory)
    assert done and len(done) < 40
    for number in done:
        read_replicate(directory, of.settings, number)
    run(of, directory, 3)
    found = contents(directory)
    assert {path: found[path] for path in contents(three)} == contents(three)


def test_at_the_time_limit_it_ends(of, tmp_path):
    with pytest.raises(OutOfTime):
        run(of, tmp_path / "study", 40, deadline=0.0)


def test_a_damaged_replicate_is_made_again_and_said(of, three, tmp_path):
    directory = shutil.copytree(three, tmp_path / "study")
    path = directory / "replicate_runs" / "r-002.parquet"
    path.write_bytes(path.read_bytes()[:-100])
    before = contents(three)
    _, notes = run(of, directory, 3)
    assert len(notes) == 1 and notes[0].startswith("replicate 2 is made again: ")
    assert contents(directory) == before


def test_replicates_of_other_rows_or_of_another_study_are_refused(of, three, tmp_path):
    directory = shutil.copytree(three, tmp_path / "study")
    others = Replication(of.settings, PLAN, (1, 2, 3), MODE, MODEL, of.emulator)
    with pytest.raises(StoreError, match=r"holds replicates of 2 row\(s\), 1 to 2, not of"):
        run(others, directory, 3)
    path = directory / "replicates" / "r-001.parquet"
    foreign = pd.read_parquet(path).assign(study="0" * 12)
    write_table(path, foreign, schema_of(REPLICATED["replicates"], "replicates"))
    with pytest.raises(StoreError, match=r"r-001\.parquet is not replicate 1 of the study"):
        read_replicate(directory, of.settings, 1)


def test_progress_says_what_is_left(of, three, tmp_path):
    with Store(tmp_path / "study", of.settings) as store:
        replicates = Replicates(of, 5, store, workers=2)
        begun = replicates.look()
        replicates.run(threading.Event())
        ended = replicates.look()
    assert begun.share == 0.0 and begun.words[0] == "0 of 5 replicates finished" and "left" in begun.words[-1]
    assert ended.share == 1.0 and "about 0 s left" in ended.words[-1]


# ---- the command ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(emulator, tmp_path_factory):
    directory = tmp_path_factory.mktemp("emulator")
    write_emulator(directory, emulator)
    return directory


def plan_run(made, study, *more):
    arguments = ["plan", "run", "--rows", "1,2", "--study", str(study), "--budget", "8"]
    return main([*arguments, "--engine", "emulator", "--emulator", str(made), *more])


def test_the_command_runs_the_study_and_then_its_replicates_and_goes_on(made, tmp_path, capsys):
    study = tmp_path / "study"
    assert plan_run(made, study, "--replicates", "1") in (0, MISSED)
    assert plan_run(made, study, "--replicates", "2") in (0, MISSED)
    said = capsys.readouterr()
    assert "2 of 2 replicates finished" in said.err and "calstudy analyse" in said.err
    assert "made again" not in said.err, "an emulator leaves no heaps, which is no damage"
    assert finished_replicates(study) == [1, 2]
    assert main(["plan", "status", "--study", str(study)]) == 0
    assert "replicates: 2 finished" in capsys.readouterr().out
    assert plan_run(made, study, "--replicates", "2", "--seed", "5") == 6


def test_replicates_of_the_full_factorial_hold_the_paper_s_rows_as_they_are(made, tmp_path, capsys):
    half, whole = tmp_path / "half", tmp_path / "whole"
    assert plan_run(made, half, "--replicates", "1") in (0, MISSED)
    # Of an option that is given twice, the last one counts.
    other = ("--plan", "full-factorial", "--rows", "1,2,73,121")
    assert plan_run(made, whole, "--replicates", "1", *other) in (0, MISSED)
    ours, theirs = (pd.read_parquet(d / "replicates" / "r-001.parquet") for d in (half, whole))
    assert list(theirs["row"]) == [1, 2, 73, 121]
    pd.testing.assert_frame_equal(ours.drop(columns="study"), theirs[:2].drop(columns="study"))
    words = ["analyse", str(whole), "--plan", "full-factorial", "--only", "half_fraction", "--format", "csv"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    table = pd.read_csv(tmp_path / "out" / "tables" / "half_fraction.csv")
    assert set(table["where"]) >= {"Table 3", "Table 4"}


def test_a_dry_run_counts_the_replicates(made, tmp_path, capsys):
    assert plan_run(made, tmp_path / "study", "--dry-run", "--replicates", "1000") == 0
    said = capsys.readouterr().out
    assert "2 row(s), and 1000 times as replicates, at coarse fidelity" in said
    assert "about 0.14 core-hours" in said


def test_replicates_need_an_emulator(tmp_path, capsys):
    arguments = ["plan", "run", "--replicates", "3", "--study", str(tmp_path / "study"), "--dry-run"]
    assert main(arguments) == 2
    assert "--replicates 3 is for --engine emulator" in capsys.readouterr().err


def test_processes_that_die_while_they_start_end_it_and_are_not_waited_for(of, tmp_path, monkeypatch):
    resource_tracker.ensure_running()  # which is started by the same program
    monkeypatch.setattr("multiprocessing.spawn._python_exe", b"/bin/false")
    ended = []

    def attempt():
        with pytest.raises(SetupError, match="ended from outside"):
            run(of, tmp_path / "study", 2)
        ended.append(True)

    trying = threading.Thread(target=attempt, daemon=True)
    trying.start()
    trying.join(60)
    assert ended == [True]
