"""Time and quality of the sampling and the Kriging beside what STK needs and reaches.

    OMP_NUM_THREADS=1 python benchmarks/numerics.py

STK's numbers were measured once (GNU Octave, STK 2.7.0 and 2.3.4, tests/golden/README.md) on another day
than this run: ratios of quality hold anywhere, ratios of time only on a comparable machine. stk_fit.m times
STK's fit and prediction on this one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from calstudy.modes import MODES
from calstudy.sampling import latin_hypercube, minimum_distance
from calstudy.surrogate import UniversalKriging

GOLDEN = Path(__file__).parents[1] / "tests" / "golden"
STK_SAMPLING = {(12, 2): (0.354, 0.2345), (36, 4): (1.27, 0.2787), (54, 6): (2.73, 0.3877)}
STK_FIT_SECONDS = (0.37, 0.52)
STK_RMSE = {"AoR": (0.710, 0.789), "BD": (3.163, 3.163)}
SEEDS = 20


def cpu(work: Callable[[], object], repeats: int = 1) -> float:
    """CPU seconds of one call."""
    start = time.process_time()
    for _ in range(repeats):
        work()
    return (time.process_time() - start) / repeats


def sampling() -> None:
    """Print the smallest distances and the CPU time of both searches."""
    print(f"Maximin Latin hypercubes, median of {SEEDS} seeds (STK: of 5)")
    print("    case   mode    distance     STK   CPU s    STK  ratio")
    for (n, d), (stk_seconds, stk_distance) in STK_SAMPLING.items():
        for mode in ("paper", "robust"):
            search = MODES[mode].design
            distances, seconds = [], []
            for seed in range(SEEDS):
                rng = np.random.default_rng(seed)
                start = time.process_time()
                design = search(n, d, rng)
                seconds.append(time.process_time() - start)
                distances.append(float(minimum_distance(design)))
            median = float(np.median(seconds))
            print(
                f"{n:>4} x {d} {mode:>7}  {np.median(distances):9.4f} {stk_distance:7.4f} "
                f"{median:7.3f} {stk_seconds:6.2f} {median / stk_seconds:6.2f}"
            )


def golden_fits() -> None:
    """Print the mean RMSE to the truth over the six noise draws that tests/golden ships."""
    intervals = pd.read_csv(GOLDEN / "kriging_intervals.csv").set_index("bound")
    names = list(intervals.columns)
    design = pd.read_csv(GOLDEN / "kriging_design.csv")[names].to_numpy()
    points = pd.read_csv(GOLDEN / "kriging_test_points.csv")[names].to_numpy()
    truth = pd.read_csv(GOLDEN / "kriging_test_truth.csv")
    responses = pd.read_csv(GOLDEN / "kriging_responses.csv").sort_values("point")
    print("\nKriging, n = 24, d = 4, six noise draws: mean RMSE to the truth, CPU s of one fit")
    print(" response     mode    RMSE  STK 2.7.0  STK 2.3.4   fit s  STK s")
    for response, (new, old) in STK_RMSE.items():
        draws = [
            draw.value.to_numpy() for _, draw in responses[responses.response == response].groupby("rep")
        ]
        for mode in ("paper", "robust"):
            model = UniversalKriging(*intervals.loc[["lower", "upper"]].to_numpy(), mode=mode)
            errors, seconds = [], []
            for z in draws:
                start = time.process_time()
                model.fit(design, z)
                seconds.append(time.process_time() - start)
                errors.append(np.sqrt(np.mean((model.predict(points) - truth[response]) ** 2)))
            print(
                f"{response:>9} {mode:>8} {np.mean(errors):7.3f} {new:10.3f} {old:10.3f} "
                f"{np.median(seconds):7.3f}  {STK_FIT_SECONDS[0]:.2f}-{STK_FIT_SECONDS[1]:.2f}"
            )


def sizes() -> None:
    """Print the time of fits and predictions in the smallest, the average and the largest plan row."""
    print("\nKriging by size: CPU s of a fit, and of predicting 10,000 points (with standard deviation)")
    print("   n  d     mode     fit  predict  with sd")
    for n, d in ((6, 2), (24, 4), (54, 6)):
        rng = np.random.default_rng(0)
        U = latin_hypercube(n, d, rng)
        z = np.sin(3.0 * U[:, 0]) + U[:, 1] + 0.1 * rng.normal(size=n)
        points = rng.random((10_000, d))
        for mode in ("paper", "robust"):
            model = UniversalKriging(np.zeros(d), np.ones(d), mode=mode)
            fit = cpu(partial(model.fit, U, z), 3)
            mean = cpu(partial(model.predict, points), 3)
            both = cpu(partial(model.predict, points, return_std=True), 3)
            print(f"{n:>4} {d:>2} {mode:>8} {fit:7.3f} {mean:8.3f} {both:8.3f}")


if __name__ == "__main__":
    sampling()
    golden_fits()
    sizes()
