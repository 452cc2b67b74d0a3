"""The TOML file of ``calstudy calibrate``.

Errors in the file are reported here, before any DEM run, with the line and the remedy.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

from calstudy.calibration.constraints import Allowed, parse
from calstudy.calibration.cost import Cost
from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.calibration.kriging.predictor import least_points
from calstudy.calibration.modes import MODES, Mode, mode_of
from calstudy.calibration.task import Stored, Task
from calstudy.disk.files import content_hash
from calstudy.engines.interface import Described, Model
from calstudy.errors import InputError
from calstudy.models.find import BESIDE
from calstudy.models.folder import FolderModel
from calstudy.parameters import GRID, Space
from calstudy.plausible import require_plausible_file
from calstudy.records import Response, Target
from calstudy.study.definition.curves import MeasuredCurve, measured_curves
from calstudy.study.definition.holdout import HOLDOUT, HeldOut, holdout_of
from calstudy.study.definition.models import Chosen, chosen_models, knowing
from calstudy.study.definition.parameters import content_of, space_of
from calstudy.study.definition.targets import targets_of
from calstudy.study.fidelities import cheap_of, require_two
from calstudy.study.prior import Prior, prior_of
from calstudy.study.schema import Quantities, tables_of
from calstudy.study.settings import CONFIRM, Case
from calstudy.tomlfile import Section, read_toml
from calstudy.written import choice

ROW = 1
"""Row of a calibration in its tables."""

KEYS = (
    "mode",
    "seed",
    "WRL",
    "samples_per_parameter",
    "budget",
    "together",
    "confirm",
    "until",
    "start",
    "models",
    "parameters",
    "constraints",
    "targets",
    "holdout",
)


@dataclass(frozen=True)
class Definition:
    """A whole calibration."""

    path: Path
    models: tuple[Chosen, ...]
    task: Task
    curves: tuple[MeasuredCurve, ...] = ()
    """Curves that are targets, point by point."""
    held_out: tuple[HeldOut, ...] = ()
    """Responses that are not calibrated to, with the criterion that the optimum is held to."""
    prior: Prior | None = None
    """Runs of an earlier study that the calibration starts from; None without one."""

    @property
    def programs(self) -> list[tuple[Model, str]]:
        """Models of the file, which DEM programs run, each with the prefix of its responses.

        Those of the cheap fidelity, if there is one, follow in the same order.
        """
        both = [(chosen.model, chosen.prefix) for chosen in self.models]
        both += [(chosen.cheap, chosen.prefix) for chosen in self.models if chosen.cheap is not None]
        return [(cast(Model, model), prefix) for model, prefix in both]

    @property
    def pairs(self) -> list[tuple[Described, Described]]:
        """Each model with its cheap one; empty for one fidelity."""
        return [(chosen.model, chosen.cheap) for chosen in self.models if chosen.cheap is not None]

    @property
    def told(self) -> dict[str, Any]:
        """What each model of one's own is, by its label, in JSON's types."""
        own = {c.label: c.model for c in self.models if isinstance(c.model, FolderModel)}
        return {label: json.loads(json.dumps(model.told)) for label, model in own.items()}

    @property
    def case(self) -> Case:
        """Content that a study directory stores."""
        task = self.task
        return Case(
            parameters={p.name: p.unit for p in task.space.parameters},
            responses={name: unit for chosen in self.models for name, unit in chosen.responses.items()},
            models={
                chosen.model.hash: {
                    "model": chosen.model.name,
                    "deck": chosen.model.deck,
                    "fidelity": chosen.fidelity,
                    "variant": chosen.variant,
                }
                for chosen in self.models
            },
            definition={
                "parameters": {p.name: content_of(p) for p in task.space.parameters},
                "WRL": task.cost.WRL,
                "samples": task.samples,
                "tolerances": dict(task.tolerances),
                "noise": None if task.noise is None else dict(task.noise),
                "models": {chosen.label: chosen.model.hash for chosen in self.models},
            }
            # A calibration that took nothing over keeps the identity from before it could.
            | ({"constraints": list(dict.fromkeys(task.allowed.texts))} if task.allowed else {})
            | ({HOLDOUT: {one.response: one.settings for one in self.held_out}} if self.held_out else {})
            | ({"together": together} if (together := task.mode.second_optimisation.together) > 1 else {})
            | ({"until": task.until} if task.until else {})
            | ({"start": self.prior.content} if self.prior else {})
            | ({"stored": [[dict(run.parameters), run.seed] for run in task.stored]} if task.stored else {}),
        )

    def reaching(self, until: float) -> Definition:
        """The same, confirmed until all responses are within their tolerances with this probability.

        InputError: it is no probability, or nothing could ever reach it.
        """
        if not 0 < until < 1:
            raise InputError(f"until is {until:g}; give a probability between 0 and 1, such as 0.9")
        if not self.task.tolerated.any():
            raise InputError("until needs a tolerance to be within; give one in [targets]")
        if not self.task.confirm:
            raise InputError("until needs runs that confirm the optimum; give confirm = 4, say")
        return replace(self, task=replace(self.task, until=until))

    def taking_over(self, stored: tuple[Stored, ...]) -> Definition:
        """The same with runs of earlier calibrations as samples."""
        return replace(self, task=replace(self.task, stored=stored))

    @property
    def hash(self) -> str:
        """SHA-256 of all that decides the results except mode, budget, seed and target."""
        return content_hash(asdict(self.case))


def read_definition(
    path: Path,
    folders: Sequence[Path] = (),
    insist: bool = False,
    grid: int | None = GRID,
    confirm: int = CONFIRM,
    procedure: int | None = None,
    start: Mapping[str, Any] | None = None,
    ranks: int | None = None,
    text: str | None = None,
) -> Definition:
    """Read the file of a calibration. Models are looked for in ``folders``, beside it, and among the shipped.

    Raises InputError with the line and the remedy for any error in it. Implausible values are errors unless
    ``insist``. ``grid`` is that of the study that it continues, and so are the ``confirm`` runs, which a file
    may give, the mode's ``procedure``, and what it has stored of the study that it ``start``s from; ``ranks``
    stands in place of the models', and ``text`` in place of what is in the file.
    """
    top = read_toml(path, text)
    top.only(*KEYS)
    beside = (path.parent, path.parent / BESIDE)
    models = chosen_models(top, (*folders, *beside), insist, ranks)
    return define(top, models, insist, grid, confirm, procedure, start)


def model_of(
    path: Path,
    name: str | None = None,
    folders: Sequence[Path] = (),
    insist: bool = False,
    ranks: int | None = None,
) -> Model:
    """The model of a file's ``[[models]]`` as a calibration runs it: fidelity, apparatus and material.

    The rest of the file may be missing. ``name`` is a label or a model's name, where there are several.
    InputError: none or several are called so, or as ``read_definition``.
    """
    top = read_toml(path)
    chosen = chosen_models(top, (*folders, path.parent, path.parent / BESIDE), insist, ranks)
    found = [one for one in chosen if name in (None, one.label, one.model.name)]
    if len(found) != 1:
        labels = choice(name or "", [one.label for one in chosen], "there are")
        raise InputError(f"{path}: which of its models? name one with --model; {labels}")
    return cast(Model, found[0].model)


def define(
    top: Section,
    models: tuple[Chosen, ...],
    insist: bool = False,
    grid: int | None = GRID,
    confirm: int = CONFIRM,
    procedure: int | None = None,
    start: Mapping[str, Any] | None = None,
) -> Definition:
    """Calibration of models with the parameters, targets and procedure of a file, or of a caller.

    InputError as ``read_definition``.
    """
    models, curves = measured_curves(top, models)
    space = space_of(top, models)
    target, tolerances, given = targets_of(top, models, curves)
    _require_own_names(top.section("parameters"), space, models, target)
    WRL, seed = top.get("WRL", "number"), top.get("seed", "whole number")
    if not 0 <= seed < 2**63:
        raise top.wrong(f"seed is {seed}; give 0 to {2**63 - 1}", "seed")
    if WRL > 0 and (without := [chosen.label for chosen in models if chosen.model.particles is None]):
        raise top.wrong(
            f"WRL is {WRL:g}, but {without[0]} has no [particles], from which the Rayleigh time-step (Eq. 1) "
            "is computed; add them to its model.toml, or set WRL to 0",
            "WRL",
        )
    confirm = _confirm(top, models, confirm)
    mode = _mode(top, models, grid, curves, confirm, procedure)
    pairs = [(chosen.model, chosen.cheap) for chosen in models if chosen.cheap is not None]
    if pairs and len(pairs) < len(models):
        one = next(chosen.label for chosen in models if chosen.cheap is None)
        raise top.wrong(f"{one} has no cheap fidelity, but another model has; give it to all or to none")
    if pairs:
        try:
            require_two(mode, pairs)
        except InputError as error:
            raise top.sections("models")[0].wrong(str(error), "cheap") from error
    if any(space.whole) and not mode.takes_noise:
        raise top.wrong(
            f"mode {mode.name} takes differences that are shorter than 1, so no parameter can be an integer "
            "or a list of values; take mode robust",
            "mode",
        )
    try:
        particles = (chosen.model.particles for chosen in models)
        cost = Cost(space, target, WRL, tuple(p for p in particles if p is not None))
    except InputError as error:
        raise top.wrong(str(error), "WRL") from error
    units = {name: unit for chosen in models for name, unit in chosen.responses.items()}
    wanted = {name: units[name] for name in target.values}
    prior = prior_of(top, space, wanted, mode, bool(pairs), start)
    if (pairs or prior) and mode.second_optimisation.together > 1:
        other = "a cheap fidelity" if pairs else "an earlier study"
        raise top.wrong(f"with {other} each run is chosen by all before it; leave out together", "together")
    known = {name: sd for chosen in models for name, sd in chosen.noise.items() if name in target.values}
    task = Task(
        row=ROW,
        space=space,
        samples=_samples(top, space, mode),
        cost=cost,
        mode=mode,
        seed=seed,
        sampled_as=ROW,
        tolerances=tolerances,
        noise=known | given or None,
        allowed=_allowed(top, space, mode),
        confirm=confirm,
        most=_positive(top, "budget") // len(models) if "budget" in top else None,
        cheap=cheap_of(pairs, space.complete(space.box.centre), [c.prefix for c in models])
        if pairs
        else Cheap.of_earlier(prior.data(space, cost.responses))
        if prior
        else None,
    )
    if not insist:
        ranges = [chosen.plausible for chosen in models]
        bounds = {p.name: (p.lower, p.upper) for p in space.parameters if p.formula is None}
        require_plausible_file(top, ranges, bounds, target)
    found = Definition(top.path, models, task, curves, holdout_of(top, models), prior)
    if "until" not in top:
        return found
    try:
        return found.reaching(top.get("until", "number"))
    except InputError as error:
        raise top.wrong(str(error), "until") from error


# ---- parameters -----------------------------------------------------------------------------------


def _require_own_names(section: Section, space: Space, models: Sequence[Chosen], target: Target) -> None:
    """Refuse names that would give a table two columns of one name."""
    parameters = tuple((p.name, p.unit) for p in space.parameters)
    responses = tuple(Response(name, unit) for chosen in models for name, unit in chosen.responses.items())
    for columns in tables_of(Quantities(parameters, responses, tuple(target.values))).values():
        for column, count in Counter(column.name for column in columns).items():
            if count > 1:
                given = (response.name for response in responses)
                own = [name for name in (*dict(parameters), *given) if column.endswith(name)]
                name = max(own, key=len)
                raise section.wrong(
                    f"{name} makes a second column {column} of the tables; call it something else", name
                )


def _allowed(top: Section, space: Space, mode: Mode) -> Allowed | None:
    """What the constraints leave of the box; None without any."""
    texts = [
        top.typed(text, "text", "constraints")
        for text in (top.get("constraints", "list") if "constraints" in top else [])
    ]
    if not texts:
        return None
    if not mode.takes_noise:
        raise top.wrong(
            f"mode {mode.name} knows no constraints, only bounds; take mode robust", "constraints"
        )
    names = [p.name for p in space.parameters]
    try:
        return Allowed.of([one for text in texts for one in parse(text, names)], space)
    except InputError as error:
        raise top.wrong(str(error), "constraints") from error


# ---- mode, samples -------------------------------------------------------------------------------


def _mode(
    top: Section,
    models: Sequence[Chosen],
    grid: int | None,
    curves: Sequence[MeasuredCurve],
    confirm: int,
    procedure: int | None,
) -> Mode:
    name = top.get("mode", "text")
    if name not in MODES:
        raise top.wrong(f"mode {name!r} is unknown; {choice(name, MODES)}", "mode")
    budget = _positive(top, "budget") if "budget" in top else None
    if budget is not None and budget < len(models):
        what = f"a budget of {budget} is less than the {len(models)} DEM runs of one parameter set; raise it"
        raise top.wrong(what, "budget")
    sets = None if budget is None else budget // len(models) - confirm
    if sets is not None and sets < 1:
        again = f"{confirm * len(models)} run(s) that confirm the optimum"
        what = f"a budget of {budget} leaves nothing beside the {again}; raise it, or lower confirm"
        raise top.wrong(what, "budget")
    mode = mode_of(name, sets, grid, procedure, _positive(top, "together") if "together" in top else 1)
    return knowing(mode, models, tuple(curve.points for curve in curves))


def _samples(top: Section, space: Space, mode: Mode) -> int | None:
    """S of Eq. 11, or None if the mode chooses it."""
    if "samples_per_parameter" not in top:
        if mode.samples is None:
            what = f"mode {mode.name} needs samples_per_parameter, such as the paper's 3 or 6; add it"
            raise top.wrong(what, "mode")
        return None
    dimension = space.box.dimension
    samples = dimension * _positive(top, "samples_per_parameter")
    needed = max(least_points(dimension, mode.kriging.trend), 3)
    if samples < needed:
        raise top.wrong(
            f"{samples} sample(s) are too few: Kriging of {dimension} parameter(s) needs {needed}; "
            "raise samples_per_parameter",
            "samples_per_parameter",
        )
    return samples


def _confirm(top: Section, models: Sequence[Chosen], usual: int) -> int:
    """DEM runs of each model that confirm the optimum.

    Without the key they are as ``usual``, but at most half of a budget, and none where the seed changes
    nothing.
    """
    if "confirm" in top:
        number: int = top.get("confirm", "whole number")
        if number < 0:
            raise top.wrong(f"confirm is {number}; give 0 or a positive whole number", "confirm")
        return number
    if not any(chosen.is_seeded for chosen in models):
        return 0
    return usual if "budget" not in top else min(usual, _positive(top, "budget") // len(models) // 2)


def _positive(top: Section, name: str) -> int:
    number: int = top.get(name, "whole number")
    if number < 1:
        raise top.wrong(f"{name} is {number}; give a positive whole number", name)
    return number
