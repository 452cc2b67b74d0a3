"""Calibrations and the study that they go into, run by a campaign: what every command comes down to."""

from __future__ import annotations

import contextlib
import logging
import os
import shlex
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from calstudy.calibration.modes import Mode
from calstudy.calibration.surrogates import Surrogates
from calstudy.calibration.task import Task
from calstudy.engines.choose import engines_and_executor
from calstudy.engines.interface import Engine, Model
from calstudy.engines.queue import Executor, LocalExecutor, cores
from calstudy.errors import OutOfTime, Stopped, StoreError
from calstudy.parameters import Array
from calstudy.records import Request
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign, Summary
from calstudy.study.session import LOG_FILE
from calstudy.study.settings import StudySettings
from calstudy.study.store import Store, mismatch
from calstudy.written import printable

Say = Callable[[str], None]
"""Hears each message, one line."""
Watch = Callable[[Campaign], AbstractContextManager[object]]
"""Is entered while a campaign runs, and may look at its progress."""


@dataclass(frozen=True, slots=True)
class Running:
    """How DEM runs are run: nothing here decides a result."""

    workers: int | None = None
    """DEM runs at once; None: one a core, or all threads of a cluster's workers."""
    time_limit: float | None = None
    """Seconds after which no DEM run may end; None: without end."""
    scratch: Path | None = None
    """Where DEM runs work; None: ``runs`` in the study."""
    keep_runs: bool = False
    """Whether the directory of each DEM run is kept."""
    retry_failed: bool = False
    """Whether failed calibrations are begun again, with their broken DEM runs."""
    command: str | None = None
    """Command of the DEM program, where it is not found by its name."""
    scheduler: str | None = None
    """Address of a Dask cluster's scheduler; None: runs are on this machine."""

    @property
    def slots(self) -> int:
        """DEM runs at once on this machine."""
        return self.workers or cores()

    def scratch_of(self, directory: Path) -> Path:
        """Where the DEM runs of a study work; absolute for a cluster's workers, which stand elsewhere."""
        scratch = self.scratch or directory / "runs"
        return scratch.absolute() if self.scheduler else scratch

    def engines(
        self, models: Sequence[tuple[Model, str]], stop: threading.Event, engine: str | None = None
    ) -> tuple[list[Engine], Executor]:
        """What runs each model (with the prefix of its responses), and where.

        ``engine`` is a name of the table of engines. Raises SetupError where a program or the cluster is not
        there.
        """
        return engines_and_executor(
            models, stop, engine, workers=self.workers, scheduler=self.scheduler, command=self.command
        )

    def here(self, stop: threading.Event | None = None) -> LocalExecutor:
        """Runs engines that are open on this machine."""
        return LocalExecutor(self.slots, stop or threading.Event())


@dataclass(frozen=True, slots=True)
class Work:
    """Calibrations, what answers them, and the study that they go into."""

    tasks: Mapping[int, Task]
    """By row; those that share samples with ``rows`` are among them."""
    rows: Sequence[int]
    tests: Sequence[MaterialTest]
    settings: StudySettings
    directory: Path
    follow: Sequence[Request] = ()
    """What another study's rows asked for, to be asked again."""
    option: str = "--study"
    """What names the directory on the command line."""

    @property
    def mode(self) -> Mode:
        """Of all its calibrations."""
        return next(iter(self.tasks.values())).mode

    @property
    def other_study(self) -> StoreError | None:
        """Error where the directory holds another study, whatever the version of its program."""
        return mismatch(self.directory, self.settings, self.option, any_version=True)


class Sequel(Protocol):
    """What follows a campaign while its study is still held."""

    def run(self) -> None:
        """Do it; raises as ``run`` does."""

    def in_words(self) -> str:
        """How far it is, in a few words."""


def silent(message: str) -> None:
    """Nobody listens."""


def unwatched(campaign: Campaign) -> AbstractContextManager[object]:
    """Nobody looks."""
    return contextlib.nullcontext()


def run(
    work: Work,
    executor: Executor,
    how: Running,
    stop: threading.Event | None = None,
    *,
    say: Say = silent,
    watch: Watch = unwatched,
    announce: Callable[[Task, Surrogates, Array], None] | None = None,
    then: Callable[[Store], Sequel] | None = None,
) -> Summary:
    """Run calibrations into their study, which goes on where it stopped; closes the executor.

    ``then`` makes what follows them.

    Raises Stopped and OutOfTime as ``Campaign.run``, StoreError where the directory is another study.
    """
    directory = work.directory
    for line in _headings(work, executor.slots):
        say(line)
    try:
        with Store(directory, work.settings, work.option) as store, _log_file(directory):
            told = list(store.notes)
            for note in told:
                say(f"NOTE {note}")
            sequel = then(store) if then else None
            campaign = Campaign(
                work.tasks,
                work.tests,
                store,
                executor,
                scratch=how.scratch_of(directory),
                keep_runs=how.keep_runs,
                retry_failed=how.retry_failed,
                time_limit=how.time_limit,
                follow=work.follow,
                announce=announce,
                stop=stop,
            )
            with watch(campaign):
                summary = campaign.run(work.rows)
            for note in store.notes[len(told) :]:
                say(f"NOTE {note}")
            if sequel:
                sequel.run()
    except (Stopped, OutOfTime) as error:
        done = "; ".join([campaign.in_words(), *([sequel.in_words()] if sequel else [])])
        raise type(error)(
            f"{error}: {done}; all are saved in {directory}, and the same command goes on"
        ) from error
    finally:
        executor.close()
    return summary


def _headings(work: Work, slots: int) -> list[str]:
    """What is going to be run, towards which target, with which noise known."""
    settings = work.settings
    if settings.case is not None:
        return [
            f"Calibration {work.directory}: {slots} DEM run(s) at once",
            f"Target: {settings.target.origin}",
        ]
    known = "never measured for this model; each row estimates it from its own runs"
    if settings.noise is not None:
        each = ", ".join(f"{name} {sd:.3g}" for name, sd in settings.noise.items())
        known = f"{each} from seed to seed, as measured"
    return [
        f"Study {work.directory}: {len(work.rows)} row(s), {slots} DEM run(s) at once",
        f"Target: {settings.target.origin}",
        *([f"Noise: {known}"] if work.mode.takes_noise else []),
    ]


class _Formatter(logging.Formatter):
    """Arguments and reasons may hold control characters, which a log file shows as their codes."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


class _LogFile(logging.FileHandler):
    """A full disk is noticed where results are written; the log must not add a traceback for each line."""

    def handleError(self, record: logging.LogRecord) -> None:
        pass


@contextlib.contextmanager
def _log_file(directory: Path) -> Iterator[None]:
    """Log what calstudy does into the study while the block runs."""
    logger = logging.getLogger("calstudy")
    handler = _LogFile(directory / LOG_FILE)
    handler.setFormatter(_Formatter("%(asctime)s %(levelname)s %(message)s"))
    logger.addHandler(handler)
    level = logger.level
    logger.setLevel(logging.INFO)
    logger.info("process %d: %s", os.getpid(), shlex.join(sys.argv))
    try:
        yield
    except BaseException as error:
        logger.error("%s: %s", type(error).__name__, error)
        raise
    finally:
        logger.setLevel(level)
        logger.removeHandler(handler)
        handler.close()
