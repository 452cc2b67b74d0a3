"""Shipped models as the benchmark's truth: what their emulators answer in a calibration's box."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np

from calstudy.emulator.benchmark.problem import Truth
from calstudy.emulator.emulator import Emulator, read_emulator, shipped_emulator
from calstudy.emulator.similarity import inputs
from calstudy.parameters import Array, Space

KEPT = Path(__file__).parent / "emulators"
"""Emulators that were shipped when the benchmark began. A better one changes no problem of the benchmark."""


@cache
def emulator_of(model: str, fidelity: str, variant: str = "") -> Emulator:
    """The emulator that the benchmark began with: kept here, or still the shipped one."""
    kept = KEPT / model / f"{fidelity}-{variant}"
    return read_emulator(kept if kept.is_dir() else shipped_emulator(model, fidelity, variant))


def emulated(
    space: Space, emulator: Emulator, names: Sequence[str], draw: int | None, noise_factor: float = 1.0
) -> Truth:
    """Some responses of a model by its emulator: a draw from its posterior, or None for its mean."""
    answers = emulator.means() if draw is None else emulator.draw(draw)
    similarity = emulator.similarity
    of = {response.name: response for response in similarity.responses}
    reduced = {response.name: response for response in emulator.responses}
    chosen = [reduced[of[name].reduced] for name in names]
    divisors = [of[name].proportional_to for name in names]

    def unit(points: Array) -> tuple[Array, Array]:
        sets = [space.complete(point) for point in points]
        at = emulator.box.to_unit(np.array([inputs(one, similarity) for one in sets]))
        factors = np.array([[1.0 if name is None else one[name] for name in divisors] for one in sets])
        return np.clip(at, 0.0, 1.0), factors

    def responses(points: Array) -> Array:
        at, factors = unit(points)
        columns = []
        for response in chosen:
            values = answers[response.name].noise_free(at)
            if response.region is not None:
                values = np.where(response.region.contains(at), np.nan, values)
            columns.append(values)
        return factors * np.column_stack(columns)

    def noise_sd(points: Array) -> Array:
        at, factors = unit(points)
        return noise_factor * factors * np.column_stack([answers[r.name].noise_sd(at) for r in chosen])

    return Truth(responses, noise_sd)


def together(truths: Sequence[Truth]) -> Truth:
    """Several models that are run at once: their responses one after another."""
    return Truth(
        lambda points: np.hstack([truth.responses(points) for truth in truths]),
        lambda points: np.hstack([truth.noise_sd(points) for truth in truths]),
    )
