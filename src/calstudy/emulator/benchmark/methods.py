"""Methods that calstudy brings to the benchmark: its own modes, and random points as a floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module

import numpy as np
from scipy.stats import qmc

from calstudy.calibration.expected import most_further_runs, number_of_samples
from calstudy.calibration.fidelities.surrogates import Cheap
from calstudy.calibration.modes import Mode, Refinement, mode_of
from calstudy.calibration.procedure import calibrate, fit
from calstudy.calibration.task import Runs, Task
from calstudy.emulator.benchmark.problem import WORKERS, Method, Problem
from calstudy.errors import InputError, NumericsError
from calstudy.parameters import Array
from calstudy.records import RAYLEIGH_TIME_STEP, Evaluation, Outcome, Phase, Request, Run
from calstudy.written import choice

TOGETHER = 3
"""Points of a round of ``robust_together``."""


def robust(problem: Problem, together: int = 1) -> Array | None:
    """Mode ``robust`` of `calstudy calibrate`."""
    task = task_of(problem, mode_of("robust", together=together))
    return by_procedure(problem, limited(task, problem.budget - number_of_samples(task)))


def robust_together(problem: Problem) -> Array | None:
    """Mode ``robust`` with several runs at once in its second optimisation, for idle cores."""
    return robust(problem, TOGETHER)


def robust_two(problem: Problem) -> Array | None:
    """Mode ``robust`` with its samples at the cheapest fidelity, where the problem sells two."""
    cheap = min(problem.fidelities, key=lambda name: problem.prices[name])
    if cheap == problem.fidelities[0]:
        return robust(problem)
    price = problem.prices[cheap]
    task = replace(task_of(problem, mode_of("robust")), cheap=Cheap(price, is_measured=False))
    most = price * (number_of_samples(task) + most_further_runs(task))
    return by_procedure(problem, limited(task, problem.budget - most), cheap)


def paper(problem: Problem) -> Array | None:
    """Mode ``paper``: samples by Eq. 11 with SPP 6 where the budget allows them and as many again."""
    d = len(problem.names)
    samples = min(6 * d, max(int(problem.budget) // 2, d + 2))
    task = replace(task_of(problem, mode_of("paper"), samples), noise=None)
    return by_procedure(problem, limited(task, problem.budget - samples))


def task_of(problem: Problem, mode: Mode, samples: int | None = None) -> Task:
    """A problem as a task of the procedure."""
    return Task(
        row=0,
        space=problem.space,
        samples=samples,
        cost=problem.cost,
        mode=mode.knowing(problem.proportional, ratios=problem.ratios),
        seed=problem.seed,
        sampled_as=0,
        noise=problem.noise,
    )


def limited(task: Task, left: float) -> Task:
    """The task with a budget of runs for its second optimisation, which is 1 at least."""
    mode, together = task.mode, task.mode.second_optimisation.together
    limit = mode_of(mode.name, max(int(left), 1), procedure=mode.procedure, together=together)
    return replace(task, mode=replace(mode, second_optimisation=limit.second_optimisation))


def by_procedure(problem: Problem, task: Task, cheap: str | None = None) -> Array | None:
    """Calibrate by the procedure; None where it ends for want of runs that succeed.

    Where the first run of each round of the second optimisation is made at the surrogates' optimum, as in
    mode ``robust``, that is the answer so far.
    """
    runs = Runs(task, lambda _: ())
    names_each = isinstance(task.mode.second_optimisation, Refinement)

    def evaluate(requests: Sequence[Request]) -> list[Evaluation]:
        points = np.array([[r.parameters[name] for name in problem.names] for r in requests])
        if names_each and len(runs.answers) and requests[0].phase is not Phase.SAMPLING:
            problem.name(points[0])
        fidelity = cheap if requests[0].phase is Phase.CHEAP else None
        answers = problem.runs(points, fidelity)
        found = [Evaluation(r, "", _run(problem, a)) for r, a in zip(requests, answers, strict=True)]
        runs.answers += zip(points, found, strict=True)
        return found

    try:
        found = calibrate(task, evaluate, lambda _task, _surrogates, optimum: problem.name(optimum))
    except NumericsError:
        return None
    best = task.space.point(found.dem.parameters)
    if not names_each:
        return best
    task = replace(task, cheap=None) if found.alone else task
    surrogates = fit(task, runs).averaged(problem.seed)  # whose doubts its solution space has as well
    expected, doubts = surrogates.predict_with_deviations(best[None])
    problem.name(best, None, expected[0], doubts[0])
    return None


def _run(problem: Problem, responses: Array) -> Run:
    named = dict(zip(problem.responses, map(float, responses), strict=True)) | {RAYLEIGH_TIME_STEP: np.nan}
    outcome = Outcome.OK if np.isfinite(responses).all() else Outcome.UNMEASURABLE
    return Run(outcome, "", named, 0.0, 0.0)


def random_points(problem: Problem) -> None:
    """Uniformly random points, eight at once."""
    rng = np.random.default_rng(problem.seed)
    while True:
        problem.runs(rng.uniform(problem.lower, problem.upper, (WORKERS, len(problem.names))))


def sobol_points(problem: Problem) -> None:
    """Points of a scrambled Sobol sequence, eight at once."""
    sequence = qmc.Sobol(len(problem.names), rng=problem.seed)
    while True:
        problem.runs(problem.space.box.from_unit(sequence.random(WORKERS)))


METHODS: Mapping[str, Method] = {
    "robust": robust,
    "robust_together": robust_together,
    "robust_two": robust_two,
    "paper": paper,
    "random": random_points,
    "sobol": sobol_points,
}


def method_of(name: str) -> Method:
    """One of calstudy's methods, or ``module:function`` of anybody's; InputError where there is none."""
    if ":" not in name:
        if name not in METHODS:
            raise InputError(
                f"method {name!r} is unknown; {choice(name, list(METHODS))}, or module:function of your own"
            )
        return METHODS[name]
    module, _, function = name.partition(":")
    try:
        method = getattr(import_module(module), function)
    except ModuleNotFoundError as error:
        raise InputError(
            f"method {name}: there is no module {error.name}; run the command in its folder, or install it"
        ) from error
    except AttributeError as error:
        raise InputError(f"method {name}: the module {module} has no function {function}") from error
    if not callable(method):
        raise InputError(f"method {name}: {function} is not a function of a problem")
    found: Method = method
    return found
