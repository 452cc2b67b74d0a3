"""What tests would leave of the solution space, foretold by calibrations that are simulated on emulators.

One simulated calibration: the truth is a point of what is known now, the DEM model a draw from each
emulator's posterior. Runs are made as a calibration would make them: a design over the box, some points
where the test's own measurement would lead the search, and some more at one of these. Surrogates are fitted
to them by the calibration's own functions. By these surrogates, with their doubts, values that may be
measured are drawn, and weighed (``preposterior``). So the promise has the doubt of a calibration with few
runs in it, not that of the emulator.

Responses are fitted one by one, and so the likelihood of any set of them is a product.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calstudy.calibration.expected import expected_optimisation_runs, number_of_samples
from calstudy.calibration.kriging.surrogates import Kriging, Surrogates
from calstudy.calibration.posterior import drawn_anew, log_likelihood
from calstudy.calibration.task import Task
from calstudy.emulator.advice.emulated import EmulatedTest
from calstudy.emulator.advice.preposterior import After, after, hypothetical, log_likelihoods
from calstudy.parameters import Array, Space

SIMULATED = 16
"""Calibrations that are simulated."""
MEASURED = 16
"""Values that may be measured, drawn in each."""
POINTS = 4096
"""Points that stand for what is known, in each."""
FIRST = 2**15
"""Points of the box that these are chosen from, where targets are known."""
LOOKED_AT = 2**10
"""Points, of these and of those, that show where a search would end."""
SEARCHED = 0.04
"""Standard deviation of the search's points about its end, as a share of each interval. Of four calibrations
in six parameters, all points but the first were within a tenth or two of the end."""
SHOWN = 128
"""Points of each simulation that are looked at for what makes up for what."""

Responses = tuple[tuple[str, str], ...]
"""Tests with one of their responses each, which are measured together."""


@dataclass(frozen=True, slots=True)
class Runs:
    """DEM runs of each test in a calibration."""

    samples: int
    trials: int
    """Of the second optimisation."""
    again: int
    """That confirm its optimum."""

    @classmethod
    def of(cls, task: Task) -> Runs:
        """Runs that a task is expected to take."""
        optimisation = round(expected_optimisation_runs(task)) - task.confirm
        return cls(number_of_samples(task), max(optimisation, 1), task.confirm)

    @property
    def total(self) -> int:
        """All of them."""
        return self.samples + self.trials + self.again


@dataclass(frozen=True, slots=True)
class Procedure:
    """How the calibrations that are simulated are made."""

    space: Space
    runs: Runs
    design: Callable[[int, np.random.Generator], Array]
    """Points (samples, d) of the box."""
    prior: Callable[[int, np.random.Generator], Array]
    """Points (n, d) spread evenly over what is allowed of the box."""
    kriging: Kriging
    seed: int


@dataclass(frozen=True, slots=True)
class Now:
    """What is known already: points of a posterior, or targets that calibrations would be run to."""

    points: Array | None = None
    """Points (n, d) of the box, equally probable, of a study that is finished."""
    targets: Mapping[str, Mapping[str, float]] | None = None
    """Measured values by test and response, where there is no study; None where nothing is measured."""


@dataclass(frozen=True, slots=True)
class Foretold:
    """What is expected, over s simulated calibrations with k measurements each."""

    now: Array
    """Covariances (s, d, d) of what is known now, in the unit cube."""
    sample: Array
    """Points (n, d) of the unit cube that are possible now, over all simulations."""
    after: dict[Responses, After]
    """By the responses that are measured beside, each (s * k, ...)."""

    def left(self, responses: Responses) -> Array:
        """Shares (d,) of the parameters' standard deviations that are expected to be left."""
        then = self.after[responses].covariance.mean(axis=0)
        found: Array = np.sqrt(np.diag(then) / np.diag(self.now.mean(axis=0)))
        return found


def foretell(
    procedure: Procedure,
    now: Now,
    tests: Mapping[str, EmulatedTest],
    asked: Sequence[Responses],
    tell: Callable[[int, int], None] = lambda done, of: None,
    simulated: int = SIMULATED,
) -> Foretold:
    """Simulate calibrations with each set of responses ``asked``.

    ``tests`` has those of the targets and those that are asked for. ``tell`` hears how many simulations are
    done.
    """
    box = procedure.space.box
    covariances, samples = [], []
    found: dict[Responses, list[After]] = {responses: [] for responses in asked}
    wanted: dict[str, list[str]] = {}
    for name, response in dict.fromkeys(one for responses in asked for one in responses):
        wanted.setdefault(name, []).append(response)
    for s in range(simulated):
        rng = np.random.default_rng(np.random.SeedSequence(procedure.seed, spawn_key=(s,)))
        points, log_before = _known(procedure, now, tests, s, rng)
        unit = box.to_unit(points)
        covariances.append(after(unit, np.zeros((1, len(unit))), log_before).covariance[0])
        truth, *others = rng.permutation(drawn_anew(log_before, 1 + SHOWN, rng))
        samples.append(unit[others])
        likelihoods: dict[tuple[str, str], Array] = {}
        for name, responses in wanted.items():
            test = replace(tests[name], responses=tuple(responses))
            measured = _measured(procedure, test, points, log_before, int(truth), s, rng)
            likelihoods |= {
                (name, response): values for response, values in zip(responses, measured, strict=True)
            }
        for chosen in asked:
            together: Array = np.sum([likelihoods[one] for one in chosen], axis=0)
            found[chosen].append(after(unit, together, log_before))
        tell(s + 1, simulated)
    return Foretold(
        np.array(covariances),
        np.concatenate(samples),
        {chosen: _together(parts) for chosen, parts in found.items()},
    )


def _together(parts: Sequence[After]) -> After:
    return After(
        *(np.concatenate([getattr(p, n) for p in parts]) for n in ("covariance", "information", "effective"))
    )


def _known(
    procedure: Procedure, now: Now, tests: Mapping[str, EmulatedTest], s: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points (n, d) of the box, and the logarithms (n,) of their weights now."""
    if now.points is not None:
        chosen = rng.permutation(len(now.points))[:POINTS]
        return now.points[chosen], np.zeros(len(chosen))
    if not now.targets:
        return procedure.prior(POINTS, rng), np.zeros(POINTS)
    points = procedure.prior(FIRST, rng)
    targeted = [
        (replace(tests[name], responses=tuple(targets)), np.array(list(targets.values())))
        for name, targets in now.targets.items()
    ]
    looked_at = points[: 4 * LOOKED_AT]
    near, log_weights = np.zeros(len(looked_at)), np.zeros(len(points))
    for test, values in targeted:
        means, doubts = test.means(procedure.space, looked_at)
        near += log_likelihood(means - values, doubts, test.sds)
    for test, values in targeted:
        surrogates = _surrogates(procedure, test, looked_at, near, s, rng)
        means, doubts = surrogates.predict_with_deviations(points)
        log_weights += log_likelihood(means - values, doubts, test.sds)
    chosen, counts = np.unique(drawn_anew(log_weights, POINTS, rng), return_counts=True)
    return points[chosen], np.log(counts)


def _measured(
    procedure: Procedure,
    test: EmulatedTest,
    points: Array,
    log_before: Array,
    truth: int,
    s: int,
    rng: np.random.Generator,
) -> list[Array]:
    """Of each response the log-likelihoods (k, n) of values that may be measured, at points (n, d)."""
    looked_at = np.concatenate([[truth], rng.permutation(len(points))[:LOOKED_AT]])
    means, doubts = test.means(procedure.space, points[looked_at])
    near = log_before[looked_at] + log_likelihood(means - means[0], doubts, test.sds)
    surrogates = _surrogates(procedure, test, points[looked_at], near, s, rng)
    means, doubts = surrogates.predict_with_deviations(points)
    values = hypothetical(means[truth], doubts[truth], test.sds, MEASURED, rng)
    return [
        log_likelihoods(values[:, k], means[:, k], doubts[:, k], test.sds[k])
        for k in range(len(test.responses))
    ]


def _surrogates(
    procedure: Procedure, test: EmulatedTest, points: Array, near: Array, s: int, rng: np.random.Generator
) -> Surrogates:
    """Surrogates of a simulated calibration.

    Its search ends at one of the points (n, d), drawn by their log-weights ``near`` (n,), and is close to it
    all the time: it does not explore what else would do as well.
    """
    runs, box = procedure.runs, procedure.space.box
    optimum = points[drawn_anew(near, 1, rng)]
    steps = SEARCHED * rng.standard_normal((runs.trials, box.dimension))
    tried = box.from_unit(np.clip(box.to_unit(optimum) + steps, 0.0, 1.0))
    again = np.repeat(optimum, runs.again, axis=0)
    at = np.vstack([procedure.design(runs.samples, rng), procedure.space.snapped(tried), again])
    responses = test.run(test.emulator.draw(procedure.seed + s), procedure.space, at, rng)
    kriging = replace(procedure.kriging, divisors=test.proportional)
    noise = {name: test.noise[name] for name in test.responses if name in test.noise}
    fitted = Surrogates.fit(kriging, procedure.space, test.responses, at, responses, noise)
    return fitted.averaged(procedure.seed + s)
