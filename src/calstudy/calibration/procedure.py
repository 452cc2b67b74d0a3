"""The calibration procedure (section 2.3.3, Figure 2), from sampling to the DEM optimum.

It knows neither LIGGGHTS nor files: ``evaluate`` answers requests, in whatever way and order.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calstudy.calibration.modes import Refinement
from calstudy.calibration.optimise import (
    Optimum,
    SequentialQuadratic,
    levenberg_marquardt,
    sequential_quadratic,
)
from calstudy.calibration.surrogates import Surrogates
from calstudy.calibration.task import (
    Announce,
    Calibration,
    Evaluate,
    Point,
    Task,
    design_generator,
    number_of_samples,
    run_seed,
    study_run_seed,
)
from calstudy.errors import NumericsError
from calstudy.parameters import Array
from calstudy.records import OPTIMISATION, RAYLEIGH_TIME_STEP, Evaluation, Phase, Request, Stop

EQUAL = 1e-9
"""Relative difference of sums of squares on the surrogates that linear algebra's last digits may make."""


def calibrate(task: Task, evaluate: Evaluate, announce: Announce | None = None) -> Calibration:
    """Calibrate once: sample, fit, optimise on the surrogate, optimise on the DEM model.

    Raises NumericsError when too few runs gave responses for the surrogates or for a start.
    """
    runs = Runs(task, evaluate)
    box = task.space.box

    # Sampling phase (2.3.1)
    generator = design_generator(task.seed, task.sampled_as)
    design = box.from_unit(task.mode.design(number_of_samples(task), box.dimension, generator))
    runs(Phase.SAMPLING, task.grid.nearest(design))

    # Universal Kriging, one model for each measured response (2.3.2)
    surrogates = fit(task, runs)

    # First optimisation, on the surrogates (2.3.3)
    first = optimise_surrogates(task, surrogates, runs)
    if announce is not None:
        announce(task, surrogates, first.best)

    # Second optimisation, on the DEM model (2.3.3)
    second = optimise_dem(task, runs, surrogates, first.best)

    best = runs.evaluation_at(second.best)
    *_, usable = runs.data(Phase.SAMPLING)
    return Calibration(
        kriging=task_point(task, first.best, surrogates.predict(first.best)),
        kriging_stop=first.stop,
        diagnostics=surrogates.diagnostics,
        dem=run_point(task, best),
        dem_stop=second.stop,
        dem_evaluation=best,
        last=run_point(task, runs.evaluation_at(second.last)),
        iterations=second.iterations,
        runs=runs.counts(),
        failed=sum(not task.usable(e.run) for _, e in runs.answers),
        left_out=len(usable) - int(usable.sum()),
    )


class Runs:
    """A row's DEM runs so far: numbers the requests of each phase, seeds them, keeps the answers."""

    def __init__(self, task: Task, evaluate: Evaluate) -> None:
        self.task, self.evaluate = task, evaluate
        self.answers: list[tuple[Array, Evaluation]] = []

    def __call__(self, phase: Phase, points: Array) -> Array:
        """Run the DEM model at points (k, d); returns the residuals (k, m), NaN where a run failed."""
        first = self.counts().get(phase, 0)
        requests = [
            Request(
                row=self.task.row,
                phase=phase,
                index=first + k,
                parameters=self.task.space.complete(point),
                seed=self._seed(phase, first + k),
            )
            for k, point in enumerate(points)
        ]
        evaluations = self.evaluate(requests)
        self.answers += zip(points, evaluations, strict=True)
        return self.task.cost.residuals(points, np.array([measured(e, self.task) for e in evaluations]))

    def _seed(self, phase: Phase, index: int) -> int:
        if self.task.mode.one_seed:
            return study_run_seed(self.task.seed)
        row = self.task.sampled_as if phase is Phase.SAMPLING else self.task.row
        return run_seed(self.task.seed, row, phase, index)

    def counts(self) -> dict[Phase, int]:
        """Number of runs of each phase."""
        return dict(Counter(e.request.phase for _, e in self.answers))

    def data(self, *phases: Phase) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Points (n, d), measured responses (n, m) and usability (n,) of the phases (default: all)."""
        chosen = [(p, e) for p, e in self.answers if not phases or e.request.phase in phases]
        points = np.array([p for p, _ in chosen])
        responses = np.array([measured(e, self.task) for _, e in chosen])
        return points, responses, np.isfinite(responses).all(axis=1)

    def failed(self, *phases: Phase) -> Array:
        """Points (n, d) of the phases whose runs gave nothing usable."""
        lost = [p for p, e in self.answers if e.request.phase in phases and not self.task.usable(e.run)]
        return np.array(lost).reshape(-1, self.task.space.box.dimension)

    def evaluation_at(self, point: Array) -> Evaluation:
        """Latest evaluation of the second optimisation at a point."""
        for p, evaluation in reversed(self.answers):
            if evaluation.request.phase in OPTIMISATION and np.array_equal(p, point):
                return evaluation
        raise NumericsError(f"row {self.task.row}: no DEM run of the second optimisation at {point}")


def measured(evaluation: Evaluation, task: Task) -> Array:
    """Measured responses (m,) that have a target, all NaN where one of them is."""
    run = evaluation.run
    return np.array([run.responses[name] if task.usable(run) else np.nan for name in task.cost.responses])


def fit(task: Task, runs: Runs, before: Surrogates | None = None) -> Surrogates:
    """Kriging models of all measured responses, on every usable run so far."""
    points, responses, _ = runs.data()
    names, noise = task.cost.responses, task.noise
    return Surrogates.fit(task.mode.kriging, task.space, names, points, responses, noise, before)


def optimise_surrogates(task: Task, surrogates: Surrogates, runs: Runs) -> Optimum:
    """First optimisation: least squares on the surrogates from the mode's starts; the best is taken.

    On a grid it is the grid's point nearest to the best; of starts that end equally well, to EQUAL, the first
    is taken, for last digits must not choose.
    """
    starts = task.space.box.centre[None]
    if task.mode.starts is not None:
        points, _, usable = runs.data()
        starts = np.vstack([starts, points[usable]])
        totals = np.sum(expected_residuals(task, surrogates, starts) ** 2, axis=1)
        starts = starts[np.argsort(totals, kind="stable")][: task.mode.starts]
    optima = [optimise_from(start, task, surrogates) for start in starts]
    if task.mode.grid is None:
        return min(optima, key=lambda optimum: optimum.sum_of_squares)
    least = min(optimum.sum_of_squares for optimum in optima)
    best = next(optimum for optimum in optima if optimum.sum_of_squares <= (1.0 + EQUAL) * least)
    point = task.grid.nearest(best.best)
    return replace(best, best=point, best_residuals=expected_residuals(task, surrogates, point[None])[0])


def optimise_from(start: Array, task: Task, surrogates: Surrogates) -> Optimum:
    """First optimisation from one start."""
    settings, box = task.mode.first_optimisation, task.space.box
    if isinstance(settings, SequentialQuadratic):
        return sequential_quadratic(lambda at: expected_residuals(task, surrogates, at), start, box, settings)
    return levenberg_marquardt(
        lambda _, at: expected_residuals(task, surrogates, at), start, box, settings, steps=task.mode.grid
    )


def expected_residuals(task: Task, surrogates: Surrogates, points: Array) -> Array:
    """Residuals (k, m) of points (k, d) whose sum of squares is what the surrogates expect there.

    The expectation of a squared residual is that of its mean, squared, plus its variance. A mode that is
    cautious counts the latter: where nothing was run, nothing is promised.
    """
    if not task.mode.cautious:
        return task.cost.residuals(points, surrogates.predict(points))
    means, deviations = surrogates.predict_with_deviations(points)
    return np.hstack([task.cost.residuals(points, means), deviations / task.cost.desired])


def optimise_dem(task: Task, runs: Runs, surrogates: Surrogates, start: Array) -> Optimum:
    """Second optimisation, from the surrogates' optimum ``start``.

    Should the run there fail, the best sample is the start; should that fail too, NumericsError.
    """
    points, responses, usable = runs.data(Phase.SAMPLING)
    totals = np.sum(task.cost.residuals(points[usable], responses[usable]) ** 2, axis=1)
    settings = task.mode.second_optimisation
    for candidate in (start, points[usable][np.argmin(totals)]):
        if isinstance(settings, Refinement):
            optimum = refine(task, runs, surrogates, candidate, settings)
        else:
            optimum = levenberg_marquardt(
                runs, candidate, task.space.box, settings, task.within, task.mode.grid
            )
        if optimum.stop is not Stop.START_FAILED:
            return optimum
        if settings.budget is not None:
            settings = replace(settings, budget=settings.budget - 1)
            if settings.budget == 0:
                raise NumericsError("the DEM run at the surrogates' optimum failed and spent the budget")
    raise NumericsError("the DEM runs at the surrogates' optimum and at the best sample both failed")


def refine(task: Task, runs: Runs, surrogates: Surrogates, start: Array, settings: Refinement) -> Optimum:
    """Second optimisation of ``robust``: run at the surrogates' optimum, refit on all runs, repeat.

    It ends when the surrogates expect too little of another point and doubt their best one no more
    than some runs there would. Of the points run, the one that the last surrogates think best is the result:
    a single noisy run is not believed against all the others. But where the task has tolerances, the first
    run within them is what was asked for.
    """
    box = task.space.box
    tried = [start]
    tried_residuals = [runs(Phase.START, start[None])[0]]
    if not np.isfinite(tried_residuals[0]).all():
        return Optimum(start, tried_residuals[0], start, tried_residuals[0], 0, 1, Stop.START_FAILED)
    stop = Stop.BUDGET
    while True:
        if task.within(tried_residuals[-1]):
            best, stop = len(tried) - 1, Stop.TOLERANCE
            break
        surrogates = fit(task, runs, surrogates)
        proposal = optimise_surrogates(task, surrogates, runs)
        points = np.array(tried)
        expected = np.sum(expected_residuals(task, surrogates, points) ** 2, axis=1)
        failed = ~np.isfinite(tried_residuals).all(axis=1)
        expected[failed] = np.inf
        best = int(np.argmin(expected))
        little = settings.tolerance * expected[best]
        gain = expected[best] - proposal.sum_of_squares
        _, deviations = surrogates.predict_with_deviations(points[[best]])
        doubt = float(np.sum((deviations / task.cost.desired) ** 2))
        noise = float(np.sum((surrogates.noise / task.cost.desired) ** 2))
        settled = gain <= little and doubt <= max(little, settings.doubt**2 * noise)
        # A failed run has taught the surrogates nothing: they would propose its point until the budget ends.
        lost = runs.failed(*OPTIMISATION)
        move = np.abs(box.to_unit(proposal.best) - box.to_unit(lost)).max(axis=1)
        if settled or (move < settings.least_move).any():
            stop = Stop.IMPROVEMENT
            break
        if settings.budget is not None and len(tried) >= settings.budget:
            break
        tried.append(proposal.best)
        tried_residuals.append(runs(Phase.TRIAL, proposal.best[None])[0])
    return Optimum(
        best=tried[best],
        best_residuals=tried_residuals[best],
        last=tried[-1],
        last_residuals=tried_residuals[-1],
        iterations=len(tried),
        evaluations=len(tried),
        stop=stop,
    )


def run_point(task: Task, evaluation: Evaluation) -> Point:
    """The point of a DEM run, with what the run gave there."""
    point = np.array([evaluation.request.parameters[name] for name in task.space.box.names])
    return task_point(task, point, measured(evaluation, task))


def task_point(task: Task, point: Array, responses: Array) -> Point:
    """A point with its responses and its sum of squares."""
    residuals = task.cost.residuals(point, responses)
    named = dict(zip(task.cost.responses, map(float, responses), strict=True))
    named[RAYLEIGH_TIME_STEP] = float(task.cost.rayleigh_time_step(point))
    return Point(task.space.complete(point), named, float(residuals @ residuals))
