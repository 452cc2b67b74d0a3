"""DEM runs on a real Dask cluster of several worker processes on this machine; LIGGGHTS is the stand-in."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import dask.config
import pytest
from distributed import Client, LocalCluster

from calstudy.cli import main as cli
from calstudy.engines.cluster import DaskExecutor, WorkersEngine
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.engines.program import Program
from calstudy.engines.queue import Job, Queue
from calstudy.errors import MISSED, SetupError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import REFERENCE
from calstudy.records import Outcome
from calstudy.study.directory.session import holder, read_sessions
from closed_form import PLAN, wait_for
from fake_liggghts import COMMAND, begun
from processes import at_work_in
from same_tables import assert_same, tables

pytestmark = pytest.mark.slow

PROGRAM = Program(LIGGGHTS, (), "3.8.0")
WORKERS = 3


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(
        n_workers=WORKERS, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
    ) as made:
        yield made


@pytest.fixture(scope="module")
def on_this_machine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    study = tmp_path_factory.mktemp("local") / "study"
    assert cli.main([*argv(study), "--liggghts", COMMAND, "--workers", "1"]) in (0, MISSED)
    return study


def argv(study: Path) -> list[str]:
    return f"plan run --rows 1,5 --fidelity tiny --budget 8 --study {study}".split()


def there(study: Path, cluster: LocalCluster, liggghts: str = COMMAND) -> list[str]:
    return [*argv(study), "--scheduler", cluster.scheduler_address, "--liggghts", liggghts]


def logging_to(log: Path, **more: str) -> str:
    """Command of a stand-in that tells which runs it was started for."""
    log.touch()
    settings = {"FAKE_LIGGGHTS_LOG": str(log), **more}
    return f"env {' '.join(f'{name}={value}' for name, value in settings.items())} {COMMAND}"


def test_a_study_on_a_cluster_has_the_tables_of_a_local_one(
    cluster: LocalCluster, on_this_machine: Path, tmp_path: Path
) -> None:
    log = tmp_path / "log"
    assert cli.main(there(tmp_path / "study", cluster, logging_to(log))) in (0, MISSED)
    assert_same(tables(tmp_path / "study"), tables(on_this_machine))
    assert max(Counter(begun(log)).values()) == 1 and len(begun(log)) == len(
        tables(on_this_machine)["evaluations"]
    )
    (session,) = read_sessions(tmp_path / "study")
    assert session.did.slots == WORKERS and session.did.runs_done == len(begun(log))
    assert list((tmp_path / "study" / "runs").iterdir()) == []


def test_a_study_goes_on_locally_where_a_cluster_left_it(
    cluster: LocalCluster, on_this_machine: Path, tmp_path: Path
) -> None:
    study, log = tmp_path / "study", tmp_path / "log"
    slow = logging_to(log, FAKE_LIGGGHTS_SECONDS="2")
    assert cli.main([*there(study, cluster, slow), "--time-limit", "15s"]) == 9
    kept = begun(log)
    assert kept
    assert cli.main([*argv(study), "--liggghts", logging_to(log)]) in (0, MISSED)
    assert not set(kept) & set(begun(log)[len(kept) :])
    assert_same(tables(study), tables(on_this_machine))


def test_workers_killed_in_mid_run_lose_nothing(
    cluster: LocalCluster, on_this_machine: Path, tmp_path: Path
) -> None:
    log, study = tmp_path / "log", tmp_path / "study"
    killed: list[int] = []

    def kill() -> None:
        with Client(cluster.scheduler_address, set_as_default=False) as client:
            for runs in (5, 20):
                wait_for(lambda: len(begun(log)) >= runs, 60)  # noqa: B023
                processes = list(client.run(os.getpid).values())
                os.kill(processes[0], signal.SIGKILL)
                killed.append(processes[0])
                client.wait_for_workers(WORKERS, timeout=60)

    killer = threading.Thread(target=kill)
    killer.start()
    assert cli.main(there(study, cluster, logging_to(log, FAKE_LIGGGHTS_SECONDS="0.4"))) in (0, MISSED)
    killer.join()
    assert len(killed) == 2
    assert_same(tables(study), tables(on_this_machine))
    repeated = [run for run, times in Counter(begun(log)).items() if times > 1]
    assert 0 < len(repeated) <= 2, "what a killed worker was at is run again, and nothing else"
    wait_for(lambda: at_work_in(study) == [])


def test_a_stop_ends_the_programs_on_the_workers(cluster: LocalCluster, tmp_path: Path) -> None:
    executor = DaskExecutor(cluster.scheduler_address)
    engine = WorkersEngine(load_model(PLAN.fixed, "tiny"), PROGRAM, f"env FAKE_LIGGGHTS=hang {COMMAND}")
    answers = [
        executor.submit(Job(engine, REFERENCE, seed, f"run{seed}", tmp_path / "runs", "session"))
        for seed in range(WORKERS)
    ]
    wait_for(lambda: len(list((tmp_path / "runs").glob("*/child.pid"))) == WORKERS, 60)
    executor.close()
    assert all(isinstance(answer.exception(1), Exception) for answer in answers)
    wait_for(lambda: at_work_in(tmp_path) == [])
    wait_for(lambda: list((tmp_path / "runs").iterdir()) == [])


def test_a_killed_command_leaves_no_program_on_the_workers(cluster: LocalCluster, tmp_path: Path) -> None:
    study = tmp_path / "study"
    words = [*there(study, cluster, f"env FAKE_LIGGGHTS=hang {COMMAND}")]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen([sys.executable, "-m", "calstudy", *words], **quiet)
    try:
        wait_for(lambda: len(list((study / "runs").glob("*/child.pid"))) == WORKERS, 90)
    finally:
        process.kill()
        process.wait()
    wait_for(lambda: at_work_in(study) == [], 60)
    session = holder(study)
    assert session is not None and session.ended_here


# ---- what a cluster may lack -------------------------------------------------------------------------


def refusal(capsys: pytest.CaptureFixture[str], words: list[str]) -> str:
    """The one line that a refused command prints."""
    capsys.readouterr()
    assert cli.main(words) == 3
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_workers_without_liggghts_give_one_clear_line(
    cluster: LocalCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = refusal(capsys, there(tmp_path / "study", cluster, "/nowhere/liggghts"))
    assert said.startswith("calstudy: worker tcp://127.0.0.1:")
    assert "LIGGGHTS was not found as '/nowhere/liggghts'" in said and "apt-get install liggghts" in said
    assert not (tmp_path / "study").exists()


def test_one_worker_of_another_version_is_named(
    cluster: LocalCluster, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The stand-in answers as another version to one of the workers alone.
    chosen = tmp_path / "chosen"
    script = f'mkdir "{chosen}" 2>/dev/null && export FAKE_LIGGGHTS=wrong_version; exec {COMMAND} "$@"'
    program = tmp_path / "liggghts"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    said = refusal(capsys, there(tmp_path / "study", cluster, str(program)))
    assert "different versions of LIGGGHTS" in said and "3.7.0 on tcp" in said and "3.8.0 on tcp" in said


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("/nowhere/liggghts", "LIGGGHTS was not found"),
        (f"env FAKE_LIGGGHTS=wrong_version {COMMAND}", "3.7.0"),
    ],
)
def test_a_worker_that_comes_later_and_lacks_liggghts_ends_the_study_in_one_line(
    cluster: LocalCluster, tmp_path: Path, command: str, said: str
) -> None:
    executor = DaskExecutor(cluster.scheduler_address)
    engine = WorkersEngine(load_model(PLAN.fixed, "tiny"), PROGRAM, command)
    answer = executor.submit(Job(engine, REFERENCE, 1, "0123", tmp_path, "session"))
    error = answer.exception(60)
    executor.close()
    assert isinstance(error, SetupError)
    assert str(error).startswith("worker on ") and said in str(error) and "\n" not in str(error)


def test_a_run_that_fails_on_a_worker_is_an_outcome(cluster: LocalCluster, tmp_path: Path) -> None:
    executor = DaskExecutor(cluster.scheduler_address)
    engine = WorkersEngine(load_model(PLAN.fixed, "tiny"), PROGRAM, f"env FAKE_LIGGGHTS=error {COMMAND}")
    run = executor.submit(Job(engine, REFERENCE, 1, "0123", tmp_path, "session")).result(60)
    executor.close()
    assert run.outcome is Outcome.FAILED and run.host == os.uname().nodename
    assert [path.name for path in tmp_path.iterdir()] == ["0123"]


def test_a_scheduler_that_does_not_answer_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calstudy.engines.cluster.ANSWER_SECONDS", 0.5)
    said = refusal(capsys, [*argv(tmp_path / "study"), "--scheduler", "tcp://127.0.0.1:9"])
    assert "no Dask scheduler answers at tcp://127.0.0.1:9" in said


def test_without_dask_the_option_says_how_to_get_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    said = refusal(capsys, [*argv(tmp_path / "study"), "--scheduler", "tcp://127.0.0.1:9"])
    assert "pip install 'calstudy[cluster]'" in said


def test_a_cluster_that_goes_away_ends_the_study_in_one_line(
    tmp_path: Path, on_this_machine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, log = tmp_path / "study", tmp_path / "log"
    command = logging_to(log, FAKE_LIGGGHTS_SECONDS="0.5")
    scheduler = LocalCluster(n_workers=1, threads_per_worker=2, dashboard_address=":0", silence_logs=50)

    def leave() -> None:
        wait_for(lambda: len(begun(log)) >= 5, 60)
        scheduler.close()

    leaving = threading.Thread(target=leave)
    leaving.start()
    said = refusal_ending(capsys, there(study, scheduler, command))
    leaving.join()
    assert "was lost on the cluster" in said and "the same command goes on" in said
    assert cli.main([*argv(study), "--liggghts", COMMAND]) in (0, MISSED)
    assert_same(tables(study), tables(on_this_machine))


def test_a_scheduler_that_goes_while_there_is_no_worker_ends_whoever_waits(tmp_path: Path) -> None:
    scheduler = LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50)
    executor = DaskExecutor(scheduler.scheduler_address)
    engine = WorkersEngine(load_model(PLAN.fixed, "tiny"), PROGRAM, COMMAND)
    queue = Queue(executor, 1.0, threading.Event())
    answer = queue.submit(Job(engine, REFERENCE, 1, "0123", tmp_path, "session"))
    assert executor.slots == 0 and not answer.done()
    scheduler.close()
    wait_for(lambda: executor.slots > 0, 60)
    queue.hand_out()
    with pytest.raises(SetupError, match=r"scheduler at tcp://.* is gone"):
        answer.result(0)
    with pytest.raises(SetupError, match="is gone"):
        executor.program(LIGGGHTS, COMMAND, threading.Event())
    queue.close()


def test_a_worker_of_another_calstudy_runs_nothing(
    cluster: LocalCluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calstudy.engines.cluster.__version__", "0.0.7")
    engine = WorkersEngine(load_model(PLAN.fixed, "tiny"), PROGRAM, COMMAND)
    executor = DaskExecutor(cluster.scheduler_address)
    answer = executor.submit(Job(engine, REFERENCE, 1, "0123", tmp_path, "session"))
    error = answer.exception(60)
    executor.close()
    assert isinstance(error, SetupError) and "elsewhere 0.0.7" in str(error)


def test_what_dead_sessions_left_is_swept_where_the_workers_are(
    cluster: LocalCluster, tmp_path: Path
) -> None:
    for name in ("0123.dead.1", "0123.alive.2"):
        (tmp_path / name).mkdir()
    executor = DaskExecutor(cluster.scheduler_address)
    executor.remove_leftovers(tmp_path, {"dead"})
    executor.close()
    assert [path.name for path in tmp_path.iterdir()] == ["0123.alive.2"]


def refusal_ending(capsys: pytest.CaptureFixture[str], words: list[str]) -> str:
    """The last line of a command that had begun its work."""
    capsys.readouterr()
    assert cli.main(words) == 3
    return capsys.readouterr().err.splitlines()[-1]


def test_a_run_that_loses_more_workers_than_dask_allows_ends_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Dask allows three by default; none is allowed here, for its nannies take their time with each."""
    deadly = tmp_path / "deadly"
    lines = ["#!/bin/bash", 'case " $* " in *" -in "*) kill -9 $PPID;; esac', f'exec {COMMAND} "$@"', ""]
    deadly.write_text("\n".join(lines))
    deadly.chmod(0o755)
    none = dask.config.set({"distributed.scheduler.allowed-failures": 0})
    with none, LocalCluster(n_workers=1, dashboard_address=":0", silence_logs=50) as made:
        study = tmp_path / "study"
        assert cli.main(there(study, made, str(deadly))) == SetupError.exit_code
    said = capsys.readouterr().err
    assert "was lost on the cluster" in said and "1 different workers" in said
