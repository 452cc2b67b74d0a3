"""One fidelity or two: calibrations of six parameters on the shipped emulators of `full` and `soft`.

    OMP_NUM_THREADS=1 python benchmarks/two_fidelities.py --seeds 16 --out two.csv

3 WRL x 2 targets x SEEDS, mode ``robust``: with `full` alone, and with `soft` as the cheap fidelity. Both
have the same seeds, so that differences are paired. Every calibration is a line of --out as soon as it is
done: the same command goes on where it was ended.

The sum of squares is that of the emulator of `full` without noise, of all residuals, less the least that the
box allows. Runs that confirm the optimum are not counted. A `soft` run costs what model.toml expects of it:
30 s to the 560 s of `full`. Intervals are 95 %.
"""

from __future__ import annotations

import argparse
import csv
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from calstudy.calibration.cost import Cost
from calstudy.calibration.modes import mode_of
from calstudy.calibration.optimise import SequentialQuadratic, sequential_quadratic
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Task
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.models.angle_of_repose import load_model
from calstudy.models.find import ratios
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, PROPORTIONAL
from calstudy.models.noise import known_noise
from calstudy.parameters import Array, Space
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import Evaluation, Phase, Request, Target
from calstudy.study.fidelities import cheap_of

EXPENSIVE, CHEAP = "full", "soft"
ALONE, TOGETHER = "one fidelity", "two fidelities"
VARIANT = "ring"
PLAN = load_plan()
SPACE = Space(PLAN.parameters, tuple(PARAMETERS))
WEIGHTS = (0.0, 0.5, 1.0)
CONFIRM = 4
"""Runs that confirm the optimum; they are not among those that are counted."""
KEY = ("seed", "WRL", "target", "how")
COLUMNS = (*KEY, "excess", "expensive", "cheap", "equivalents", "stop", "alone", "cpu")


class Emulated:
    """Both emulators; callable as a calibration's ``evaluate``."""

    def __init__(self) -> None:
        self.models = {name: load_model(PLAN.fixed, name) for name in (EXPENSIVE, CHEAP)}
        self.engines = {
            name: EmulatorEngine(
                model, read_emulator(shipped_emulator(model.name, name, VARIANT)), rounded=True
            )
            for name, model in self.models.items()
        }
        self.noise = {name: known_noise(m.name, m.hash) for name, m in self.models.items()}
        self.share = self.models[CHEAP].expected_seconds / self.models[EXPENSIVE].expected_seconds
        reference = self.engines[EXPENSIVE].twin(self.models[EXPENSIVE].reference).values
        self.targets = {"paper": {ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}, "reference": dict(reference)}

    def __call__(self, requests: Sequence[Request]) -> list[Evaluation]:
        """Noisy answers."""
        answers = []
        for request in requests:
            engine = self.engines[CHEAP if request.phase is Phase.CHEAP else EXPENSIVE]
            run = engine.run(request.parameters, request.seed, Path(), threading.Event())
            answers.append(Evaluation(request, "", run))
        return answers

    def task(self, seed: int, WRL: float, target: str, how: str) -> Task:
        """A calibration of all six parameters."""
        cost = Cost(SPACE, Target(self.targets[target], "set", ""), WRL, (PLAN.fixed.particles,))
        mode = mode_of("robust").knowing(PROPORTIONAL, ratios=ratios(self.models[EXPENSIVE]))
        middle = SPACE.complete(SPACE.box.centre)
        cheap = replace(cheap_of([(self.models[EXPENSIVE], self.models[CHEAP])], middle), is_measured=False)
        task = Task(1, SPACE, None, cost, mode, seed, 1, self.noise[EXPENSIVE], confirm=CONFIRM)
        return task if how == ALONE else replace(task, cheap=cheap)

    def exact(self, task: Task, points: Array) -> Array:
        """Noise-free residuals (k, 3) of points (k, 6) at the expensive fidelity."""
        names, twin = task.cost.responses, self.engines[EXPENSIVE].twin
        values = [[twin(SPACE.complete(point)).values[name] for name in names] for point in points]
        return task.cost.residuals(points, np.array(values))

    def least(self, task: Task) -> float:
        """Smallest noise-free sum of squares in the box, from many starts."""
        box = SPACE.box
        unit = np.random.default_rng(0).uniform(-0.2, 1.2, (300, box.dimension))
        points = box.from_unit(np.clip(unit, 0.0, 1.0))
        totals = np.sum(self.exact(task, points) ** 2, axis=1)
        optima = [
            sequential_quadratic(
                lambda at: self.exact(task, at), start, box, SequentialQuadratic(difference=1e-3)
            )
            for start in points[np.argsort(totals)[:4]]
        ]
        return min(totals.min(), *(optimum.sum_of_squares for optimum in optima))

    def line(self, task: Task, least: float, of: dict[str, object]) -> dict[str, object]:
        """What one calibration cost and reached."""
        start = time.process_time()
        found = calibrate(task, self)
        cheap = found.runs.get(Phase.CHEAP, 0)
        expensive = sum(found.runs.values()) - cheap - found.runs[Phase.CONFIRMATION]
        at = task.space.point(found.dem.parameters)
        return {
            **of,
            "excess": float(np.sum(self.exact(task, at[None]) ** 2)) - least,
            "expensive": expensive,
            "cheap": cheap,
            "equivalents": expensive + cheap * self.share,
            "stop": str(found.dem_stop),
            "alone": found.alone,
            "cpu": time.process_time() - start,
        }


def measure(seeds: int, weights: Sequence[float], out: Path) -> pd.DataFrame:
    """Calibrations that are not in ``out`` yet are added to it; returns all of these seeds and weights."""
    emulated = Emulated()
    if not out.exists():
        out.write_text(",".join(COLUMNS) + "\n")
    done = set(pd.read_csv(out)[list(KEY)].itertuples(index=False, name=None))
    cases = [(WRL, target) for WRL in weights for target in emulated.targets]
    least = {case: emulated.least(emulated.task(0, *case, ALONE)) for case in cases}
    for seed in range(seeds):
        for case in cases:
            for how in (ALONE, TOGETHER):
                if (seed, *case, how) in done:
                    continue
                of = dict(zip(KEY, (seed, *case, how), strict=True))
                line = emulated.line(emulated.task(seed, *case, how), least[case], of)
                with out.open("a", newline="") as file:
                    csv.DictWriter(file, COLUMNS).writerow(line)
    lines = pd.read_csv(out, keep_default_na=False)
    return lines[(lines["seed"] < seeds) & lines["WRL"].isin(weights)]


def show(lines: pd.DataFrame) -> None:
    """Print both beside each other: a table in Markdown."""
    excess = lines.pivot_table(index=list(KEY[:-1]), columns="how", values="excess").dropna()
    print("| | calibrations | expensive runs | cheap runs | in expensive runs (most) | above the least |")
    print("|---|---|---|---|---|---|")
    for how, group in lines.groupby("how"):
        runs = group[["expensive", "cheap", "equivalents"]].mean()
        print(
            f"| {how} | {len(group)} | {runs['expensive']:.2f} | {runs['cheap']:.1f} | "
            f"{runs['equivalents']:.2f} ({group['equivalents'].max():.2f}) | {mean(excess[how])} |"
        )
    print(f"\ntwo less one, paired: {mean(excess[TOGETHER] - excess[ALONE])}")
    for WRL, group in excess.groupby("WRL"):
        print(f"at WRL {WRL:g}: {mean(group[TOGETHER] - group[ALONE])}")
    print(f"the expensive fidelity went on alone in {(lines['alone'] != '').sum()} of {len(excess)}")


def mean(values: pd.Series) -> str:
    """Mean with its 95 % interval."""
    half = 1.96 * values.std(ddof=1) / np.sqrt(len(values))
    return f"{values.mean():.5f} ± {half:.5f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--weights", type=float, nargs="+", default=WEIGHTS, metavar="WRL")
    parser.add_argument("--out", type=Path, required=True, help="CSV with a line for each calibration")
    a = parser.parse_args()
    show(measure(a.seeds, a.weights, a.out))


if __name__ == "__main__":
    main()
