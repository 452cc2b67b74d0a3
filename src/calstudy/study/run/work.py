"""Calibrations and their study, run by a campaign."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import os
import shlex
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import Mode
from calstudy.calibration.task import Task
from calstudy.disk.files import open_to_append, write_atomically
from calstudy.engines.choose import engines_and_executor, slots
from calstudy.engines.interface import Engine, Model
from calstudy.engines.queue import Executor, LocalExecutor, cores
from calstudy.errors import OutOfTime, Stopped, StoreError
from calstudy.parameters import Array
from calstudy.records import Request
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign, Summary
from calstudy.study.directory.begun import mismatch
from calstudy.study.directory.elements import Element
from calstudy.study.directory.session import LOG_FILE
from calstudy.study.directory.store import Store
from calstudy.study.prior import Prior
from calstudy.study.settings import StudySettings
from calstudy.study.stored import StoredRuns
from calstudy.written import printable

MODELS_FILE = "models.json"
"""What the models of one's own were when a study was begun, so that a change of them can be told."""
Say = Callable[[str], None]
"""Takes each message, which is one line."""
Watch = Callable[[Campaign], AbstractContextManager[object]]
"""Context of a running campaign, which may show its progress."""


@dataclass(frozen=True, slots=True)
class Running:
    """How DEM runs are run. Nothing here changes a result."""

    workers: int | None = None
    """DEM runs at once; None: one for each core, or all threads of the cluster."""
    time_limit: float | None = None
    """Time in s by which every DEM run must have ended; None: no limit."""
    scratch: Path | None = None
    """Working directory of DEM runs; None: ``runs`` in the study."""
    keep_runs: bool = False
    """Keep the directory of each DEM run."""
    retry_failed: bool = False
    """Start failed calibrations again, with their broken DEM runs."""
    command: str | None = None
    """Command of the DEM program; None: its profile finds it."""
    scheduler: str | None = None
    """Address of the scheduler of a Dask cluster; None: this machine."""
    wait_workers: float | None = None
    """Time in s that the cluster may be without workers; None: a day."""
    element: Element | None = None
    """Element of a job array, which takes its share of the rows; None: all rows are this command's."""

    @property
    def slots(self) -> int:
        """DEM runs at once on this machine."""
        return self.workers or cores()

    def scratch_of(self, directory: Path) -> Path:
        """Working directory of the DEM runs of a study; absolute for the workers of a cluster."""
        scratch = self.scratch or directory / "runs"
        if self.scratch and scratch.is_symlink():  # the user's own; one in a study is not followed
            scratch = scratch.resolve()
        return scratch.absolute() if self.scheduler else scratch

    def engines(
        self, models: Sequence[tuple[Model, str]], stop: threading.Event, engine: str | None = None
    ) -> tuple[list[Engine], Executor]:
        """Engine of each model, given with the prefix of its responses, and the executor of its runs.

        ``engine`` is a name in the table of engines. SetupError: a program or the cluster is missing.
        """
        return engines_and_executor(
            models,
            stop,
            engine,
            workers=self.workers,
            scheduler=self.scheduler,
            command=self.command,
            wait=self.wait_workers,
        )

    def here(self, stop: threading.Event | None = None, *models: Model) -> LocalExecutor:
        """Executor of open engines on this machine, which may run these models."""
        return LocalExecutor(self.workers or slots(*models), stop or threading.Event())


@dataclass(frozen=True, slots=True)
class Work:
    """Calibrations, the engines that answer them, and their study."""

    tasks: Mapping[int, Task]
    """By row; includes rows whose samples ``rows`` share."""
    rows: Sequence[int]
    tests: Sequence[MaterialTest]
    settings: StudySettings
    directory: Path
    follow: Sequence[Request] = ()
    """Requests of another study's rows, to be repeated to the last digit."""
    option: str = "--study"
    """Option of the command line for the directory."""
    stored: StoredRuns | None = None
    """Runs of other studies, which are not repeated; None if they were not looked for."""
    models: Mapping[str, Any] = field(default_factory=dict)
    """What each model of one's own is, by its label, in JSON's types."""
    cheap: Sequence[MaterialTest] = ()
    """Those of the cheap fidelity, in the order of ``tests``; empty for one fidelity."""
    prior: Prior | None = None
    """Runs of an earlier study that a calibration starts from."""

    @property
    def mode(self) -> Mode:
        """Mode of its calibrations."""
        return next(iter(self.tasks.values())).mode

    @property
    def other_study(self) -> StoreError | None:
        """Error if the directory holds another study; the version of the program does not count."""
        return mismatch(self.directory, self.settings, self.option, any_version=True)


class Sequel(Protocol):
    """Work that follows a campaign while the study is still locked."""

    def run(self) -> None:
        """Do the work; raises as ``run``."""

    def in_words(self) -> str:
        """Progress in a few words."""


def silent(message: str) -> None:
    """Drop a message."""


def unwatched(campaign: Campaign) -> AbstractContextManager[object]:
    """Watch nothing."""
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
    """Run calibrations into their study, which continues where it stopped; closes the executor.

    ``then`` makes the work that follows them. Raises Stopped and OutOfTime as ``Campaign.run``, StoreError if
    the directory holds another study.
    """
    directory = work.directory
    for line in _headings(work, executor.slots):
        say(line)
    try:
        with Store(directory, work.settings, work.option, how.element) as store, _log_file(directory):
            if work.models and not (directory / MODELS_FILE).exists():
                content = json.dumps(work.models).encode() + b"\n"
                write_atomically(directory / MODELS_FILE, content, directory)
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
                cheap=work.cheap,
                follow=work.follow,
                known=work.stored.known if work.stored else {},
                announce=announce,
                warn=say,
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
    """Messages about what will be run, its target and its known noise."""
    settings = work.settings
    if settings.case is not None:
        taken = [_taken_over(work.stored, work.tasks)] if work.stored and work.stored.places else []
        prior = [f"Prior: {work.prior.in_words}"] if work.prior else []
        return [
            f"Calibration {work.directory}: {slots} DEM run(s) at once",
            f"Target: {settings.target.origin}",
            *prior,
            *taken,
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


def _taken_over(stored: StoredRuns, tasks: Mapping[int, Task]) -> str:
    samples = sum(len(task.stored) for task in tasks.values())
    places = ", ".join(map(str, stored.places))
    return f"Stored: {len(stored.known)} run(s) of {places}; {samples} serve(s) as samples"


class _Formatter(logging.Formatter):
    """Shows control characters of arguments and reasons by their codes."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


class _LogFile(logging.StreamHandler):
    """Ignores a full disk, which is reported where results are written, not for each line of the log."""

    def handleError(self, record: logging.LogRecord) -> None:
        pass


@contextlib.contextmanager
def _log_file(directory: Path) -> Iterator[None]:
    """Log into the study while the block runs."""
    logger = logging.getLogger("calstudy")
    file = open_to_append(directory / LOG_FILE, directory)
    handler = _LogFile(io.TextIOWrapper(file, errors="backslashreplace", line_buffering=True))
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
        with contextlib.suppress(OSError):
            handler.stream.close()
