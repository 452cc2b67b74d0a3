"""Time and quality of the sampling and the Kriging beside what STK needs and reaches.

    OMP_NUM_THREADS=1 python benchmarks/numerics.py          (--seeds 2 --rows 2: a quick look)

Where Octave and its package stk are installed (Debian: octave, octave-stk), stk.m times STK in the same run.
Elsewhere its times are those of tests/golden/README.md, from another machine: the heading says which. STK's
errors to the truth are from there in any case.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd
from calibration_cost import INPUTS, RUNS, StandIn, measured_noise, real_runs, task_of

from calstudy.calibration.expected import number_of_samples
from calstudy.calibration.kriging.predictor import Trend
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.kriging.universal import UniversalKriging
from calstudy.calibration.modes import MODES
from calstudy.calibration.optimise import SequentialQuadratic, levenberg_marquardt, sequential_quadratic
from calstudy.calibration.procedure import expected_residuals, fit
from calstudy.calibration.sampling import latin_hypercube, minimum_distance
from calstudy.calibration.task import Runs, Task
from calstudy.parameters import Array
from calstudy.plan import PARAMETERS
from calstudy.records import Phase

ROOT = Path(__file__).parents[1]
GOLDEN = ROOT / "tests" / "golden"
STK_RECORDED = {
    ("sampling", "12x2"): (0.354, 0.2345),
    ("sampling", "36x4"): (1.27, 0.2787),
    ("sampling", "54x6"): (2.73, 0.3877),
    ("fit", "AoR"): (0.445, np.nan),
    ("fit", "BD"): (0.445, np.nan),
}
"""CPU s and smallest distance, recorded in tests/golden/README.md (fit: 0.37 to 0.52 s)."""
STK_RMSE = {"AoR": (0.710, 0.789), "BD": (3.163, 3.163)}
SEEDS = 20
ROWS = 100
TINY = 1e-4
"""A sum of squares below this is as good as none: a miss of one per cent."""


def cpu(work: Callable[[], object], repeats: int = 1) -> float:
    """CPU seconds of one call."""
    start = time.process_time()
    for _ in range(repeats):
        work()
    return (time.process_time() - start) / repeats


Reference = Mapping[tuple[str, str], tuple[float, float]]


def stk() -> Reference:
    """STK's CPU s and smallest distances on this machine, or those recorded."""
    octave = shutil.which("octave-cli")
    # Octave 7 may complain of its own exit after all is printed: the lines count, not the exit code.
    done = octave and subprocess.run(
        [octave, "benchmarks/stk.m"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    lines = [line.split(",") for line in done.stdout.splitlines()] if done else []
    if len(lines) < len(STK_RECORDED):
        print("STK: recorded elsewhere (tests/golden/README.md)\n")
        return STK_RECORDED
    print("STK: timed on this machine in this run\n")
    return {(what, case): (float(seconds), float(distance)) for what, case, seconds, distance in lines}


def sampling(reference: Reference, seeds: int) -> None:
    """Print the smallest distances and the CPU time of both searches."""
    print(f"Maximin Latin hypercubes, median of {seeds} seeds (STK: of 5)")
    print("    case   mode    distance     STK   CPU s    STK  ratio")
    for n, d in ((12, 2), (36, 4), (54, 6)):
        stk_seconds, stk_distance = reference["sampling", f"{n}x{d}"]
        for mode in ("paper", "robust"):
            search = MODES[mode].design
            distances, seconds = [], []
            for seed in range(seeds):
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


def golden_fits(reference: Reference) -> None:
    """Print the mean RMSE to the truth over the six noise draws that tests/golden ships."""
    intervals = pd.read_csv(GOLDEN / "kriging_intervals.csv").set_index("bound")
    names = list(intervals.columns)
    design = pd.read_csv(GOLDEN / "kriging_design.csv")[names].to_numpy()
    points = pd.read_csv(GOLDEN / "kriging_test_points.csv")[names].to_numpy()
    truth = pd.read_csv(GOLDEN / "kriging_test_truth.csv")
    responses = pd.read_csv(GOLDEN / "kriging_responses.csv").sort_values("point")
    print("\nKriging, n = 24, d = 4, six noise draws: mean RMSE to the truth, CPU s of one fit")
    print(" response     mode    RMSE  STK 2.7.0  STK 2.3.4   fit s  STK s  ratio")
    for response, (new, old) in STK_RMSE.items():
        draws = [
            draw.value.to_numpy() for _, draw in responses[responses.response == response].groupby("rep")
        ]
        stk_seconds, _ = reference["fit", response]
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
                f"{np.median(seconds):7.3f} {stk_seconds:6.2f} {np.median(seconds) / stk_seconds:6.2f}"
            )


def trends(seeds: int) -> None:
    """Print how well robust mode predicts with either trend, by the number of runs.

    The truth is the stand-in of calibration_cost.py, fitted to real runs; noise as measured, and known.
    """
    noise = measured_noise()
    truth = StandIn.fit(real_runs(RUNS), "ring", noise)
    density = PARAMETERS.index("DENS")
    print(f"\nTrend of robust mode, {seeds} designs each: RMSE to the noise-free truth over the box (d = 6),")
    print("and affine less constant with twice its standard error")
    print("   n          response  constant  affine  difference")
    for n in (10, 16, 24, 36, 54):
        errors: dict[tuple[str, str], list[float]] = defaultdict(list)
        for seed in range(seeds):
            rng = np.random.default_rng([n, seed])
            design, points = MODES["robust"].design(n, 6, rng), rng.random((500, 6))
            for k, (response, unit) in enumerate((("angle, deg", 1.0), ("solid fraction, 1e-3", 1e-3))):
                at_design, at_points = (
                    truth.responses(INPUTS.space.box.from_unit(u)) for u in (design, points)
                )
                noisy = at_design + noise * rng.standard_normal((n, 2))
                scale_design, scale_points = (
                    INPUTS.space.box.from_unit(u)[:, density] if k else np.ones(len(u))
                    for u in (design, points)
                )
                sd = noise[k] / scale_design.mean()
                for trend in get_args(Trend):
                    model = UniversalKriging(
                        np.zeros(6), np.ones(6), mode="robust", trend=trend, noise_sd=float(sd)
                    ).fit(design, noisy[:, k] / scale_design)
                    off = model.predict(points) - at_points[:, k] / scale_points
                    errors[response, trend].append(float(np.sqrt(np.mean(off**2))) / unit)
        for response in dict.fromkeys(name for name, _ in errors):
            constant, affine = (np.array(errors[response, trend]) for trend in ("constant", "affine"))
            difference = affine - constant
            twice = 2 * difference.std(ddof=1) / np.sqrt(seeds)
            print(
                f"{n:>4} {response:>20} {constant.mean():8.3f} {affine.mean():8.3f} "
                f"{difference.mean():+8.3f} +- {twice:.3f}"
            )


def solvers(rows: int) -> None:
    """Print where both modes' first optimisation ends on the same surrogates: those of mode paper."""
    noise = measured_noise()
    truth = StandIn.fit(real_runs(RUNS), "ring", noise)
    print(
        "\nFirst optimisation on paper's surrogates from the centre: random rows of the plan, the share where"
    )
    print("the authors' solver ends with more than twice the sum of squares that SLSQP reaches, and medians")
    print("parameters  WRL  rows  share  authors' solver    SLSQP")
    found: dict[tuple[str, float], list[tuple[float, float]]] = defaultdict(list)
    for number, row in enumerate(map(int, np.random.default_rng(2017).integers(1, 73, rows))):
        task = task_of(row, "paper", 1000 + number, free=False, noise=noise)
        runs = Runs(task, truth)
        box = task.space.box
        design = MODES["paper"].design(number_of_samples(task), box.dimension, np.random.default_rng(number))
        runs(Phase.SAMPLING, box.from_unit(design))
        surrogates = fit(task, runs)

        def residuals(points: Array, task: Task = task, surrogates: Surrogates = surrogates) -> Array:
            return expected_residuals(task, surrogates, points)

        ends = (
            levenberg_marquardt(lambda _, at: residuals(at), box.centre, box),
            sequential_quadratic(residuals, box.centre, box, SequentialQuadratic()),
        )
        many = "4 to 6" if box.dimension >= 4 else "2 or 3"
        found[many, task.cost.WRL].append((ends[0].sum_of_squares, ends[1].sum_of_squares))
    for (many, WRL), pairs in sorted(found.items()):
        authors, ours = np.array(pairs).T
        print(
            f"{many:>10} {WRL:>4g} {len(pairs):>5} {np.mean(authors > 2 * ours + TINY):6.0%} "
            f"{np.median(authors):16.5f} {np.median(ours):8.5f}"
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


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"of designs, 2 at least; default: {SEEDS}")
    parser.add_argument("--rows", type=int, default=ROWS, help=f"random rows; default: {ROWS}")
    a = parser.parse_args()
    reference = stk()
    sampling(reference, a.seeds)
    golden_fits(reference)
    trends(a.seeds)
    solvers(a.rows)
    sizes()


if __name__ == "__main__":
    main()
