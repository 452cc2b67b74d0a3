"""What a calibration costs in each mode, and how good it is: DEM runs by phase, noise-free sum of squares.

    OMP_NUM_THREADS=1 python benchmarks/calibration_cost.py --out cost.csv

200 random rows of the plan and 200 free-standing calibrations of all six parameters, in each mode: the same
rows, seeds and noise, so that differences are paired. Every calibration is a line of --out as soon as it is
done, and the same command goes on where it was ended. ``ring`` takes a quarter of an hour on one core.

The DEM model is replaced by a stand-in that is fitted to the real 5 mm runs of reports/angle_of_repose (plate
and noise) by another family than the surrogates: a quadratic polynomial (ridge regression, its penalty by
cross-validation) plus regression trees (a random forest of its residuals), so that the response has steps.
Its inputs are the four frictions and YM/DENS, through which alone the two act (docs/explanation/emulator.md).
Heaps that end at the ring are one regime, whatever the plate beyond it: their angle is the same. On the
``wide`` plate most heaps run out instead, which is another regime, told by a decision tree; between
the two the angle jumps by ten degrees. The noise is the scatter from seed to seed that was measured
(noise.csv), drawn anew where seed or parameters differ at all; ``robust`` knows it, as in `plan run`.

The sum of squares is that of the stand-in without noise, of all residuals (time-step included), at the point
that the calibration returns. "least" is the smallest that the row's box allows. Intervals are for the
mean difference to ``paper``, by the bootstrap (95 %).
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.ensemble import RandomForestRegressor
from sklearn.linear_model import RidgeCV
from sklearn.tree import DecisionTreeClassifier

from calstudy.calibration.cost import Cost
from calstudy.calibration.kriging.coordinates import Coordinates
from calstudy.calibration.modes import MODES, VERSIONS
from calstudy.calibration.optimise import SequentialQuadratic, sequential_quadratic
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Calibration, Task
from calstudy.errors import NumericsError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, PROPORTIONAL
from calstudy.models.noise import known_noise
from calstudy.parameters import Array, Space
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import OPTIMISATION, Evaluation, Outcome, Phase, Request, Run, Target

RUNS = Path(__file__).parents[1] / "reports" / "angle_of_repose"
FIDELITY = "soft"
PLAN = load_plan()
RATIO = ("YM", "DENS")
INPUTS = Coordinates.of(Space(PLAN.parameters, tuple(PARAMETERS)), RATIO)
"""What angle of repose and solid fraction are functions of: frictions and YM/DENS."""
TARGET = Target({ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}, "paper", "the paper's targets")
FREE_SAMPLES = 36
"""Samples of mode paper in a free-standing calibration of six parameters: Eq. 11 with SPP = 6."""
HELD = 0.055
"""m; the ring's radius is 50 mm, and a heap with a smaller radius than this ends there."""
GAP = 0.015
"""Heap radii that differ by more than this (m, three bead diameters) belong to two regimes: PLATE.md."""
MODE_NAMES = ("paper", "robust", "robust, noise estimated", "robust, version 1")
KEY = ("free", "number", "mode")
RESAMPLES = 4000


@dataclass(frozen=True)
class Response:
    """A quadratic polynomial of the inputs in the unit cube, and trees of what it leaves."""

    coefficients: Array
    forest: RandomForestRegressor

    @classmethod
    def fit(cls, unit: Array, values: Array) -> Response:
        """Fit to runs (n, 5); runs at one point are cross-validated together."""
        points, which, counts = np.unique(unit, axis=0, return_inverse=True, return_counts=True)
        means = np.bincount(which, values) / counts
        terms = quadratic(points)[:, 1:]
        centre, scale = terms.mean(axis=0), terms.std(axis=0)
        ridge = RidgeCV(np.logspace(-2, 3, 11)).fit((terms - centre) / scale, means, sample_weight=counts)
        slopes = ridge.coef_ / scale
        coefficients = np.array([ridge.intercept_ - slopes @ centre, *slopes])
        forest = RandomForestRegressor(30, min_samples_leaf=4, random_state=0)
        forest.fit(points, means - quadratic(points) @ coefficients, sample_weight=counts)
        return cls(coefficients, forest)

    def __call__(self, unit: Array) -> Array:
        """Values (n,) at inputs (n, 5)."""
        single = np.ascontiguousarray(unit, np.float32)
        # The trees one by one: scikit-learn's own checks take a hundred times longer for one point.
        steps = [tree.tree_.predict(single)[:, 0] for tree in self.forest.estimators_]
        return quadratic(unit) @ self.coefficients + np.mean(steps, axis=0)


@dataclass(frozen=True)
class StandIn:
    """Responses of a plate; callable as a calibration's ``evaluate``."""

    solid: Response
    held: Response
    """Angle of repose of a heap that ends at the ring."""
    out: Response | None
    """The same of one that has run out; None on a plate where none does."""
    regimes: DecisionTreeClassifier | None
    """Whether it has run out."""
    noise: Array
    """Standard deviations of the angle of repose and of the bulk density, (2,)."""

    @classmethod
    def fit(cls, runs: pd.DataFrame, variant: str, noise: Array) -> StandIn:
        """Fit to the usable runs of all plates."""
        unit = unit_of(runs[list(PARAMETERS)].to_numpy())
        radius, angle = runs["heap_radius"].to_numpy(), runs[ANGLE_OF_REPOSE].to_numpy()
        solid = Response.fit(unit, (runs[BULK_DENSITY] / runs["DENS"]).to_numpy())
        held = Response.fit(unit[radius < HELD], angle[radius < HELD])
        of_plate = (runs["variant"] == variant).to_numpy()
        ran_out = radius[of_plate] > beyond_the_gap(radius[of_plate])
        if not ran_out.any():
            return cls(solid, held, None, None, noise)
        out = Response.fit(unit[of_plate][ran_out], angle[of_plate][ran_out])
        tree = DecisionTreeClassifier(max_depth=2, min_samples_leaf=2, random_state=0)
        return cls(solid, held, out, tree.fit(unit[of_plate], ran_out), noise)

    def responses(self, points: Array) -> Array:
        """Noise-free responses (n, 2) of full parameter sets (n, 6)."""
        unit = unit_of(points)
        angle = self.held(unit)
        if self.out is not None and self.regimes is not None:
            angle = np.where(self.regimes.predict(unit), self.out(unit), angle)
        return np.column_stack([angle, self.solid(unit) * points[:, PARAMETERS.index("DENS")]])

    def __call__(self, requests: Sequence[Request]) -> list[Evaluation]:
        """Noisy answers; the noise follows from the seed and from every bit of the parameters."""
        points = np.array([[r.parameters[name] for name in PARAMETERS] for r in requests])
        answers = []
        for request, point, exact in zip(requests, points, self.responses(points), strict=True):
            rng = np.random.default_rng([request.seed, *map(int, point.view(np.uint32))])
            noisy = exact + self.noise * rng.standard_normal(2)
            responses = dict(zip(MEASURED, map(float, noisy), strict=True))
            answers.append(Evaluation(request, "", Run(Outcome.OK, "", responses, 0.0, 0.0)))
        return answers


def unit_of(points: Array) -> Array:
    """Inputs (n, 5) in the unit cube at points of the box (n, 6)."""
    return INPUTS.to_unit(points)


def quadratic(unit: Array) -> Array:
    """Terms (n, 21) of a quadratic polynomial of five inputs: 1, linear, products."""
    d = unit.shape[1]
    products = [unit[:, i] * unit[:, j] for i, j in combinations_with_replacement(range(d), 2)]
    return np.column_stack([np.ones(len(unit)), unit, *products])


def beyond_the_gap(radii: Array) -> float:
    """Radius in the middle of the largest gap between sorted heap radii; infinite without a gap."""
    ordered = np.sort(radii)
    k = int(np.argmax(np.diff(ordered)))
    low, high = ordered[k : k + 2]
    return float(low + high) / 2 if high - low > GAP else np.inf


def real_runs(directory: Path) -> pd.DataFrame:
    """The usable 5 mm runs: every plate, and the ring's runs of several seeds."""
    runs = pd.concat([pd.read_parquet(directory / name / "runs.parquet") for name in ("plate", "noise")])
    return runs[(runs["fidelity"] == FIDELITY) & (runs["outcome"] == "ok")].reset_index(drop=True)


def measured_noise() -> Array:
    """Standard deviations from seed to seed (2,) of a 5 mm run that ends at the ring."""
    measured = known_noise("angle_of_repose", load_model(PLAN.fixed, FIDELITY, "ring").hash)
    if measured is None:
        raise SystemExit(f"the noise of {FIDELITY} was not measured for this version of the model")
    return np.array([measured[name] for name in MEASURED])


def task_of(row: int, name: str, seed: int, free: bool, noise: Array) -> Task:
    """A row of the plan, or with its WRL a free-standing calibration of all six parameters."""
    of, _, how = name.partition(", ")
    mode = VERSIONS[of][0] if how == "version 1" else MODES[of]
    mode = mode.knowing(PROPORTIONAL, ratios=dict.fromkeys(MEASURED, RATIO))
    plan_row = PLAN.row(row)
    space = Space(PLAN.parameters, tuple(PARAMETERS)) if free else PLAN.space(plan_row)
    cost = Cost(space, TARGET, plan_row.WRL, (PLAN.fixed.particles,))
    own = FREE_SAMPLES if mode.samples is None else None
    is_known = of == "robust" and how != "noise estimated"
    known = dict(zip(MEASURED, map(float, noise), strict=True)) if is_known else None
    return Task(row, space, own if free else plan_row.samples, cost, mode, seed, row, known)


def exact_residuals(task: Task, model: StandIn, points: Array) -> Array:
    """Noise-free residuals (k, 3) of points (k, d)."""
    full = np.array([[task.space.complete(p)[name] for name in PARAMETERS] for p in points])
    return task.cost.residuals(points, model.responses(full))


def exact_sum_of_squares(task: Task, model: StandIn, point: Array) -> float:
    """Noise-free sum of squares of all residuals at a point (d,)."""
    return float(np.sum(exact_residuals(task, model, point[None]) ** 2))


def least_sum_of_squares(task: Task, model: StandIn, rng: np.random.Generator) -> float:
    """Smallest noise-free sum of squares in the box, from many starts; on steps it is met by chance."""
    box = task.space.box
    points = box.from_unit(np.clip(rng.uniform(-0.2, 1.2, (1000, box.dimension)), 0.0, 1.0))
    totals = np.sum(exact_residuals(task, model, points) ** 2, axis=1)
    optima = [
        sequential_quadratic(
            lambda at: exact_residuals(task, model, at), start, box, SequentialQuadratic(difference=1e-3)
        )
        for start in points[np.argsort(totals)[:3]]
    ]
    return min(totals.min(), *(optimum.sum_of_squares for optimum in optima))


def calibrations(
    model: StandIn, free: bool, count: int, modes: Sequence[str], done: set[tuple[bool, int, str]]
) -> Iterator[dict[str, object]]:
    """A line for each calibration that is not done; all modes calibrate the same rows with the same seeds."""
    rows = np.random.default_rng(2017).integers(1, 73, count)
    for number, row in enumerate(map(int, rows)):
        missing = [name for name in modes if (free, number, name) not in done]
        if not missing:
            continue
        some_task = task_of(row, "paper", 0, free, model.noise)
        least = least_sum_of_squares(some_task, model, np.random.default_rng(number))
        for name in missing:
            task = task_of(row, name, 1000 + number, free, model.noise)
            start = time.process_time()
            line: dict[str, object] = dict(zip(KEY, (free, number, name), strict=True))
            line |= {"row": row, "WRL": task.cost.WRL, "least": least, "failure": ""}
            try:
                line |= result(task, model, calibrate(task, model))
            except NumericsError as error:
                line |= {"failure": str(error)}
            yield line | {"cpu": time.process_time() - start}


def result(task: Task, model: StandIn, found: Calibration) -> dict[str, float]:
    """What one calibration cost and reached."""
    return {
        **{str(phase): found.runs.get(phase, 0) for phase in Phase},
        "second optimisation": sum(found.runs.get(phase, 0) for phase in OPTIMISATION),
        "all runs": sum(found.runs.values()),
        "surrogate": exact_sum_of_squares(task, model, task.space.point(found.kriging.parameters)),
        "result": exact_sum_of_squares(task, model, task.space.point(found.dem.parameters)),
    }


COLUMNS = (
    *(*KEY, "row", "WRL", "least", "failure", *map(str, Phase), "second optimisation", "all runs"),
    *("surrogate", "result", "cpu"),
)


def print_tables(lines: pd.DataFrame) -> None:
    """Each other mode beside ``paper`` by WRL, the same calibrations: a table in Markdown."""
    paper = lines[lines["mode"] == "paper"].set_index("number")
    for mode, other in lines[lines["mode"] != "paper"].groupby("mode", sort=False):
        again = other.set_index("number")
        pairs = paper.merge(again, left_index=True, right_index=True, suffixes=("", " of other"))
        print(
            f"| WRL | calibrations | samples: paper, {mode} | second optimisation (most) "
            f"| all DEM runs (most) | sum of squares: paper | {mode} | difference | least | failures |"
        )
        print("|" + "---|" * 10)
        for WRL, group in by_weight(pairs):
            there = group.dropna(subset=["result", "result of other"])
            low, high = interval((there["result of other"] - there["result"]).to_numpy())
            cells = [
                WRL,
                len(group),
                beside(group, str(Phase.SAMPLING)),
                *(beside(group, name, most=True) for name in ("second optimisation", "all runs")),
                *(f"{there[name].mean():.4f}" for name in ("result", "result of other")),
                f"{low:+.4f} to {high:+.4f}",
                f"{there['least'].mean():.4f}",
                f"{group['result'].isna().sum()}, {group['result of other'].isna().sum()}",
            ]
            print(f"| {' | '.join(map(str, cells))} |")
        phases = ", ".join(f"{phase} {paper[str(phase)].mean():.1f}" for phase in OPTIMISATION)
        worse = (pairs["result of other"] - pairs["result"]).dropna()
        print(f"\nsecond optimisation of paper: {phases}")
        print(f"{mode} is the worse in {(worse > 0).mean():.1%}, by {worse.max():.4f} at most")
        print(f"at the surrogates' optimum of paper: {paper['surrogate'].mean():.4f}\n")
    print("CPU s of one calibration: ", end="")
    print(", ".join(f"{mode} {s:.2f}" for mode, s in lines.groupby("mode", sort=False)["cpu"].mean().items()))


def beside(pairs: pd.DataFrame, name: str, most: bool = False) -> str:
    """Mean of a column in both modes, with the largest if wished."""
    columns = (pairs[name], pairs[f"{name} of other"])
    return ", ".join(f"{c.mean():.1f}" + (f" ({c.max():.0f})" if most else "") for c in columns)


def by_weight(lines: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    """Lines of each WRL, and all."""
    return [*((f"{WRL:g}", group) for WRL, group in lines.groupby("WRL")), ("all", lines)]


def interval(differences: Array) -> tuple[float, float]:
    """95 % interval of a mean by the bootstrap's percentiles."""
    chosen = np.random.default_rng(0).integers(len(differences), size=(RESAMPLES, len(differences)))
    low, high = np.quantile(differences[chosen].mean(axis=1), [0.025, 0.975])
    return float(low), float(high)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=Path, default=RUNS, help="directory of plate/ and noise/")
    parser.add_argument("--variant", default="ring", choices=("ring", "wide"))
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--modes", nargs="+", default=MODE_NAMES[:2], choices=MODE_NAMES)
    parser.add_argument("--out", type=Path, required=True, help="CSV with a line for each calibration")
    a = parser.parse_args()
    runs = real_runs(a.runs)
    noise = measured_noise()
    model = StandIn.fit(runs, a.variant, noise)
    print(
        f"Stand-in for {a.variant} from {len(runs)} runs, {1 + (model.out is not None)} regime(s); ", end=""
    )
    print(f"noise {noise[0]:.2f} deg, {noise[1]:.1f} kg/m3")
    done: set[tuple[bool, int, str]] = set()
    if a.out.exists():
        done = set(pd.read_csv(a.out)[list(KEY)].itertuples(index=False, name=None))
    else:
        a.out.write_text(",".join(COLUMNS) + "\n")
    for free in (False, True):
        for line in calibrations(model, free, a.count, a.modes, done):
            with a.out.open("a", newline="") as file:
                csv.DictWriter(file, COLUMNS).writerow(line)
    lines = pd.read_csv(a.out)
    lines = lines[lines["mode"].isin(a.modes) & (lines["number"] < a.count)]
    for free, title in ((False, "Random rows of the plan"), (True, "Free-standing, six parameters")):
        print(f"\n{title}\n")
        print_tables(lines[lines["free"] == free])


if __name__ == "__main__":
    main()
