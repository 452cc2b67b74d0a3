"""Calibrated parameters: names, units, intervals, and the box that they span."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calstudy.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One DEM parameter: its interval if calibrated, its value if not (Table 2, section 2.3.4).

    A parameter that is never calibrated has its value as both bounds.
    """

    name: str
    unit: str
    lower: float
    upper: float
    constant: float | None
    """Value if excluded from the calibration; None for a parameter that is always calibrated."""
    meaning: str = ""
    is_whole: bool = False
    """Whether it counts: only whole numbers of its interval are run."""

    def __post_init__(self) -> None:
        bounds = (self.lower, self.upper)
        is_constant = self.lower == self.upper == self.constant
        if not all(map(math.isfinite, bounds)) or not (self.lower < self.upper or is_constant):
            raise InputError(
                f"parameter {self.name}: interval [{self.lower}; {self.upper}] must be finite and go upwards"
            )
        if self.constant is not None and not math.isfinite(self.constant):
            raise InputError(f"parameter {self.name}: constant value {self.constant} must be finite")


@dataclass(frozen=True, slots=True)
class Box:
    """The calibrated parameters' intervals, and the conversion between real units and the unit cube.

    All arrays of points have the parameters in the box's order, on their last axis.
    """

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    @classmethod
    def of(cls, parameters: Iterable[Parameter]) -> Box:
        """Span the box of the given parameters, in their order."""
        chosen = tuple(parameters)
        return cls(
            names=tuple(p.name for p in chosen),
            lower=tuple(p.lower for p in chosen),
            upper=tuple(p.upper for p in chosen),
        )

    @property
    def dimension(self) -> int:
        """Number of calibrated parameters, d."""
        return len(self.names)

    @property
    def width(self) -> Array:
        """Interval widths, shape (d,)."""
        return np.subtract(self.upper, self.lower)

    @property
    def centre(self) -> Array:
        """Mean of each interval, shape (d,): the start of the first optimisation (section 2.3.3)."""
        return 0.5 * np.add(self.lower, self.upper)

    def to_unit(self, points: ArrayLike) -> Array:
        """Scale points (…, d) from real units to the unit cube."""
        return (np.asarray(points, float) - self.lower) / self.width

    def from_unit(self, unit: ArrayLike) -> Array:
        """Scale points (…, d) from the unit cube to real units; 0 and 1 give the bounds exactly."""
        u = np.asarray(unit, float)
        inside = np.clip(self.lower + u * self.width, self.lower, self.upper)
        # lower + width need not be upper in floating point.
        return np.where(u >= 1.0, self.upper, inside)


@dataclass(frozen=True, slots=True)
class Grid:
    """Points of a box at which a DEM model is run: equally spaced on each interval, with both bounds.

    On another processor or with another library, linear algebra has other last digits, and with another last
    digit a DEM model gives another heap. On the grid such numbers are equal.
    """

    box: Box
    steps: int | None
    """Number of steps in each interval. None: points are not rounded."""
    whole: tuple[bool, ...] = ()
    """Which parameters count, so that only their whole numbers are in the grid; empty for none."""

    @property
    def step(self) -> Array:
        """Length of a step of each parameter, shape (d,); 0 without a grid."""
        return self.box.width / self.steps if self.steps else np.zeros(self.box.dimension)

    def nearest(self, points: ArrayLike) -> Array:
        """Points (…, d) of the grid nearest to points (…, d).

        A coordinate is lower + (k / steps) (upper - lower) in double precision, with a whole number k. These
        are only sums, products and quotients, which IEEE 754 prescribes to the last bit. k = 0 and k = steps
        are exactly the bounds.
        """
        near = np.asarray(points, float)
        if self.steps:
            near = self.box.from_unit(np.rint(self.box.to_unit(near) * self.steps) / self.steps)
        return np.where(self.whole, np.rint(near), near) if any(self.whole) else near


@dataclass(frozen=True, slots=True)
class Space:
    """All parameters of a model, of which some are calibrated and the others constant."""

    parameters: tuple[Parameter, ...]
    calibrated: tuple[str, ...]

    def __post_init__(self) -> None:
        known = {p.name for p in self.parameters}
        for name in self.calibrated:
            if name not in known:
                raise InputError(f"parameter {name} is unknown; known: {', '.join(sorted(known))}")
        if not self.calibrated:
            raise InputError("no parameter is calibrated; name at least one")
        for p in self.parameters:
            if p.name not in self.calibrated and p.constant is None:
                raise InputError(f"parameter {p.name} has no constant value, so it must be calibrated")

    @property
    def box(self) -> Box:
        """Intervals of the calibrated parameters, in the parameters' order."""
        return Box.of(p for p in self.parameters if p.name in self.calibrated)

    @property
    def whole(self) -> tuple[bool, ...]:
        """Which of the calibrated parameters count, in the parameters' order."""
        return tuple(p.is_whole for p in self.parameters if p.name in self.calibrated)

    def complete(self, point: ArrayLike) -> dict[str, float]:
        """Full parameter set of a point (d,) of the box: calibrated values and constants."""
        values = dict(zip(self.box.names, map(float, np.asarray(point, float)), strict=True))
        return {p.name: values.get(p.name, constant_of(p)) for p in self.parameters}

    def point(self, values: Mapping[str, float]) -> Array:
        """Calibrated values of a full parameter set, shape (d,)."""
        return np.array([values[name] for name in self.box.names], dtype=float)


def constant_of(parameter: Parameter) -> float:
    """Value of a parameter that is not calibrated; NaN for one that always is."""
    return math.nan if parameter.constant is None else parameter.constant


GRID = 1_000_000
"""Steps of the grid of new studies: each is a millionth of an interval. Differences that matter are far
larger: in the plan, the shortest difference step of the second optimisation is ten steps, and noise leaves
the optimum of a parameter uncertain by thousands."""
