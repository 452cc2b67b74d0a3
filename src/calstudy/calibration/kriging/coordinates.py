"""The inputs of a Kriging model: the calibrated parameters, or two of them as their quotient.

Where two parameters act on a response through their quotient alone, as a stiffness and a density do, points
of equal quotient have equal responses. A model that has both as inputs does not know that. With few noisy
runs it finds slopes along such points, and a search follows them away from the targets.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calstudy.parameters import Array, Box, Space


@dataclass(frozen=True, slots=True)
class Coordinates:
    """Inputs (n, c) of a Kriging model at points (n, d) of a space."""

    space: Space
    ratio: tuple[str, str] | None
    """Two parameters whose quotient, in its logarithm, is the last input; None: the inputs are the points."""
    box: Box
    """Intervals of the inputs."""
    kept: tuple[int, ...]
    """Which parameters are inputs themselves."""

    @classmethod
    def of(cls, space: Space, ratio: tuple[str, str] | None) -> Coordinates:
        """Inputs where two parameters act through their quotient alone, if they do.

        The quotient is an input if both are calibrated and no other parameter follows from one of them.
        """
        box = space.box
        followed = {name for p in space.parameters if p.formula is not None for name in p.formula.names}
        if ratio is None or not {*ratio} <= {*box.names} or followed & {*ratio}:
            return cls(space, None, box, tuple(range(box.dimension)))
        kept = tuple(k for k, name in enumerate(box.names) if name not in ratio)
        ends = np.array([box.lower, box.upper])
        (above_low, above_high), (below_low, below_high) = (space.values(name, ends) for name in ratio)
        inputs = Box(
            (*(box.names[k] for k in kept), "/".join(ratio)),
            (*(box.lower[k] for k in kept), float(np.log(above_low / below_high))),
            (*(box.upper[k] for k in kept), float(np.log(above_high / below_low))),
        )
        return cls(space, ratio, inputs, kept)

    def __call__(self, points: Array) -> Array:
        """Inputs (n, c) at points (n, d)."""
        if self.ratio is None:
            return points
        above, below = (self.space.values(name, points) for name in self.ratio)
        return np.column_stack([points[:, self.kept], np.log(above / below)])

    def to_unit(self, points: Array) -> Array:
        """The same, scaled to the unit cube of their intervals."""
        return self.box.to_unit(self(points))
