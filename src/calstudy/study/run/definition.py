"""A calibration defined by a file, run into its study."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from pathlib import Path

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.solutions import forecast
from calstudy.calibration.task import Task
from calstudy.engines.interface import Engine
from calstudy.engines.queue import Executor
from calstudy.errors import RunError
from calstudy.parameters import Array
from calstudy.study.definition import Definition, read_definition
from calstudy.study.directory.begun import begun_with
from calstudy.study.directory.store import read_lines
from calstudy.study.reading import Result, read_result
from calstudy.study.reread import keeping, remember, reread
from calstudy.study.run.refusal import refusal
from calstudy.study.run.taking import definition_work, settings_of, take_over
from calstudy.study.run.trial import require_sound, try_models
from calstudy.study.run.work import Running, Say, Watch, Work, run, silent, unwatched
from calstudy.study.settings import SETTINGS_FILE
from calstudy.study.status import failures
from calstudy.study.stored import StoredRuns

log = logging.getLogger(__name__)


def calibrate_file(
    file: str | Path,
    path: str | Path | None = None,
    how: Running | None = None,
    *,
    models: Sequence[Path] = (),
    insist: bool = False,
) -> Result:
    """Calibrate what a file says, as ``calstudy calibrate`` does; ``write_report`` makes its pages.

    ``path`` is the study, by default ``studies/FILE``; ``models`` are directories that hold model folders;
    ``insist`` takes implausible values. The same call goes on where it stopped. Raises InputError with the
    line of the file, SetupError without the DEM program, RunError if the calibration failed.
    """
    file, how, stop = Path(file), how or Running(), threading.Event()
    directory = Path(path or Path("studies") / file.stem)
    definition = read_definition(file, models, insist, *begun_with(directory))
    engines, executor = how.engines(definition.programs, stop)
    return finished(*calibrate_definition(definition, engines, executor, directory, how, stop), directory)


def calibrate_definition(
    definition: Definition,
    engines: Sequence[Engine],
    executor: Executor,
    directory: Path,
    how: Running,
    stop: threading.Event,
    *,
    say: Say = silent,
    watch: Watch = unwatched,
) -> tuple[Definition, Result | None]:
    """Read kept runs anew, try new models, take stored runs over, and calibrate; closes the executor.

    Returns the definition with the samples that were taken over, and the result, None if the calibration
    failed. Raises StoreError where the directory holds another study, and as ``prepare`` and ``run``.
    """
    engines = [keeping(engine, directory.parent) for engine in engines]
    try:
        taken, stored = prepare(definition, engines, directory, how, stop, say)
        work = definition_work(taken, engines, directory, stored)
        if other := refusal(taken, engines, work, executor.slots):
            raise other
    except BaseException:
        executor.close()
        raise
    return taken, run_definition(taken, work, executor, how, stop, say=say, watch=watch)


def prepare(
    definition: Definition,
    engines: Sequence[Engine],
    directory: Path,
    how: Running,
    stop: threading.Event,
    say: Say = silent,
) -> tuple[Definition, StoredRuns]:
    """Read kept runs anew, try models that no run of the project has proven, and take stored runs over.

    Raises RunError for a model that fails its trial; SetupError, Stopped as ``try_models``.
    """
    taken, stored = take_over(definition, engines, directory)
    if (directory / SETTINGS_FILE).exists():
        return taken, stored
    project, scratch = directory.parent, how.scratch_of(directory)
    if again := reread(engines, project, stored.known, scratch, stop):
        for of_model in again:
            say(of_model.in_words)
        remember(again, project)
        taken, stored = take_over(definition, engines, directory)
    trials = try_models(definition, engines, project, scratch, stop, say, stored)
    require_sound(trials)
    return take_over(definition, engines, directory) if trials else (taken, stored)


def run_definition(
    definition: Definition,
    work: Work,
    executor: Executor,
    how: Running,
    stop: threading.Event | None = None,
    *,
    say: Say = silent,
    watch: Watch = unwatched,
) -> Result | None:
    """Run a calibration; None if it failed. Raises as ``run``."""

    def announce(task: Task, surrogates: Surrogates, optimum: Array) -> None:
        for line in forecast(task, surrogates, optimum, work.settings.quantities.units):
            log.info("%s", line)
            say(line)

    run(work, executor, how, stop, say=say, watch=watch, announce=announce)
    return read_result(work.directory, definition, work.settings)


def finished(definition: Definition, result: Result | None, directory: Path) -> Result:
    """The result; RunError with the reason if the calibration failed."""
    if result is None:
        quantities = settings_of(definition, "").quantities
        line = read_lines(directory, "calibrations", quantities)[0]
        broken = failures(read_lines(directory, "evaluations", quantities))
        why = f"; the latest of {broken[0].runs} failed runs: {broken[0].reason}" if broken else ""
        raise RunError(f"the calibration failed: {line['reason']}{why}")
    return result
