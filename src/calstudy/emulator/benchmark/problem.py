"""A calibration as a method of the benchmark meets it: it asks for runs, pays for them, and names a point.

A method is a function of one `Problem`. Its answer is what it returns, or the last point that it named by
`Problem.name`. A method that does neither is taken to answer with the cheapest of its runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calstudy.calibration.cost import Cost
from calstudy.errors import InputError
from calstudy.parameters import Array, Space

WORKERS = 8
"""Runs at once that a round of runs stands for."""


class Spent(Exception):
    """The budget does not pay for the run that was asked for. A method may let it pass."""


@dataclass(frozen=True, slots=True)
class Truth:
    """A DEM model's responses as functions of points (k, d) of the calibrated parameters."""

    responses: Callable[[Array], Array]
    """Without noise, (k, m); NaN where a run fails."""
    noise_sd: Callable[[Array], Array]
    """Standard deviation from seed to seed, (k, m)."""


@dataclass(frozen=True, slots=True)
class Made:
    """A run at the fidelity that counts."""

    paid: float
    """What the method had paid with it, in runs of the fidelity that counts."""
    rounds: int
    """Rounds that the method had taken with it."""
    point: Array
    responses: Array


@dataclass(frozen=True, slots=True)
class Named:
    """A point (d,) that a method named as its answer, and what it said of it."""

    paid: float
    """What the method had paid by then, in runs of the fidelity that counts."""
    rounds: int
    """Rounds that it had taken by then."""
    point: Array
    within: bool | None
    """Whether it said that all responses are within their tolerances there; None: it did not say."""
    expected: Array | None = None
    """Noise-free responses (m,) that it expected there; None: it did not say."""
    doubts: Array | None = None
    """Standard deviations (m,) of what it expected."""

    def surprise(self, responses: Array) -> float:
        """Root mean square of what responses (m,) deviate from those expected, in its own doubts.

        1 where the doubts are honest on average; NaN where it said nothing.
        """
        if self.expected is None or self.doubts is None:
            return np.nan
        return float(np.sqrt(np.mean(((responses - self.expected) / self.doubts) ** 2)))


@dataclass
class Problem:
    """One calibration: parameters in their units, desired responses, and runs that are paid for."""

    space: Space
    cost: Cost
    tolerances: Mapping[str, float]
    """Deviation of each response from its target that is good enough, in the response's units."""
    noise: Mapping[str, float]
    """Known standard deviation of each response from seed to seed."""
    proportional: Mapping[str, str]
    """Parameter that a response is proportional to, by the response's name: bulk density is to DENS."""
    ratios: Mapping[str, tuple[str, str]]
    """Two parameters that act on a response through their quotient alone, by the response's name. On one that
    is proportional to a parameter they act so on what is left."""
    budget: float
    seed: int
    """For the method's own random numbers."""
    truths: Mapping[str, Truth] = field(repr=False)
    """By fidelity. The first is the one that counts; methods do not look inside."""
    prices: Mapping[str, float]
    """What a run at each fidelity costs, in runs of the first."""
    paid: float = 0.0
    rounds: int = 0
    asked: int = 0
    """Runs so far, at any fidelity."""
    made: list[Made] = field(default_factory=list)
    named: list[Named] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibrated parameters."""
        return self.space.box.names

    @property
    def lower(self) -> Array:
        """Lower ends of their intervals, (d,)."""
        return np.array(self.space.box.lower)

    @property
    def upper(self) -> Array:
        """Upper ends of their intervals, (d,)."""
        return np.array(self.space.box.upper)

    @property
    def whole(self) -> tuple[bool, ...]:
        """Which parameters count, so that they are run at whole numbers alone."""
        return self.space.whole

    @property
    def responses(self) -> tuple[str, ...]:
        """Names of the responses, in the order of all arrays of them."""
        return self.cost.responses

    @property
    def desired(self) -> Array:
        """Desired responses, (m,)."""
        return self.cost.desired

    @property
    def fidelities(self) -> tuple[str, ...]:
        """Names of the fidelities; the first is the one that counts."""
        return tuple(self.prices)

    def run(self, point: Sequence[float] | Array, fidelity: str | None = None) -> Array:
        """Responses (m,) of one run at a point (d,); NaN if it failed. Raises `Spent`."""
        answers: Array = self.runs(np.asarray(point, float)[None], fidelity)[0]
        return answers

    def runs(self, points: Sequence[Sequence[float]] | Array, fidelity: str | None = None) -> Array:
        """Responses (k, m) of runs at points (k, d), made at once; NaN where one failed.

        Raises `Spent`, with no run made, where the budget does not pay for all.
        """
        name = self.fidelities[0] if fidelity is None else fidelity
        if name not in self.prices:
            raise InputError(f"fidelity {name!r} is unknown; there are {', '.join(self.prices)}")
        points = np.array(points, float)
        if points.ndim != 2 or points.shape[1] != len(self.names) or not np.isfinite(points).all():
            raise InputError(
                f"points to be run must be finite, and (k, {len(self.names)}): {', '.join(self.names)}"
            )
        if len(points) == 0:
            return np.empty((0, len(self.responses)))
        if self.paid + len(points) * self.prices[name] > self.budget + 1e-9:
            raise Spent(f"{self.budget:g} runs are paid for, and {self.paid:g} of them are made")
        inside = np.clip(points, self.lower, self.upper)
        inside = np.where(self.whole, np.rint(inside), inside) if any(self.whole) else inside
        before, rounds, price = self.paid, self.rounds, self.prices[name]
        self.paid += len(points) * price
        self.rounds += -(-len(points) // WORKERS)
        truth = self.truths[name]
        exact, scatter = truth.responses(inside), truth.noise_sd(inside)
        draws = [np.random.default_rng([self.seed, self.asked + k]) for k in range(len(points))]
        self.asked += len(points)
        found: Array = exact + scatter * [rng.standard_normal(len(self.responses)) for rng in draws]
        if name == self.fidelities[0]:
            self.made += [
                Made(before + price * k, rounds - (-k // WORKERS), point, answer)
                for k, (point, answer) in enumerate(zip(inside, found, strict=True), start=1)
            ]
        return found

    def residuals(self, point: Sequence[float] | Array, responses: Sequence[float] | Array) -> Array:
        """Residuals (m + 1,) of Eq. 9 and 10 at a point (d,) with responses (m,)."""
        return self.cost.residuals(np.asarray(point, float), np.asarray(responses, float))

    def square_sum(self, point: Sequence[float] | Array, responses: Sequence[float] | Array) -> float:
        """Cost of a point (d,) with responses (m,): the sum of squares of its residuals."""
        residuals = self.residuals(point, responses)
        return float(residuals @ residuals)

    def is_within(self, responses: Sequence[float] | Array) -> bool:
        """Whether responses (m,) are all within their tolerances."""
        allowed = np.array([self.tolerances[name] for name in self.responses])
        return bool(np.all(np.abs(np.asarray(responses, float) - self.desired) <= allowed))

    def name(
        self,
        point: Sequence[float] | Array,
        within: bool | None = None,
        expected: Sequence[float] | Array | None = None,
        doubts: Sequence[float] | Array | None = None,
    ) -> None:
        """Name a point (d,) as the answer if the budget ended here.

        ``within``: whether all responses are said to be within their tolerances there. ``expected``: what
        they are expected to be without noise (m,), with standard deviations ``doubts`` (m,), above 0.
        """
        inside = np.clip(np.asarray(point, float), self.lower, self.upper)
        said = [None if one is None else np.asarray(one, float) for one in (expected, doubts)]
        if any(one is not None and one.shape != self.desired.shape for one in said):
            raise InputError(f"expected responses and their doubts must be ({len(self.responses)},)")
        self.named.append(Named(self.paid, self.rounds, inside, within, *said))

    def answer(self, paid: float) -> Named | None:
        """What the method answers once it has paid so much: the last point that it named by then.

        One that has named none by then answers with its cheapest run. Where it said nothing about the
        tolerances, it says what its last run at the point says. None: no run has succeeded by then.
        """
        there = [named for named in self.named if named.paid <= paid + 1e-9]
        made = [run for run in self.made if run.paid <= paid + 1e-9]
        if there:
            last = there[-1]
        else:
            costs = [self.square_sum(run.point, run.responses) for run in made]
            if not np.isfinite(costs).any():
                return None
            last = Named(made[-1].paid, made[-1].rounds, made[int(np.nanargmin(costs))].point, None)
        if last.within is not None:
            return last
        here = [run.responses for run in made if np.array_equal(run.point, last.point)]
        return replace(last, within=self.is_within(here[-1]) if here else None)


Method = Callable[[Problem], "Sequence[float] | Array | None"]
"""A calibrator: asks a problem for runs, and returns the point (d,) that it found, or None."""


def solve(method: Method, problem: Problem) -> None:
    """Let a method work on a problem until it returns or has spent the budget."""
    try:
        found = method(problem)
    except Spent:
        return
    if found is not None:
        problem.name(found)
