"""Calibrated parameters: names, units, intervals, and the box that they span.

A point of the box has coordinates. That of a parameter is its value; of a logarithmic one its decimal
logarithm; of one with listed values the place in the list, from 0. So design, Kriging and search work in a
box of plain intervals, whatever the parameters are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from calstudy.errors import InputError
from calstudy.parameters.expression import Expression, rounded

Array = NDArray[np.float64]

HALF = 0.49
"""What a listed value takes of the coordinates on either side; at a half, rounding would choose."""


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
    is_log: bool = False
    """Whether its interval is divided by ratios: its coordinate is the decimal logarithm."""
    values: tuple[float, ...] = ()
    """Its values where it has no other, upwards."""
    texts: tuple[str, ...] = ()
    """What a script is given for each of ``values``; empty where that is the number."""
    formula: Expression | None = None
    """What it follows from. It has no interval then."""

    def __post_init__(self) -> None:
        if self.formula is not None:
            return
        bounds = (self.lower, self.upper)
        is_constant = self.lower == self.upper == self.constant
        if not all(map(math.isfinite, bounds)) or not (self.lower < self.upper or is_constant):
            raise InputError(
                f"parameter {self.name}: interval [{self.lower}; {self.upper}] must be finite and go upwards"
            )
        if self.constant is not None and not math.isfinite(self.constant):
            raise InputError(f"parameter {self.name}: constant value {self.constant} must be finite")
        if self.is_log and not self.lower > 0:
            raise InputError(f"parameter {self.name}: a logarithmic interval must be positive")

    @property
    def ends(self) -> tuple[float, float]:
        """Coordinates of its bounds. Each listed value has the same share of them."""
        if self.values:
            return -HALF, len(self.values) - 1 + HALF
        return self.coordinate(self.lower), self.coordinate(self.upper)

    @property
    def is_bent(self) -> bool:
        """Whether its value is no linear function of the coordinates."""
        return self.formula is not None or (self.constant is None and (self.is_log or bool(self.values)))

    def coordinate(self, value: float) -> float:
        """Coordinate of one of its values; ValueError for one that is not listed."""
        if self.values:
            return float(self.values.index(value))
        return math.log10(value) if self.is_log else value

    def value(self, coordinate: float) -> float:
        """Value at a coordinate; at the ends exactly the bounds."""
        if self.values:
            return self.values[round(coordinate)]
        if not self.is_log:
            return coordinate
        low, high = self.ends
        if not low < coordinate < high:
            return self.lower if coordinate <= low else self.upper
        return rounded(10.0**coordinate)

    def takes(self, value: float) -> bool:
        """Whether it may have a value."""
        if self.values:
            return value in self.values
        return self.lower <= value <= self.upper and (not self.is_whole or float(value).is_integer())

    def said(self, value: float) -> str:
        """A value as a script is given it."""
        return self.texts[self.values.index(value)] if self.texts else f"{value:.5g}"

    @property
    def interval(self) -> str:
        """Its values in words."""
        if self.formula is not None:
            return f"= {self.formula.text}"
        if self.values and self.constant is None:
            named = (f"{v:g} = {t}" for v, t in zip(self.values, self.texts, strict=True))
            return ", ".join(named if self.texts else (f"{value:g}" for value in self.values))
        if self.constant is not None and self.lower == self.upper:
            return "fixed"
        return f"[{self.lower:g}; {self.upper:g}]{' log' if self.is_log else ''}"


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
            lower=tuple(p.ends[0] for p in chosen),
            upper=tuple(p.ends[1] for p in chosen),
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
            if p.name not in self.calibrated and p.constant is None and p.formula is None:
                raise InputError(f"parameter {p.name} has no constant value, so it must be calibrated")
            if p.formula is not None and (strange := set(p.formula.names) - self._plain):
                raise InputError(
                    f"parameter {p.name} follows from {min(strange)}, which is no parameter with a value or "
                    "interval of its own"
                )

    @property
    def _plain(self) -> set[str]:
        """Parameters that follow from no other."""
        return {p.name for p in self.parameters if p.formula is None}

    @property
    def free(self) -> tuple[Parameter, ...]:
        """Calibrated parameters, in the parameters' order."""
        return tuple(p for p in self.parameters if p.name in self.calibrated)

    @property
    def box(self) -> Box:
        """Intervals of the calibrated parameters as coordinates, in the parameters' order."""
        return Box.of(self.free)

    @property
    def whole(self) -> tuple[bool, ...]:
        """Which coordinates are whole numbers alone, in the parameters' order."""
        return tuple(p.is_whole or bool(p.values) for p in self.free)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(f"log10 {p.name}" if p.is_log else p.name for p in self.free)

    def complete(self, point: ArrayLike) -> dict[str, float]:
        """Full parameter set of a point (d,) of the box: calibrated values, constants, what follows."""
        at = zip(self.free, map(float, np.asarray(point, float)), strict=True)
        values = {p.name: p.value(coordinate) for p, coordinate in at}
        plain = {p.name: values.get(p.name, constant_of(p)) for p in self.parameters}
        return {p.name: p.formula.at(plain) if p.formula else plain[p.name] for p in self.parameters}

    def point(self, values: Mapping[str, float]) -> Array:
        """Point (d,) of a full parameter set."""
        return np.array([p.coordinate(values[p.name]) for p in self.free], dtype=float)

    def values(self, name: str, points: ArrayLike) -> Array:
        """Values (…) of any parameter at points (…, d)."""
        points = np.asarray(points, float)
        parameter = next(p for p in self.parameters if p.name == name)
        if parameter.formula is not None:
            found = parameter.formula({used: self.values(used, points) for used in parameter.formula.names})
            return np.broadcast_to(found, points.shape[:-1])
        if name not in self.calibrated:
            return np.full(points.shape[:-1], constant_of(parameter))
        at: Array = points[..., [p.name for p in self.free].index(name)]
        if parameter.values:
            return np.take(parameter.values, np.rint(at).astype(int), mode="clip")
        return np.clip(10.0**at, parameter.lower, parameter.upper) if parameter.is_log else at

    def snapped(self, points: Array) -> Array:
        """Points (…, d) with whole coordinates where only those are run."""
        return np.where(self.whole, np.rint(points), points) if any(self.whole) else points

    def shown(self, name: str, coordinate: float) -> float:
        """Value of a calibrated parameter at a coordinate; NaN for NaN."""
        parameter = next(p for p in self.free if p.name == name)
        return coordinate if math.isnan(coordinate) else parameter.value(coordinate)

    def takes(self, values: Mapping[str, float]) -> bool:
        """Whether a full parameter set lies in it, with what follows from others as it follows."""
        if not all(p.takes(values[p.name]) for p in self.parameters if p.formula is None):
            return False
        expected = self.complete(self.point(values))
        follow = [p.name for p in self.parameters if p.formula is not None]
        return all(math.isclose(values[name], expected[name], rel_tol=1e-9) for name in follow)

    def filled(self, values: Mapping[str, float]) -> dict[str, float]:
        """A parameter set that may lack constants and what follows from others, with them."""
        plain = {p.name: values.get(p.name, constant_of(p)) for p in self.parameters}
        return {
            p.name: p.formula.at(plain) if p.formula and p.name not in values else plain[p.name]
            for p in self.parameters
        }


def constant_of(parameter: Parameter) -> float:
    """Value of a parameter that is not calibrated; NaN for one that always is."""
    return math.nan if parameter.constant is None else parameter.constant


GRID = 1_000_000
"""Steps of the grid of new studies: each is a millionth of an interval. Differences that matter are far
larger: in the plan, the shortest difference step of the second optimisation is ten steps, and noise leaves
the optimum of a parameter uncertain by thousands."""
