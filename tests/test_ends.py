"""A command ends when it is told to, whatever its threads do: numerics may hang, workers may never come."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from dask.utils import parse_timedelta
from distributed import LocalCluster

from calstudy.engines.cluster import DaskExecutor, WorkersEngine
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.engines.program import Program
from calstudy.engines.queue import Job
from calstudy.errors import OutOfTime, SetupError, StoreError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import REFERENCE
from calstudy.study.directory.session import holder, read_sessions
from calstudy.study.directory.store import Store
from closed_form import PLAN, study_settings, wait_for
from fake_liggghts import COMMAND

pytestmark = pytest.mark.slow
STUCK = """
import sys, time
from calstudy.study import campaign
from calstudy.cli import main
campaign.calibrate = lambda *_: (print("stuck", flush=True), time.sleep(600))
sys.exit(main.program())
"""
HOLDING = STUCK.replace("import sys, time", "import ctypes, sys").replace(
    "time.sleep(600)", "[ctypes.PyDLL(None).sleep(600) for _ in range(9)]"
)
"""A thread that never gives up Python's lock, so that neither signals nor time are noticed."""
ENGINE = WorkersEngine(load_model(PLAN.fixed, "tiny", "ring"), Program(LIGGGHTS, (), "3.8.0"), COMMAND)
AT_MOST = 12.0
"""Seconds: 10 that are promised, and Python's own start and end on a busy machine."""


def stuck(study, *words, program=STUCK):
    argv = f"plan run --rows 1 --fidelity tiny --budget 2 --workers 1 --study {study}".split()
    process = subprocess.Popen(
        [sys.executable, "-c", program, *argv, *words],
        env=os.environ | {"CALSTUDY_LIGGGHTS": COMMAND},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "stuck\n"
    return process


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_computation_that_never_ends_does_not_keep_a_signal_from_ending_all(tmp_path, number):
    with stuck(tmp_path) as process:
        started = time.monotonic()
        process.send_signal(number)
        assert process.wait(60) == 130
        assert time.monotonic() - started < AT_MOST
        said = process.stderr.read()
    assert "the same command goes on" in said and "a computation did not end" in said
    assert holder(tmp_path) is None and [one.state for one in read_sessions(tmp_path)] == ["interrupted"]


def test_a_thread_that_holds_pythons_lock_outlasts_neither_a_signal_nor_a_time_limit(tmp_path):
    with (
        stuck(tmp_path / "signal", program=HOLDING) as told,
        stuck(tmp_path / "time", "--time-limit", "6s", program=HOLDING) as late,
    ):
        started = time.monotonic()
        told.send_signal(signal.SIGTERM)
        assert told.wait(60) == -signal.SIGKILL
        assert time.monotonic() - started < AT_MOST
        assert late.wait(90) == -signal.SIGKILL
        assert time.monotonic() - started < 6 + 2 * AT_MOST


def test_a_computation_that_never_ends_does_not_outlast_a_time_limit(tmp_path):
    started = time.monotonic()
    with stuck(tmp_path, "--time-limit", "6s") as process:
        assert process.wait(90) == OutOfTime.exit_code
        assert time.monotonic() - started < 6 + 2 * AT_MOST
    assert holder(tmp_path) is None and len(read_sessions(tmp_path)) == 1


def test_what_was_left_behind_writes_nothing_into_a_closed_study(tmp_path):
    with Store(tmp_path, study_settings()) as store:
        pass
    with pytest.raises(StoreError, match="is closed"):
        store.finish(1, {"outcome": "ok"}, [], [])


@pytest.fixture(scope="module")
def no_workers():
    """Address of a scheduler whose only worker died at once."""
    here = {"processes": False, "protocol": "tcp"}
    with LocalCluster(n_workers=1, dashboard_address=":0", silence_logs=50, **here) as cluster:
        cluster.scale(0)
        wait_for(lambda: not cluster.scheduler.workers)
        yield cluster.scheduler_address


def test_waiting_for_a_first_worker_says_so_and_has_a_limit(no_workers, monkeypatch, caplog):
    monkeypatch.setattr("calstudy.engines.cluster.TELL_SECONDS", 0.1)
    monkeypatch.setattr("calstudy.engines.cluster.LOOK_SECONDS", 0.2)
    executor = DaskExecutor(no_workers, 4, wait=3.0)
    try:
        with pytest.raises(SetupError, match=r"for 0 min, 1 worker\(s\) came and went; if workers"):
            executor.program(None, None, threading.Event())
    finally:
        executor.close()
    assert sum("waiting: no worker at" in record.message for record in caplog.records) >= 2


def test_runs_that_wait_for_lost_workers_are_given_up_in_time(no_workers, monkeypatch, tmp_path):
    monkeypatch.setattr("calstudy.engines.cluster.LOOK_SECONDS", 0.2)
    executor = DaskExecutor(no_workers, 4, wait=3.0)
    try:
        answer = executor.submit(Job(ENGINE, REFERENCE, 1, "run", tmp_path, "token"))
        assert isinstance(answer.exception(60), SetupError)
        with pytest.raises(SetupError, match="no worker"):
            executor.submit(Job(ENGINE, REFERENCE, 1, "run", tmp_path, "token"))
    finally:
        executor.close()


def test_dask_takes_the_times_of_the_example():
    page = (Path(__file__).parent.parent / "docs" / "how-to" / "clusters.md").read_text()
    times = re.findall(r'"--lifetime(?:-stagger)?", "(\w+)"', page)
    assert len(times) == 2
    assert parse_timedelta(times[0]) < 4 * 3600 - parse_timedelta(times[1]), "before the walltime of 4 h"
