"""A failure at every operation on the disk in turn: it fails as on a full disk, or the machine dies there."""

import errno
import multiprocessing
import os
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from calstudy.disk import files, ours
from calstudy.errors import CalstudyError
from calstudy.study.directory.journal import read_journal
from closed_form import PAPER, ClosedForm, run_study
from same_tables import assert_same, tables

ROWS = (53,)
SHORT = replace(PAPER, second_optimisation=replace(PAPER.second_optimisation, budget=4))
FAILS, DIES = "fails", "dies"
DEAD = 77
OPERATIONS = ("open", "fsync", "rename", "unlink", "mkdir", "fdopen")


class FaultyFile:
    """An open file whose writes are operations, too."""

    def __init__(self, file, count):
        self._file, self._count = file, count

    def write(self, content):
        self._count("write")
        return self._file.write(content)

    def __getattr__(self, name):
        return getattr(self._file, name)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._file.close()


class FaultyOs:
    """The module ``os`` with a fault at one of its operations on the disk, which are counted from 1."""

    def __init__(self, at, how):
        self.at, self.how, self.done, self.met = at, how, 0, ""

    def _count(self, name):
        self.done += 1
        if self.done == self.at:
            self.met = name
            if self.how == DIES:
                os._exit(DEAD)
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def __getattr__(self, name):
        real = getattr(os, name)
        if name not in OPERATIONS:
            return real

        def counted(*arguments, **options):
            self._count(name)
            found = real(*arguments, **options)
            return FaultyFile(found, self._count) if name == "fdopen" else found

        return counted


@contextmanager
def faulty(at, how):
    """A fault at the operation of that number, in what writes and removes files."""
    wrapped = FaultyOs(at, how)
    with pytest.MonkeyPatch.context() as patch:
        for module in (files, ours):
            patch.setattr(module, "os", wrapped)
        yield wrapped


def work(directory, log, at=0, how=FAILS):
    """Calibrate; returns how it ended and the number of operations. Engine calls are appended to a log."""

    def note(_):
        with log.open("a") as file:
            file.write(".")

    with faulty(at, how) as wrapped:
        try:
            run_study(directory, ROWS, engine=ClosedForm(noise=0.01, on_call=note), mode=SHORT, workers=1)
            ended = "ok"
        except (CalstudyError, OSError) as error:
            ended = type(error).__name__
    return ended, wrapped.done, wrapped.met


def _child(directory, log, at, how, answer):
    answer.send(work(directory, log, at, how))


def durable(directory):
    """Number of DEM runs that are on disk, by whole lines."""
    return len(read_journal(directory / "journal" / f"row-{ROWS[0]:02d}.jsonl").evaluations)


def check(folder: Path, step: int = 1, hows=(FAILS, DIES)) -> dict[str, int]:
    """Inject a fault at every ``step``-th operation. AssertionError: a run is lost or repeated."""
    context = multiprocessing.get_context("fork")
    whole, log = folder / "whole", folder / "log"
    ended, operations, _ = work(whole, log)
    assert ended == "ok"
    runs, expected = log.stat().st_size, tables(whole)
    met: dict[str, int] = {}
    for how in hows:
        for at in range(1, operations + 1, step):
            study, log = folder / f"{how}-{at}", folder / f"log-{how}-{at}"
            log.touch()
            mine, theirs = context.Pipe(False)
            child = context.Process(target=_child, args=(study, log, at, how, theirs))
            child.start()
            theirs.close()
            try:
                ended, _, name = mine.recv()
            except EOFError:
                ended, name = "died", "any"
            child.join()
            assert child.exitcode == (DEAD if ended == "died" else 0)
            kept, before = durable(study) if study.exists() else 0, log.stat().st_size
            assert kept >= before - 1, f"{how} at {at} ({name}): a run that had ended is lost"
            assert work(study, log)[0] == "ok", f"{how} at {at} ({name})"
            assert_same(tables(study), expected)
            assert log.stat().st_size - before == runs - kept, f"{how} at {at}: a durable run was run again"
            left = [path for path in study.rglob(".*") if path.name.endswith(".part")]
            assert len(left) <= 1, "a part that waits for its name is replaced, not added to"
            met[f"{how}, {ended}"] = met.get(f"{how}, {ended}", 0) + 1
    return {"operations": operations, "faults": sum(met.values()), **met}
