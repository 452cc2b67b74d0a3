"""Bead sizes: a few diameters with their shares by number, as they are or taken from a distribution."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np

from calstudy.errors import InputError

Weighting = Literal["number", "mass"]
CLASSES = 7
"""Sizes that stand for a continuous distribution."""
LARGEST_RATIO = 10.0
"""Of the largest diameter to the smallest: beyond, the small ones cost more than anybody has time for."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Diameters of spheres and what share of their number has each."""

    diameters: tuple[float, ...]
    """In m, rising."""
    shares: tuple[float, ...]
    """By number; their sum is 1."""

    @property
    def diameter(self) -> float:
        """Diameter in m of the sphere of mean volume."""
        if len(self.diameters) == 1:
            return self.diameters[0]  # to the last digit
        return float(np.dot(self.shares, np.power(self.diameters, 3)) ** (1 / 3))

    def grown(self, factor: float) -> Sizes:
        """The same sizes, all larger by a factor."""
        return Sizes(tuple(factor * d for d in self.diameters), self.shares)


def discrete(diameters: Sequence[float], shares: Sequence[float], weighting: Weighting) -> Sizes:
    """Sizes in m whose shares are of the number or of the mass; they need not add up to 1.

    InputError: they are not positive, not as many, or too far apart.
    """
    if len(diameters) != len(shares) or not diameters:
        raise InputError(f"{len(diameters)} diameters have {len(shares)} shares; give each one share")
    if min(diameters) <= 0 or min(shares) <= 0:
        raise InputError("diameters and shares must be positive; leave out a size that has no share")
    if len({*diameters}) < len(diameters):
        raise InputError("a diameter stands twice; add up its shares")
    if max(diameters) > LARGEST_RATIO * min(diameters):
        raise InputError(
            f"the largest diameter is {max(diameters) / min(diameters):.3g} times the smallest; cut the "
            f"sizes at a ratio of {LARGEST_RATIO:g}, the smallest cost the most and weigh the least"
        )
    order = np.argsort(diameters)
    d = np.asarray(diameters, float)[order]
    number = np.asarray(shares, float)[order] / (d**3 if weighting == "mass" else 1.0)
    return Sizes(tuple(map(float, d)), tuple(map(float, number / number.sum())))


def log_normal(
    median: float, deviation: float, smallest: float, largest: float, weighting: Weighting
) -> Sizes:
    """A log-normal distribution, cut at two diameters, as `CLASSES` sizes.

    ``median`` in m and the geometric standard deviation ``deviation`` are of the number or of the mass,
    before the cut. Classes have equal shares of it, and each has the number and the mass that the
    distribution has there. InputError: nothing lies between the cuts, or they are too far apart.
    """
    if not median > 0 or not deviation > 1:
        raise InputError(
            f"median {median:g} m and deviation {deviation:g}: the median must be positive and the geometric "
            "standard deviation above 1, such as 1.2"
        )
    if not 0 < smallest < largest:
        raise InputError(f"sizes are cut at {smallest:g} m and {largest:g} m; write the smaller one first")
    spread = math.log(deviation)
    normal = NormalDist()  # SciPy's would be loaded for every single run
    cuts = [math.log(end / median) / spread for end in (smallest, largest)]
    ends = [normal.cdf(cut) for cut in cuts]
    if not ends[1] - ends[0] > 1e-6:
        raise InputError(f"no bead lies between {smallest:g} m and {largest:g} m; correct the median")
    inner = [normal.inv_cdf(share) for share in np.linspace(ends[0], ends[1], CLASSES + 1)[1:-1]]
    edges = np.array([cuts[0], *inner, cuts[1]])
    # The mean of d^3 by number, and of d^-3 by mass, over a class: of a log-normal both are known.
    power = 3.0 if weighting == "number" else -3.0
    share = np.diff([normal.cdf(edge) for edge in edges])
    mean = np.diff([normal.cdf(edge - power * spread) for edge in edges]) / share
    moment = median**power * math.exp(0.5 * (power * spread) ** 2) * mean
    return discrete((moment ** (1 / power)).tolist(), share.tolist(), weighting)
