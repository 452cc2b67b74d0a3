"""What the values of options stand for."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calstudy.emulator.emulator import Emulator, read_emulator, shipped_emulator
from calstudy.emulator.engine import DEFAULT_FIDELITY, EMULATOR, EmulatorEngine, twin_of
from calstudy.engines.choose import kind_of
from calstudy.engines.interface import Engine, Model
from calstudy.errors import InputError
from calstudy.models.find import DEFAULT_MODEL
from calstudy.models.targets import describe, twin_in
from calstudy.plan import Plan, known_runs
from calstudy.plan_file import RUN
from calstudy.plausible import require_plausible
from calstudy.records import Target
from calstudy.study.run.work import Running
from calstudy.written import choice, number_in, shortened


def chosen_emulator(
    engine: str,
    directory: Path | None,
    fidelity: str | None,
    variant: str,
    scheduler: str | None = None,
    replicates: int | None = None,
    model: str | None = None,
) -> Emulator | None:
    """Emulator that ``--engine`` and ``--emulator`` ask for; None for another engine.

    Without a directory it is the shipped one of the fidelity and variant. InputError: the options contradict
    each other, or there is no such emulator, as of any ``model`` but the default one.
    """
    if kind_of(engine) is not EMULATOR:
        if directory is not None:
            raise InputError("--emulator is for --engine emulator; give both, or neither")
        if replicates is not None:
            raise InputError(
                f"--replicates {replicates} is for --engine emulator, since each takes as many DEM runs as "
                "the study; give --engine emulator, or leave --replicates out"
            )
        return None
    if scheduler is not None:
        raise InputError("--engine emulator answers on this machine; leave --scheduler out")
    if directory is None and model not in (None, DEFAULT_MODEL):
        raise InputError(
            f"--model {model}: no emulator of it is shipped; name one with --emulator DIR, made by 'calstudy "
            "emulator fit'"
        )
    return read_emulator(directory or shipped_emulator(DEFAULT_MODEL, fidelity or DEFAULT_FIDELITY, variant))


def parse_rows_option(text: str, plan: Plan) -> tuple[int, ...]:
    """Run numbers, ascending and once each, from numbers and ranges such as ``1,4,10-12``.

    InputError for an empty part, a part that is not a number, a range that goes downwards, and a row that is
    not in the plan.
    """
    known = {row.run for row in plan.rows}
    chosen: set[int] = set()
    for part in text.split(","):
        first, dash, last = (piece.strip() for piece in part.partition("-"))
        if not RUN.fullmatch(first) or not RUN.fullmatch(last if dash else first):
            raise InputError(
                f"rows: {shortened(part)} is neither a row nor a range; write for example 1,4,10-12"
            )
        low, high = int(first), int(last if dash else first)
        if low > high:
            raise InputError(f"rows: {shortened(part)} goes downwards; write {high}-{low}")
        for end in (low, high):
            if end not in known:
                raise InputError(f"rows: {end} is not in plan {plan.name}; {known_runs(plan)}")
        chosen |= known.intersection(range(low, high + 1))
    return tuple(sorted(chosen))


def running(a: Namespace) -> Running:
    """How DEM runs are run: the values of ``running_options``, ``--retry-failed`` and ``--liggghts``."""
    return Running(
        a.workers,
        a.time_limit,
        a.scratch,
        a.keep_runs,
        a.retry_failed,
        a.liggghts,
        scheduler=a.scheduler,
        wait_workers=a.wait_workers,
    )


def chosen_target(text: str, plan: Plan, model: Model, engine: Engine, insist: bool = False) -> Target:
    """Target of ``--target``. An emulator makes its own twin, and its targets name it."""
    if not isinstance(engine, EmulatorEngine):
        return parse_target(text, plan, model, engine.identity, insist)
    if text == "twin":
        return engine.twin(model.reference)
    target = parse_target(text, plan, model, engine.identity, insist)
    return replace(target, origin=f"{target.origin}; responses of {engine.identity}")


def target_of_tests(text: str | None, plan: Plan, model: Model, engines: Sequence[Engine]) -> Target:
    """Target of a plan of several material tests: their twin, by the plan or by the emulators that answer.

    InputError: ``--target`` asks for another one.
    """
    if text not in (None, "twin"):
        raise InputError(
            f"--target {text}: the rows of {plan.name} calibrate to its tests' responses at known "
            "parameters; write twin, or leave it out"
        )
    truth = dict(model.reference)
    emulators = [engine for engine in engines if isinstance(engine, EmulatorEngine)]
    if not emulators:
        return Target(plan.targets, "twin", f"twin: {plan.source.targets}", truth)
    return twin_of(emulators, tuple(plan.targets), truth)


def parse_target(text: str, plan: Plan, model: Model, engine: str, insist: bool = False) -> Target:
    """Target of ``--target``: ``paper``, ``twin``, ``twin:FILE`` or ``response=value,response=value``.

    Raises InputError for anything else, for implausible values unless somebody insists, and when no twin was
    made of this very model.
    """
    units = {response.name: response.unit for response in model.responses}
    if text == "paper":
        return Target(plan.targets, "paper", f"the paper's {describe(plan.targets, units)}")
    kind, _, rest = text.partition(":")
    if kind == "twin":
        return twin_in(rest, model, engine)
    values, names = {}, []
    for part in text.split(","):
        name, equals, number = part.partition("=")
        names.append(name.strip())
        if not equals:
            comma = "; decimals have a point, not a comma" if part.strip().isdigit() else ""
            raise InputError(
                f"--target {text!r}: {part!r} is not response=number; "
                f"use paper, twin, or {_example(plan)}{comma}"
            )
        if names[-1] not in units:
            raise InputError(f"--target {text!r}: no response {names[-1]}; {choice(names[-1], units)}")
        try:
            values[names[-1]] = number_in(number)
        except InputError as error:
            raise InputError(f"--target {text!r}: {names[-1]}: {error}") from error
    if sorted(names) != sorted(units):
        raise InputError(f"--target {text!r}: give exactly {' and '.join(units)}, each once")
    for name, value in values.items():
        if not 0 < value < float("inf"):
            raise InputError(f"--target {text!r}: {name} must be a positive number (Eq. 9 divides by it)")
    require_plausible(values, insist, f"--target {text!r}: ")
    ordered = {name: values[name] for name in units}
    return Target(ordered, "set", f"set by hand: {describe(ordered, units)}")


def _example(plan: Plan) -> str:
    return ",".join(f"{name}={value:g}" for name, value in plan.targets.items())
