"""What ``plan run`` and ``calibrate`` share: engines and where they run, the study's log, failed DEM runs."""

from __future__ import annotations

import contextlib
import logging
import os
import shlex
import sys
import threading
from argparse import Namespace
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console

from calstudy.dispatch import Executor, LocalExecutor
from calstudy.engine import LiggghtsEngine, Model
from calstudy.liggghts import find_liggghts
from calstudy.status import Failure
from calstudy.terminal import cores
from calstudy.written import printable

FAILED_ROWS = 8
"""Exit code where a calibration failed."""
MISSED = 11
"""Exit code where every calibration is finished, and a target was missed."""
LOG_FILE = "calstudy.log"


def engines_and_executor(
    a: Namespace, models: Sequence[tuple[Model, str]], stop: threading.Event
) -> tuple[list[LiggghtsEngine[Model]], Executor]:
    """What runs each model (with the prefix of its responses), and where: threads here, or a cluster."""
    if a.scheduler is None:
        program = find_liggghts(a.liggghts)
        here = [LiggghtsEngine(model, program, prefix) for model, prefix in models]
        return here, LocalExecutor(a.workers or cores(), stop)
    from calstudy.cluster import DaskExecutor, WorkersEngine

    cluster = DaskExecutor(a.scheduler, a.workers)
    try:
        version = cluster.liggghts_version(a.liggghts, stop)
        return [WorkersEngine(model, version, a.liggghts, prefix) for model, prefix in models], cluster
    except BaseException:
        cluster.close()
        raise


def print_failures(out: Console, directory: Path, found: Sequence[Failure], scratch: Path) -> None:
    """Say which DEM runs gave no responses, and where to look."""
    for f in found:
        out.print(
            f"{f.runs} DEM run(s) {f.outcome.replace('_', ' ')}; the last, of row {f.row}: {f.reason}\n"
            f"  deck and log: {scratch / f.run_id} on {f.host}; all: {directory / LOG_FILE}",
            style="yellow",
            highlight=False,
            soft_wrap=True,
        )


def print_paths(out: Console, heading: str, paths: Sequence[Path | str]) -> None:
    """Name files, or a command, under a heading; nothing where there are none."""
    for line in [heading, *(f"  {path}" for path in paths)] if paths else []:
        out.print(line, highlight=False, soft_wrap=True)


class _LogFile(logging.FileHandler):
    """A full disk is noticed where results are written; the log must not add a traceback for each line."""

    def handleError(self, record: logging.LogRecord) -> None:
        pass


class _Formatter(logging.Formatter):
    """Arguments and reasons may hold control characters, which a log file shows as their codes."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


@contextlib.contextmanager
def log_file(directory: Path) -> Iterator[None]:
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
