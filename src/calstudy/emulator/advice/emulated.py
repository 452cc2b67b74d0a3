"""A material test through its emulator: its responses at points of a calibration's box, and what a run
costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calstudy.emulator.emulator import MARGIN, Answers, Emulator, Response
from calstudy.emulator.similarity import inputs_of
from calstudy.errors import InputError
from calstudy.parameters import Array, Space, constant_of

Answer = Callable[[Response, Array], tuple[Array, Array]]
"""Two numbers of a response at points (k, d) of the unit cube, each (k,)."""

CHUNK = 1024
"""Points that an emulator is asked for at once."""


@dataclass(frozen=True)
class EmulatedTest:
    """A test, with the responses of it that count."""

    emulator: Emulator
    responses: tuple[str, ...]
    errors: Mapping[str, float]
    """Standard deviation of a laboratory's value of each, in its unit."""
    noise: Mapping[str, float]
    """Known standard deviations of a run from seed to seed, in the responses' units."""
    seconds: float
    """Processor time of a run."""

    @property
    def name(self) -> str:
        """Name of its model."""
        return self.emulator.origin.model

    @property
    def proportional(self) -> dict[str, str]:
        """Parameter that a response is proportional to, by response."""
        every = self.emulator.similarity.responses
        return {r.name: r.proportional_to for r in every if r.proportional_to is not None}

    @property
    def sds(self) -> Array:
        """Errors (m,) in the order of the responses."""
        return np.array([self.errors[name] for name in self.responses])

    def means(self, space: Space, points: Array) -> tuple[Array, Array]:
        """Expected responses at points (k, d) and their standard deviations, each (k, m)."""
        return self._of(space, points, lambda response, unit: response.process.mean_and_sd(unit))

    def run(
        self, answers: Mapping[str, Answers], space: Space, points: Array, rng: np.random.Generator
    ) -> Array:
        """Responses (k, m) of a run at each point (k, d), with noise."""
        mean, noise = self._of(
            space,
            points,
            lambda response, unit: (
                answers[response.name].noise_free(unit),
                answers[response.name].noise_sd(unit),
            ),
        )
        run: Array = mean + noise * rng.standard_normal(mean.shape)
        return run

    def _of(self, space: Space, points: Array, answer: Answer) -> tuple[Array, Array]:
        """Two numbers of each response, in its unit, at points (k, d): each (k, m)."""
        similarity = self.emulator.similarity
        unit = np.clip(self.emulator.box.to_unit(self._inputs(space, points)), 0.0, 1.0)
        of = {r.reduced: r for r in similarity.responses}
        ones, others = [], []
        chosen = {of[r.name].name: r for r in self.emulator.responses}
        for name in self.responses:
            parts = [answer(chosen[name], unit[k : k + CHUNK]) for k in range(0, len(unit), CHUNK)]
            one, other = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
            divisor = self.proportional.get(name)
            by = np.ones(len(points)) if divisor is None else space.values(divisor, points)
            ones.append(by * one)
            others.append(by * other)
        return np.column_stack(ones), np.column_stack(others)

    def _inputs(self, space: Space, points: Array) -> Array:
        names = [name for name, _ in self.emulator.similarity.parameters]
        table = pd.DataFrame({name: space.values(name, points) for name in names})
        return inputs_of(table, self.emulator.similarity)

    def require_covered(self, space: Space, corners: Array) -> None:
        """InputError where the emulator does not know a parameter, or part of the box.

        ``corners`` (k, d) are points that reach the box's ends.
        """
        known = {p.name: p for p in space.parameters}
        similarity = self.emulator.similarity
        if missing := [name for name, _ in similarity.parameters if name not in known]:
            raise InputError(f"{self.name} takes {missing[0]}, which the file has not")
        takes = {name for name, _ in similarity.parameters}
        if strange := [name for name in space.calibrated if name not in takes]:
            raise InputError(f"{self.name} does not take {strange[0]}, which the file calibrates")
        for name, value in similarity.constants:
            held = constant_of(known[name])
            if not np.isclose(held, value, rtol=MARGIN):
                raise InputError(f"{self.name}: its emulator knows {name} = {value:g} alone")
        box, values = self.emulator.box, self._inputs(space, corners)
        unit = box.to_unit(values)
        for k, name in enumerate(box.names):
            if unit[:, k].min() < -MARGIN or unit[:, k].max() > 1.0 + MARGIN:
                raise InputError(
                    f"{self.name}: {name} goes from {values[:, k].min():.4g} to {values[:, k].max():.4g}, "
                    f"its emulator from {box.lower[k]:.4g} to {box.upper[k]:.4g}"
                )


def corners_of(space: Space) -> Array:
    """All corners (2^d, d) of a box."""
    box = space.box
    grids = np.meshgrid(*([0.0, 1.0],) * box.dimension, indexing="ij")
    return box.from_unit(np.column_stack([grid.ravel() for grid in grids]))
