"""Methods that calstudy brings to the benchmark: its own two modes, and random points as a floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module

import numpy as np
from scipy.stats import qmc

from calstudy.calibration.modes import MODES, Mode, mode_of
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Task
from calstudy.emulator.benchmark.problem import WORKERS, Method, Problem
from calstudy.errors import InputError, NumericsError
from calstudy.parameters import Array
from calstudy.records import RAYLEIGH_TIME_STEP, Evaluation, Outcome, Request, Run
from calstudy.written import choice


def robust(problem: Problem) -> Array | None:
    """Mode ``robust`` of `calstudy calibrate`."""
    samples = MODES["robust"].samples
    assert samples is not None
    budget = int(problem.budget) - samples(len(problem.names))
    return by_procedure(problem, mode_of("robust", max(budget, 1)), None)


def paper(problem: Problem) -> Array | None:
    """Mode ``paper``: samples by Eq. 11 with SPP 6 where the budget allows them and as many again."""
    d = len(problem.names)
    samples = min(6 * d, max(int(problem.budget) // 2, d + 2))
    return by_procedure(problem, mode_of("paper", max(int(problem.budget) - samples, 1)), samples)


def by_procedure(problem: Problem, mode: Mode, samples: int | None) -> Array | None:
    """Calibrate by the procedure; None where it ends for want of runs that succeed."""
    task = Task(
        row=0,
        space=problem.space,
        samples=samples,
        cost=problem.cost,
        mode=mode.knowing(problem.proportional),
        seed=problem.seed,
        sampled_as=0,
        noise=problem.noise if mode.takes_noise else None,
    )

    def evaluate(requests: Sequence[Request]) -> list[Evaluation]:
        points = np.array([[r.parameters[name] for name in problem.names] for r in requests])
        return [
            Evaluation(r, "", _run(problem, a)) for r, a in zip(requests, problem.runs(points), strict=True)
        ]

    try:
        found = calibrate(task, evaluate, lambda _task, _surrogates, optimum: problem.name(optimum))
    except NumericsError:
        return None
    return task.space.point(found.dem.parameters)


def _run(problem: Problem, responses: Array) -> Run:
    named = dict(zip(problem.responses, map(float, responses), strict=True)) | {RAYLEIGH_TIME_STEP: np.nan}
    outcome = Outcome.OK if np.isfinite(responses).all() else Outcome.UNMEASURABLE
    return Run(outcome, "", named, 0.0, 0.0)


def random_points(problem: Problem) -> None:
    """Uniformly random points, one after another."""
    rng = np.random.default_rng(problem.seed)
    while True:
        problem.run(rng.uniform(problem.lower, problem.upper))


def sobol_points(problem: Problem) -> None:
    """Points of a scrambled Sobol sequence, eight at once."""
    sequence = qmc.Sobol(len(problem.names), rng=problem.seed)
    while True:
        problem.runs(problem.space.box.from_unit(sequence.random(WORKERS)))


METHODS: Mapping[str, Method] = {
    "robust": robust,
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
