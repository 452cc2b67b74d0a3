"""Table of the engines by name. A line is loaded when it is first used."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, cast

from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Engine, Model
from calstudy.engines.profiles import LAMMPS, LIGGGHTS, YADE
from calstudy.engines.program import Profile, Program
from calstudy.engines.queue import Executor, LocalExecutor, cores
from calstudy.errors import InputError, SetupError
from calstudy.written import choice

DEFAULT_MODEL = "calstudy.models.angle_of_repose:shipped_model"
"""Default model, as a function of a fidelity or None and a variant."""


class Kind(Protocol):
    """An engine that can be chosen by name."""

    @property
    def open(self) -> Callable[..., Engine]:
        """Open it for a model or None, a fidelity or None, a variant, and its own options by name.

        Without a model it runs the angle-of-repose model at the fidelity and variant. Raises SetupError if
        something is missing on this machine, InputError for a model that it cannot run.
        """

    def look(self) -> str:
        """What was found of it on this machine, in one line; SetupError if nothing was."""


@dataclass(frozen=True, slots=True)
class ProgramKind:
    """An external program in the table."""

    profile: Profile
    model: str = DEFAULT_MODEL
    """Place of its own default model."""

    def open(
        self,
        model: Model | None = None,
        fidelity: str | None = None,
        variant: str = "ring",
        *,
        command: str | None = None,
        prefix: str = "",
    ) -> ProgramEngine[Model]:
        """Engine of the program; ``command`` as in ``Profile.find``, ``prefix`` as in ``ProgramEngine``."""
        program = self.profile.find(command)
        return ProgramEngine(model or loaded(self.model)(fidelity, variant), program, prefix)

    def look(self) -> str:
        """The program's version and command."""
        return self.profile.find().described


ENGINES: Mapping[str, Kind | str] = {
    "liggghts": ProgramKind(LIGGGHTS),
    "lammps": ProgramKind(LAMMPS, "calstudy.models.folder.file:lammps_heap"),
    "yade": ProgramKind(YADE, "calstudy.models.folder.file:yade_heap"),
    "emulator": "calstudy.emulator.engine:EMULATOR",
}
"""Each engine, or its place as ``module:name``. The first is the default."""
DEFAULT = next(iter(ENGINES))


def loaded(place: str) -> Any:
    """Object at ``module:name``; InputError if there is none."""
    module, _, name = place.partition(":")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"{place} cannot be loaded ({error}); write package.module:name") from error


def kind_of(name: str | Profile) -> Kind:
    """Engine of the table, or your own at ``module:name`` or of a profile; InputError for an unknown name."""
    if isinstance(name, Profile):
        return ProgramKind(name)
    if name not in ENGINES and ":" not in name:
        raise InputError(f"engine {name!r} is unknown; {choice(name, ENGINES)}")
    kind = ENGINES.get(name, name)
    return cast(Kind, loaded(kind)) if isinstance(kind, str) else kind


def open_engine(
    name: str = DEFAULT,
    model: Model | None = None,
    *,
    fidelity: str | None = None,
    variant: str = "ring",
    **options: Any,
) -> Engine:
    """Open an engine by its name in the table, or by ``module:name``.

    Without a model it is for the angle-of-repose model at a fidelity and variant; without a fidelity, at the
    engine's own. Options are the engine's: ``command`` of a program, ``directory`` of an emulator. Raises
    InputError for an unknown engine, fidelity or variant, SetupError where the machine lacks the program.

    >>> open_engine("emulator", fidelity="full").particle_diameter
    0.005
    """
    if model is not None and fidelity is not None:
        raise InputError("a model was given and a fidelity; a model has its own, so leave the fidelity out")
    return kind_of(name).open(model, fidelity, variant, **options)


def found_engines(command: str | None = None) -> dict[str, Program | str]:
    """What was found of each engine of the table: its program, or in words what there is or is not.

    ``command`` is another command of the table's first.
    """
    found: dict[str, Program | str] = {}
    for name in ENGINES:
        kind = kind_of(name)
        try:
            if isinstance(kind, ProgramKind):
                found[name] = kind.profile.find(command if name == DEFAULT else None)
            else:
                found[name] = kind.look()
        except SetupError as error:
            found[name] = str(error)
    return found


def profile_of(name: str | Profile = DEFAULT) -> Profile:
    """Profile of an engine that is an external program; InputError for any other."""
    kind = kind_of(name)
    if not isinstance(kind, ProgramKind):
        known = [program for program, line in ENGINES.items() if isinstance(line, ProgramKind)]
        raise InputError(f"engine {name!r} is not an external program; choose one such as {known[0]}")
    return kind.profile


def program_of(model: Model, command: str | None = None) -> Program:
    """Program of a model; ``command`` is another command of the table's first. Raises as ``Profile.find``."""
    return profile_of(model.program).find(command if model.program == DEFAULT else None)


def program_that_made(identity: str) -> str | None:
    """Name in the table of the program with this identity, whatever its version; None if there is none."""
    for name, kind in ENGINES.items():
        if isinstance(kind, ProgramKind) and identity.startswith(f"{kind.profile.name} "):
            return name
    return None


def require_own_program(model: Model, name: str | None) -> None:
    """InputError if a model's script is written for another program than the one that is named."""
    kind = None if name is None or name == model.program else kind_of(name)
    if isinstance(kind, ProgramKind) and not isinstance(model.program, Profile):
        raise InputError(
            f"engine {name}: the model {model.name} is written for {model.program}; leave the engine out, or "
            "take a model of this program"
        )


def planned_engine(model: Model, name: str | None = None) -> Engine:
    """Engine for estimates, which runs nothing; a program is taken to have its proven version."""
    require_own_program(model, name)
    kind = kind_of(name or model.program)
    if isinstance(kind, ProgramKind) and kind.profile.proven_version:
        return ProgramEngine(model, Program(kind.profile, (), kind.profile.proven_version))
    return kind.open(model, None, "ring")


def slots(*models: Model) -> int:
    """Number of runs of any of the models that this machine's cores hold at once; at least 1."""
    return max(cores() // max((model.ranks * model.threads for model in models), default=1), 1)


def engines_and_executor(
    models: Sequence[tuple[Model, str]],
    stop: threading.Event,
    name: str | None = None,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    command: str | None = None,
    wait: float | None = None,
) -> tuple[list[Engine], Executor]:
    """Engine of each model, given with the prefix of its responses, and the executor of its runs.

    ``name`` is that of an engine in the table, by default each model's own program; ``scheduler`` the address
    of a Dask cluster's, None for this machine; ``wait`` the time in s without any worker after which it is
    given up; ``command`` another command of that engine, or else of the
    table's first. Raises SetupError if a program or the cluster is missing, InputError if a cluster cannot
    run the engine.
    """
    for model, _ in models:
        require_own_program(model, name)
    names = [name or model.program for model, _ in models]
    commands = {one: command if one == (name or DEFAULT) else None for one in names}
    if scheduler is None:
        kinds = {one: kind_of(one) for one in names}
        found = {
            one: kind.profile.find(commands[one])
            for one, kind in kinds.items()
            if isinstance(kind, ProgramKind)
        }
        here = [
            ProgramEngine(model, found[one], prefix) if one in found else kinds[one].open(model, None, "ring")
            for one, (model, prefix) in zip(names, models, strict=True)
        ]
        return here, LocalExecutor(workers or slots(*(model for model, _ in models)), stop)
    from calstudy.engines.cluster import WAIT_SECONDS, DaskExecutor, WorkersEngine

    profiles = {one: profile_of(one) for one in names}
    cluster = DaskExecutor(scheduler, workers, WAIT_SECONDS if wait is None else wait)
    try:
        there = {one: cluster.program(profile, commands[one], stop) for one, profile in profiles.items()}
        return [
            WorkersEngine(model, there[one], commands[one], prefix)
            for one, (model, prefix) in zip(names, models, strict=True)
        ], cluster
    except BaseException:
        cluster.close()
        raise
