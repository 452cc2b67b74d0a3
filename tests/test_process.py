import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from calstudy.engines.process import run_process
from calstudy.errors import SetupError
from processes import runs, wait_until

TEN_MINUTES = 600


def run(argv, directory, *, time_limit=TEN_MINUTES, stop=None):
    stop = stop or threading.Event()
    return run_process(argv, directory=directory, output=directory / "out", time_limit=time_limit, stop=stop)


def shell(script):
    return ["sh", "-c", script]


CHILD_AND_WAIT = "sleep 600 & echo $! > child.tmp; mv child.tmp child; wait"


def child_of(directory):
    assert wait_until((directory / "child").exists)
    return int((directory / "child").read_text())


@pytest.fixture
def bystander():
    """A process of somebody else, which no end of ours may touch."""
    process = subprocess.Popen(["sleep", "600"])
    yield process
    process.kill()
    process.wait()


def test_output_and_complaints_go_to_the_file_in_order(tmp_path):
    done = run(shell("echo one; echo two >&2; pwd"), tmp_path)
    assert (tmp_path / "out").read_text() == f"one\ntwo\n{tmp_path}\n"
    assert (done.exit_code, done.timed_out, done.stopped) == (0, False, False)


@pytest.mark.parametrize("code", [0, 1, 3, 255])
def test_the_exit_code_comes_back(tmp_path, code):
    assert run(shell(f"exit {code}"), tmp_path).exit_code == code


def test_a_signal_comes_back_as_a_negative_number(tmp_path):
    assert run(shell("kill -TERM $$"), tmp_path).exit_code == -15


def test_arguments_are_not_read_by_a_shell(tmp_path):
    run(["echo", "$HOME; *"], tmp_path)
    assert (tmp_path / "out").read_text() == "$HOME; *\n"


def test_nothing_comes_from_standard_input(tmp_path):
    assert run(["cat"], tmp_path).exit_code == 0
    assert (tmp_path / "out").read_bytes() == b""


def test_numerical_libraries_are_held_to_one_thread(tmp_path):
    run(shell("echo $OMP_NUM_THREADS $OPENBLAS_NUM_THREADS $MKL_NUM_THREADS"), tmp_path)
    assert (tmp_path / "out").read_text() == "1 1 1\n"


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="only Linux tells how long one waited")
def test_a_program_that_waits_for_a_core_is_not_late(tmp_path):
    """Three others share its core: 0.8 s of work take three seconds."""
    core = {min(os.sched_getaffinity(0))}
    work = "import time\nwhile time.process_time() < {}: pass"
    others = [subprocess.Popen([sys.executable, "-c", work.format(20)]) for _ in range(3)]
    for other in others:
        os.sched_setaffinity(other.pid, core)
    program = f"import os\nos.sched_setaffinity(0, {core})\n{work.format(0.8)}"
    try:
        done = run([sys.executable, "-c", program], tmp_path, time_limit=1.5)
    finally:
        for other in others:
            other.kill()
            other.wait()
    assert done.wall_time > 1.5
    assert (done.exit_code, done.timed_out) == (0, False)


def test_a_time_limit_ends_the_whole_group(tmp_path, bystander):
    done = run(shell(CHILD_AND_WAIT), tmp_path, time_limit=1.0)
    assert done.timed_out
    assert not done.stopped
    assert done.exit_code == -9
    child = child_of(tmp_path)
    assert wait_until(lambda: not runs(child))
    assert runs(bystander.pid)


def test_a_stop_ends_the_whole_group(tmp_path, bystander):
    stop = threading.Event()
    when_there = threading.Thread(target=lambda: (child_of(tmp_path), stop.set()))
    when_there.start()
    done = run(shell(CHILD_AND_WAIT), tmp_path, stop=stop)
    when_there.join()
    assert done.stopped
    assert not done.timed_out
    assert done.wall_time < TEN_MINUTES / 10, "it did not wait for the program"
    child = child_of(tmp_path)
    assert wait_until(lambda: not runs(child))
    assert runs(bystander.pid)


def test_a_program_that_ends_leaves_no_child_behind(tmp_path):
    done = run(shell("sleep 600 & echo $! > child"), tmp_path)
    assert (done.exit_code, done.timed_out, done.stopped) == (0, False, False)
    child = child_of(tmp_path)
    assert wait_until(lambda: not runs(child))


def test_a_child_is_seen_while_it_runs(bystander):
    assert runs(bystander.pid)
    bystander.kill()
    assert wait_until(lambda: not runs(bystander.pid))


def test_a_program_that_ends_in_time_is_not_timed_out(tmp_path):
    assert not run(["true"], tmp_path, time_limit=60).timed_out


def test_the_waiting_of_a_process_that_has_ended_still_counts(tmp_path, monkeypatch):
    """A wrapper that outlives the program which it has started: the program's account is gone with it."""
    told = iter([10.0])
    monkeypatch.setattr("calstudy.machine.waited", lambda session: next(told, 0.0))
    done = run(["sleep", "0.8"], tmp_path, time_limit=0.2)
    assert (done.exit_code, done.timed_out) == (0, False)


def test_time_in_which_the_machine_slept_does_not_count(tmp_path, monkeypatch):
    """A suspended batch job, say: it and we stand still, and the clock goes on."""
    began, slept = time.monotonic(), threading.Event()

    def clock():
        now = time.monotonic()
        return now + (0.0 if now < began + 0.3 else slept.set() or 1000.0)

    monkeypatch.setattr("calstudy.engines.process.time", SimpleNamespace(monotonic=clock))
    done = run(["sleep", "0.8"], tmp_path, time_limit=60)
    assert slept.is_set()
    assert (done.exit_code, done.timed_out) == (0, False)


@pytest.mark.parametrize(
    ("ending", "by_others"),
    [("kill -TERM $$", True), ("exit 137", True), ("exit 1", False), ("kill -SEGV $$", False)],
)
def test_who_ended_a_program_is_known(tmp_path, ending, by_others):
    assert run(shell(ending), tmp_path).ended_from_outside is by_others


def test_a_program_that_we_end_is_not_ended_from_outside(tmp_path):
    assert not run(["sleep", "60"], tmp_path, time_limit=0.2).ended_from_outside


def test_an_error_while_waiting_ends_the_group_too(tmp_path):
    class Broken(threading.Event):
        def is_set(self):
            child_of(tmp_path)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(shell(CHILD_AND_WAIT), tmp_path, stop=Broken())
    child = child_of(tmp_path)
    assert wait_until(lambda: not runs(child))


def test_cpu_time_is_the_programs_own(tmp_path):
    busy = run(shell("i=0; while [ $i -lt 100000 ]; do i=$((i+1)); done"), tmp_path)
    idle = run(["sleep", "0.2"], tmp_path)
    assert busy.cpu_time > 0
    assert idle.wall_time >= 0.2
    assert idle.cpu_time < 0.1
    assert busy.cpu_time > idle.cpu_time


@pytest.mark.parametrize("name", ["no-such-program", "./no-such-program", "/no/such/program"])
def test_a_missing_program_is_a_matter_of_set_up(tmp_path, name):
    with pytest.raises(SetupError) as caught:
        run([name], tmp_path)
    message = str(caught.value)
    assert message.startswith(f"cannot start {name}: No such file")
    assert "calstudy doctor" in message
    assert "\n" not in message


def test_a_file_that_is_no_program_is_a_matter_of_set_up(tmp_path):
    plain = tmp_path / "plain"
    plain.write_text("not a program")
    with pytest.raises(SetupError, match=rf"cannot start {re.escape(str(plain))}: Permission denied"):
        run([str(plain)], tmp_path)
    plain.chmod(0o755)
    with pytest.raises(SetupError, match="Exec format error"):
        run([str(plain)], tmp_path)
