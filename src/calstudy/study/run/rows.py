"""Rows of a plan, calibrated into a study, and rows of a study calibrated again to compare them."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from calstudy import __version__
from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.calibration.modes import Mode, mode_of
from calstudy.calibration.task import Task, tasks_of
from calstudy.engines.choose import program_that_made
from calstudy.engines.interface import Engine, Model
from calstudy.errors import InputError, StoreError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.find import declaration, is_shipped, model_folder, ratios
from calstudy.models.folder import load_folder
from calstudy.models.noise import noise_in
from calstudy.models.targets import describe
from calstudy.plan import PARAMETERS, Plan
from calstudy.plan_check import check
from calstudy.records import Target, proportional
from calstudy.study.answers import MaterialTest
from calstudy.study.directory.begun import grid_there, procedure_there, version_there
from calstudy.study.fidelities import cheap_of, labels_of, require_two, run_by
from calstudy.study.reading import Study, read_study
from calstudy.study.run.comparison import RowComparison, compare_row, requests_of, times_of
from calstudy.study.run.work import Running, Say, Watch, Work, run, silent, unwatched
from calstudy.study.schema import Quantities
from calstudy.study.settings import StudySettings


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
    how = how or Running()
    if how.scheduler or how.command:
        raise InputError("run_plan runs the engine that it is given; leave the scheduler and the command out")
    model = _model_of(plan, engine)
    chosen = [row.run for row in plan.rows] if rows is None else [plan.row(row).run for row in rows]
    given = rows_of(
        plan, chosen, model, Path(path), mode=mode, budget=budget, seed=seed, share_samples=share_samples
    )
    work = given.work(engine, target or paper_target(plan, model, engine.identity))
    run(work, how.here(None, model), how)
    return read_study(work.directory)


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows of a plan to be calibrated into a directory, by any engine."""

    plan: Plan
    rows: tuple[int, ...]
    model: Model
    mode: Mode
    seed: int
    share_samples: bool
    directory: Path
    cheap: Model | None = None
    """The model at the cheap fidelity; None for one fidelity."""
    confirm: int = 0
    """DEM runs with fresh seeds at each optimum."""
    further: tuple[Model, ...] = ()
    """Models of the plan's further material tests."""

    @property
    def models(self) -> list[tuple[Model, str]]:
        """Model of each material test with the prefix of its responses."""
        return [(self.model, ""), *((model, f"{model.name}_") for model in self.further)]

    def work(
        self, engine: Engine, target: Target, cheap: Engine | None = None, further: Sequence[Engine] = ()
    ) -> Work:
        """The rows as ``engine``, which runs the model, is to calibrate them to ``target``.

        ``cheap`` runs the model at the cheap fidelity, if there is one, ``further`` the further tests.
        """
        calstudy = version_there(self.directory)
        identity = "+".join(dict.fromkeys(one.identity for one in (engine, *further)))
        settings = plan_settings(
            self.plan, self.model, identity, self.mode, target, self.seed, self.share_samples, calstudy
        )
        settings = replace(settings, confirm=self.confirm)
        if self.further:
            settings = replace(
                settings,
                units=_units_of_all(self.models),
                tests={model.hash: labels_of(model) for model in self.further},
                noise=_noise_of_all(self.models) if self.mode.takes_noise else None,
            )
        tasks = tasks_of(self.plan, target, self.mode, self.seed, self.share_samples, settings.noise)
        tests: list[MaterialTest] = []
        fidelity: Cheap | None = None
        if cheap is not None and self.cheap is not None:
            tests = [MaterialTest(cheap, PARAMETERS)]
            settings = replace(settings, cheap={self.cheap.hash: labels_of(self.cheap)})
            fidelity = _cheap_of(self.plan, self.model, self.cheap)
        tasks = {
            row: run_by(replace(task, cheap=fidelity, confirm=self.confirm), engine)
            for row, task in tasks.items()
        }
        asked = [MaterialTest(one, PARAMETERS) for one in (engine, *further)]
        return Work(tasks, self.rows, asked, settings, self.directory, cheap=tests)


def rows_of(
    plan: Plan,
    rows: Sequence[int],
    model: Model,
    directory: Path,
    *,
    mode: str = "paper",
    budget: int | None = None,
    seed: int = 1,
    share_samples: bool = False,
    cheap: Model | None = None,
    confirm: int = 0,
    further: Sequence[Model] = (),
) -> Rows:
    """Rows of a plan by a mode's name; InputError for an unknown one, or one that knows no cheap fidelity.

    A study that is in the directory already goes on with its own grid.
    """
    found = mode_of(mode, budget, grid_there(directory), procedure_there(directory))
    if cheap is not None:
        require_two(found, [(model, cheap)])
    of = Rows(plan, tuple(rows), model, found, seed, share_samples, directory, cheap, confirm, tuple(further))
    known = [(proportional(one.responses), ratios(one), prefix) for one, prefix in of.models]
    return replace(
        of,
        mode=found.knowing(
            {f"{prefix}{name}": parameter for each, _, prefix in known for name, parameter in each.items()},
            ratios={f"{prefix}{name}": ratio for _, each, prefix in known for name, ratio in each.items()},
        ),
    )


def _model_of(plan: Plan, engine: Engine) -> Model:
    """Model that an engine runs; InputError where it lacks a parameter or a response of the plan."""
    model: Model | None = getattr(engine, "model", None)
    if model is None:
        raise InputError(f"{engine.identity} runs no model, which the plan needs; open it with one")
    return fitting(plan, model)


def fitting(plan: Plan, model: Model) -> Model:
    """The model; InputError where it lacks a parameter or a response of the plan, or takes another one."""
    given = (*model.parameters, *(response.name for response in model.responses))
    parameters = [p.name for p in plan.parameters]
    wanted = next((t.targets for t in plan.tests if t.model == model.name), tuple(plan.targets))
    if missing := [name for name in (*parameters, *wanted) if name not in given]:
        raise InputError(f"{model.name} has no {missing[0]}, which the plan needs; take a model that has it")
    if more := [name for name in model.parameters if name not in parameters]:
        raise InputError(f"{model.name} takes {more[0]}, too, which the plan does not give; hold it fixed")
    return model


def _units(model: Model) -> dict[str, dict[str, str]] | None:
    """Units of a model's parameters and responses; None of a shipped model, which declares them."""
    quantities = Quantities.of(model)
    if is_shipped(model.name) and Quantities.of(declaration(model.name)) == quantities:
        return None
    return {"parameters": dict(quantities.parameters), "responses": quantities.measured}


def further_models(plan: Plan, fidelity: str | None) -> tuple[Model, ...]:
    """Model of each of the plan's material tests but the first; InputError as of ``load_folder``."""
    models = [load_folder(model_folder(test.model), fidelity=fidelity) for test in plan.tests[1:]]
    return tuple(fitting(plan, model) for model in models)


def _units_of_all(models: Sequence[tuple[Model, str]]) -> dict[str, dict[str, str]]:
    """Units of the parameters, and of the responses of several models by their names in the study."""
    responses = {f"{prefix}{r.name}": r.unit for model, prefix in models for r in model.responses}
    return {"parameters": dict(models[0][0].parameters), "responses": responses}


def _noise_of_all(models: Sequence[tuple[Model, str]]) -> dict[str, float] | None:
    """Known noise of the responses of several models by their names in the study; None of none."""
    known = [(noise_in(model.noise_table, model.hash) or {}, prefix) for model, prefix in models]
    return {f"{prefix}{name}": sd for each, prefix in known for name, sd in each.items()} or None


def paper_target(plan: Plan, model: Model, engine: str) -> Target:
    """The responses that the plan's paper calibrated to; says so where an emulator answers."""
    units = {response.name: response.unit for response in model.responses}
    answers = f"; responses of {engine}" if engine.startswith("emulator ") else ""
    return Target(plan.targets, "paper", f"the paper's {describe(plan.targets, units)}{answers}")


def plan_settings(
    plan: Plan,
    model: Model,
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
        fidelity=model.labels["fidelity"],
        variant=model.labels["variant"],
        engine=engine,
        calstudy=calstudy,
        mode=mode.name,
        budget=mode.second_optimisation.budget,
        seed=seed,
        target=target,
        share_samples=share_samples,
        noise=noise_in(model.noise_table, model.hash) if mode.takes_noise else None,
        grid=mode.grid,
        units=_units(model),
        procedure=mode.procedure,
    )


# ---- rows of a study once more --------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Repeat:
    """Finished rows of a study, and what made them."""

    there: Study
    rows: tuple[int, ...]
    program: str
    """Its name in the table of engines."""
    model: Model
    cheap: Model | None
    """The model at the cheap fidelity; None for one fidelity."""

    @property
    def models(self) -> list[tuple[Model, str]]:
        """Models as engines are made of them, the cheap one last."""
        return [(self.model, ""), *([(self.cheap, "")] if self.cheap else [])]

    def work(self, engines: Sequence[Engine], directory: Path) -> Work:
        """The rows by the study's own settings, to be calibrated again into ``directory``."""
        was, engine = self.there.settings, engines[0]
        own = mode_of(was.mode, None, was.grid, was.procedure)
        # The mode's own budget is stored, too; given, it would be the number of expensive runs.
        budget = None if was.budget == own.second_optimisation.budget else was.budget
        mode = mode_of(was.mode, budget, was.grid, was.procedure)
        mode = mode.knowing(proportional(self.model.responses), ratios=ratios(self.model))
        settings = replace(was, engine=engine.identity, calstudy=version_there(directory))
        tasks = tasks_of(self.there.plan, was.target, mode, was.seed, was.share_samples, was.noise)
        tasks = {row: self._again(task, engine) for row, task in tasks.items()}
        tests = [MaterialTest(of, PARAMETERS) for of in engines]
        follow = requests_of(self.there, self.rows)
        return Work(tasks, self.rows, tests[:1], settings, directory, follow, "--out", cheap=tests[1:])

    def _again(self, task: Task, engine: Engine) -> Task:
        """A task with the study's confirmation, and its fidelities with the times that their runs took."""
        cheap = None
        if self.cheap is not None:
            times = times_of(self.there, task.row)
            cheap = replace(_cheap_of(self.there.plan, self.model, self.cheap), times=times)
        return run_by(replace(task, cheap=cheap, confirm=self.there.settings.confirm), engine)


def repeat_of(there: Study, rows: Sequence[int], path: Path) -> Repeat:
    """Rows of the study at ``path`` that are to be calibrated again.

    InputError for a row that is not finished, and for a study that no program made. StoreError where this
    version of calstudy has another model.
    """
    was = there.settings
    if missing := sorted(set(rows) - set(there.calibrations["row"])):
        raise InputError(f"--rows: {path} has no row {missing[0]} to compare with; choose a finished one")
    if was.tests:
        raise InputError(
            f"{path} has several material tests, and plan rerun knows one; run its rows again with "
            f"'calstudy plan run --plan {was.plan} --study ANOTHER'"
        )
    program = program_that_made(was.engine)
    if program is None:
        raise InputError(f"{path} was made by {was.engine}; make it again with 'calstudy plan run'")
    if not is_shipped(was.model):
        raise InputError(
            f"{path}: its model {was.model} is not a shipped one; run the rows again with 'calstudy plan run "
            "--model FOLDER --study ANOTHER'"
        )
    model = _model_there(there.plan, was.model_hash, was.provenance, path)
    cheap = [_model_there(there.plan, of, labels, path) for of, labels in (was.cheap or {}).items()]
    return Repeat(there, tuple(rows), program, model, cheap[0] if cheap else None)


def _model_there(plan: Plan, model_hash: str, labels: Mapping[str, Any], path: Path) -> Model:
    """Shipped model of a study by its labels; StoreError where this version of calstudy has another one."""
    model: Model = (
        load_model(plan.fixed, labels["fidelity"], labels["variant"])
        if labels["variant"]
        else load_folder(model_folder(labels["model"]), fidelity=labels["fidelity"] or None)
    )
    if model.hash != model_hash:
        raise StoreError(
            f"{path} was made with deck {labels['deck']} of the model, hash {model_hash[:12]}, here it is "
            f"{model.deck}, {model.hash[:12]}; take the calstudy that made it"
        )
    return model


def _cheap_of(plan: Plan, model: Model, cheap: Model) -> Cheap:
    """The cheap fidelity of a plan's model."""
    middle = plan.space(plan.rows[0])
    return cheap_of([(model, cheap)], middle.complete(middle.box.centre))


def rerun(
    of: Repeat,
    directory: Path,
    how: Running,
    stop: threading.Event,
    *,
    say: Say = silent,
    watch: Watch = unwatched,
) -> tuple[Study, list[RowComparison]]:
    """Calibrate rows of a study again by the program that made them, and compare DEM run by DEM run.

    Returns the study in ``directory`` and a comparison of each row. Raises as ``run``.
    """
    engines, executor = how.engines(of.models, stop, of.program)
    run(of.work(engines, directory), executor, how, stop, say=say, watch=watch)
    again = read_study(directory, Path(of.there.plan.origin))
    return again, [compare_row(of.there, again, row) for row in of.rows]
