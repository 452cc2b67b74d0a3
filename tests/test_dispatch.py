"""The queue of DEM runs, on an executor and a clock of the test's own."""

import threading
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest

from calstudy.engines import queue as dispatch
from calstudy.engines.queue import Job, LocalExecutor, Queue, run_job
from calstudy.errors import OutOfTime, SetupError, Stopped
from calstudy.records import Outcome
from closed_form import TRUTH, ClosedForm


class Clock:
    def __init__(self, monkeypatch):
        self.now = 1000.0
        monkeypatch.setattr(dispatch.time, "monotonic", lambda: self.now)


class ByHand:
    """Executor whose runs end when the test says so."""

    def __init__(self, slots):
        self.slots = slots
        self.begun = []
        self.closed = False

    def submit(self, job):
        future = Future()
        self.begun.append((job.run_id, future))
        return future

    def end(self, run_id, seconds, outcome=Outcome.OK):
        (future,) = [future for name, future in self.begun if name == run_id and not future.done()]
        future.set_result(replace(run_of(seconds), outcome=outcome))

    def close(self):
        self.closed = True
        for _, future in self.begun:
            if not future.done():
                future.set_exception(Stopped("closed"))

    def remove_leftovers(self, scratch, sessions):
        pass

    @property
    def names(self):
        return [name for name, _ in self.begun]


def run_of(seconds):
    run = ClosedForm(seconds=seconds).answer(TRUTH)
    return dispatch.Run(outcome="ok", reason="", responses=run, wall_time=seconds, cpu_time=0.9 * seconds)


def job(name, engine=None, scratch=Path("nowhere"), keep=False):
    return Job(engine, TRUTH, 1, name, scratch, "session", keep)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def test_runs_are_handed_out_in_order_and_never_more_than_slots(clock):
    hand = ByHand(2)
    queue = Queue(hand, 1.0, threading.Event())
    answers = {name: queue.submit(job(name)) for name in "abcd"}
    assert hand.names == ["a", "b"]
    hand.end("b", 1.0)
    assert hand.names == ["a", "b", "c"] and answers["b"].result().wall_time == 1.0
    hand.end("a", 1.0)
    hand.end("d", 1.0)
    assert not queue.idle
    hand.end("c", 1.0)
    assert queue.idle and all(answer.done() for answer in answers.values())


def test_lower_ranks_go_first_and_equals_in_order(clock):
    hand = ByHand(1)
    queue = Queue(hand, 1.0, threading.Event())
    for name, rank in {"a": 2, "b": 1, "c": 0, "d": 1, "e": 0}.items():
        queue.submit(job(name), rank)
    for name in "acebd":
        assert hand.names[-1] == name
        hand.end(name, 1.0)


def test_slots_that_are_added_are_used(clock):
    hand = ByHand(1)
    queue = Queue(hand, 1.0, threading.Event())
    for name in "abc":
        queue.submit(job(name))
    hand.slots = 3
    queue.hand_out()
    assert hand.names == ["a", "b", "c"]


def test_an_answer_is_dealt_with_before_its_run_counts_as_ended(clock):
    hand = ByHand(1)
    queue = Queue(hand, 1.0, threading.Event())
    seen = []
    queue.submit(job("a")).add_done_callback(lambda _: seen.append(queue.idle))
    hand.end("a", 1.0)
    assert seen == [False] and queue.idle


def test_no_run_is_handed_out_that_might_not_end_in_time(clock):
    hand = ByHand(1)
    queue = Queue(hand, 10.0, threading.Event(), deadline=1030.0)
    first, second = queue.submit(job("a")), queue.submit(job("b"))
    clock.now = 1016.0
    hand.end("a", 16.0)  # it took longer than expected: another one might take until 1035
    assert hand.names == ["a"] and first.result().wall_time == 16.0
    assert isinstance(second.exception(), OutOfTime) and queue.late and queue.idle


def test_a_run_that_was_ended_for_its_time_says_nothing_of_the_others(clock):
    hand = ByHand(1)
    queue = Queue(hand, 10.0, threading.Event(), deadline=1230.0)
    queue.submit(job("a"))
    queue.submit(job("b"))
    clock.now = 1200.0
    hand.end("a", 200.0, Outcome.TIMED_OUT)
    assert hand.names == ["a", "b"] and queue.longest == 10.0


def test_a_run_that_fits_is_handed_out_before_the_deadline(clock):
    hand = ByHand(1)
    queue = Queue(hand, 10.0, threading.Event(), deadline=1030.0)
    queue.submit(job("a"))
    queue.submit(job("b"))
    clock.now = 1010.0
    hand.end("a", 10.0)
    assert hand.names == ["a", "b"] and not queue.late


def test_a_deadline_without_work_is_nothing_to_complain_of(clock):
    queue = Queue(ByHand(1), 10.0, threading.Event(), deadline=1001.0)
    queue.hand_out()
    assert not queue.late


def test_after_a_stop_nothing_is_handed_out(clock):
    hand, stop = ByHand(1), threading.Event()
    queue = Queue(hand, 1.0, stop)
    first, second = queue.submit(job("a")), queue.submit(job("b"))
    queue.close()
    assert stop.is_set() and hand.closed and hand.names == ["a"]
    for answer in (first, second, queue.submit(job("c"))):
        assert isinstance(answer.exception(), Stopped)
    assert hand.names == ["a"] and queue.idle


def test_slots_that_are_always_busy_while_runs_wait_are_fully_used(clock):
    hand = ByHand(2)
    queue = Queue(hand, 10.0, threading.Event())
    for name in "abcd":
        queue.submit(job(name))
    clock.now += 10.0
    hand.end("a", 10.0)
    hand.end("b", 10.0)
    assert queue.usage.offered_seconds == queue.usage.busy_seconds == 20.0
    # Nothing waits any more: that one slot idles at the end is not counted against anybody.
    clock.now += 5.0
    hand.end("c", 5.0)
    clock.now += 5.0
    hand.end("d", 10.0)
    used = queue.usage
    assert (used.offered_seconds, used.busy_seconds, used.dem_seconds) == (20.0, 20.0, 35.0)
    assert used.dem_cpu_seconds == pytest.approx(31.5)


def test_time_that_is_lost_between_runs_lowers_the_utilisation(clock):
    hand = ByHand(1)
    queue = Queue(hand, 10.0, threading.Event())
    for name in "abc":
        queue.submit(job(name))
    for name in "ab":
        clock.now += 10.0
        hand.end(name, 7.5)  # the program ran for 7.5 s of the 10 s that its slot was taken
    used = queue.usage
    assert used.busy_seconds == 15.0 and used.offered_seconds == 20.0


def test_a_run_under_way_counts_as_far_as_it_is(clock):
    hand = ByHand(1)
    queue = Queue(hand, 10.0, threading.Event())
    queue.submit(job("a"))
    queue.submit(job("b"))
    clock.now += 4.0
    used = queue.usage
    assert (used.running, used.waiting, used.busy_seconds, used.offered_seconds) == (1, 1, 4.0, 4.0)


def test_an_error_of_a_run_reaches_who_asked_and_frees_the_slot(clock):
    hand = ByHand(1)
    queue = Queue(hand, 1.0, threading.Event())
    failed, _ = queue.submit(job("a")), queue.submit(job("b"))
    hand.begun[0][1].set_exception(OSError("no disk"))
    assert isinstance(failed.exception(), OSError) and hand.names == ["a", "b"]


# ---- one job -------------------------------------------------------------------------------------


@pytest.mark.parametrize("keep", [False, True])
def test_a_job_leaves_its_directory_only_on_request(tmp_path, keep):
    run = run_job(job("0123", ClosedForm(writes=True), tmp_path, keep), threading.Event())
    assert run.usable and run.host and run.finished_at
    assert [path.name for path in tmp_path.iterdir()] == (["0123"] if keep else [])


def test_equal_jobs_of_two_sessions_do_not_disturb_each_other(tmp_path):
    stop = threading.Event()
    executor = LocalExecutor(2, stop)
    jobs = [
        Job(ClosedForm(writes=True, seconds=0.2), TRUTH, 1, "0123", tmp_path, name, True) for name in "ab"
    ]
    runs = [executor.submit(one).result() for one in jobs]
    executor.close()
    assert runs[0].responses == runs[1].responses
    assert [path.name for path in tmp_path.iterdir()] == ["0123"]


def test_a_job_that_is_stopped_leaves_nothing(tmp_path):
    stop = threading.Event()
    threading.Timer(0.1, stop.set).start()
    with pytest.raises(Stopped):
        run_job(job("0123", ClosedForm(writes=True, seconds=60.0), tmp_path), stop)
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_the_executor_refuses_is_heard_of_and_the_others_go_on(clock):
    class Refusing(ByHand):
        def submit(self, job):
            if job.run_id == "b":
                raise SetupError("nobody runs it")
            return super().submit(job)

    hand = Refusing(slots=3)
    queue = Queue(hand, 10.0, threading.Event())
    answers = {name: queue.submit(job(name)) for name in "abc"}
    with pytest.raises(SetupError, match="nobody runs it"):
        answers["b"].result(0)
    for name in "ac":
        hand.end(name, 5.0)
        assert answers[name].result(0).wall_time == 5.0
    assert queue.idle
