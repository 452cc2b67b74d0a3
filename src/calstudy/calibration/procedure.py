"""The calibration procedure of Rackl & Hanley (2017): section 2.3, Figure 2, from top to bottom.

    sampling               a MAXIMIN Latin hypercube of DEM runs      section 2.3.1, Eq. 2 to 5
    universal Kriging      one surrogate for each response            section 2.3.2, Eq. 6 to 8
    first optimisation     least squares on the surrogates            section 2.3.3, Eq. 9 and 10
    second optimisation    least squares on the DEM model             section 2.3.3, Eq. 9 and 10

It knows neither LIGGGHTS nor files: ``evaluate`` answers requests for DEM runs, in any way and order.
``modes`` has the settings of modes ``paper`` and ``robust``. Arrays: k or n points, d calibrated parameters
in their own units, m measured responses. Residuals are the m of Eq. 9 and that of Eq. 10.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit, logit

from calstudy.calibration.confirmation import (
    HOPELESS,
    ROUNDS,
    UNTIL,
    confirmed_at,
    contradicts,
    most_promising,
)
from calstudy.calibration.expected import number_of_samples
from calstudy.calibration.fidelities.search import Disagreement, fit_two, refine_two
from calstudy.calibration.fidelities.surrogates import TwoSurrogates
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import Refinement
from calstudy.calibration.optimise import (
    Optimum,
    SequentialQuadratic,
    levenberg_marquardt,
    sequential_quadratic,
)
from calstudy.calibration.solutions import noise_of, reach
from calstudy.calibration.task import Announce, Calibration, Evaluate, Runs, Task, run_seed
from calstudy.errors import NumericsError
from calstudy.parameters import Array
from calstudy.records import OPTIMISATION, Phase, Stop

SHARPNESS = 4
"""Power of the odds that a run gives responses, by which its gain is weighed: what is likelier to fail than
not is hardly worth a run, whatever it promises."""
EQUAL = 1e-9
"""Two costs on the surrogates are equal within this relative difference, which rounding may cause."""


def calibrate(
    task: Task,
    evaluate: Evaluate,
    announce: Announce | None = None,
    warn: Callable[[str], object] | None = None,
) -> Calibration:
    """Calibrate once: sample, fit surrogates, optimise on the surrogates, optimise on the DEM model.

    ``warn`` is told at once if a cheap fidelity, or an earlier study, is given up.

    NumericsError: too few runs gave responses to fit the surrogates or to start the second optimisation.
    """
    runs, alone = Runs(task, evaluate), ""
    try:
        surrogates, first, second = search(task, runs, announce)
    except Disagreement as error:
        assert task.cheap is not None
        alone = str(error)
        if warn is not None:
            warn(f"{task.cheap.given_up}: {alone}")
        runs.task = replace(task, cheap=None, stored=())
        surrogates, first, second = search(runs.task, runs, announce)
    task = runs.task

    best = runs.evaluation_at(second.best)
    return Calibration(
        kriging=task.point(first.best, surrogates.predict(first.best)),
        kriging_stop=first.stop,
        diagnostics=surrogates.diagnostics,
        reachable={one.response: one.reachable for one in reach(task, surrogates)},
        dem=runs.point(best),
        dem_stop=second.stop,
        dem_evaluation=best,
        last=runs.point(runs.evaluation_at(second.last)),
        iterations=second.iterations,
        runs=runs.counts(),
        failed=len(runs.failed()),
        left_out=len(runs.failed(Phase.SAMPLING, Phase.CHEAP)),
        alone=alone,
    )


def search(task: Task, runs: Runs, announce: Announce | None) -> tuple[Surrogates, Optimum, Optimum]:
    """Surrogates of the samples, first and second optimum, which is confirmed if the task asks for it.

    Disagreement: the task has a cheap fidelity, which does not tell what the expensive one gives.
    """
    sample(task, runs)  # 2.3.1: Eq. 2 to 5, Eq. 11
    surrogates = fit(task, runs)  # 2.3.2: Eq. 6 to 8
    task = runs.task = task.weighing(noise_of(task, surrogates))
    first = optimise_surrogates(task, surrogates, runs)  # 2.3.3: Eq. 9 and 10
    if announce is not None:
        announce(task, surrogates, first.best)
    second = optimise_dem(task, runs, surrogates, first.best)  # 2.3.3: Eq. 9 and 10
    return surrogates, first, confirm(task, runs, surrogates, second) if task.confirm else second


def sample(task: Task, runs: Runs) -> None:
    """Run the DEM model at S points (Eq. 11) of a Latin hypercube (Eq. 2 to 5), at the cheap fidelity if any.

    Runs of earlier calibrations take the places of the design's points nearest to them. With an earlier study
    in place of a cheap fidelity the points are those that check it.
    """
    is_cheap = task.cheap is not None and task.cheap.earlier is None
    runs.sample(Phase.CHEAP if is_cheap else Phase.SAMPLING, number_of_samples(task))


def fit(
    task: Task,
    runs: Runs,
    before: Surrogates | None = None,
    imagined: tuple[Sequence[Array], Sequence[Array]] = ((), ()),
) -> Surrogates:
    """Fit universal Kriging (Eq. 6 to 8) to each measured response of all usable runs so far.

    The search for the hyperparameters also starts from those of ``before``, a fit to fewer runs. With a cheap
    fidelity, its runs are fitted together with the expensive ones. Without one, points (d,) and responses
    (m,) of runs that are ``imagined`` may be added.
    """
    if task.cheap is not None:
        return fit_two(task, runs, before)
    points, responses, _ = runs.data()
    points, responses = np.vstack([points, *imagined[0]]), np.vstack([responses, *imagined[1]])
    names = task.cost.responses
    return Surrogates.fit(task.mode.kriging, task.space, names, points, responses, task.noise, before)


def optimise_surrogates(task: Task, surrogates: Surrogates, runs: Runs) -> Optimum:
    """First optimisation: the smallest cost on the surrogates, from the mode's starts.

    The paper starts at the centre of the intervals. The result is rounded to the grid. Of starts that end
    equally well (`EQUAL`) the first is taken, so that rounding does not choose.
    """
    starts = task.centre[None]
    if task.mode.starts is not None:
        points, _, usable = runs.data(*Phase) if task.cheap is not None else runs.data()
        starts = np.vstack([starts, points[usable]])
        if task.cheap is not None and task.cheap.earlier is not None:
            there = task.cheap.earlier.points
            starts = np.vstack([starts, there[task.allows(there)]])
        costs = expected_costs(task, surrogates, starts)
        starts = starts[np.argsort(costs, kind="stable")][: task.mode.starts]
    optima = [optimise_from(start, task, surrogates) for start in starts]
    if task.mode.grid is None:
        return min(optima, key=lambda optimum: optimum.sum_of_squares)
    least = min(optimum.sum_of_squares for optimum in optima)
    best = next(optimum for optimum in optima if optimum.sum_of_squares <= (1.0 + EQUAL) * least)
    point = task.nearest(best.best[None])[0]
    return replace(best, best=point, best_residuals=expected_residuals(task, surrogates, point[None])[0])


def optimise_from(start: Array, task: Task, surrogates: Surrogates) -> Optimum:
    """First optimisation from one start (d,)."""
    settings, box = task.mode.first_optimisation, task.space.box
    if isinstance(settings, SequentialQuadratic):
        return sequential_quadratic(
            lambda at: expected_residuals(task, surrogates, at), start, box, settings, task.allowed
        )
    return levenberg_marquardt(
        lambda _, at: expected_residuals(task, surrogates, at), start, box, settings, steps=task.mode.grid
    )


def expected_residuals(task: Task, surrogates: Surrogates, points: Array) -> Array:
    """Residuals (Eq. 9 and 10) that the surrogates expect at points (k, d), shape (k, m + 1).

    A cautious mode appends the surrogates' standard deviations in units of the residuals, shape (k, 2m + 1).
    The sum of squares is then the expected cost: the mean of a square is the square of the mean plus the
    variance. So a point far from all runs, of which the surrogates know little, looks bad.

    Once runs have failed, it counts as well that a failed run saves nothing of the least cost of those that
    did not, shape (k, 2m + 2): where failure is sure, no gain is expected.
    """
    if not task.mode.cautious:
        return task.cost.residuals(points, surrogates.predict(points))
    if surrogates.success is None:
        return _with_doubts(task, surrogates, points)
    box, residuals = task.space.box, _with_doubts(task, surrogates, points)
    done = box.from_unit(surrogates.success.runs[surrogates.success.usable])
    least = np.sum(_with_doubts(task, surrogates, done) ** 2, axis=1).min()
    probability = expit(SHARPNESS * logit(surrogates.success(box.to_unit(points))))
    probability[np.sum(residuals**2, axis=1) >= least] = 1.0
    lost = np.sqrt((1.0 - probability) * least)
    return np.hstack([np.sqrt(probability)[:, None] * residuals, lost[:, None]])


def _with_doubts(task: Task, surrogates: Surrogates, points: Array) -> Array:
    """Residuals of the surrogates' means, and their standard deviations, shape (k, 2m + 1)."""
    means, deviations = surrogates.predict_with_deviations(points)
    return np.hstack([task.cost.residuals(points, means), deviations / task.cost.scale])


def expected_costs(task: Task, surrogates: Surrogates, points: Array) -> Array:
    """Costs (k,) that the surrogates expect at points (k, d)."""
    costs: Array = np.sum(expected_residuals(task, surrogates, points) ** 2, axis=1)
    return costs


def optimise_dem(task: Task, runs: Runs, surrogates: Surrogates, start: Array) -> Optimum:
    """Second optimisation: the smallest cost on the DEM model, from the surrogates' optimum (d,).

    If the run there fails, the best sample is the start. NumericsError if that fails too.
    """
    if isinstance(surrogates, TwoSurrogates):
        return refine_two(task, runs, surrogates, start, optimise_surrogates, expected_costs, is_settled)
    points, responses, usable = runs.data(Phase.SAMPLING)
    costs = np.sum(task.cost.residuals(points[usable], responses[usable]) ** 2, axis=1)
    settings = task.mode.second_optimisation
    for candidate in (start, points[usable][np.argmin(costs)]):
        if isinstance(settings, Refinement):
            optimum = refine(task, runs, surrogates, candidate, settings)
        else:
            optimum = levenberg_marquardt(
                runs, candidate, task.space.box, settings, task.within, task.mode.grid
            )
        if optimum.stop is not Stop.START_FAILED:
            return optimum
        if settings.budget is not None:
            settings = replace(settings, budget=settings.budget - optimum.evaluations)
            if settings.budget == 0:
                raise NumericsError("the DEM run at the surrogates' optimum failed and spent the budget")
    raise NumericsError("the DEM runs at the surrogates' optimum and at the best sample both failed")


def confirm(task: Task, runs: Runs, surrogates: Surrogates, second: Optimum) -> Optimum:
    """Run the optimum again with fresh seeds, and look for a better one if the surrogates were wrong there.

    The result is the point, of those that were confirmed, where the last surrogates expect the smallest cost.
    Mode ``paper`` confirms once, and goes no further. A task that asks for a probability (``until``) goes on
    until a point has it, perhaps with more runs at the same point, or the surrogates promise it nowhere.
    """
    points, used = [second.best], second.evaluations
    learns = isinstance(task.mode.second_optimisation, Refinement)
    rounds = UNTIL if task.until else ROUNDS
    most = used + rounds * task.confirm if task.most is None else task.most
    while True:
        if learns:
            surrogates = fit(task, runs, surrogates)
        runs(Phase.CONFIRMATION, np.tile(points[-1], (task.confirm, 1)))
        used += task.confirm
        noise = noise_of(task, surrogates)
        assumed = np.array([noise[name] for name in task.cost.responses])
        found = confirmed_at(task, runs, points[-1], assumed)
        if task.until and found is not None and found.all_within >= task.until:
            return replace(second, best=points[-1], last=points[-1])
        missed = task.until > 0 or (found is not None and contradicts(task, surrogates, points[-1], found))
        if not (learns and missed) or used + task.confirm > most:
            break
        surrogates = fit(task, runs, surrogates)
        proposal = optimise_surrogates(task, surrogates, runs).best
        if task.until:
            proposal, hope = most_promising(task, surrogates, points, proposal)
            if hope < HOPELESS:
                break
        elif any(np.array_equal(proposal, point) for point in points):
            break
        points.append(proposal)
    if found is None and len(points) == 1 and not np.isfinite(second.best_residuals).all():
        return replace(second, best=second.last)  # the optimum was never run, and its confirmation failed
    if len(points) > 1:
        costs = expected_costs(task, fit(task, runs, surrogates), np.array(points))
        return replace(second, best=points[int(np.argmin(costs))], last=points[-1])
    return second


def refine(task: Task, runs: Runs, surrogates: Surrogates, start: Array, settings: Refinement) -> Optimum:
    """Second optimisation of mode ``robust``: run the surrogates' optimum, refit to all runs, repeat.

    The result is the point, of those run, where the last surrogates expect the smallest cost. The smallest
    cost that a run gave would be chosen by noise. With tolerances, the first run within them is the result.
    Each round runs as many points at once as the settings say, see `proposals`.
    """
    most = math.inf if settings.budget is None else settings.budget
    tried, residuals = np.empty((0, len(start))), np.empty((0, len(task.cost.desired) + 1))
    rounds, best = 0, 0
    phase, proposed = Phase.START, start
    while True:
        asked = proposals(task, runs, surrogates, proposed, int(min(settings.together, most - len(tried))))
        tried, residuals = np.vstack([tried, asked]), np.vstack([residuals, runs(phase, asked)])
        phase, rounds, usable = Phase.TRIAL, rounds + 1, np.isfinite(residuals).all(axis=1)
        if not usable.any():
            stop = Stop.START_FAILED
            break
        within = [task.within(one) for one in residuals]
        if any(within):
            best, stop = within.index(True), Stop.TOLERANCE
            break
        surrogates = fit(task, runs, surrogates)
        proposal = optimise_surrogates(task, surrogates, runs)
        costs = np.where(usable, expected_costs(task, surrogates, tried), np.inf)
        best, proposed = int(np.argmin(costs)), proposal.best
        gain = costs[best] - proposal.sum_of_squares
        spare = int(runs.data()[2].sum()) - task.mode.overview(task.space.box.dimension)
        enough = settings.before(task.confirm, spare)
        settled = is_settled(task, surrogates, tried[best], costs[best], gain, enough)
        if settled or has_failed_near(proposed, runs, settings):
            stop = Stop.IMPROVEMENT
            break
        if len(tried) >= most:
            stop = Stop.BUDGET
            break
    return Optimum(
        best=tried[best],
        best_residuals=residuals[best],
        last=tried[-1],
        last_residuals=residuals[-1],
        iterations=rounds,
        evaluations=len(tried),
        stop=stop,
    )


def proposals(task: Task, runs: Runs, surrogates: Surrogates, first: Array, number: int) -> Array:
    """Points (number, d) of a round, whose runs do not wait for each other; ``first`` (d,) is one of them.

    What a run will answer is not known when the next point is chosen. So an answer is drawn from those that
    the surrogates hold possible there, a run's noise included, and the next point is the optimum of the
    surrogates that have been told it.
    """
    points, answers = [first], []
    drawn = np.random.default_rng(run_seed(task.seed, task.row, Phase.TRIAL, len(runs.answers)))
    while len(points) < number:
        means, deviations = surrogates.predict_with_deviations(points[-1][None])
        spread = np.hypot(deviations, surrogates.noise)
        answers.append((means + spread * drawn.standard_normal(means.shape))[0])
        surrogates = fit(task, runs, surrogates, (points, answers))
        points.append(optimise_surrogates(task, surrogates, runs).best)
    return np.array(points)


def is_settled(
    task: Task, surrogates: Surrogates, best: Array, cost: float, gain: float, settings: Refinement
) -> bool:
    """Whether another point promises little, and the surrogates know the best one (d,) well enough.

    ``gain`` is what they expect another point to save of the ``cost`` at the best one.
    """
    little = settings.tolerance * cost
    _, deviations = surrogates.predict_with_deviations(best[None])
    doubt = float(np.sum((deviations / task.cost.scale) ** 2))
    noise = float(np.sum((surrogates.noise / task.cost.scale) ** 2))
    return bool(gain <= little and doubt <= max(little, settings.doubt**2 * noise))


def has_failed_near(point: Array, runs: Runs, settings: Refinement) -> bool:
    """Whether a run of the second optimisation failed so near a point (d,) that another would be wasted.

    A failed run teaches the surrogates nothing, so they would propose its point until the budget is spent.
    """
    box = runs.task.space.box
    distances = np.abs(box.to_unit(point) - box.to_unit(runs.failed(*OPTIMISATION))).max(axis=1)
    return bool((distances < settings.least_move).any())
