"""One session at a time on a study, on any file system; what the dead leave is taken over, never lost."""

import errno
import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import asdict, replace

import pytest

from calstudy.errors import SetupError, StoreError
from calstudy.study.directory import lock as lock_module
from calstudy.study.directory import session
from calstudy.study.directory.lock import Lock
from calstudy.study.directory.session import Activity, Session, holder, read_session, read_sessions
from closed_form import ClosedForm, run_study, wait_for

ELSEWHERE = "another boot 4026531836"


def wait_at_most(monkeypatch, seconds):
    """Set the patience with a silent session."""
    for module in (session, lock_module):
        monkeypatch.setattr(module, "PATIENCE_SECONDS", seconds)


@pytest.fixture
def quick(monkeypatch):
    """Signs of life and patience of tenths of a second."""
    monkeypatch.setattr(lock_module, "BEAT_SECONDS", 0.02)
    wait_at_most(monkeypatch, 0.4)


def acquire(directory):
    lock = Lock(directory)
    lock.acquire()
    return lock


def put(directory, **changes):
    """Leave another session's lock in the directory."""
    other = replace(Session.here(), **changes)
    (directory / "lock").write_bytes(other.line)
    return other


def dead_here(directory, **changes):
    ended = subprocess.Popen([sys.executable, "-S", "-c", ""])
    ended.wait()
    return put(directory, process=ended.pid, **changes)


def test_a_session_is_read_back():
    one = replace(Session.here(), did=Activity(rows=(1, 4), slots=2, busy_seconds=1.5, offered_seconds=2.0))
    assert read_session(one.line) == one
    assert one.did.utilisation == 0.75


@pytest.mark.parametrize(
    "content", [b"", b"null", b"[]", b"{}", b"process 7 on vm\n", b"\xff", b'{"did": 1}']
)
def test_what_is_no_session_is_none(content):
    assert read_session(content) is None


def test_a_lock_is_held_by_one_and_given_back(tmp_path):
    lock = acquire(tmp_path)
    with pytest.raises(StoreError, match=rf"in use by process {os.getpid()} on .*; wait for it"):
        acquire(tmp_path)
    assert holder(tmp_path).token == lock.session.token
    lock.release()
    assert holder(tmp_path) is None and not (tmp_path / "lock").exists()
    acquire(tmp_path).release()


def test_of_many_at_once_one_gets_it(tmp_path):
    dead_here(tmp_path)
    got, refused = [], []

    def one():
        try:
            got.append(acquire(tmp_path))
        except StoreError as error:
            refused.append(str(error))

    threads = [threading.Thread(target=one) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(got) == 1 and len(refused) == 7
    assert holder(tmp_path).token == got[0].session.token
    got[0].release()


HOLDER = "import sys, time; from pathlib import Path; from calstudy.study.directory.lock import Lock\n"
HOLDER += "lock = Lock(Path(sys.argv[1])); lock.acquire(); print('held', flush=True); time.sleep(600)"


def test_the_lock_of_a_killed_process_of_this_machine_does_not_block(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout.readline() == "held\n"
        with pytest.raises(StoreError, match=f"in use by process {process.pid} on "):
            acquire(tmp_path)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
    lock = acquire(tmp_path)
    assert [(one.process, one.state) for one in read_sessions(tmp_path)] == [(process.pid, "killed")]
    lock.release()


def test_a_process_that_got_the_id_of_a_dead_one_is_not_taken_for_it(tmp_path):
    put(tmp_path, born=1)
    acquire(tmp_path).release()


def test_the_last_sign_of_life_of_a_killed_session_is_its_record(tmp_path):
    did = Activity(rows=(3,), runs_done=7)
    dead = dead_here(tmp_path, did=did, beat=9)
    acquire(tmp_path).release()
    assert read_sessions(tmp_path) == [replace(dead, state="killed")]


def test_a_silent_session_elsewhere_is_dead(quick, tmp_path):
    dead = put(tmp_path, place=ELSEWHERE, host="node7")
    lock = acquire(tmp_path)
    assert [one.token for one in read_sessions(tmp_path)] == [dead.token]
    lock.release()


def test_a_session_elsewhere_that_gives_signs_of_life_is_alive(quick, tmp_path):
    other = put(tmp_path, place=ELSEWHERE, host="node7")
    beats = iter(range(1, 10**6))
    ended = threading.Event()

    def beat():
        while not ended.wait(0.05):
            beside = tmp_path / "beside"
            beside.write_bytes(replace(other, beat=next(beats)).line)
            beside.replace(tmp_path / "lock")

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        with pytest.raises(StoreError, match=r"in use by process .* on node7"):
            acquire(tmp_path)
    finally:
        ended.set()
        thread.join()
    assert read_sessions(tmp_path) == []


def test_a_clock_that_jumps_takes_nobody_for_dead(quick, tmp_path):
    """What a jump by years does to a lock: it is as old as can be, and its holder beats all the same."""
    other = put(tmp_path, place=ELSEWHERE, host="node7")
    os.utime(tmp_path / "lock", (0, 0))
    beat = threading.Timer(0.02, lambda: put(tmp_path, **{**asdict(other), "did": Activity(), "beat": 1}))
    beat.start()
    with pytest.raises(StoreError, match=r"in use by process .* on node7"):
        acquire(tmp_path)
    beat.join()


def test_what_is_left_of_an_unreadable_lock_is_taken_over_in_time(quick, tmp_path):
    (tmp_path / "lock").write_bytes(b'{"token": "cut sho')
    acquire(tmp_path).release()
    assert read_sessions(tmp_path) == []


def test_of_two_that_take_over_the_one_that_wrote_last_has_it(quick, tmp_path, monkeypatch):
    put(tmp_path, place=ELSEWHERE)
    write = lock_module.write_atomically

    def and_then_another(path, content, below):
        write(path, content, below)
        put(tmp_path, host="the faster one")

    monkeypatch.setattr(lock_module, "write_atomically", and_then_another)
    with pytest.raises(StoreError, match=r"in use by process .* on the faster one"):
        acquire(tmp_path)
    assert holder(tmp_path).host == "the faster one"


def test_a_file_system_without_flock_has_locks_too(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr(fcntl, "flock", refuse)
    lock = acquire(tmp_path)
    with pytest.raises(StoreError, match="in use"):
        acquire(tmp_path)
    lock.release()


def test_signs_of_life_say_what_the_session_does(quick, tmp_path):
    lock = acquire(tmp_path)
    lock.report = lambda: Activity(rows=(5,), runs_done=3)
    wait_for(lambda: holder(tmp_path).did.runs_done == 3 and holder(tmp_path).beat > 2)
    lock.release("interrupted")
    (left,) = read_sessions(tmp_path)
    assert (left.state, left.did.rows, left.did.runs_done) == ("interrupted", (5,), 3)


def test_signs_of_life_go_on_when_the_figures_or_a_look_fail(quick, tmp_path, monkeypatch):
    lock = acquire(tmp_path)
    monkeypatch.setattr(lock, "report", lambda: {}["no figures"])
    before = holder(tmp_path).beat
    wait_for(lambda: holder(tmp_path).beat > before + 1)
    with monkeypatch.context() as patched:
        patched.setattr(lock, "_holder", lambda: [][0])
        time.sleep(0.3)
    before = holder(tmp_path).beat
    wait_for(lambda: holder(tmp_path).beat > before + 1)
    lock.report = None
    lock.release()


def test_a_session_that_was_taken_for_dead_knows_it_and_leaves_the_other_alone(quick, tmp_path):
    lock = acquire(tmp_path)
    lock.report = Activity
    other = put(tmp_path, host="node7")
    wait_for(lock.lost.is_set)
    lock.release()
    assert holder(tmp_path) == other and read_sessions(tmp_path) == []


def test_a_campaign_whose_study_was_taken_over_ends(quick, tmp_path):
    def taken_over(number):
        if number >= 3:  # one alone may fall between a beat's look and its writing, and be overwritten
            put(tmp_path, host="node7")

    with pytest.raises(StoreError, match="taken over by another session"):
        run_study(tmp_path, (1,), engine=ClosedForm(seconds=0.1, on_call=taken_over), workers=1)
    assert holder(tmp_path).host == "node7"


def test_a_lock_that_could_not_be_written_is_not_left(quick, tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError(errno.ENOSPC, "no space")))
        with pytest.raises(OSError, match="no space"):
            Lock(tmp_path).acquire()
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_no_reason_for_another_study(tmp_path, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", lambda _: (_ for _ in ()).throw(OSError(errno.ENOSPC, "no space")))
        with pytest.raises(SetupError, match=r"no space; free space and run it again"):
            run_study(tmp_path / "study", (1,))


def test_who_waits_for_a_session_elsewhere_goes_on_when_it_ends_in_peace(quick, tmp_path, monkeypatch):
    wait_at_most(monkeypatch, 30.0)
    monkeypatch.setattr(lock_module, "LOOK_SECONDS", 0.02)
    put(tmp_path, place=ELSEWHERE, host="node7")
    leaving = threading.Timer(0.3, (tmp_path / "lock").unlink)
    leaving.start()
    lock = acquire(tmp_path)
    leaving.join()
    lock.release()
    assert read_sessions(tmp_path) == []


def test_a_session_that_says_nothing_any_more_is_silent():
    one = Session.here()
    assert not one.is_silent
    assert replace(one, seen="2026-01-01T00:00:00+00:00").is_silent
