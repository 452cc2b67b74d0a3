"""Numbers of DEM runs: those that a calibration samples, and those that it is expected to take."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from calstudy.calibration.modes import Refinement
from calstudy.calibration.sampling import places_taken
from calstudy.calibration.task import Task

CHEAP_FOR_ONE = 2
"""Cheap samples for each run of the mode's ``overview``."""
FURTHER = 2
"""Beside one for each parameter, so many cheap runs follow the samples at most."""
UNCONFIRMED = 5
"""Points of a second optimisation of mode ``robust``."""
CONFIRMED = {True: 4, False: 3}
"""The same where runs that confirm the optimum let it end earlier, by whether the mode chooses the number of
samples. On emulators and stand-ins (benchmarks/fewer_runs.py) they are 4.0 of six parameters, and 2.4 of rows
of the plan, which have more samples; where nothing is confirmed, 5.2 and 4.3."""


def number_of_samples(task: Task) -> int:
    """S of Eq. 11 if the task gives it, otherwise the number that the mode chooses.

    An earlier study needs no more than are to check it.
    """
    if task.cheap is not None and task.cheap.earlier is not None:
        return len(task.checks)
    if task.samples is not None:
        return task.samples
    assert task.mode.samples is not None  # a task without both is refused
    dimension = task.space.box.dimension
    if task.cheap is not None:
        return CHEAP_FOR_ONE * task.mode.overview(dimension)
    return task.mode.samples(dimension)


def number_of_new_samples(task: Task) -> int:
    """Number of samples that no earlier calibration has run."""
    there = np.array([task.space.point(run.parameters) for run in task.stored])
    samples, box = number_of_samples(task), task.space.box
    return samples - places_taken(samples, box.to_unit(there.reshape(-1, box.dimension)))


def number_of_sampling_runs(task: Task) -> int:
    """Number of runs of the sampling phase, those of earlier calibrations among them."""
    return number_of_new_samples(task) + len(task.stored)


def expected_optimisation_runs(task: Task) -> float:
    """DEM runs that a second optimisation is expected to take, with those that confirm its optimum.

    See `expected_batches`; a second optimisation's cheap runs are not among them.
    """
    second = task.mode.second_optimisation
    if task.cheap is not None and isinstance(second, Refinement):
        return second.most_expensive + task.confirm
    guess = sum(_second_batches(task))
    return min(guess, math.inf if second.budget is None else second.budget) + task.confirm


def most_further_runs(task: Task) -> int:
    """Most cheap runs that follow the samples; 0 for one fidelity, and after an earlier study."""
    if task.cheap is None or task.cheap.earlier is not None:
        return 0
    return task.space.box.dimension + FURTHER


def expected_batches(task: Task) -> tuple[list[int], list[int]]:
    """Numbers of parameter sets that a calibration is expected to request at once, batch by batch.

    The first list is of the expensive fidelity, or of the only one, the second of the cheap one.

    First come the samples. Then mode ``paper`` requests a start, three Jacobians and six trials, and
    ``robust`` five points, one by one. That is what second optimisations of shipped studies took on average:
    31.0 runs in the 72 rows of reports/soft/paper, from 27 with two parameters to 53 with six, and 4.6 in the
    11 rows of mode ``robust`` in reports/coarse-rows and reports/soft, none of which was confirmed. Before a
    confirmation fewer points are enough, as `CONFIRMED` has them. Runs that confirm the optimum are the last
    batch. With two fidelities, or after an earlier study, all runs that may be made are expected.

    Several points ``together`` take fewer batches and more runs: of six parameters 2.6 batches of two, or 1.9
    of three, in place of 4.3 points one by one.
    """
    last, samples = [task.confirm] if task.confirm else [], number_of_new_samples(task)
    if task.cheap is None or task.cheap.earlier is not None:
        return [samples, *_second_batches(task), *last], []
    return [*_second_batches(task), *last], [samples, *[1] * most_further_runs(task)]


def _second_batches(task: Task) -> list[int]:
    """The same of a second optimisation."""
    second, jacobian = task.mode.second_optimisation, 2 * task.space.box.dimension
    at_once = second.together
    if not isinstance(second, Refinement):
        return [1, *[jacobian] * 3, *[at_once] * max(3, math.ceil(6 / at_once))]
    if task.cheap is not None:
        return [1] * second.most_expensive
    is_less = second.before(task.confirm, 0) != second
    points = CONFIRMED[task.samples is None] if is_less else UNCONFIRMED
    return [at_once] * (1 + math.ceil((points - 1) / at_once))


def least_waves(batches: Sequence[int], models: int, slots: int) -> int:
    """Number of DEM runs in the longest chain of a calibration that must run one after another."""
    return sum(math.ceil(batch * models / max(slots, 1)) for batch in batches)


def weight_left(
    left: Sequence[tuple[float, Sequence[int], Sequence[int]]], models: int, slots: int
) -> tuple[float, float]:
    """What calibrations still expect, in expensive runs: a run on average, and the longest chain of one.

    Of each calibration ``left`` has a cheap run's share of an expensive one's time, and the batches of either
    fidelity.
    """
    weight, runs, longest = 0.0, 0, 0.0
    for share, expensive, cheap in left:
        weight += sum(expensive) + share * sum(cheap)
        runs += sum(expensive) + sum(cheap)
        waves, cheap_waves = (least_waves(of, models, slots) for of in (expensive, cheap))
        longest = max(longest, waves + share * cheap_waves)
    return weight / runs if runs else 1.0, longest
