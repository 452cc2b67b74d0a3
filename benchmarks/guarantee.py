"""How often "within tolerance" is wrong: by the run at the optimum, and by runs with fresh seeds.

    OMP_NUM_THREADS=1 python benchmarks/guarantee.py --count 200 --out guarantee.csv

Calibrations of all six parameters on the shipped emulator of `full`, mode ``robust``, WRL 0. Each has a
target of its own: the noise-free responses at parameters drawn at random, so that it can be reached. With
tolerances of 1 deg and 10 kg/m3, where a run scatters by 0.8 deg and 2.3 kg/m3, a verdict is false where the
emulator without noise is outside a tolerance at the optimum. Intervals are 95 % (Wilson). The same command
goes on where it was ended.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats
from two_fidelities import ALONE, EXPENSIVE, SPACE, TOGETHER, Emulated

from calstudy.calibration.confirmation import SURE, confirmed
from calstudy.calibration.procedure import calibrate
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.records import Evaluation, Phase, Request

TOLERANCES = {ANGLE_OF_REPOSE: 1.0, BULK_DENSITY: 10.0}
"""Of `--share` 1."""
KEY = ("number", "how")
COLUMNS = (*KEY, "is_within", "run_says", "probability", "runs", "confirmations")


def lines(
    emulated: Emulated, count: int, how: str, share: float, done: set[tuple[int, str]]
) -> Iterator[dict[str, object]]:
    """What each calibration that is not done says of its optimum, and what is true."""
    for number in range(count):
        if (number, how) in done:
            continue
        u = np.random.default_rng([2017, number]).random(SPACE.box.dimension)
        truth = SPACE.complete(SPACE.box.from_unit(u))
        emulated.targets["own"] = dict(emulated.engines[EXPENSIVE].twin(truth).values)
        tolerances = {name: share * tolerance for name, tolerance in TOLERANCES.items()}
        task = replace(emulated.task(number, 0.0, "own", how), tolerances=tolerances)
        answers: list[Evaluation] = []

        def evaluate(requests: list[Request], answers: list[Evaluation] = answers) -> list[Evaluation]:
            answers += (new := emulated(requests))
            return new

        found = calibrate(task, evaluate)
        at = task.space.point(found.dem.parameters)
        again = [
            task.measured(e.run)
            for e in answers
            if e.request.phase is Phase.CONFIRMATION
            and np.array_equal(task.space.point(e.request.parameters), at)
        ]
        assumed = np.array([(task.noise or {})[name] for name in task.cost.responses])
        verdict = confirmed(np.array(again), task.good, assumed)
        seen = np.array([found.dem.responses[name] for name in task.cost.responses])
        cheap = found.runs.get(Phase.CHEAP, 0)
        yield {
            "number": number,
            "how": how,
            "is_within": task.within(emulated.exact(task, at[None])[0]),
            "run_says": task.within(task.cost.residuals(at, seen)),
            "probability": verdict.all_within,
            "runs": sum(found.runs.values()) - cheap + cheap * emulated.share,
            "confirmations": found.runs[Phase.CONFIRMATION],
        }


def share_of(chosen: pd.Series) -> str:
    """Share of true values with its 95 % interval."""
    if not len(chosen):
        return "of none"
    interval = stats.binomtest(int(chosen.sum()), len(chosen)).proportion_ci(method="wilson")
    return f"{chosen.mean():.1%} of {len(chosen)} ({interval.low:.1%} to {interval.high:.1%})"


def show(table: pd.DataFrame) -> None:
    """Print how often each verdict is given, and how often it is false."""
    for how, of in table.groupby("how"):
        sure = of["probability"] >= SURE
        print(f"{how}: {len(of)} calibrations, {of['runs'].mean():.1f} expensive runs each")
        print(f"  optimum within its tolerances: {share_of(of['is_within'])}")
        print(f"  by the run at the optimum within: {share_of(of['run_says'])}")
        print(f"    of these false: {share_of(~of['is_within'][of['run_says']])}")
        print(f"  P(all) at least {SURE:g}: {share_of(sure)}")
        print(f"    of these false: {share_of(~of['is_within'][sure])}")
        print(f"    false of all: {share_of(sure & ~of['is_within'])}")
        print(
            f"  mean of P(all) {of['probability'].mean():.2f}, confirmations {of['confirmations'].mean():.1f}"
        )


def main() -> None:
    """Calibrate, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument(
        "--share", type=float, default=1.0, help="of the tolerances; another one, another --out"
    )
    parser.add_argument("--how", nargs="+", default=[ALONE], choices=(ALONE, TOGETHER))
    parser.add_argument("--out", type=Path, required=True, help="CSV with a line for each calibration")
    a = parser.parse_args()
    if not a.out.exists():
        a.out.write_text(",".join(COLUMNS) + "\n")
    done = set(pd.read_csv(a.out)[list(KEY)].itertuples(index=False, name=None))
    emulated = Emulated()
    for how in a.how:
        for line in lines(emulated, a.count, how, a.share, done):
            with a.out.open("a", newline="") as file:
                csv.DictWriter(file, COLUMNS).writerow(line)
    table = pd.read_csv(a.out)
    show(table[(table["number"] < a.count) & table["how"].isin(a.how)])


if __name__ == "__main__":
    main()
