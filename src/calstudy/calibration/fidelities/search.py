"""A calibration with two fidelities: cheap runs fill the box, each next run is made where it pays most.

What a run at the surrogates' optimum is expected to gain is what it takes off the responses' variances there:
by so much falls the cost that can be had. A cheap run tells the response's shape, an expensive one the offset
between the fidelities as well. The greater gain for its time is the one that is made.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calstudy.calibration.expected import most_further_runs
from calstudy.calibration.fidelities.surrogates import FidelityRuns, TwoSurrogates
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import Refinement
from calstudy.calibration.optimise import Optimum
from calstudy.calibration.task import Runs, Task
from calstudy.errors import NumericsError
from calstudy.parameters import Array
from calstudy.records import Phase, Stop

LEAST_EXPENSIVE = 2
"""A single expensive run cannot say whether the fidelities agree."""


class Disagreement(Exception):
    """The cheap fidelity is no help; the message says why."""


Optimise = Callable[[Task, Surrogates, Runs], Optimum]
Expected = Callable[[Task, Surrogates, Array], Array]
Settled = Callable[[Task, Surrogates, Array, float, float, Refinement], bool]


def fit_two(task: Task, runs: Runs, before: Surrogates | None = None) -> TwoSurrogates:
    """Surrogates of all usable runs so far. Disagreement: the cheap ones are too few, or are no guide."""
    assert task.cheap is not None
    cheap, expensive = (FidelityRuns(*runs.data(*phases)[:2]) for phases in ((Phase.CHEAP,), ()))
    try:
        found = TwoSurrogates.of(
            task.mode.kriging,
            task.space,
            task.cost.responses,
            task.cheap,
            (task.cheap.earlier or cheap, expensive),
            task.noise,
            before,
        )
    except NumericsError as error:
        what = "cheap fidelity" if task.cheap.earlier is None else "earlier study"
        raise Disagreement(f"the {what} cannot be modelled: {error}") from error
    if found.disagreement:
        raise Disagreement(found.disagreement)
    return found


def refine_two(
    task: Task,
    runs: Runs,
    surrogates: TwoSurrogates,
    start: Array,
    optimise: Optimise,
    expected: Expected,
    settled: Settled,
) -> Optimum:
    """Second optimisation: the run that pays most at the surrogates' optimum, refit, repeat.

    The result is the last surrogates' optimum where it is going to be confirmed, or else the best point that
    the expensive fidelity ran. With tolerances, the first run within them is the result.
    """
    settings = task.mode.second_optimisation
    assert isinstance(settings, Refinement)
    tried: list[Array] = []
    residuals: list[Array] = []
    further, at = most_further_runs(task), start
    best, stop, is_expensive = start, Stop.BUDGET, True
    while True:
        if is_expensive:
            phase = Phase.TRIAL if tried else Phase.START
            tried.append(at)
            residuals.append(runs(phase, at[None])[0])
            if task.within(residuals[-1]):
                best, stop = at, Stop.TOLERANCE
                break
        else:
            further -= 1
            runs(Phase.CHEAP, at[None])
        surrogates = fit_two(task, runs, surrogates)
        optimum = optimise(task, surrogates, runs)
        at, cost, gain = optimum.best, optimum.sum_of_squares, 0.0
        best = at
        if not task.confirm:
            costs = expected(task, surrogates, np.array(tried))
            costs[~np.isfinite(residuals).all(axis=1)] = np.inf
            best, cost = tried[int(np.argmin(costs))], float(costs.min())
            gain = cost - optimum.sum_of_squares
        is_known = len(tried) >= LEAST_EXPENSIVE
        if is_known and settled(task, surrogates, best, cost, gain, settings):
            stop = Stop.IMPROVEMENT
            break
        left = (further, settings.most_expensive - len(tried))
        chosen = pays_most(task, runs, surrogates, at, left)
        if chosen is None:
            break
        is_expensive = chosen
    if not np.isfinite(residuals).all(axis=1).any():
        raise Disagreement("no expensive run of the second optimisation gave responses")
    there = [k for k, point in enumerate(tried) if np.array_equal(point, best)]
    known = residuals[there[-1]] if there else np.full(len(residuals[0]), np.nan)
    return Optimum(best, known, tried[-1], residuals[-1], len(tried), len(tried), stop)


def pays_most(
    task: Task, runs: Runs, surrogates: TwoSurrogates, at: Array, left: tuple[int, int]
) -> bool | None:
    """Whether an expensive run at a point (d,) gains more for its time than a cheap one.

    None where neither is left: ``left`` are the numbers of cheap and expensive runs that may still be made.
    """
    if left[0] <= 0:
        return True if left[1] > 0 else None
    cheap, expensive = (float(np.sum(g / task.cost.scale**2)) for g in surrogates.gains(at))
    return left[1] > 0 and expensive >= cheap / runs.share
