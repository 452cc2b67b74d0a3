"""The same peers with calstudy's closed forms: what remains of its lead where everybody knows as much.

Where two parameters act through their quotient alone, and a response is proportional to the second, a run
tells the responses at every value of the second with that quotient. So the peer searches the others and the
quotient, and the second parameter is solved for after each run. What the peer sees are the responses there.
Problems that know no such forms (rows that calibrate one of the two, formulas) are left as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import peers

from calstudy.calibration.kriging.coordinates import Coordinates
from calstudy.emulator.benchmark.methods import METHODS
from calstudy.emulator.benchmark.problem import Method, Problem
from calstudy.parameters import Array, Parameter, Space


class Informed:
    """A problem in the coordinates that count; what is not here is the problem's own."""

    def __init__(self, problem: Problem, ratio: tuple[str, str]) -> None:
        self.problem, (self.above, self.below) = problem, ratio
        self.coordinates = Coordinates.of(problem.space, ratio)
        box = self.coordinates.box
        ends = zip(box.names, box.lower, box.upper, strict=True)
        self.space = Space(tuple(Parameter(name, "-", *two, None) for name, *two in ends), box.names)
        self.names, self.lower, self.upper = box.names, np.array(box.lower), np.array(box.upper)
        self.whole = (False,) * len(self.names)
        self.scaled = np.array([problem.proportional.get(name) == self.below for name in problem.responses])
        self.known: list[tuple[Array, Array]] = []
        """Of each run its point, and its responses at a `below` of 1."""
        self.least, self.is_named = np.inf, False
        self.best: tuple[Array, bool] | None = None
        """The cheapest point so far, and whether all responses were within their tolerances there."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.problem, name)

    def full(self, point: Array, reduced: Array | None = None) -> Array:
        """The point (d,) with the best `below` for responses (m,) at one of 1; the nearest run's by default.

        It is in the middle of what the quotient allows before the first run.
        """
        point = np.clip(point, self.lower, self.upper)
        box, quotient = self.problem.space.box, float(np.exp(point[-1]))
        ends = {name: (box.lower[k], box.upper[k]) for k, name in enumerate(box.names)}
        low = max(ends[self.below][0], ends[self.above][0] / quotient)
        high = min(ends[self.below][1], ends[self.above][1] / quotient)
        if reduced is None and self.known:
            there = np.array([known for known, _ in self.known])
            distances = np.sum(((there - point) / (self.upper - self.lower)) ** 2, axis=1)
            reduced = self.known[int(np.argmin(distances))][1]
        below = (low + high) / 2
        if reduced is not None:
            shares = (reduced / self.problem.desired)[self.scaled]
            below = float(np.clip(shares.sum() / (shares @ shares), low, high))
        values = dict(zip(self.names, point, strict=True)) | {self.below: below, self.above: quotient * below}
        return np.array([values[name] for name in box.names])

    def runs(self, points: Sequence[Sequence[float]] | Array) -> Array:
        """Responses (k, m) at the best `below` of each point (k, d); NaN where a run failed."""
        points = np.clip(np.array(points, float), self.lower, self.upper)
        full = np.array([self.full(point) for point in points]).reshape(-1, len(self.problem.names))
        answers = self.problem.runs(full)
        k, found = self.problem.names.index(self.below), []
        for point, made, answer in zip(points, full, answers, strict=True):
            reduced = np.where(self.scaled, answer / made[k], answer)
            if np.isfinite(reduced).all():
                best = self.full(point, reduced)
                answer = np.where(self.scaled, reduced * best[k], reduced)
                self.known.append((point, reduced))
                if (cost := self.problem.square_sum(best, answer)) < self.least:
                    self.least, self.best = cost, (best, self.problem.is_within(answer))
            found.append(answer)
        if self.best is not None and not self.is_named:
            self.problem.name(*self.best)
        return np.array(found).reshape(-1, len(self.problem.responses))

    def run(self, point: Sequence[float] | Array) -> Array:
        """Responses (m,) of one run."""
        answers: Array = self.runs(np.asarray(point, float)[None])[0]
        return answers

    def residuals(self, point: Sequence[float] | Array, responses: Sequence[float] | Array) -> Array:
        """Residuals (m + 1,); that of the Rayleigh time-step depends on the quotient alone."""
        return self.problem.residuals(self.full(np.asarray(point, float)), responses)

    def square_sum(self, point: Sequence[float] | Array, responses: Sequence[float] | Array) -> float:
        """The sum of their squares."""
        residuals = self.residuals(point, responses)
        return float(residuals @ residuals)

    def name(self, point: Sequence[float] | Array) -> None:
        """Name an answer."""
        self.is_named = True
        self.problem.name(self.full(np.asarray(point, float)))


def told(method: Callable[[Any], Any]) -> Method:
    """A method that is told the closed forms."""

    def informed(problem: Problem) -> None:
        ratios = {problem.ratios.get(name) for name in problem.responses}
        ratio = ratios.pop()
        if ratios or ratio is None or not {*ratio} <= {*problem.names}:
            found = method(problem)
            if found is not None:
                problem.name(found)
            return
        view = Informed(problem, ratio)
        found = method(view)
        if found is not None:
            view.name(found)

    return informed


sobol = told(METHODS["sobol"])
cma_es = told(peers.cma_es)
dfo_ls = told(peers.dfo_ls)
least_squares = told(peers.least_squares)
optuna_gp = told(peers.optuna_gp)
optuna_tpe = told(peers.optuna_tpe)
