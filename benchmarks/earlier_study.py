"""An earlier material's study as the prior of a calibration (`start`), or without it: paired, on emulators.

    OMP_NUM_THREADS=1 python benchmarks/earlier_study.py --seeds 30 --out earlier.csv

Mode ``robust`` calibrates six parameters on the emulator of `full` (5 mm beads) to what a hidden parameter
set gives; WRL is 0, 0.5 and 1 by turns. The earlier study is such a calibration, too, of another material
with a hidden set of its own, confirmed as usual. Its runs, some twenty, are the prior. Materials:

    larger beads    the emulator of `coarse`: 7.5 mm and softened
    exchanged       the same with what MU_PP and RF_PP do, and what MU_PW and RF_PW do, exchanged
    mirrored        the same at the mirrored point of the box: all goes the other way

The first is a related material, the others are not. The sum of squares is that of the emulator without noise,
of all residuals, less the least that the box allows. Runs that confirm the optimum are not counted. Intervals
are 95 %. Every calibration is a line of --out as soon as it is done: the same command goes on where it was
ended.
"""

from __future__ import annotations

import argparse
import csv
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from two_fidelities import CONFIRM, PLAN, SPACE, VARIANT, WEIGHTS, mean

from calstudy.calibration.cost import Cost
from calstudy.calibration.fidelities.surrogates import Cheap, FidelityRuns
from calstudy.calibration.modes import mode_of
from calstudy.calibration.optimise import SequentialQuadratic, sequential_quadratic
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Task
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.models.angle_of_repose import load_model
from calstudy.models.find import ratios
from calstudy.models.heap import MEASURED, PROPORTIONAL
from calstudy.models.noise import known_noise
from calstudy.parameters import Array
from calstudy.records import Evaluation, Phase, Request, Target

NEW, EARLIER = "full", "coarse"
WITHOUT = "no earlier study"
EXCHANGED = {"MU_PP": "RF_PP", "RF_PP": "MU_PP", "MU_PW": "RF_PW", "RF_PW": "MU_PW"}
KEY = ("seed", "earlier")
COLUMNS = (*KEY, "WRL", "excess", "prior", "runs", "confirming", "given up", "cpu")


def as_it_is(u: dict[str, float]) -> dict[str, float]:
    """The same places in the intervals."""
    return u


def exchanged(u: dict[str, float]) -> dict[str, float]:
    """Places of frictions exchanged."""
    return {name: u[EXCHANGED.get(name, name)] for name in u}


def mirrored(u: dict[str, float]) -> dict[str, float]:
    """Places from the other end of each interval."""
    return {name: 1.0 - place for name, place in u.items()}


MATERIALS: Mapping[str, Callable[[dict[str, float]], dict[str, float]]] = {
    "larger beads": as_it_is,
    "exchanged": exchanged,
    "mirrored": mirrored,
}
"""Of each earlier material where the emulator is asked."""


@dataclass(frozen=True)
class Material:
    """Answers by an emulator; callable as a calibration's ``evaluate``."""

    engine: EmulatorEngine
    noise: Mapping[str, float]
    place: Callable[[dict[str, float]], dict[str, float]] = as_it_is

    @classmethod
    def of(cls, fidelity: str, name: str = "") -> Material:
        """A fidelity's beads, as one of MATERIALS where it is named."""
        model = load_model(PLAN.fixed, fidelity)
        engine = EmulatorEngine(
            model, read_emulator(shipped_emulator(model.name, fidelity, VARIANT)), rounded=True
        )
        return cls(engine, known_noise(model.name, model.hash) or {}, MATERIALS.get(name, as_it_is))

    def asked(self, parameters: Mapping[str, float]) -> dict[str, float]:
        """Where the emulator is asked for a parameter set; the density stays, for it acts as it does."""
        box = SPACE.box
        place = self.place(
            dict(zip(box.names, map(float, box.to_unit(SPACE.point(parameters))), strict=True))
        )
        moved = SPACE.complete(box.from_unit(np.clip([place[name] for name in box.names], 0.0, 1.0)))
        return moved | {"DENS": parameters["DENS"]}

    def __call__(self, requests: Sequence[Request]) -> list[Evaluation]:
        """Noisy answers."""
        answers = []
        for request in requests:
            at = self.asked(request.parameters)
            run = self.engine.run(at, request.seed, Path(), threading.Event())
            answers.append(Evaluation(request, "", run))
        return answers

    def exact(self, task: Task, points: Array) -> Array:
        """Noise-free residuals (k, 3) of points (k, 6)."""
        values = [self.engine.twin(self.asked(SPACE.complete(p))).values for p in points]
        return task.cost.residuals(points, np.array([[v[n] for n in task.cost.responses] for v in values]))

    def task(self, seed: int, WRL: float, stream: int) -> Task:
        """A calibration of all six parameters to what a hidden set gives."""
        rng = np.random.default_rng([seed, stream])
        hidden = SPACE.complete(SPACE.box.from_unit(rng.uniform(0.15, 0.85, SPACE.box.dimension)))
        values = self.engine.twin(self.asked(hidden)).values
        target = Target({name: values[name] for name in MEASURED}, "twin", "hidden")
        cost = Cost(SPACE, target, WRL, (PLAN.fixed.particles,))
        mode = mode_of("robust").knowing(PROPORTIONAL, ratios=ratios(self.engine.model))
        return Task(1, SPACE, None, cost, mode, seed + 1000 * stream, 1, self.noise, confirm=CONFIRM)

    def least(self, task: Task) -> float:
        """Smallest noise-free sum of squares in the box, from many starts."""
        if task.cost.WRL == 0:
            return 0.0
        unit = np.random.default_rng(0).uniform(-0.2, 1.2, (200, SPACE.box.dimension))
        points = SPACE.box.from_unit(np.clip(unit, 0.0, 1.0))
        totals = np.sum(self.exact(task, points) ** 2, axis=1)
        optima = [
            sequential_quadratic(
                lambda at: self.exact(task, at), start, SPACE.box, SequentialQuadratic(difference=1e-3)
            )
            for start in points[np.argsort(totals)[:2]]
        ]
        return min(totals.min(), *(optimum.sum_of_squares for optimum in optima))


def runs_of(material: Material, task: Task) -> FidelityRuns:
    """Runs of a calibration."""
    answers: list[Evaluation] = []

    def evaluate(requests: Sequence[Request]) -> list[Evaluation]:
        found = material(requests)
        answers.extend(found)
        return found

    calibrate(task, evaluate)
    points = np.array([SPACE.point(e.request.parameters) for e in answers])
    return FidelityRuns(points, np.array([task.measured(e.run) for e in answers]))


def measure(seeds: int, out: Path, materials: Sequence[str]) -> pd.DataFrame:
    """Calibrations that are not in ``out`` yet are added to it; returns all of these seeds."""
    new = Material.of(NEW)
    if not out.exists():
        out.write_text(",".join(COLUMNS) + "\n")
    done = set(pd.read_csv(out)[list(KEY)].itertuples(index=False, name=None))
    for seed in range(seeds):
        missing = [name for name in (WITHOUT, *materials) if (seed, name) not in done]
        if not missing:
            continue
        task = new.task(seed, WEIGHTS[seed % 3], 1)
        least = new.least(task)
        for name in missing:
            of, prior = task, 0
            if name != WITHOUT:
                earlier = Material.of(EARLIER, name)
                runs = runs_of(earlier, earlier.task(seed, 0.0, 2))
                of, prior = replace(task, cheap=Cheap.of_earlier(runs.usable)), len(runs.usable.points)
            start = time.process_time()
            found = calibrate(of, new)
            at = SPACE.point(found.dem.parameters)
            confirming = found.runs[Phase.CONFIRMATION]
            line = {
                "seed": seed,
                "earlier": name,
                "WRL": task.cost.WRL,
                "excess": float(np.sum(new.exact(task, at[None]) ** 2)) - least,
                "prior": prior,
                "runs": sum(found.runs.values()) - confirming,
                "confirming": confirming,
                "given up": bool(found.alone),
                "cpu": time.process_time() - start,
            }
            with out.open("a", newline="") as file:
                csv.DictWriter(file, COLUMNS).writerow(line)
    lines = pd.read_csv(out)
    return lines[(lines["seed"] < seeds) & lines["earlier"].isin([WITHOUT, *materials])]


def show(lines: pd.DataFrame) -> None:
    """Print each earlier material beside none: a table in Markdown."""
    excess = lines.pivot_table(index="seed", columns="earlier", values="excess")
    print(
        "| earlier material | pairs | given up | runs (most) | sum of squares above the least | less none |"
    )
    print("|---|---|---|---|---|---|")
    for name in (WITHOUT, *MATERIALS):
        if name not in excess:
            continue
        of = lines[lines["earlier"] == name]
        less = "" if name == WITHOUT else mean((excess[name] - excess[WITHOUT]).dropna())
        print(
            f"| {name} | {len(of)} | {int(of['given up'].sum())} | {of['runs'].mean():.1f} "
            f"({of['runs'].max()}) | {mean(excess[name].dropna())} | {less} |"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--out", type=Path, required=True, help="CSV with a line for each calibration")
    parser.add_argument("--materials", nargs="*", default=list(MATERIALS), metavar="NAME")
    a = parser.parse_args()
    show(measure(a.seeds, a.out, a.materials))


if __name__ == "__main__":
    main()
