"""The cheap fidelity of a calibration's models, as the calibration needs to know it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.calibration.modes import Mode
from calstudy.calibration.task import Task
from calstudy.engines.interface import Described, Engine
from calstudy.errors import InputError
from calstudy.models.noise import difference_in, noise_in


def labels_of(model: Described) -> dict[str, Any]:
    """Columns that say which model it is."""
    return {"model": model.name, "deck": model.deck, **model.labels}


def cheap_of(
    pairs: Sequence[tuple[Described, Described]],
    parameters: Mapping[str, float],
    prefixes: Sequence[str] = ("",),
) -> Cheap:
    """The cheap fidelity of models, each given with its cheap one, as the calibration takes it.

    ``parameters`` are those of a typical run.
    """
    times = [[model.expected_seconds_at(parameters) for model in pair] for pair in pairs]
    expensive, cheap = (sum(of) for of in zip(*times, strict=True))
    noise = {
        f"{prefix}{name}": sd
        for prefix, (_, model) in zip(prefixes, pairs, strict=True)
        for name, sd in (noise_in(model.noise_table, model.hash) or {}).items()
    }
    known = [
        difference_in(model.noise_table, (model.hash, other.hash), model.parameters) for model, other in pairs
    ]
    ratios = {model.ratio for model, _ in pairs}
    return Cheap(
        share=cheap / expensive,
        noise=noise or None,
        overlaps=ratios.pop() if len(ratios) == 1 else None,
        offsets={
            f"{prefix}{name}": offset
            for prefix, found in zip(prefixes, known, strict=True)
            if found is not None
            for name, offset in found.offsets.items()
        },
        measured_at={name: value for found in known if found is not None for name, value in found.at.items()},
    )


LEAST_SECONDS = 0.01
"""A run that is expected to take less is an emulator's answer, whose own time says nothing."""


def run_by(task: Task, engine: Engine) -> Task:
    """A task whose runs an engine makes: where they take no time, it goes by the times of the models."""
    if task.cheap is None or task.cheap.earlier is not None:
        return task
    return replace(task, cheap=replace(task.cheap, is_measured=engine.expected_seconds > LEAST_SECONDS))


def require_two(mode: Mode, pairs: Sequence[tuple[Described, Described]]) -> None:
    """InputError where a mode knows one fidelity alone, or a cheap model is not the same test."""
    if not mode.takes_noise:
        raise InputError(f"mode {mode.name} knows one fidelity; take mode robust, or leave the cheap one out")
    if mode.kriging.curves:
        raise InputError("a measured curve is calibrated to at one fidelity; leave the cheap one out")
    for model, cheap in pairs:
        if cheap.hash == model.hash:
            raise InputError(f"{in_words(cheap)} is both the cheap and the expensive fidelity; name another")
        for what, of, other in (
            ("parameters", dict(model.parameters), dict(cheap.parameters)),
            ("responses", units_of(model), units_of(cheap)),
        ):
            if of != other:
                differing = sorted(of.items() ^ other.items())[0][0]
                raise InputError(
                    f"{in_words(cheap)}: its {what} are not those of {in_words(model)} ({differing}); two "
                    "fidelities are of one test"
                )


def in_words(model: Described) -> str:
    """Its name and fidelity."""
    fidelity = model.labels["fidelity"]
    return f"{model.name} ({fidelity})" if fidelity else model.name


def units_of(model: Described) -> dict[str, str]:
    """Unit of each response of a model."""
    return {response.name: response.unit for response in model.responses}
