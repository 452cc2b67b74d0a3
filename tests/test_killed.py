"""The command killed and stopped as users, batch systems and power cuts do it; the engine is the stand-in."""

from __future__ import annotations

import io
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from rich.console import Console

from calstudy.cli import main as cli
from calstudy.cli.terminal import stop_on_signals
from calstudy.errors import MISSED
from calstudy.study.directory.journal import decode
from calstudy.study.directory.session import holder, read_sessions
from closed_form import wait_for
from fake_liggghts import COMMAND, begun
from processes import at_work_in
from same_tables import assert_same, tables

pytestmark = pytest.mark.slow

PARTS, KILLS = 2, 15
"""Parts that run side by side, and the kills of each; the soak kills a thousand times."""
ROWS = "1,5"
PATIENCE = 100.0
"""Seconds that a busy machine may need for what takes one; the stand-in waits and hangs for longer."""


def argv(study: Path, *more: str, seed: int = 1) -> list[str]:
    words = f"plan run --rows {ROWS} --fidelity tiny --budget 8 --workers 2 --seed {seed} --study {study}"
    return [*words.split(), *more]


def command(study: Path, log: Path, seed: int, endless: bool) -> None:
    """Entry of a process that is meant to be killed; endless DEM runs wait for a file that never comes."""
    os.environ |= {"CALSTUDY_LIGGGHTS": COMMAND, "FAKE_LIGGGHTS_LOG": str(log)}
    if endless:
        os.environ["FAKE_LIGGGHTS_UNTIL"] = str(log.with_name("never"))
    sys.stdout = sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115
    sys.exit(cli.main(argv(study, seed=seed)))


def on_disk(study: Path) -> set[str]:
    """Identities of the DEM runs that are durable: nothing but whole lines count."""
    lines = [line for path in (study / "journal").glob("*.jsonl") for line in path.read_bytes().split(b"\n")]
    return {evaluation.run_id for evaluation in map(decode, lines) if evaluation is not None}


@pytest.fixture(scope="module")
def forks():
    """Processes that start in no time, because all is imported already."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["calstudy.cli.plan.run", "calstudy.calibration.task", "test_killed"])
    return context


@pytest.mark.parametrize("part", range(PARTS))
def test_a_study_killed_at_random_instants_ends_as_an_undisturbed_one(forks, tmp_path, capsys, part):
    instants = random.Random(5 + part)
    kills: list[tuple[int, int, int]] = []
    seed = first = KILLS * part
    while len(kills) < KILLS:
        seed += 1
        study, log = tmp_path / f"killed-{seed}", tmp_path / f"log-{seed}"
        log.touch()
        kept: set[str] = set()
        while True:
            before = len(begun(log))
            # Half of the kills meet DEM runs that last until then, the others any stage of the study.
            in_a_run = len(kills) < KILLS and instants.random() < 0.5
            process = forks.Process(target=command, args=(study, log, seed, in_a_run))
            process.start()
            if len(kills) < KILLS:
                # Any time from where it has the lock; before that, it has changed nothing.
                wait_for(lambda: has_lock(study, process.pid) or not process.is_alive(), PATIENCE)  # noqa: B023
                due = len(kept) + instants.randrange(5)
                if in_a_run:
                    wait_for(lambda: len(begun(log)) > before or not process.is_alive(), PATIENCE)  # noqa: B023
                else:
                    wait_for(lambda: len(on_disk(study)) >= due or not process.is_alive(), PATIENCE)  # noqa: B023
                process.join(instants.uniform(0.0, 0.2))
                process.kill()
            process.join()
            new = begun(log)[before:]
            assert not kept & set(new), "a DEM run that was durable has been run again"
            wait_for(lambda: not at_work_in(study), PATIENCE)  # noqa: B023
            assert kept <= on_disk(study), "a DEM run that was durable is lost"
            kept = on_disk(study)
            if process.exitcode in (0, MISSED):
                break
            assert process.exitcode == -signal.SIGKILL
            kills.append((seed, len(kept), len(set(new) - kept)))
            process.close()
        undisturbed = tmp_path / f"whole-{seed}"
        assert cli.main(argv(undisturbed, "--liggghts", COMMAND, seed=seed)) in (0, MISSED)
        assert_same(tables(study), tables(undisturbed))
        assert list((study / "runs").iterdir()) == []
        assert [one.state for one in read_sessions(study)].count("killed") > 0
    under_way = sum(lost > 0 for _, _, lost in kills)
    stages = len({(study, durable) for study, durable, _ in kills})
    with capsys.disabled():
        studies = seed - first
        print(f" [{len(kills)} kills, {under_way} in DEM runs, {stages} stages, {studies} studies]", end="")
    assert under_way > KILLS / 4 and stages > KILLS / 4, "the kills met too few different instants"


def has_lock(study: Path, process: int) -> bool:
    session = holder(study)
    return session is not None and session.process == process


@pytest.mark.liggghts
def test_a_study_on_real_liggghts_killed_in_mid_run_ends_as_an_undisturbed_one(tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "CALSTUDY_LIGGGHTS"}
    words = ["plan", "run", "--rows", "1", "--fidelity", "tiny", "--budget", "2", "--workers", "2", "--study"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    instants = random.Random(6)

    def started(study):
        return subprocess.Popen([sys.executable, "-m", "calstudy", *words, str(study)], **quiet)

    study = tmp_path / "killed"
    for durable in (1, 4):
        process = started(study)
        wait_for(lambda: len(on_disk(study)) >= durable and at_work_in(study), 300)  # noqa: B023
        assert process.poll() is None
        time.sleep(instants.uniform(0.0, 1.0))
        process.kill()
        process.wait()
        wait_for(lambda: not at_work_in(study))
    kept = {path: path.read_bytes() for path in (study / "journal").iterdir()}
    for name in (study, tmp_path / "whole"):
        assert started(name).wait(600) in (0, MISSED)
    for path, lines in kept.items():
        # What was durable was neither lost nor run again: it stands as it stood, and no run stands twice.
        assert path.read_bytes().startswith(lines[: lines.rindex(b"\n") + 1])
        runs = [decode(line).run_id for line in path.read_bytes().splitlines() if decode(line)]
        assert len(runs) == len(set(runs))
    assert_same(tables(study), tables(tmp_path / "whole"))


# ---- signals -------------------------------------------------------------------------------------


@pytest.fixture
def hanging(tmp_path):
    """The command with two DEM runs that hang, each with a child process."""
    environment = os.environ | {"CALSTUDY_LIGGGHTS": COMMAND, "FAKE_LIGGGHTS": "hang"}
    words = [sys.executable, "-m", "calstudy", *argv(tmp_path / "study")]
    process = subprocess.Popen(
        words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, env=environment, text=True
    )
    try:
        wait_for(lambda: len(list((tmp_path / "study" / "runs").glob("*/child.pid"))) == 2, PATIENCE)
        yield process
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_liggghts_and_says_what_is_saved(hanging, tmp_path, number):
    hanging.send_signal(number)
    said = hanging.stderr.read().splitlines()
    assert hanging.wait(PATIENCE) == 130
    assert any("stopping" in line for line in said)
    assert said[-1].startswith("calstudy: interrupted: 0 row(s) finished")
    assert "the same command goes on" in said[-1]
    assert at_work_in(tmp_path) == []
    assert [one.state for one in read_sessions(tmp_path / "study")] == ["interrupted"]
    assert holder(tmp_path / "study") is None


def test_a_second_signal_ends_at_once_and_leaves_nothing_running(hanging, tmp_path):
    assert len(at_work_in(tmp_path)) >= 4
    hanging.send_signal(signal.SIGSTOP)  # so that both signals wait for it, whatever it was doing
    hanging.send_signal(signal.SIGINT)
    hanging.send_signal(signal.SIGTERM)
    hanging.send_signal(signal.SIGCONT)
    assert hanging.wait(PATIENCE) == 130
    wait_for(lambda: at_work_in(tmp_path) == [], PATIENCE)


def test_a_first_signal_is_no_second_one_though_the_work_is_ending_already():
    with stop_on_signals(Console(file=io.StringIO())) as stop:
        stop.set()  # as a queue does that closes by itself
        signal.raise_signal(signal.SIGINT)


def test_a_killed_command_leaves_no_process_behind(hanging, tmp_path):
    assert len(at_work_in(tmp_path)) >= 4
    bystander = subprocess.Popen(["sleep", "600"], cwd=tmp_path)
    try:
        hanging.kill()
        wait_for(lambda: at_work_in(tmp_path / "study") == [], PATIENCE)
        assert bystander.poll() is None
    finally:
        bystander.kill()
        bystander.wait()
