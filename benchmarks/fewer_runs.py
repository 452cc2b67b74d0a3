"""What fewer DEM runs cost: mode ``robust`` with fewer samples, fewer later runs or a larger doubt, paired.

    OMP_NUM_THREADS=1 python benchmarks/fewer_runs.py draw 7000 7096 version2 version3 --out fewer.csv

Calibrations FROM to TO, each with every setting, the first of which the others are paired with: a version of
the mode, such as version3, or version3_by3 for rounds of three runs; or SAMPLES_BUDGET_DOUBT: samples (0: as
the plan has them), most runs of the second optimisation, and the doubt that ends it, in units of a run's
noise. For six parameters 10_6_0.3 is version 2. Families:

    draw          six parameters and a hidden target, on a hidden draw of the emulator of ``full``
    ring, wide    six parameters on the stand-in of calibration_cost.py, with the paper's or a hidden target
    full          the same on such a stand-in for the runs at ``full`` of reports/emulator
    fails         six parameters on the emulator of the wide plate, where runs beyond the jump fail
    rows          random rows of the plan on the stand-in for the ring

WRL is 0, 0.5 and 1 by turns, and 0 where runs fail; rows have their own. All optima are confirmed by four
runs, or by eight where these are not as expected; "all runs" are without them. The sum of squares is without
noise, on the emulators less the least of the box. Every calibration is a line of --out as soon as it is done:
the same command goes on where it was ended. Intervals are 95 %.
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import calibration_cost as cost_of
import numpy as np
import pandas as pd

from calstudy.calibration.cost import Cost
from calstudy.calibration.modes import Refinement, mode_of
from calstudy.calibration.procedure import calibrate
from calstudy.calibration.task import Evaluate, Task
from calstudy.emulator.benchmark.challenges import Posed, heap
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import MEASURED, PROPORTIONAL
from calstudy.models.noise import known_noise
from calstudy.parameters import Array
from calstudy.plan import PARAMETERS
from calstudy.records import Evaluation, Outcome, Phase, Request, Run, Target

WEIGHTS = (0.0, 0.5, 1.0)
CONFIRM = 4
AT_FULL = cost_of.RUNS.parent / "emulator"
"""Runs at ``full``."""
KEY = ("family", "number", "setting")
COLUMNS = (*KEY, "WRL", "sum of squares", "second", "rounds", "runs", "confirming", "cpu")

Case = tuple[Task, Evaluate, Callable[[Array], float]]
"""A calibration, what answers it, and the noise-free sum of squares at a point (d,)."""


def drawn(number: int) -> Case:
    """Six parameters on a draw of the emulator."""
    return on_emulator(number, heap(number, WRL=WEIGHTS[number % 3]))


def failing(number: int) -> Case:
    """The same on the wide plate at ``soft``, where runs beyond the jump fail."""
    return on_emulator(number, heap(number, fidelity="soft", variant="wide"))


def on_emulator(number: int, posed: Posed) -> Case:
    """A challenge of the benchmark."""
    return (
        six(number, posed.cost, posed.noise),
        answering(posed),
        lambda at: float(posed.exact(at[None])[1][0] - posed.least),
    )


def answering(posed: Posed) -> Evaluate:
    """Noisy answers of a challenge; the noise follows from the seed and from every bit of the parameters."""
    truth = next(iter(posed.truths.values()))

    def evaluate(requests: Sequence[Request]) -> list[Evaluation]:
        answers = []
        for request in requests:
            point = posed.space.point(request.parameters)
            rng = np.random.default_rng([request.seed, *map(int, np.asarray(point, float).view(np.uint32))])
            noise = truth.noise_sd(point[None])[0] * rng.standard_normal(len(MEASURED))
            found = truth.responses(point[None])[0] + noise
            responses = dict(zip(posed.cost.responses, map(float, found), strict=True))
            outcome = Outcome.OK if np.isfinite(found).all() else Outcome.UNMEASURABLE
            answers.append(Evaluation(request, "", Run(outcome, "", responses, 0.0, 0.0)))
        return answers

    return evaluate


def standing_in(number: int, model: cost_of.StandIn) -> Case:
    """Six parameters on a stand-in: the paper's target, or what a hidden parameter set gives."""
    space = cost_of.Space(cost_of.PLAN.parameters, tuple(PARAMETERS))
    hidden = space.box.from_unit(np.random.default_rng([number, 7]).uniform(0.2, 0.8, (1, 6)))
    full = np.array([[space.complete(hidden[0])[name] for name in PARAMETERS]])
    values = dict(zip(MEASURED, map(float, model.responses(full)[0]), strict=True))
    target = Target(values, "set", "hidden") if number % 2 else cost_of.TARGET
    cost = Cost(space, target, WEIGHTS[number % 3], (cost_of.PLAN.fixed.particles,))
    task = six(number, cost, dict(zip(MEASURED, map(float, model.noise), strict=True)))
    return task, model, lambda at: cost_of.exact_sum_of_squares(task, model, at)


def six(number: int, cost: Cost, noise: Mapping[str, float]) -> Task:
    """A calibration of six parameters with known noise."""
    mode = mode_of("robust").knowing(PROPORTIONAL, ratios=dict.fromkeys(MEASURED, cost_of.RATIO))
    return Task(1, cost.space, None, cost, mode, number, 1, dict(noise), confirm=CONFIRM)


def of_the_plan(number: int, model: cost_of.StandIn) -> Case:
    """A random row of the plan."""
    row = int(np.random.default_rng(2028).integers(1, 73, 400)[number])
    task = replace(cost_of.task_of(row, "robust", 5000 + number, False, model.noise), confirm=CONFIRM)
    return task, model, lambda at: cost_of.exact_sum_of_squares(task, model, at)


def set_to(task: Task, setting: str) -> Task:
    """The task with a version of the mode, in rounds or not, or SAMPLES_BUDGET_DOUBT."""
    if setting.startswith("version"):
        version, _, together = setting.removeprefix("version").partition("_by")
        kriging = task.mode.kriging
        newer = mode_of("robust", procedure=int(version), together=int(together or 1))
        return replace(task, mode=newer.knowing(kriging.divisors or {}, ratios=kriging.ratios))
    samples, budget, doubt = setting.split("_")
    second = task.mode.second_optimisation
    assert isinstance(second, Refinement)
    second = replace(second, budget=int(budget), doubt=float(doubt), most_doubt=0.0)
    return replace(
        task, samples=int(samples) or task.samples, mode=replace(task.mode, second_optimisation=second)
    )


def measure(family: str, numbers: range, settings: Sequence[str], out: Path) -> pd.DataFrame:
    """Calibrations that are not in ``out`` yet are added to it; returns all of these."""
    if not out.exists():
        out.write_text(",".join(COLUMNS) + "\n")
    done = set(pd.read_csv(out)[list(KEY)].itertuples(index=False, name=None))
    make: Callable[[int], Case] = failing if family == "fails" else drawn
    if family not in ("draw", "fails"):
        model = model_of(family)
        kind = of_the_plan if family == "rows" else standing_in
        make = lambda number: kind(number, model)  # noqa: E731
    for number in numbers:
        missing = [setting for setting in settings if (family, number, setting) not in done]
        if not missing:
            continue
        task, evaluate, exact = make(number)
        for setting in missing:
            start = time.process_time()
            found = calibrate(set_to(task, setting), evaluate)
            second = sum(found.runs.get(phase, 0) for phase in (Phase.START, Phase.TRIAL))
            runs = found.runs[Phase.SAMPLING] + second
            at = task.space.point(found.dem.parameters)
            confirming = found.runs.get(Phase.CONFIRMATION, 0)
            made = (second, found.iterations, runs, confirming)
            line = (family, number, setting, task.cost.WRL, exact(at), *made)
            with out.open("a", newline="") as file:
                csv.writer(file).writerow((*line, time.process_time() - start))
    lines = pd.read_csv(out)
    return lines[
        (lines["family"] == family) & lines["number"].isin(numbers) & lines["setting"].isin(settings)
    ]


def model_of(family: str) -> cost_of.StandIn:
    """The stand-in of a family."""
    if family != "full":
        variant = "wide" if family == "wide" else "ring"
        return cost_of.StandIn.fit(cost_of.real_runs(cost_of.RUNS), variant, noise=cost_of.measured_noise())
    runs = pd.concat(
        [pd.read_parquet(AT_FULL / name / "runs.parquet") for name in ("full-ring", "full-ring-fresh")]
    )
    runs = runs[(runs["outcome"] == "ok") & (runs["fidelity"] == "full")].reset_index(drop=True)
    measured = known_noise("angle_of_repose", load_model(cost_of.PLAN.fixed, "full", "ring").hash) or {}
    return cost_of.StandIn.fit(runs, "ring", noise=np.array([measured[name] for name in MEASURED]))


def show(lines: pd.DataFrame, first: str) -> None:
    """Print each setting beside the first: a table in Markdown."""
    squares = lines.pivot_table(index="number", columns="setting", values="sum of squares")
    print(
        "| setting | pairs | second optimisation | its rounds | all runs (most) | confirming "
        "| sum of squares | median | less the first |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for setting, group in lines.groupby("setting"):
        apart = (squares[setting] - squares[first]).dropna()
        half = 1.96 * apart.std(ddof=1) / np.sqrt(len(apart))
        print(
            f"| {setting} | {len(apart)} | {group['second'].mean():.2f} "
            f"| {group['rounds'].mean():.2f} | {group['runs'].mean():.1f} "
            f"({group['runs'].max()}) | {group['confirming'].mean():.2f} "
            f"| {squares[setting][apart.index].mean():.5f} | {squares[setting][apart.index].median():.5f} "
            f"| {apart.mean():+.5f} ± {half:.5f} |"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("family", choices=("draw", "ring", "wide", "full", "fails", "rows"))
    parser.add_argument("numbers", type=int, nargs=2, metavar=("FROM", "TO"))
    parser.add_argument("settings", nargs="+", metavar="SETTING")
    parser.add_argument("--out", type=Path, required=True, help="CSV with a line for each calibration")
    a = parser.parse_args()
    show(measure(a.family, range(*a.numbers), a.settings, a.out), a.settings[0])


if __name__ == "__main__":
    main()
