"""Challenges of the benchmark: calibrations of emulated heaps, and of formulas in place of one's own models.

A seed makes one problem of a challenge: what is hidden, the emulator's draw and the noise follow from it,
so that all methods meet the same problems. The emulators answer from real LIGGGHTS runs; a draw of an
emulator is one function that these runs allow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from calstudy.calibration.cost import Cost
from calstudy.calibration.optimise import SequentialQuadratic, sequential_quadratic
from calstudy.emulator.benchmark.emulated import emulated, emulator_of, together
from calstudy.emulator.benchmark.problem import Problem, Truth
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.find import DEFAULT_MODEL, declaration, ratios
from calstudy.models.noise import known_noise
from calstudy.parameters import Array, Parameter, Space
from calstudy.plan import PARAMETERS, Plan
from calstudy.plan_file import load_plan
from calstudy.records import Target, proportional
from calstudy.written import choice

HEAP = declaration(DEFAULT_MODEL)
NAMES = tuple(response.name for response in HEAP.responses)
"""Responses of the heap: its angle of repose in degrees, and its bulk density in kg/m3."""
PAPERS, TOLERANCES = (22.0, 1500.0), (1.0, 15.0)
"""The paper's targets, and deviations that are good enough: a degree, and a hundredth of the bulk density."""
MIDDLE = 0.2
"""A hidden parameter set keeps this share of each interval from its ends."""
BEYOND = 3.0
"""Degrees by which a target out of reach lies below the least angle of the box."""
LOOKED_AT, STARTS = 4096, 5
"""Points at which the least cost of a box is looked for, and those of them from which it is searched."""


@dataclass(frozen=True, slots=True)
class Posed:
    """A problem before it has a budget: what the methods see, and the least cost, which they do not."""

    space: Space
    cost: Cost
    tolerances: Mapping[str, float]
    noise: Mapping[str, float]
    proportional: Mapping[str, str]
    ratios: Mapping[str, tuple[str, str]]
    truths: Mapping[str, Truth]
    prices: Mapping[str, float]
    seed: int
    least: float
    """Least noise-free cost in the box."""

    def problem(self, budget: float) -> Problem:
        """The problem with a budget, in runs of the fidelity that counts."""
        return Problem(
            space=self.space,
            cost=self.cost,
            tolerances=self.tolerances,
            noise=self.noise,
            proportional=self.proportional,
            ratios=self.ratios,
            budget=budget,
            seed=self.seed,
            truths=self.truths,
            prices=self.prices,
        )

    def exact(self, points: Array) -> tuple[Array, Array]:
        """Noise-free responses (k, m) and costs (k,) at points (k, d) at the fidelity that counts."""
        return exact(self.cost, next(iter(self.truths.values())), points)


@dataclass(frozen=True, slots=True)
class Challenge:
    """A kind of calibration."""

    name: str
    meaning: str
    pose: Callable[[int], Posed]
    """The problem that a seed makes of it."""


def exact(cost: Cost, truth: Truth, points: Array) -> tuple[Array, Array]:
    """Noise-free responses (k, m) and costs (k,) at points (k, d); NaN where a run fails."""
    responses = truth.responses(points)
    squares: Array = np.sum(cost.residuals(points, responses) ** 2, axis=1)
    return responses, squares


def least_cost(cost: Cost, truth: Truth, rng: np.random.Generator) -> float:
    """Least noise-free cost of a box: the smallest of many points, and of searches from the best of them."""
    box, whole = cost.space.box, cost.space.whole
    points = box.from_unit(np.clip(rng.uniform(-0.1, 1.1, (LOOKED_AT, box.dimension)), 0.0, 1.0))
    points = np.where(whole, np.rint(points), points)
    _, costs = exact(cost, truth, points)
    costs = np.where(np.isfinite(costs), costs, np.inf)
    if any(whole):
        return float(costs.min())

    def residuals(at: Array) -> Array:
        return np.nan_to_num(cost.residuals(at, truth.responses(at)), nan=10.0)

    settings = SequentialQuadratic(difference=1e-3)
    starts = points[np.argsort(costs)[:STARTS]]
    found = [sequential_quadratic(residuals, start, box, settings).sum_of_squares for start in starts]
    return float(min(costs.min(), *found))


# ---- heaps -------------------------------------------------------------------------------------------


@cache
def _plan() -> Plan:
    return load_plan()


def _heap(space: Space, fidelity: str, variant: str, draw: int | None, noise_factor: float = 1.0) -> Truth:
    return emulated(space, emulator_of(DEFAULT_MODEL, fidelity, variant), NAMES, draw, noise_factor)


def heap(
    seed: int,
    *,
    hidden: str = "inside",
    WRL: float = 0.0,
    fidelity: str = "full",
    variant: str = "ring",
    noise_factor: float = 1.0,
    cheap: str = "",
) -> Posed:
    """Six parameters of the heap model; the target is what a ``hidden`` parameter set gives without noise.

    ``hidden``: ``inside`` the box, in a ``corner`` of it, or ``beyond`` it, where no run has the angle.
    With a ``cheap`` fidelity both answer by their emulators' means, whose difference the runs know best.
    """
    plan = _plan()
    space = Space(plan.parameters, tuple(PARAMETERS))
    rng = np.random.default_rng([seed, 1])
    draw = None if cheap else seed
    truth = _heap(space, fidelity, variant, draw, noise_factor)
    while True:
        u = rng.uniform(MIDDLE, 1.0 - MIDDLE, len(PARAMETERS))
        point = space.box.from_unit(np.rint(u) if hidden == "corner" else u)
        wanted = truth.responses(point[None])[0]
        if np.isfinite(wanted).all():
            break
    if hidden == "beyond":
        points = space.box.from_unit(rng.random((LOOKED_AT, len(PARAMETERS))))
        wanted[0] = np.nanmin(truth.responses(points)[:, 0]) - BEYOND
    target = Target(dict(zip(NAMES, map(float, wanted), strict=True)), "twin", "hidden")
    cost = Cost(space, target, WRL, (plan.fixed.particles,))
    met = hidden != "beyond" and WRL == 0.0
    truths, prices = {fidelity: truth}, {fidelity: 1.0}
    if cheap:
        truths[cheap] = _heap(space, cheap, variant, draw, noise_factor)
        seconds = [load_model(plan.fixed, f, variant).expected_seconds for f in (cheap, fidelity)]
        prices[cheap] = seconds[0] / seconds[1]
    return _posed(cost, truths, prices, seed, 0.0 if met else least_cost(cost, truth, rng), noise_factor)


def row(seed: int) -> Posed:
    """A row of the paper's plan, chosen by the seed, with the paper's targets."""
    plan = _plan()
    chosen = plan.row(int(np.random.default_rng([seed, 2]).choice([row.run for row in plan.rows])))
    space = plan.space(chosen)
    truth = _heap(space, "full", "ring", seed)
    target = Target(dict(zip(NAMES, PAPERS, strict=True)), "paper", "the paper's targets")
    cost = Cost(space, target, chosen.WRL, (plan.fixed.particles,))
    least = least_cost(cost, truth, np.random.default_rng([seed, 3]))
    return _posed(cost, {"full": truth}, {"full": 1.0}, seed, least, 1.0)


def _posed(
    cost: Cost,
    truths: Mapping[str, Truth],
    prices: Mapping[str, float],
    seed: int,
    least: float,
    noise_factor: float,
) -> Posed:
    centre = cost.space.box.centre[None]
    model = load_model(_plan().fixed, next(iter(truths)))
    measured = known_noise(DEFAULT_MODEL, model.hash) or {}
    scatter = next(iter(truths.values())).noise_sd(centre)[0]
    noise = {
        name: noise_factor * measured[name] if name in measured else float(sd)
        for name, sd in zip(cost.responses, scatter, strict=True)
    }
    return Posed(
        space=cost.space,
        cost=cost,
        tolerances=dict(zip(NAMES, TOLERANCES, strict=True)),
        noise=noise,
        proportional=proportional(HEAP.responses),
        ratios=ratios(HEAP),
        truths=truths,
        prices=prices,
        seed=seed,
        least=least,
    )


# ---- five material tests -----------------------------------------------------------------------------

TESTS: Mapping[str, tuple[str, ...]] = {
    "angle_of_repose": ("angle_of_repose_deg", "bulk_density"),
    "draw_down": ("discharged_mass", "crater_angle_deg"),
    "shear_cell": ("steady_state_angle_deg",),
    "uniaxial_compression": ("bulk_density_loaded",),
    "rotating_drum": ("slow_angle_deg",),
}
"""Shipped models with the responses that are calibrated to: those that vary by more than their noise."""
SAME_BOX = "shear_cell"
"""Its emulator has all parameters as inputs, in the box that the five have in common."""
TOLERATED = 2.0
"""Deviation that is good enough, in standard deviations of a run's noise."""


def five_tests(seed: int) -> Posed:
    """Six parameters and one response or two of each shipped test; a run is one of all five."""
    box = emulator_of(SAME_BOX, "coarse").box
    ends = {name: (low, high) for name, low, high in zip(box.names, box.lower, box.upper, strict=True)}
    parameters = tuple(Parameter(name, unit, *ends[name], None) for name, unit in HEAP.parameters.items())
    space, truths = Space(parameters, box.names), []
    of_response: dict[str, str] = {}
    of_ratio: dict[str, tuple[str, str]] = {}
    for model, names in TESTS.items():
        emulator = emulator_of(model, "coarse", "ring" if model == DEFAULT_MODEL else "")
        truths.append(emulated(space, emulator, names, seed))
        declared = declaration(model)
        of_response |= {
            f"{model}_{name}": by for name, by in proportional(declared.responses).items() if name in names
        }
        of_ratio |= {f"{model}_{name}": ratio for name, ratio in ratios(declared).items() if name in names}
    truth, rng = together(truths), np.random.default_rng([seed, 5])
    point = space.box.from_unit(rng.uniform(MIDDLE, 1.0 - MIDDLE, box.dimension))
    wanted, scatter = truth.responses(point[None])[0], truth.noise_sd(space.box.centre[None])[0]
    named = [f"{model}_{name}" for model, names in TESTS.items() for name in names]
    target = Target(dict(zip(named, map(float, wanted), strict=True)), "twin", "hidden")
    noise = dict(zip(named, map(float, scatter), strict=True))
    return Posed(
        space=space,
        cost=Cost(space, target, 0.0, ()),
        tolerances={name: TOLERATED * sd for name, sd in noise.items()},
        noise=noise,
        proportional=of_response,
        ratios=of_ratio,
        truths={"coarse": truth},
        prices={"coarse": 1.0},
        seed=seed,
        least=0.0,
    )


# ---- formulas ----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Formula:
    """A formula in the place of one's own model, over the unit cube of its parameters."""

    responses: Callable[[Array], Array]
    """(k, m) at points (k, d) of the unit cube; NaN where a run fails."""
    dimension: int
    noise: tuple[float, ...]
    tolerances: tuple[float, ...]
    whole: tuple[float, float] | None = None
    """Interval of the first parameter where it counts."""


def _steep(u: Array) -> Array:
    """An outlet that is blocked or flows, and a time that grows by the power of ten."""
    flow = 50.0 + 45.0 * np.tanh(6.0 * (u[:, 0] + 0.5 * u[:, 1] - 0.75))
    return np.column_stack([flow, 10.0 ** (1.0 + u[:, 2]) * (1.0 + 0.3 * u[:, 3])])


def _flat(u: Array) -> Array:
    """Two responses that hardly move, along a curved valley."""
    angle = 30.0 + 1.5 * (u[:, 0] - 0.5) + 4.0 * (u[:, 0] * u[:, 1] - 0.25)
    return np.column_stack([angle, 1500.0 * (1.0 + 0.02 * (u[:, 2] - u[:, 1] ** 2) + 0.005 * u[:, 3])])


def _failing(u: Array) -> Array:
    """A fifth of the box in which every run fails, beside the best of it."""
    angle = 20.0 + 10.0 * u[:, 0] + 6.0 * u[:, 1] * u[:, 2]
    found = np.column_stack([angle, 900.0 - 80.0 * u[:, 1] + 60.0 * u[:, 3]])
    return np.where((u[:, 0] + u[:, 1] > 1.35)[:, None], np.nan, found)


def _whole(u: Array) -> Array:
    """A number of blades, or of anything that is counted, and two friction coefficients."""
    torque = 4.0 + 8.0 * u[:, 0] * (1.0 + 0.5 * u[:, 1])
    return np.column_stack([torque, 20.0 + 6.0 * np.sin(3.0 * u[:, 0]) + 12.0 * u[:, 1] * u[:, 2]])


FORMULAS: Mapping[str, Formula] = {
    "steep": Formula(_steep, 4, (1.0, 0.8), (3.0, 2.5)),
    "flat": Formula(_flat, 4, (0.3, 3.0), (0.5, 5.0)),
    "failing": Formula(_failing, 4, (0.4, 4.0), (1.0, 10.0)),
    "whole": Formula(_whole, 3, (0.2, 0.4), (0.5, 1.0), (2.0, 12.0)),
}


def formula(seed: int, name: str) -> Posed:
    """A formula, whose target is what a hidden point inside the box gives without noise."""
    of = FORMULAS[name]
    ends = [of.whole if k == 0 and of.whole else (0.0, 1.0) for k in range(of.dimension)]
    parameters = tuple(
        Parameter(f"p{k + 1}", "-", low, high, None, is_whole=k == 0 and of.whole is not None)
        for k, (low, high) in enumerate(ends)
    )
    space = Space(parameters, tuple(p.name for p in parameters))
    box, rng = space.box, np.random.default_rng([seed, 4])
    truth = Truth(
        lambda points: of.responses(box.to_unit(points)),
        lambda points: np.broadcast_to(of.noise, (len(points), len(of.noise))).astype(float),
    )
    while True:
        point = box.from_unit(rng.uniform(MIDDLE, 1.0 - MIDDLE, of.dimension))
        point = np.where(space.whole, np.rint(point), point)
        wanted = truth.responses(point[None])[0]
        if np.isfinite(wanted).all():
            break
    names = [f"r{k + 1}" for k in range(len(wanted))]
    target = Target(dict(zip(names, map(float, wanted), strict=True)), "twin", "hidden")
    return Posed(
        space=space,
        cost=Cost(space, target, 0.0, ()),
        tolerances=dict(zip(names, of.tolerances, strict=True)),
        noise=dict(zip(names, of.noise, strict=True)),
        proportional={},
        ratios={},
        truths={"formula": truth},
        prices={"formula": 1.0},
        seed=seed,
        least=0.0,
    )


CHALLENGES = (
    Challenge("six", "six parameters of the heap at full, target in reach", heap),
    Challenge("six_weighted", "the same with WRL 0.5", partial(heap, WRL=0.5)),
    Challenge("row", "rows of the paper's plan, the paper's targets", row),
    Challenge("corner", "the hidden set is a corner of the box", partial(heap, hidden="corner")),
    Challenge("beyond", "an angle 3 deg below what the box reaches", partial(heap, hidden="beyond")),
    Challenge("quiet", "six parameters, half the noise", partial(heap, noise_factor=0.5)),
    Challenge("noisy", "six parameters, twice the noise", partial(heap, noise_factor=2.0)),
    Challenge(
        "wide",
        "the wide plate at soft, where runs beyond the jump fail",
        partial(heap, fidelity="soft", variant="wide"),
    ),
    Challenge("two_fidelities", "six parameters; runs at soft are for sale too", partial(heap, cheap="soft")),
    Challenge("five_tests", "six parameters, seven responses of five material tests", five_tests),
    Challenge("steep", "a formula with a step and a power of ten", partial(formula, name="steep")),
    Challenge("flat", "a formula that hardly moves", partial(formula, name="flat")),
    Challenge("failing", "a formula with a region where runs fail", partial(formula, name="failing")),
    Challenge("whole", "a formula with a parameter that counts", partial(formula, name="whole")),
)


def challenge(name: str) -> Challenge:
    """A challenge by its name; InputError for an unknown one."""
    of = {one.name: one for one in CHALLENGES}
    if name not in of:
        raise InputError(f"challenge {name!r} is unknown; {choice(name, list(of))}")
    return of[name]
