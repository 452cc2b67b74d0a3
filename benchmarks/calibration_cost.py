"""What a calibration costs in each mode, and how good it is: DEM runs by phase, noise-free sum of squares.

    OMP_NUM_THREADS=1 python benchmarks/calibration_cost.py [--variant ring] [--count 200] [--out cost.csv]

The DEM model is replaced by a stand-in that is fitted to the real 5 mm runs of reports/angle_of_repose/plate
by another family than the surrogate: a quadratic polynomial (ridge regression, penalty by cross-validation)
of the angle of repose and of the solid fraction in each regime, the regimes (a heap that ends at the ring, or
a carpet beyond it) told apart by a decision tree; where it switches, the responses jump. Its noise is the
scatter from seed to seed of reports/angle_of_repose/noise, drawn anew where seed or parameters differ at all.

The sum of squares is that of the stand-in without noise, of all residuals (time-step included), at the point
that the calibration returns. "least" is the smallest that the row's box allows.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import Pipeline, make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler
from sklearn.tree import DecisionTreeClassifier

from calstudy.calibration import Calibration, Task, calibrate
from calstudy.cost import Cost
from calstudy.errors import NumericsError
from calstudy.modes import MODES, Mode
from calstudy.optimise import SequentialQuadratic, sequential_quadratic
from calstudy.parameters import Array, Space
from calstudy.plan import PARAMETERS, load_plan
from calstudy.records import (
    ANGLE_OF_REPOSE,
    BULK_DENSITY,
    MEASURED,
    OPTIMISATION,
    Evaluation,
    Outcome,
    Phase,
    Request,
    Run,
    Target,
)

RUNS = Path(__file__).parents[1] / "reports" / "angle_of_repose"
PLAN = load_plan()
LOWER = np.array([next(p.lower for p in PLAN.parameters if p.name == name) for name in PARAMETERS])
UPPER = np.array([next(p.upper for p in PLAN.parameters if p.name == name) for name in PARAMETERS])
TARGET = Target({ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}, "paper", "the paper's targets")
FREE_SAMPLES = 36
"""Samples of mode paper in a free-standing calibration of six parameters: Eq. 11 with SPP = 6."""
GAP = 0.015
"""Heap radii that differ by more than this (m, three bead diameters) belong to two regimes."""
LEAST_REGIME = 5
"""Fewer runs than this make no regime of their own."""


@dataclass(frozen=True)
class StandIn:
    """Polynomials in regimes; callable as a calibration's ``evaluate``."""

    tree: DecisionTreeClassifier
    polynomials: dict[int, tuple[Pipeline, Pipeline]]
    """Angle of repose and solid fraction of each regime, on the unit cube."""
    noise: Array
    """Standard deviations of the angle of repose and of the bulk density, (2,)."""

    @classmethod
    def fit(cls, runs: pd.DataFrame, noise: Array) -> StandIn:
        """Fit to the usable runs of one variant."""
        runs = runs[runs["outcome"] == "ok"]
        points = runs[list(PARAMETERS)].to_numpy()
        unit = (points - LOWER) / (UPPER - LOWER)
        regimes = regimes_of(runs["heap_radius"].to_numpy())
        tree = DecisionTreeClassifier(max_depth=2, min_samples_leaf=2, random_state=0).fit(unit, regimes)
        told = tree.predict(unit)
        polynomials = {}
        for regime in np.unique(told):
            chosen = told == regime
            polynomials[int(regime)] = (
                polynomial().fit(unit[chosen], runs[ANGLE_OF_REPOSE].to_numpy()[chosen]),
                polynomial().fit(unit[chosen], (runs[BULK_DENSITY].to_numpy() / points[:, 0])[chosen]),
            )
        return cls(tree, polynomials, noise)

    def responses(self, points: Array) -> Array:
        """Noise-free responses (n, 2) of full parameter sets (n, 6)."""
        unit = (points - LOWER) / (UPPER - LOWER)
        told = self.tree.predict(unit)
        found = np.empty((len(points), 2))
        for regime, (angle, solid) in self.polynomials.items():
            chosen = told == regime
            if chosen.any():
                found[chosen, 0] = angle.predict(unit[chosen])
                found[chosen, 1] = solid.predict(unit[chosen]) * points[chosen, 0]
        return found

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


def polynomial() -> Pipeline:
    """Quadratic ridge regression."""
    return make_pipeline(
        PolynomialFeatures(2, include_bias=False), StandardScaler(), RidgeCV(np.logspace(-2, 3, 11))
    )


def regimes_of(radii: Array) -> Array:
    """0 or 1 for each heap: on which side of the largest gap between sorted radii; all 0 without one."""
    ordered = np.sort(radii)
    k = int(np.argmax(np.diff(ordered)))
    few = min(k + 1, len(ordered) - k - 1)
    if ordered[k + 1] - ordered[k] <= GAP or few < LEAST_REGIME:
        return np.zeros(len(radii), int)
    return (radii > ordered[k]).astype(int)


def measured_noise(runs: pd.DataFrame, fidelity: str) -> Array:
    """Scatter from seed to seed (2,), pooled over the points of the noise runs."""
    usable = runs[(runs["fidelity"] == fidelity) & (runs["outcome"] == "ok")]
    return np.sqrt(usable.groupby("label")[list(MEASURED)].var().mean()).to_numpy()


def task_of(row: int, mode: Mode, seed: int, free: bool, noise: Array | None) -> Task:
    """A row of the plan, or with its WRL a free-standing calibration of all six parameters."""
    plan_row = PLAN.row(row)
    space = Space(PLAN.parameters, tuple(PARAMETERS)) if free else PLAN.space(plan_row)
    cost = Cost(space, TARGET, plan_row.WRL, (PLAN.fixed.particles,))
    own = FREE_SAMPLES if mode.samples is None else None
    known = None if noise is None else dict(zip(MEASURED, map(float, noise), strict=True))
    return Task(row, space, own if free else plan_row.samples, cost, mode, seed, row, known)


def exact_sum_of_squares(task: Task, model: StandIn, point: Array) -> float:
    """Noise-free sum of squares of all residuals at a point (d,)."""
    return float(np.sum(exact_residuals(task, model, point[None]) ** 2))


def exact_residuals(task: Task, model: StandIn, points: Array) -> Array:
    """Noise-free residuals (k, 3) of points (k, d)."""
    full = np.array([[task.space.complete(p)[name] for name in PARAMETERS] for p in points])
    return task.cost.residuals(points, model.responses(full))


def least_sum_of_squares(task: Task, model: StandIn, rng: np.random.Generator) -> float:
    """Smallest noise-free sum of squares in the box, from many starts."""
    box = task.space.box
    points = box.from_unit(rng.random((500, box.dimension)))
    totals = np.sum(exact_residuals(task, model, points) ** 2, axis=1)
    optima = [
        sequential_quadratic(lambda at: exact_residuals(task, model, at), start, box, SequentialQuadratic())
        for start in points[np.argsort(totals)[:3]]
    ]
    return min(totals.min(), *(optimum.sum_of_squares for optimum in optima))


def calibrations(model: StandIn, free: bool, count: int, modes: Sequence[str]) -> pd.DataFrame:
    """A line for each calibration of each mode; all modes calibrate the same rows."""
    rows = np.random.default_rng(2017).integers(1, 73, count)
    lines = []
    for number, row in enumerate(map(int, rows)):
        least = least_sum_of_squares(
            task_of(row, MODES["paper"], 0, free, None), model, np.random.default_rng(number)
        )
        for name in modes:
            mode = MODES[name.removesuffix(", noise known")]
            noise = model.noise if name.endswith("noise known") else None
            task = task_of(row, mode, 1000 + number, free, noise)
            start = time.process_time()
            line = {"mode": name, "free": free, "row": row, "WRL": task.cost.WRL, "least": least}
            try:
                line |= result(task, model, calibrate(task, model))
            except NumericsError as error:
                line |= {"failure": str(error)}
            lines.append(line | {"cpu": time.process_time() - start})
    return pd.DataFrame(lines)


def result(task: Task, model: StandIn, found: Calibration) -> dict[str, float]:
    """What one calibration cost and reached."""
    return {
        **{str(phase): found.runs.get(phase, 0) for phase in Phase},
        "second phase": sum(found.runs.get(phase, 0) for phase in OPTIMISATION),
        "surrogate": exact_sum_of_squares(task, model, task.space.point(found.kriging.parameters)),
        "result": exact_sum_of_squares(task, model, task.space.point(found.dem.parameters)),
    }


def print_table(lines: pd.DataFrame) -> None:
    """Means by mode and WRL, as a table in Markdown."""
    print(
        "| mode | WRL | calibrations | samples | start, Jacobian, trials | second phase (most) "
        "| sum of squares: mean | median | at the surrogates' optimum | least | failures |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for mode, of_mode in lines.groupby("mode", sort=False):
        groups = [(f"{WRL:g}", group) for WRL, group in of_mode.groupby("WRL")] + [("all", of_mode)]
        for WRL, group in groups:
            failed = int(group["result"].isna().sum())
            phases = ", ".join(f"{group[str(phase)].mean():.1f}" for phase in OPTIMISATION)
            print(
                f"| {mode} | {WRL} | {len(group)} | {group[str(Phase.SAMPLING)].mean():.1f} | {phases} "
                f"| {group['second phase'].mean():.1f} ({group['second phase'].max():.0f}) "
                f"| {group['result'].mean():.5f} | {group['result'].median():.5f} "
                f"| {group['surrogate'].mean():.5f} | {group['least'].mean():.5f} | {failed} |"
            )
    print("\nCPU s of one calibration: ", end="")
    print(", ".join(f"{mode} {seconds:.2f}" for mode, seconds in lines.groupby("mode")["cpu"].mean().items()))


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=Path, default=RUNS, help="directory of plate/ and noise/")
    parser.add_argument("--variant", default="ring")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--modes", nargs="+", default=["paper", "robust", "robust, noise known"])
    parser.add_argument("--out", type=Path, help="CSV with a line for each calibration")
    a = parser.parse_args()
    if not (a.runs / "plate" / "runs.parquet").exists():
        parser.exit(1, f"{a.runs}/plate/runs.parquet: not there; make it with `calstudy sweep`\n")
    runs = pd.read_parquet(a.runs / "plate" / "runs.parquet")
    noise = measured_noise(pd.read_parquet(a.runs / "noise" / "runs.parquet"), "soft")
    runs = runs[runs["variant"] == a.variant]
    model = StandIn.fit(runs, noise)
    print(f"Stand-in for {a.variant}, {len(runs)} runs, {len(model.polynomials)} regimes; ", end="")
    print(f"noise {noise[0]:.2f} deg, {noise[1]:.1f} kg/m3")
    tables = []
    for free, title in ((False, "Random rows of the plan"), (True, "Free-standing, six parameters")):
        print(f"\n{title}\n")
        tables.append(calibrations(model, free, a.count, a.modes))
        print_table(tables[-1])
    if a.out is not None:
        pd.concat(tables).to_csv(a.out, index=False)


if __name__ == "__main__":
    main()
