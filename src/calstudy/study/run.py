"""Run a plan or a calibration: what a command assembles, as functions."""

from __future__ import annotations

import contextlib
import logging
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console

from calstudy import __version__
from calstudy.study.definition import Definition
from calstudy.study.session import LOG_FILE
from calstudy.study.settings import StudySettings
from calstudy.written import printable

MISSED = 11
"""Exit code where every calibration is finished, and a target was missed."""


def print_paths(out: Console, heading: str, paths: Sequence[Path | str]) -> None:
    """Name files, or a command, under a heading; nothing where there are none."""
    for line in [heading, *(f"  {path}" for path in paths)] if paths else []:
        out.print(line, highlight=False, soft_wrap=True)


class _Formatter(logging.Formatter):
    """Arguments and reasons may hold control characters, which a log file shows as their codes."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def settings_of(definition: Definition, engine: str, calstudy: str = __version__) -> StudySettings:
    """What makes two calibrations the same; ``calstudy`` is the version that they were begun with."""
    task, models = definition.task, definition.models
    one = models[0] if len(models) == 1 else None
    return StudySettings(
        plan=f"calibration {definition.path.stem}",
        plan_hash=definition.hash,
        model="+".join(chosen.label for chosen in models),
        deck=one.model.deck if one else 0,
        model_hash="+".join(chosen.model.hash for chosen in models),
        fidelity="+".join(dict.fromkeys(chosen.fidelity for chosen in models if chosen.fidelity)),
        variant="+".join(dict.fromkeys(chosen.variant for chosen in models if chosen.variant)),
        engine=engine,
        calstudy=calstudy,
        mode=task.mode.name,
        budget=task.mode.second_optimisation.budget,
        seed=task.seed,
        target=task.cost.target,
        case=definition.case,
        grid=task.mode.grid,
    )


class _LogFile(logging.FileHandler):
    """A full disk is noticed where results are written; the log must not add a traceback for each line."""

    def handleError(self, record: logging.LogRecord) -> None:
        pass


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
