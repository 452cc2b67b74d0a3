"""Linear constraints between parameters, such as ``MU_PP >= MU_PW``."""

from __future__ import annotations

import ast
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calstudy.calibration.sampling import latin_hypercube
from calstudy.errors import InputError, NumericsError
from calstudy.parameters import Array, Box, Grid, Space
from calstudy.written import choice

ROUNDED = 1e-9
"""A constraint holds if it is broken by no more than this share of its range over the box, by rounding."""
LEAST_SHARE = 1e-3
"""Least share of the box that constraints may leave; points inside them are looked for by chance."""
LOOKED_AT = 2**14
"""Points from which the share is estimated."""
SPARE = 8
"""Points inside the constraints for each point of a design."""
LONGEST = 500
"""Most characters of a constraint."""
LIKE = "write for example 'A >= B' or 'A + 2 * B <= 0.5'"


@dataclass(frozen=True, slots=True)
class Constraint:
    """That a sum of multiples of parameters is at most a bound."""

    text: str
    """As it was written."""
    factors: Mapping[str, float]
    bound: float


def parse(text: str, names: Sequence[str]) -> list[Constraint]:
    """Constraints of a comparison of linear terms; a chain such as ``A >= B >= C`` is several.

    InputError: it is anything else, or names an unknown parameter.
    """
    try:
        if len(text) > LONGEST:
            raise ValueError
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(f"{text[:LONGEST]!r} is not a comparison; {LIKE}") from error
    if not isinstance(tree, ast.Compare):
        raise InputError(f"{text!r} compares nothing; {LIKE}")
    sides = [_linear(side, text, names) for side in (tree.left, *tree.comparators)]
    found = []
    for (left, right), operator in zip(itertools.pairwise(sides), tree.ops, strict=True):
        if isinstance(operator, ast.GtE | ast.Gt):
            left, right = right, left
        elif not isinstance(operator, ast.LtE | ast.Lt):
            raise InputError(
                f"{text!r} compares by neither <= nor >=; where a parameter follows from others, compute it "
                "in the model's script, and calibrate the others"
            )
        factors, constant = _sum(left, _times(-1.0, right))
        found.append(
            Constraint(text, {name: factor for name, factor in factors.items() if factor}, -constant)
        )
    return found


Linear = tuple[dict[str, float], float]
"""Factor of each parameter in a sum, and its constant."""


def _linear(node: ast.expr, text: str, names: Sequence[str]) -> Linear:
    """A side of a comparison. Only what is listed here is read; nothing is evaluated."""
    match node:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            if math.isfinite(number):
                return {}, float(number)
        case ast.Name(id=name):
            if name not in names:
                raise InputError(f"{text!r}: {name} is not a parameter; {choice(name, names, 'there are')}")
            return {name: 1.0}, 0.0
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return _times(-1.0, _linear(operand, text, names))
        case ast.BinOp(left=one, op=ast.Add() | ast.Sub() as op, right=two):
            other = _times(1.0 if isinstance(op, ast.Add) else -1.0, _linear(two, text, names))
            return _sum(_linear(one, text, names), other)
        case ast.BinOp(left=one, op=ast.Mult(), right=two):
            left, right = _linear(one, text, names), _linear(two, text, names)
            if not left[0]:
                return _times(left[1], right)
            if not right[0]:
                return _times(right[1], left)
        case ast.BinOp(left=one, op=ast.Div(), right=two):
            left, right = _linear(one, text, names), _linear(two, text, names)
            if not right[0] and right[1] != 0.0:
                return _times(1.0 / right[1], left)
    raise InputError(f"{text!r} is not linear; use numbers, parameters, + and -, and * and / by numbers")


def _sum(one: Linear, two: Linear) -> Linear:
    names = {**one[0], **two[0]}
    return {name: one[0].get(name, 0.0) + two[0].get(name, 0.0) for name in names}, one[1] + two[1]


def _times(factor: float, term: Linear) -> Linear:
    return {name: factor * value for name, value in term[0].items()}, factor * term[1]


@dataclass(frozen=True, slots=True)
class Allowed:
    """The part of a box that constraints leave: A x <= b in the parameters' units."""

    box: Box
    texts: tuple[str, ...]
    A: Array
    """Factors (c, d) of the calibrated parameters."""
    b: Array
    """Bounds (c,), less what constants add to the sums."""
    centre: Array
    """Mean (d,) of the allowed points, which keeps all constraints."""

    @classmethod
    def of(cls, constraints: Sequence[Constraint], space: Space) -> Allowed:
        """What the constraints leave of a space's box.

        InputError: a constraint has no calibrated parameter, or one that is no plain interval; they leave
        next to nothing.
        """
        box, values = space.box, space.complete(space.box.centre)
        for one in constraints:
            if not set(one.factors) & set(box.names):
                raise InputError(f"{one.text!r} has no calibrated parameter; remove it")
            bent = [p.name for p in space.parameters if p.name in one.factors and p.is_bent]
            if bent:
                raise InputError(
                    f"{one.text!r}: {bent[0]} is logarithmic, listed, or follows from others; a constraint "
                    "takes plain intervals and constants"
                )
        A = np.array([[one.factors.get(name, 0.0) for name in box.names] for one in constraints])
        fixed = [
            sum(factor * values[name] for name, factor in one.factors.items() if name not in box.names)
            for one in constraints
        ]
        texts = tuple(one.text for one in constraints)
        found = cls(box, texts, A, np.array([one.bound for one in constraints]) - fixed, box.centre)
        points = box.from_unit(latin_hypercube(LOOKED_AT, box.dimension, np.random.default_rng(0)))
        inside = points[found.holds(points)]
        if len(inside) < LEAST_SHARE * LOOKED_AT:
            raise InputError(
                f"{' and '.join(map(repr, dict.fromkeys(texts)))} leave {len(inside) / LOOKED_AT:.2g} of the "
                "intervals' box, which is too little to search; correct them, or the intervals"
            )
        return replace(found, centre=inside.mean(axis=0))

    @property
    def unit(self) -> tuple[Array, Array]:
        """A (c, d) and b (c,) in the unit cube, each constraint over its range there."""
        ranges = np.abs(self.A) @ self.box.width
        return self.A * self.box.width / ranges[:, None], (self.b - self.A @ self.box.lower) / ranges

    def slack(self, points: Array) -> Array:
        """How far (…, c) points (…, d) are inside each constraint, as a share of its range over the box."""
        A, b = self.unit
        return np.asarray(b - self.box.to_unit(points) @ A.T)

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (…, d) keep all constraints."""
        return np.asarray(np.all(self.slack(points) >= -ROUNDED, axis=-1))

    def pulled_in(self, point: Array) -> Array:
        """A point (d,) itself if it keeps the constraints; otherwise where the way to the centre enters."""
        here, there = self.slack(point), self.slack(self.centre)
        out = here < 0.0
        way = float(np.max(here[out] / (here[out] - there[out]), initial=0.0))
        return np.asarray(point + way * (self.centre - point))

    def nearest(self, points: Array, grid: Grid) -> Array:
        """Points (k, d) of the grid that keep the constraints, near points (k, d) that do.

        Where the nearest point of the grid breaks one, it is the nearest corner of the cell that breaks none.
        NumericsError: each corner breaks one.
        """
        near = grid.nearest(points)
        for k in np.flatnonzero(~self.holds(near)):
            near[k] = self._corner(points[k], near[k], grid)
        return near

    def _corner(self, point: Array, near: Array, grid: Grid) -> Array:
        """The nearest of the corners (d,) around a point (d,) that keep the constraints."""
        step = np.where(grid.whole, 1.0, grid.step) if grid.whole else grid.step
        beyond = near + np.where(point >= near, step, -step)
        other = grid.nearest(np.clip(beyond, self.box.lower, self.box.upper))
        used = np.flatnonzero(self.A.any(axis=0))
        corners = np.tile(near, (2 ** len(used), 1))
        for corner, chosen in zip(corners, itertools.product((False, True), repeat=len(used)), strict=True):
            moved = used[np.array(chosen)]
            corner[moved] = other[moved]
        kept = corners[self.holds(corners)]
        if not len(kept):
            raise NumericsError(f"no point of the grid near {point} keeps {' and '.join(self.texts)}")
        return np.asarray(kept[np.argmin(np.sum(((kept - point) / self.box.width) ** 2, axis=1))])

    def spread(self, n: int, rng: np.random.Generator) -> Array:
        """Random points (n, d) of the unit cube that keep the constraints, of one Latin hypercube."""
        drawn = n
        while True:
            unit = latin_hypercube(drawn, self.box.dimension, rng)
            unit = unit[self.holds(self.box.from_unit(unit))]
            if len(unit) >= n:
                return unit[:n]
            drawn *= 2

    def design(self, n: int, rng: np.random.Generator) -> Array:
        """Well-spread points (n, d) of the unit cube that keep the constraints.

        Of SPARE times as many, one of the closest two is left out until n remain: the more crowded one.
        """
        inside = self.spread(SPARE * n, rng)
        distances = np.linalg.norm(inside[:, None] - inside, axis=2)
        np.fill_diagonal(distances, np.inf)
        while len(inside) > n:
            pair = np.unravel_index(np.argmin(distances), distances.shape)
            out = min(pair, key=lambda k: float(np.partition(distances[k], 1)[1]))
            inside = np.delete(inside, out, axis=0)
            distances = np.delete(np.delete(distances, out, axis=0), out, axis=1)
        return inside
