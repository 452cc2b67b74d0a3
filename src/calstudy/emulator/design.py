"""Which DEM runs an emulator is made from, and by which it is judged, as designs of a sweep.

The order of a design is part of it: its runs take hours, and whenever they end, what is there must serve.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calstudy.calibration.sampling import sobol
from calstudy.emulator.similarity import Similarity, inputs_box, parameter_set
from calstudy.errors import InputError
from calstudy.parameters import Array, Parameter
from calstudy.study.sweep import Line

REACH = 1.2
"""The sequence fills a cube this much wider than the box, and what lies outside is put on the box's faces.

Every sixth value of a parameter is then an end of its interval. Calibrations end at bounds, and far from
all points, in the corners, an emulator knows least."""
REFERENCE_EVERY, REPEAT_EVERY = 6, 10
"""One point in so many is run at the reference fidelity too; one run in so many is repeated."""
FRESH_SEEDS = 3

_CHEAP, _REFERENCE, _FRESH, _SHIFT = 0, 1, 2, 3


@dataclass(frozen=True, slots=True)
class Choice:
    """What a design is for."""

    fidelity: str
    """The cheap fidelity; the same as ``reference`` for a design of one fidelity."""
    reference: str
    """The fidelity that is emulated."""
    variant: str
    seed: int
    """Seed of the design, from which the runs' seeds are drawn, too."""


def space_filling(count: int, dimension: int, seed: int) -> Array:
    """The first points of a Sobol sequence, shifted at random and reaching the faces, (count,dimension)."""
    if count < 1:
        raise InputError(f"a design cannot have {count} points; ask for at least 1")
    spread = sobol(count, dimension, scramble=False)
    shift = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_SHIFT,))).random(dimension)
    return np.clip(0.5 + REACH * ((spread + shift) % 1.0 - 0.5), 0.0, 1.0)


def emulator_design(
    parameters: Sequence[Parameter], choice: Choice, points: int, similarity: Similarity
) -> list[Line]:
    """Runs that an emulator is fitted to; a longer design begins like a shorter one.

    The cheap runs take the points of one sequence in turn. After each `REFERENCE_EVERY` of them the
    reference fidelity runs the next point from the sequence's beginning, and after each `REPEAT_EVERY` runs
    of a fidelity its next point from the beginning is run once more. So at any moment each of the four
    sets has the first, evenly spread, points of the sequence. No two runs share a seed: their noise must
    be independent.
    """
    unit = space_filling(points, _coordinates(similarity), choice.seed)
    lines: list[Line] = []

    def run(k: int, is_reference: bool, repeat: int) -> None:
        stream = _REFERENCE if is_reference else _CHEAP
        lines.append(
            Line(
                label=f"point-{k:03d}",
                fidelity=choice.reference if is_reference else choice.fidelity,
                variant=choice.variant,
                seed=_seed(choice.seed, stream, k, repeat),
                parameters=_set(unit[k], parameters, similarity),
            )
        )

    both = choice.fidelity != choice.reference
    for k in range(points):
        run(k, not both, 0)
        if (k + 1) % REPEAT_EVERY == 0:
            run((k + 1) // REPEAT_EVERY - 1, not both, 1)
        if both and k % REFERENCE_EVERY == 0:
            j = k // REFERENCE_EVERY
            run(j, True, 0)
            if (j + 1) % REPEAT_EVERY == 0:
                run((j + 1) // REPEAT_EVERY - 1, True, 1)
    return lines


def fresh_design(
    parameters: Sequence[Parameter], choice: Choice, points: int, similarity: Similarity
) -> list[Line]:
    """Runs of the reference fidelity at random points of the box, three seeds each at every other point.

    Further seeds come last, so that a design cut short has as many points as possible.
    """
    if points < 1:
        raise InputError(f"a design cannot have {points} points; ask for at least 1")
    rng = np.random.default_rng(np.random.SeedSequence(choice.seed, spawn_key=(_FRESH,)))
    unit = rng.random((points, _coordinates(similarity)))
    sets = [_set(u, parameters, similarity) for u in unit]
    return [
        Line(
            f"fresh-{k:02d}", choice.reference, choice.variant, _seed(choice.seed, _FRESH, k, repeat), sets[k]
        )
        for repeat in range(FRESH_SEEDS)
        for k in range(0, points, 1 if repeat == 0 else 2)
    ]


def _coordinates(similarity: Similarity) -> int:
    """Coordinates of a point of a design: the inputs, and where a quotient's two parameters lie."""
    return len(similarity.inputs) + (similarity.ratio is not None)


def _set(unit: Array, parameters: Sequence[Parameter], similarity: Similarity) -> dict[str, float]:
    """Parameters at a point (d,) of the unit cube of the coordinates."""
    d = len(similarity.inputs)
    point = inputs_box(parameters, similarity).from_unit(unit[:d])
    return parameter_set(point, float(unit[-1]), parameters, similarity)


def _seed(seed: int, stream: int, point: int, repeat: int) -> int:
    """Seed of one run, a positive 31-bit integer."""
    sequence = np.random.SeedSequence(seed, spawn_key=(stream, point, repeat))
    return int(sequence.generate_state(1, np.uint32)[0] >> 1) + 1
