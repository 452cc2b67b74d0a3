"""Elements of a job array on one study: each row by one of them, nothing twice, the tables of one process."""

import multiprocessing
import os
import signal
from collections import Counter
from dataclasses import replace

import pytest

from calstudy.cli.main import main
from calstudy.errors import MISSED, InputError, StoreError
from calstudy.study.directory import elements
from calstudy.study.directory.elements import Claims, Element
from calstudy.study.directory.lock import InUse, Lock
from calstudy.study.directory.session import read_session
from calstudy.study.directory.store import finished_rows, journals
from closed_form import PAPER, PLAN, ClosedForm, run_study, wait_for
from same_tables import assert_same, tables

SHORT = replace(PAPER, second_optimisation=replace(PAPER.second_optimisation, budget=4))
ROWS = (2, 5, 8, 11, 53, 56, 59, 62)
ELSEWHERE = "another boot 4026531836"


class Noting(ClosedForm):
    """Notes each run in a file of all processes."""

    log = None

    def run(self, parameters, seed, directory, stop):
        found = super().run(parameters, seed, directory, stop)
        with self.log.open("a") as file:
            file.write(directory.name.partition(".")[0] + "\n")
        return found


def work(study, log, element=None, seconds=0.0, rows=ROWS, **options):
    engine = Noting(noise=0.01, seconds=seconds)
    engine.log = log
    return run_study(study, rows, engine=engine, mode=SHORT, workers=1, element=element, **options)[1]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("undisturbed")
    work(folder / "study", folder / "log")
    return tables(folder / "study"), Counter((folder / "log").read_text().split())


@pytest.fixture
def array(tmp_path):
    """Processes, each an element of one array on one study, which the test starts."""
    context = multiprocessing.get_context("fork")
    started = []

    def start(number, of, seconds=0.0, **options):
        words = (tmp_path / "study", tmp_path / "log", Element(number, of), seconds)
        process = context.Process(target=work, args=words, kwargs=options)
        process.start()
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.join()


@pytest.mark.slow
@pytest.mark.parametrize("rerun", [None, Element(5, 8)], ids=["alone", "as an element"])
def test_eight_elements_of_which_one_is_killed_make_the_tables_of_one_process(
    array, tmp_path, undisturbed, rerun
):
    study, log = tmp_path / "study", tmp_path / "log"
    processes = [array(number, 8, seconds=0.02) for number in range(1, 9)]
    wait_for(lambda: set(journals(study)) - finished_rows(study), 120)
    (row, *_) = set(journals(study)) - finished_rows(study)
    os.kill(read_session((study / "claims" / f"row-{row:02d}.0").read_bytes()).process, signal.SIGKILL)
    for process in processes:
        process.join()
    codes = sorted(process.exitcode for process in processes)
    assert codes == [-signal.SIGKILL, *[0] * 7]
    assert work(study, log, rerun).failed == ()
    expected, runs = undisturbed
    assert_same(tables(study), expected)
    # What the killed one had under way was not on disk: one run, with one slot.
    done = Counter(log.read_text().split())
    assert done.keys() == runs.keys() and done.total() <= runs.total() + 1
    assert rerun or list((study / "claims").iterdir()) == []


def test_elements_begin_with_shares_of_their_own_and_take_what_is_left(tmp_path):
    (tmp_path / "claims").mkdir()
    groups = {row: [row] for row in (1, 2, 3, 4, 5)}
    done = set()

    def element(number):
        lock = Element(number, 2).lock(tmp_path)
        lock.acquire()
        return Claims(tmp_path, Element(number, 2), lock, groups, lambda: done)

    first, second = element(1), element(2)
    taken = [first.next(), second.next(), first.next(), second.next(), second.next()]
    assert taken == [(1,), (2,), (3,), (4,), (1 + 4,)]
    assert first.next() is None, "the other is alive, and has what is left"
    done.update({1, 3, 4, 5})
    second.release()
    first._again = 0.0
    assert first.next() == (2,)
    for claims in (first, second):
        claims.lock.release()


def claims_beside(directory, monkeypatch, patience=0.3, **changes):
    """Claims of element 1 where element 2, of another machine, has the only row."""
    monkeypatch.setattr(elements, "PATIENCE_SECONDS", patience)
    monkeypatch.setattr(elements, "BEAT_SECONDS", patience / 10)
    (directory / "claims").mkdir()
    mine, theirs = (Element(number, 2).lock(directory) for number in (1, 2))
    theirs.session = replace(theirs.session, place=ELSEWHERE, host="node7", **changes)
    (directory / "claims" / "row-07.0").write_bytes(theirs.session.line)
    theirs.path.write_bytes(theirs.session.line)
    return Claims(directory, Element(1, 2), mine, {7: [7]}, set), theirs


def test_rows_of_an_element_elsewhere_that_gives_no_sign_are_taken_over(tmp_path, monkeypatch):
    claims, _ = claims_beside(tmp_path, monkeypatch)
    assert claims.next() == ()
    wait_for(lambda: claims.next() == (7,))
    assert (tmp_path / "claims" / "row-07.1").exists()


def test_rows_of_an_element_elsewhere_that_gives_signs_are_left_to_it(tmp_path, monkeypatch):
    claims, theirs = claims_beside(tmp_path, monkeypatch, patience=20.0)
    assert claims.next() == ()
    theirs.path.write_bytes(replace(theirs.session, beat=1).line)
    wait_for(lambda: claims.next() is None)


def test_a_clock_that_jumps_ends_nobody(tmp_path, monkeypatch):
    claims, theirs = claims_beside(tmp_path, monkeypatch, patience=20.0, seen="2001-01-01T00:00:00+00:00")
    for path in (theirs.path, tmp_path / "claims" / "row-07.0"):
        os.utime(path, (0, 0))
    for _ in range(3):
        assert claims.next() == (), "taken for dead by its clock"
        claims._again = 0.0


def test_of_two_that_take_over_a_row_one_gets_it_and_the_first_owner_ends(tmp_path, monkeypatch):
    claims, theirs = claims_beside(tmp_path, monkeypatch, patience=0.01)
    other = Claims(tmp_path, Element(3, 3), Element(3, 3).lock(tmp_path), {7: [7]}, set)
    owner = Claims(tmp_path, Element(2, 3), theirs, {7: [7]}, set)
    owner._mine[7] = tmp_path / "claims" / "row-07.0"
    owner.require()
    got = Counter()
    wait_for(lambda: got.update([claims.next(), other.next()]) or got[(7,)])
    assert got[(7,)] == 1
    owner._check = 0.0
    with pytest.raises(StoreError, match="another element has taken over"):
        owner.require()


@pytest.mark.slow
def test_rows_that_share_samples_are_taken_together(array, tmp_path):
    study, log = tmp_path / "study", tmp_path / "log"
    rows = (*(row.run for row in PLAN.rows if PLAN.sampled_as(row.run) == 2), 5)
    assert len(rows) > 2
    options = {"share_samples": True, "rows": rows}
    processes = [array(number, 3, **options) for number in (1, 2, 3)]
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0, 0]
    work(tmp_path / "alone", tmp_path / "log alone", **options)
    assert_same(tables(study), tables(tmp_path / "alone"))
    assert Counter(log.read_text().split()) == Counter((tmp_path / "log alone").read_text().split())


def test_an_element_and_who_works_alone_exclude_each_other(tmp_path):
    study, log = tmp_path / "study", tmp_path / "log"
    study.mkdir()
    one = Element(1, 2).lock(study)
    one.acquire()
    with pytest.raises(InUse, match="in use by element 1, process"):
        work(study, log)
    with pytest.raises(InUse, match="in use by element 1, process"):
        work(study, log, Element(1, 2))
    one.release()
    alone = Lock(study)
    alone.acquire()
    with pytest.raises(InUse, match="in use by process"):
        work(study, log, Element(2, 2))
    alone.release()
    assert not list(study.glob("lock*"))


EMULATED = "plan run --engine emulator --fidelity coarse --rows 1,5 --budget 4 --study"


@pytest.mark.slow
def test_elements_by_the_command_say_what_each_has_done(tmp_path, capsys):
    study = tmp_path / "study"
    one = Element(1, 2).lock(study)
    study.mkdir()
    one.acquire()
    (study / "claims").mkdir()
    (study / "claims" / "row-01.0").write_bytes(one.session.line)
    assert main([*EMULATED.split(), str(study), "--array", "2/2"]) in (0, MISSED)
    assert "element 2 of 2: 1 row(s) calibrated here; row(s) 1 are being" in capsys.readouterr().err
    assert main(["plan", "status", "--study", str(study)]) == 0
    assert f"at work: element 1, process {os.getpid()} on " in capsys.readouterr().out
    assert main([*EMULATED.split(), str(study)]) == InUse.exit_code
    one.release()
    assert main([*EMULATED.split(), str(study)]) in (0, MISSED)
    assert finished_rows(study) == {1, 5} and not list((study / "claims").iterdir())


@pytest.mark.parametrize("share", ["0/8", "9/8", "3", "3/", "/8", "3/8/2", "-1/8", "a/b", "1/0"])
def test_what_is_no_share_is_refused(share, capsys):
    with pytest.raises(SystemExit, match="2"):
        main([*EMULATED.split(), "nowhere", f"--array={share}"])
    assert f"'{share}' is not a share such as 3/8" in capsys.readouterr().err


@pytest.mark.parametrize("more", ["--retry-failed", "--replicates 2", "--scheduler tcp://node1:8786"])
def test_what_is_for_one_process_is_refused_to_an_element(more, tmp_path, capsys):
    words = f"plan run --array 1/2 {more} --study {tmp_path / 'study'}"
    words += " --engine emulator" if "replicates" in more else ""
    assert main(words.split()) == InputError.exit_code
    assert f"{more.split()[0]} is for one process that works alone" in capsys.readouterr().err
