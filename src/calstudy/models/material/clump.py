"""Particles that are no spheres: rigid clumps of spheres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calstudy.errors import InputError

CELLS = 128
"""Cells along the longest side of the grid on which a clump's volume is counted: exact to about 1e-4."""
MOST_SPHERES = 16
"""A run takes as many times as long; more are for the script of one's own."""


@dataclass(frozen=True)
class Clump:
    """Spheres that move as one rigid particle of uniform density; where they overlap nothing counts twice."""

    spheres: tuple[tuple[float, float, float, float], ...]
    """Centre x, y, z and diameter of each, in m."""

    @property
    def diameters(self) -> tuple[float, ...]:
        """Of the spheres, in m: the smallest sets the time-step."""
        return tuple(sphere[3] for sphere in self.spheres)

    @property
    def diameter(self) -> float:
        """Of the single sphere of the same volume, in m."""
        return float((6 / np.pi * self.volume) ** (1 / 3))

    @property
    def length(self) -> float:
        """Largest distance in m of two points of the clump."""
        centre, radius = self._arrays
        apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
        return float((apart + radius[:, None] + radius[None]).max())

    @cached_property
    def volume(self) -> float:
        """In m3, of the union of the spheres, counted on a grid of `CELLS`."""
        centre, radius = self._arrays
        low, high = (centre - radius[:, None]).min(axis=0), (centre + radius[:, None]).max(axis=0)
        cell = float((high - low).max()) / CELLS
        sides = [
            lo + cell * (np.arange(np.ceil((hi - lo) / cell)) + 0.5) for lo, hi in zip(low, high, strict=True)
        ]
        x, y, z = np.meshgrid(*sides, indexing="ij", sparse=True)
        inside = np.zeros(tuple(map(len, sides)), bool)
        for (cx, cy, cz), r in zip(centre, radius, strict=True):
            inside |= (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2 < r**2
        return float(np.count_nonzero(inside)) * cell**3

    @property
    def _arrays(self) -> tuple[np.ndarray, np.ndarray]:
        """Centres (n, 3) and radii (n,) in m."""
        spheres = np.array(self.spheres)
        return spheres[:, :3], spheres[:, 3] / 2

    def grown(self, factor: float) -> Clump:
        """The same shape, larger by a factor."""
        return Clump(tuple((factor * x, factor * y, factor * z, factor * d) for x, y, z, d in self.spheres))


def clump(spheres: Sequence[Sequence[float]]) -> Clump:
    """A clump of spheres, each x, y, z and diameter in m; InputError where they are none or not one piece."""
    if not 2 <= len(spheres) <= MOST_SPHERES:
        raise InputError(
            f"a clump has 2 to {MOST_SPHERES} spheres, not {len(spheres)}; one alone is a diameter"
        )
    if any(len(sphere) != 4 for sphere in spheres):
        raise InputError("each sphere of a clump has four numbers in m: x, y, z and its diameter")
    if min(sphere[3] for sphere in spheres) <= 0:
        raise InputError("a sphere of a clump has no positive diameter; correct its fourth number")
    made = Clump(tuple((float(x), float(y), float(z), float(d)) for x, y, z, d in spheres))
    centre, radius = made._arrays
    apart = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    touch = apart < radius[:, None] + radius[None]
    reached = np.linalg.matrix_power(touch.astype(int), len(radius)) > 0
    if not reached.all():
        raise InputError("the spheres of a clump do not hang together; let each overlap with another one")
    if (apart + radius[None] <= radius[:, None] * (1 + 1e-9))[~np.eye(len(radius), dtype=bool)].any():
        raise InputError("a sphere of a clump lies within another one; leave it out")
    return made
