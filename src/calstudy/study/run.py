"""Run a plan or a calibration: what a command assembles, as functions."""

from __future__ import annotations

import contextlib
import logging
import os
import shlex
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from rich.console import Console

from calstudy import __version__
from calstudy.calibration.modes import Mode, mode_of
from calstudy.calibration.solutions import forecast
from calstudy.calibration.surrogates import Surrogates
from calstudy.calibration.task import Task, tasks_of
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.function import FunctionEngine, FunctionModel
from calstudy.engines.interface import Engine
from calstudy.engines.profiles import LIGGGHTS
from calstudy.engines.queue import Executor, LocalExecutor, cores
from calstudy.errors import InputError, OutOfTime, RunError, Stopped
from calstudy.models.angle_of_repose import AngleOfReposeModel
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.models.noise import known_noise
from calstudy.models.targets import describe
from calstudy.parameters import Array
from calstudy.plan import PARAMETERS, Plan
from calstudy.plan_check import check
from calstudy.records import Request, Target, proportional
from calstudy.study.campaign import Campaign, MaterialTest, Summary
from calstudy.study.definition import ROW, Chosen, Definition, define, read_definition
from calstudy.study.reading import Result, Study, read_result, read_study
from calstudy.study.session import LOG_FILE
from calstudy.study.settings import StudySettings
from calstudy.study.status import failures
from calstudy.study.store import Store, grid_there, read_lines, version_there
from calstudy.tomlfile import Section
from calstudy.written import choice, printable

MISSED = 11
"""Exit code where every calibration is finished, and a target was missed."""

log = logging.getLogger(__name__)

Say = Callable[[str], None]
"""Hears each message, one line."""
Watch = Callable[[Campaign], AbstractContextManager[object]]
"""Is entered while a campaign runs, and may look at its progress."""


@dataclass(frozen=True, slots=True)
class Running:
    """How DEM runs are run: nothing here decides a result."""

    workers: int | None = None
    """DEM runs at once; None: one a core."""
    time_limit: float | None = None
    """Seconds after which no DEM run may end; None: without end."""
    scratch: Path | None = None
    """Where DEM runs work; None: ``runs`` in the study."""
    keep_runs: bool = False
    """Whether the directory of each DEM run is kept."""
    retry_failed: bool = False
    """Whether failed calibrations are begun again, with their broken DEM runs."""


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


class Sequel(Protocol):
    """What follows a campaign while its study is still held."""

    def run(self) -> None:
        """Do it; raises as ``run`` does."""

    def in_words(self) -> str:
        """How far it is, in a few words."""


def _silent(message: str) -> None:
    """Nobody listens."""


def _unwatched(campaign: Campaign) -> AbstractContextManager[object]:
    return contextlib.nullcontext()


def run(
    work: Work,
    executor: Executor,
    how: Running,
    stop: threading.Event | None = None,
    *,
    say: Say = _silent,
    watch: Watch = _unwatched,
    announce: Callable[[Task, Surrogates, Array], None] | None = None,
    then: Callable[[Store], Sequel] | None = None,
) -> Summary:
    """Run calibrations into their study, which goes on where it stopped; closes the executor.

    ``then`` makes what follows them.

    Raises Stopped and OutOfTime as ``Campaign.run``, StoreError where the directory is another study.
    """
    directory = work.directory
    try:
        with Store(directory, work.settings, work.option) as store, log_file(directory):
            told = list(store.notes)
            for note in told:
                say(f"NOTE {note}")
            sequel = then(store) if then else None
            campaign = Campaign(
                work.tasks,
                work.tests,
                store,
                executor,
                scratch=how.scratch or directory / "runs",
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


def run_calibration(
    definition: Definition,
    engines: Sequence[Engine],
    directory: Path,
    executor: Executor,
    how: Running,
    stop: threading.Event | None = None,
    *,
    say: Say = _silent,
    watch: Watch = _unwatched,
) -> Result | None:
    """Run a calibration, each model by its engine; None where it failed. Raises as ``run``."""
    settings = settings_of(definition, engines[0].identity, version_there(directory))
    tests = [
        MaterialTest(engine, tuple(chosen.parameters))
        for engine, chosen in zip(engines, definition.models, strict=True)
    ]
    say(f"Calibration {directory}: {executor.slots} DEM run(s) at once")
    say(f"Target: {settings.target.origin}")

    def announce(task: Task, surrogates: Surrogates, optimum: Array) -> None:
        for line in forecast(task, surrogates, optimum, settings.quantities.units):
            log.info("%s", line)
            say(line)

    work = Work({ROW: definition.task}, [ROW], tests, settings, directory)
    run(work, executor, how, stop, say=say, watch=watch, announce=announce)
    return read_result(directory, definition, settings)


def run_plan(
    plan: Plan,
    engine: Engine,
    rows: Sequence[int] | None = None,
    path: str | Path = "studies/mine",
    *,
    target: Target | None = None,
    mode: str = "paper",
    budget: int | None = None,
    seed: int = 1,
    share_samples: bool = False,
    how: Running | None = None,
) -> Study:
    """Calibrate rows of a plan (default: all) into the study at ``path``, and read it.

    ``target`` None is the paper's. The same call goes on where it stopped. Raises InputError for a wrong
    plan, row or mode, StoreError where ``path`` holds another study.
    """
    check(plan).refuse_if_wrong()
    chosen = [row.run for row in plan.rows] if rows is None else [plan.row(row).run for row in rows]
    directory, how = Path(path), how or Running()
    model = _model_of(engine)
    found = mode_of(mode, budget, grid_there(directory)).knowing(proportional(model.responses))
    target = target or paper_target(plan, engine.identity)
    settings = plan_settings(
        plan, model, engine.identity, found, target, seed, share_samples, version_there(directory)
    )
    tasks = tasks_of(plan, target, found, seed, share_samples, settings.noise)
    work = Work(tasks, chosen, [MaterialTest(engine, PARAMETERS)], settings, directory)
    run(work, _here(how), how)
    return read_study(directory)


def _here(how: Running) -> LocalExecutor:
    return LocalExecutor(how.workers or cores(), threading.Event())


def paper_target(plan: Plan, engine: str) -> Target:
    """The responses that the plan's paper calibrated to; says so where an emulator answers."""
    values = {ANGLE_OF_REPOSE: plan.targets.angle_of_repose_deg, BULK_DENSITY: plan.targets.bulk_density}
    answers = f"; responses of {engine}" if engine.startswith("emulator ") else ""
    return Target(values, "paper", f"the paper's {describe(values)}{answers}")


def _model_of(engine: Engine) -> AngleOfReposeModel:
    """Model of an engine that a plan is run on; InputError where it is another one."""
    model = getattr(engine, "model", None)
    if not isinstance(model, AngleOfReposeModel):
        raise InputError(f"{engine.identity} does not run the angle-of-repose model, which a plan calibrates")
    return model


def plan_settings(
    plan: Plan,
    model: AngleOfReposeModel,
    engine: str,
    mode: Mode,
    target: Target,
    seed: int,
    share_samples: bool = False,
    calstudy: str = __version__,
) -> StudySettings:
    """What makes two studies of a plan the same.

    ``engine`` is an engine's identity, ``calstudy`` the version that the study was begun with.
    """
    return StudySettings(
        plan=plan.name,
        plan_hash=plan.hash,
        model=model.name,
        deck=model.deck,
        model_hash=model.hash,
        fidelity=model.fidelity.name,
        variant=model.variant.name,
        engine=engine,
        calstudy=calstudy,
        mode=mode.name,
        budget=mode.second_optimisation.budget,
        seed=seed,
        target=target,
        share_samples=share_samples,
        noise=known_noise(model.name, model.hash) if mode.takes_noise else None,
        grid=mode.grid,
    )


def calibrate_file(file: str | Path, path: str | Path | None = None, how: Running | None = None) -> Result:
    """Calibrate what a file says through LIGGGHTS, as ``calstudy calibrate`` does, without its report.

    ``path`` is the study, by default ``studies/FILE``. The same call goes on where it stopped. Raises
    InputError with the line of the file, SetupError without LIGGGHTS, RunError where the calibration failed.
    """
    file, how = Path(file), how or Running()
    directory = Path(path or Path("studies") / file.stem)
    definition = read_definition(file, grid=grid_there(directory))
    program = LIGGGHTS.find(None)
    engines = [ProgramEngine(model, program, prefix) for model, prefix in definition.programs]
    return _finished(run_calibration(definition, engines, directory, _here(how), how), definition, directory)


def calibrate(
    function: Callable[..., object],
    parameters: Mapping[str, tuple[float, float] | float],
    targets: Mapping[str, float],
    *,
    units: Mapping[str, str] | None = None,
    tolerances: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    mode: str = "robust",
    samples_per_parameter: int | None = None,
    budget: int | None = None,
    seed: int = 1,
    workers: int = 1,
    path: str | Path | None = None,
    version: str = "",
) -> Result:
    """Calibrate a Python function to targets, by the procedure that ``calstudy calibrate`` runs.

    Parameters
    ----------
    function : takes the parameters as keywords, or one mapping, and a ``seed`` if it has such an argument;
        returns a mapping with each response, or the only response. What it raises fails that run.
    parameters : an interval (lower, upper) for each that is calibrated, a number for each that is fixed.
    targets : desired responses, positive (Eq. 9 divides by them).
    units : of parameters and responses, "-" where not named.
    tolerances : deviations from the targets at which the second optimisation ends, in units of the responses.
    noise : known standard deviations of the responses from seed to seed.
    mode, samples_per_parameter, budget, seed : as in the file of ``calstudy calibrate``; WRL is 0.
    workers : calls at once, by threads.
    path : the study, which goes on where it stopped; None keeps nothing.
    version : what tells the function from others of its name; by default a hash of its source.

    Raises
    ------
    InputError : what is wrong with the arguments, RunError : the calibration failed.
    """
    tolerances, noise, units = tolerances or {}, noise or {}, units or {}
    _require_known("units", units, (*parameters, *targets))
    _require_known("tolerances", tolerances, targets)
    _require_known("noise", noise, targets)
    engine = FunctionEngine(
        function,
        {name: units.get(name, "-") for name in parameters},
        {name: units.get(name, "-") for name in targets},
        version or ("" if path else "of this process"),
    )
    said: dict[str, object] = {
        "mode": mode,
        "seed": seed,
        "WRL": 0.0,
        "parameters": {n: list(p) if isinstance(p, Sequence) else p for n, p in parameters.items()},
        "targets": {
            name: {"value": value}
            | ({"tolerance": tolerances[name]} if name in tolerances else {})
            | ({"noise": noise[name]} if name in noise else {})
            for name, value in targets.items()
        },
    }
    said |= {} if budget is None else {"budget": budget}
    said |= {} if samples_per_parameter is None else {"samples_per_parameter": samples_per_parameter}
    model = Chosen(FunctionModel(engine), engine.name, "")
    with tempfile.TemporaryDirectory(prefix="calstudy-") as scratch:
        directory = Path(path or scratch)
        definition = define(Section(Path(engine.name), said, {}), (model,), grid=grid_there(directory))
        how = Running(workers=workers, scratch=Path(scratch) / "runs")
        found = run_calibration(definition, [engine], directory, _here(how), how)
        return _finished(found, definition, directory)


def _require_known(
    what: str, given: Mapping[str, object], known: Sequence[str] | Mapping[str, object]
) -> None:
    for name in given:
        if name not in known:
            raise InputError(f"{what}: {name} is unknown; {choice(name, known, 'there are')}")


def _finished(result: Result | None, definition: Definition, directory: Path) -> Result:
    """The result; RunError with the reason where the calibration failed."""
    if result is None:
        quantities = settings_of(definition, "").quantities
        line = read_lines(directory, "calibrations", quantities)[0]
        broken = failures(read_lines(directory, "evaluations", quantities))
        why = f"; the latest of {broken[0].runs} failed runs: {broken[0].reason}" if broken else ""
        raise RunError(f"the calibration failed: {line['reason']}{why}")
    return result


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
