"""Other people's calibrators, each as its authors recommend it, as methods of `calstudy benchmark`.

Each is a function of a `Problem` (calstudy.emulator.benchmark.problem). It works in the unit cube, sees
what a user would see, and stops when the budget is spent. Where its documentation says how to treat noise,
failed runs, or the choice of the answer, that is what is done; the sources are named. README.md has the
pinned versions.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from calstudy.emulator.benchmark.problem import WORKERS, Problem, Spent
from calstudy.parameters import Array

PACE = ("DENS", "YM")
"""The Rayleigh time-step goes with the root of their ratio."""
FAILED = 10.0
"""Cost of a run that failed, for methods that need a number: a response that misses its target by three
times it."""


def cost_at(problem: Problem, unit: Array) -> float:
    """Cost of one run at a point (d,) of the unit cube; NaN if it failed."""
    point = real(problem, unit)
    return problem.square_sum(point, problem.run(point))


def residuals_at(problem: Problem, unit: Array) -> Array:
    """Residuals (m + 1,) of one run at a point (d,) of the unit cube; large ones if it failed."""
    point = real(problem, unit)
    found = problem.residuals(point, problem.run(point))
    return np.where(np.isfinite(found), found, np.sqrt(FAILED))


def real(problem: Problem, unit: Sequence[float] | Array) -> Array:
    """A point of the unit cube in the parameters' units, whole where a parameter counts."""
    point = problem.space.box.from_unit(np.clip(unit, 0.0, 1.0))
    return np.where(problem.whole, np.rint(point), point)


def optuna_tpe(problem: Problem) -> None:
    """Optuna's default sampler. Multivariate, as its documentation advises for dependent parameters."""
    import optuna

    _optuna(problem, optuna.samplers.TPESampler(seed=problem.seed, multivariate=True))


def optuna_gp(problem: Problem) -> None:
    """Optuna's Gaussian process with log expected improvement, told that the objective is noisy."""
    import optuna

    _optuna(problem, optuna.samplers.GPSampler(seed=problem.seed, deterministic_objective=False))


def _optuna(problem: Problem, sampler: object) -> None:
    import optuna

    warnings.simplefilter("ignore")
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    study = optuna.create_study(sampler=sampler)
    box = problem.space.box
    while True:
        trial = study.ask()
        values = [
            trial.suggest_int(name, int(low), int(high)) if whole else trial.suggest_float(name, low, high)
            for name, low, high, whole in zip(box.names, box.lower, box.upper, problem.whole, strict=True)
        ]
        cost = problem.square_sum(values, problem.run(values))
        # A failed trial is left out of the sampler's data: optuna.readthedocs.io, FAQ on NaN.
        study.tell(
            trial,
            cost if np.isfinite(cost) else None,
            None if np.isfinite(cost) else optuna.trial.TrialState.FAIL,
        )


def cma_es(problem: Problem) -> None:
    """CMA-ES (pycma) as ACCES uses it: bounds, a first step of 0.4 of each interval, eight points at once.

    The favourite solution (the mean of the distribution) is the answer, as pycma advises for noisy
    objectives.
    """
    import cma

    d = len(problem.names)
    options = {"bounds": [0, 1], "seed": problem.seed + 1, "verbose": -9, "popsize": WORKERS}
    strategy = cma.CMAEvolutionStrategy(np.full(d, 0.5), 0.4, options)
    while True:
        units = strategy.ask()
        points = np.array([real(problem, unit) for unit in units])
        room = int(problem.budget - problem.paid)
        if room < len(points):  # the last runs are spent on part of a generation, which teaches nothing more
            problem.runs(points[:room])
            return
        answers = problem.runs(points)
        costs = [problem.square_sum(p, r) for p, r in zip(points, answers, strict=True)]
        worst = np.nanmax(costs) if np.isfinite(costs).any() else FAILED
        strategy.tell(units, [cost if np.isfinite(cost) else worst + 1.0 for cost in costs])
        problem.name(real(problem, strategy.result.xfavorite))


def skopt_gp(problem: Problem) -> None:
    """scikit-optimize's `gp_minimize` settings; the answer is the model's expected minimum, for noisy
    objectives."""
    import skopt

    warnings.simplefilter("ignore")
    d = len(problem.names)
    optimiser = skopt.Optimizer([(0.0, 1.0)] * d, random_state=problem.seed, n_initial_points=10)
    while True:
        unit = optimiser.ask()
        cost = cost_at(problem, np.array(unit))
        result = optimiser.tell(unit, cost if np.isfinite(cost) else FAILED)
        if optimiser.models and len(result.x_iters) in (15, 16, 31, 32, 63, 64):
            problem.name(real(problem, skopt.expected_minimum(result, random_state=problem.seed)[0]))


def dfo_ls(problem: Problem) -> Array:
    """DFO-LS, a derivative-free solver for noisy least squares, from the centre, with its restarts for
    noise."""
    import dfols

    d = len(problem.names)

    box = (np.zeros(d), np.ones(d))
    most = int(problem.budget)
    found = dfols.solve(
        partial(residuals_at, problem),
        np.full(d, 0.5),
        bounds=box,
        rhobeg=0.2,
        maxfun=most,
        objfun_has_noise=True,
    )
    return real(problem, found.x)


def least_squares(problem: Problem) -> Array:
    """SciPy's least squares from the centre, with difference steps of a tenth of the value."""
    from scipy.optimize import least_squares as solve

    d = len(problem.names)

    found = solve(
        partial(residuals_at, problem), np.full(d, 0.5), bounds=(0.0, 1.0), diff_step=0.1, x_scale=1.0
    )
    return real(problem, found.x)


def botorch_scalar(problem: Problem) -> None:
    """BoTorch: a Gaussian process of the cost, noisy expected improvement, one point at a time."""
    _botorch(problem, composite=False)


def botorch_composite(problem: Problem) -> None:
    """BoTorch with all that is known: a Gaussian process of each response, divided by what it is
    proportional to, over the quotient where two parameters act through it alone; and the cost as the exact
    function of them that Eq. 9 and 10 make it."""
    _botorch(problem, composite=True)


def botorch_batch(problem: Problem) -> None:
    """The same, eight points at once."""
    _botorch(problem, composite=True, together=WORKERS)


def _botorch(problem: Problem, composite: bool, together: int = 1) -> None:
    import torch
    from botorch.acquisition.logei import qLogNoisyExpectedImprovement
    from botorch.acquisition.objective import GenericMCObjective
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from botorch.models.transforms import Standardize
    from botorch.optim import optimize_acqf
    from gpytorch.mlls import ExactMarginalLogLikelihood
    from scipy.stats import qmc

    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    torch.manual_seed(problem.seed)
    torch.set_default_dtype(torch.double)
    d, (factors, value) = len(problem.names), _closed_forms(problem) if composite else (None, _less)
    known = _quotient(problem) if composite else None
    units = list(qmc.Sobol(d, rng=problem.seed).random(-(-2 * (d + 1) // together) * together))
    answers = list(problem.runs([real(problem, u) for u in units]))
    while True:
        there = [k for k, answer in enumerate(answers) if np.isfinite(answer).all()]
        x = np.array([units[k] for k in there])
        responses = np.array([answers[k] for k in there])
        costs = [-problem.square_sum(real(problem, u), r) for u, r in zip(x, responses, strict=True)]
        inputs = torch.from_numpy(x)
        by = factors(inputs) if factors else 1.0
        outputs = torch.from_numpy(responses) / by if factors else torch.tensor(costs)[:, None]
        standard = Standardize(outputs.shape[-1])
        model = SingleTaskGP(inputs, outputs, outcome_transform=standard, input_transform=known)
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
        with torch.no_grad():
            seen = model.posterior(inputs)
            best = int(value(seen.mean, inputs).argmax())
            said = [(one * by)[best].numpy() for one in (seen.mean, seen.variance.sqrt())] if factors else []
        problem.name(real(problem, x[best]), None, *said)
        improvement = qLogNoisyExpectedImprovement(model, inputs, objective=GenericMCObjective(value))
        cube = torch.stack([torch.zeros(d), torch.ones(d)])
        found, _ = optimize_acqf(improvement, cube, q=together, num_restarts=10, raw_samples=512)
        units += list(found.detach().numpy())
        answers += list(problem.runs([real(problem, unit) for unit in units[-together:]]))


def _less(samples: Any, X: Any = None) -> Any:
    """The cost itself, of which less is better, turned round."""
    return samples[..., 0]


def _quotient(problem: Problem) -> Any:
    """Inputs in which two parameters are their quotient where they act through it alone; None without such.

    The logarithm of the quotient, in units of its interval, takes the place of the first of the two.
    """
    import torch
    from botorch.models.transforms.input import InputTransform

    ratio, names = next(iter(problem.ratios.values()), None), list(problem.names)
    if ratio is None or not {*ratio} <= {*names}:
        return None
    above, below = (names.index(name) for name in ratio)
    kept = [k for k in range(len(names)) if k not in (above, below)]
    lower, width = torch.from_numpy(problem.lower), torch.from_numpy(problem.upper - problem.lower)
    upper = lower + width
    low, high = (lower[above] / upper[below]).log(), (upper[above] / lower[below]).log()

    class Quotient(InputTransform):
        is_one_to_many = False
        transform_on_train = transform_on_eval = transform_on_fantasize = True

        def transform(self, X: Any) -> Any:
            values = lower + X * width
            quotient = ((values[..., above] / values[..., below]).log() - low) / (high - low)
            return torch.cat([X[..., kept], quotient[..., None]], -1)

    return Quotient()


def _closed_forms(problem: Problem) -> tuple[Callable[[Any], Any], Callable[..., Any]]:
    """What a response is divided by, and the cost turned round, as functions of PyTorch's tensors.

    The residual of Eq. 10 is linear in the Rayleigh time-step, which goes with the root of DENS / YM.
    """
    import torch

    box, cost, d = problem.space.box, problem.cost, len(problem.names)
    low, width = torch.from_numpy(problem.lower), torch.from_numpy(box.width)
    ends = box.from_unit(np.stack([np.full(d, 0.4), np.full(d, 0.6) - 0.1 * np.arange(d)]))
    steps = cost.rayleigh_time_step(ends)
    parts = cost.residuals(ends, np.tile(problem.desired, (2, 1)))[:, -1]
    slope = 0.0 if cost.WRL == 0 else (parts[1] - parts[0]) / (steps[1] - steps[0])
    fixed = problem.space.complete(ends[0])

    def columns(at: Any) -> dict[str, Any]:
        return dict(zip(box.names, (low + at * width).unbind(-1), strict=True))

    def factors(at: Any) -> Any:
        ones = torch.ones_like(at[..., 0])
        names = [problem.proportional.get(name, "") for name in problem.responses]
        return torch.stack([columns(at).get(name, ones) for name in names], -1)

    def value(samples: Any, X: Any = None) -> Any:
        deviations = samples * factors(X) / torch.from_numpy(problem.desired) - 1.0
        squares = (deviations**2).sum(-1)
        if cost.WRL == 0:
            return -squares
        there = {name: columns(X).get(name, torch.tensor(fixed[name])) / fixed[name] for name in PACE}
        return -(
            squares + (parts[0] + slope * steps[0] * ((there[PACE[0]] / there[PACE[1]]) ** 0.5 - 1)) ** 2
        )

    return factors, value


def grainlearning(problem: Problem) -> None:
    """GrainLearning: iterative Bayesian filtering, 16 samples an iteration, settings of its documentation."""
    import contextlib
    import io

    from grainlearning import BayesianCalibration
    from grainlearning.dynamic_systems import DynamicSystem

    warnings.simplefilter("ignore")

    def run(calibration: BayesianCalibration) -> None:
        system = calibration.system
        if problem.paid:
            problem.name(real(problem, system.estimated_params[-1]))
        points = np.array([real(problem, unit) for unit in system.param_data])
        room = int(problem.budget - problem.paid)
        if room < 1:
            raise Spent
        answers = problem.runs(points[:room])
        answers = np.where(np.isfinite(answers), answers, 10.0 * problem.desired)
        system.param_data = system.param_data[: len(answers)]
        system.set_sim_data([answer[:, None] for answer in answers])

    np.random.seed(problem.seed)  # noqa: NPY002 - what the package draws from
    with contextlib.redirect_stdout(io.StringIO()):
        BayesianCalibration.from_dict(_settings(problem, DynamicSystem, run)).run()


def _settings(problem: Problem, system: type, run: Callable[[Any], None]) -> dict[str, Any]:
    """What GrainLearning reads."""
    return {
        "num_iter": 5,
        "callback": run,
        "save_fig": -1,
        "system": {
            "system_type": system,
            "param_names": list(problem.names),
            "param_min": [0.0] * len(problem.names),
            "param_max": [1.0] * len(problem.names),
            "num_samples": 16,
            "obs_data": problem.desired[:, None],
            "obs_names": list(problem.responses),
            "inv_obs_weight": list(1.0 / problem.desired),
        },
        "inference": {
            "Bayes_filter": {"ess_target": 0.3},
            "sampling": {"max_num_components": 1, "random_state": problem.seed, "slice_sampling": True},
        },
    }
