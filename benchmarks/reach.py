"""How often ``calibrate`` and ``plan run`` are wrong about what is within reach.

    python benchmarks/reach.py                    (some ten minutes)
    python benchmarks/reach.py --emulator full --rows 24 --seeds 5

Rows of the plan are sampled on an emulator of the DEM model, with its noise, as either mode samples them, and
their surrogates fitted. What is truly within reach is known: the range of the emulator's mean over each row's
intervals. A target beyond that range which is said to be within reach is a false positive, one inside which
is said to be out of reach a false negative; both depend on how far from the range's end the target lies.
Printed are the
rates of the stored flag ``reachable`` (the surrogate's own range), of what is said (only a standard deviation
or more away from the range's end; otherwise "at the edge"), and of the rule before 28 November 2026: the
surrogate's and the samples' range, and two standard deviations of a run's noise on top.
"""

from __future__ import annotations

import argparse

import numpy as np
import pandas as pd
from scipy.stats import qmc
from threadpoolctl import threadpool_limits

from calstudy.calibration.expected import number_of_samples
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES
from calstudy.calibration.solutions import NOISE_FACTOR, STRETCHED, SURE, reach
from calstudy.calibration.task import Task, design_generator, tasks_of
from calstudy.emulator.emulator import Emulator, read_emulator, shipped_emulator
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, PROPORTIONAL, UNITS
from calstudy.parameters import Array
from calstudy.plan_file import load_plan
from calstudy.records import Target

TARGET = Target({ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}, "paper", "the paper's 22 deg and 1500 kg/m3")
LOOKED_AT = 2**11
"""Points that the true range is taken from."""
FAR = {ANGLE_OF_REPOSE: (0.25, 0.5, 1.0, 2.0), BULK_DENSITY: (2.0, 5.0, 10.0, 20.0)}
"""Distances of a target from the end of the true range, in the response's unit."""


def answers(emulator: Emulator, task: Task, points: Array) -> tuple[Array, Array]:
    """Means and standard deviations of a run of the measured responses (k, m) at points (k, d)."""
    full = [task.space.complete(point) for point in points]
    at = np.clip(np.vstack([emulator.point(parameters) for parameters in full]), 0.0, 1.0)
    by = [
        np.array([parameters[PROPORTIONAL[name]] for parameters in full]) if name in PROPORTIONAL else 1.0
        for name in MEASURED
    ]
    means = [r.process.mean(at) * factor for r, factor in zip(emulator.responses, by, strict=True)]
    noise = [r.process.noise_sd(at) * factor for r, factor in zip(emulator.responses, by, strict=True)]
    return np.column_stack(means), np.column_stack(noise)


def true_means(emulator: Emulator, task: Task) -> Array:
    """Mean responses (LOOKED_AT, m) all over a row's box and on its bounds."""
    box = task.space.box
    unit = qmc.Sobol(box.dimension, seed=1).random(LOOKED_AT)
    means, _ = answers(emulator, task, box.from_unit(np.clip(0.5 + STRETCHED * (unit - 0.5), 0.0, 1.0)))
    return means


def ends_of(emulator: Emulator, task: Task, seed: int, true: Array) -> list[dict[str, object]]:
    """Both ends of each response's range: the true one, and what is said of it after sampling."""
    box = task.space.box
    rng = np.random.default_rng([seed, task.row])
    design = box.from_unit(
        task.mode.design(number_of_samples(task), box.dimension, design_generator(seed, task.sampled_as))
    )
    means, noise = answers(emulator, task, design)
    sampled = means + noise * rng.standard_normal(means.shape)
    fitted = Surrogates.fit(task.mode.kriging, task.space, task.cost.responses, design, sampled, task.noise)
    lines = []
    for k, one in enumerate(reach(task, fitted)):
        for end, side in (("lower", 1.0), ("upper", -1.0)):
            # Upper ends are turned round, so that below an end is outside.
            said, sd = (one.low, one.low_sd) if end == "lower" else (-one.high, one.high_sd)
            lines.append(
                {
                    **{"row": task.row, "seed": seed, "mode": task.mode.name},
                    **{"response": one.response, "end": end, "sd": sd},
                    "true": (side * true[:, k]).min(),
                    "said": said,
                    "before": min(said, (side * sampled[:, k]).min()) - NOISE_FACTOR * noise[:, k].mean(),
                }
            )
    return lines


def rates(lines: pd.DataFrame, far: float) -> dict[str, tuple[float, float]]:
    """Shares of targets so far outside that count as within, and so far inside that count as out, by rule."""
    said, sd, true = lines["said"], SURE * lines["sd"], lines["true"]
    ends = {
        "flag": (said, said),
        "said": (said + sd, said - sd),
        "before": (lines["before"], lines["before"]),
    }
    return {
        rule: (float((within <= true - far).mean()), float((out > true + far).mean()))
        for rule, (within, out) in ends.items()
    }


def main() -> None:
    """Sample, fit and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--emulator", default="soft", help="fidelity of a shipped emulator of the ring")
    parser.add_argument("--rows", type=int, default=18, help="rows of the plan, spread over it")
    parser.add_argument("--seeds", type=int, default=3)
    a = parser.parse_args()
    plan, emulator = load_plan(), read_emulator(shipped_emulator("angle_of_repose", a.emulator, "ring"))
    rows = [plan.rows[k].run for k in np.linspace(0, len(plan.rows) - 1, a.rows).round().astype(int)]
    lines = []
    with threadpool_limits(1):
        first = tasks_of(plan, TARGET, MODES["paper"], 1)
        true = {row: true_means(emulator, first[row]) for row in rows}
        for mode in MODES.values():
            for seed in range(1, a.seeds + 1):
                tasks = tasks_of(plan, TARGET, mode.knowing(PROPORTIONAL), seed)
                lines += [line for row in rows for line in ends_of(emulator, tasks[row], seed, true[row])]
    found = pd.DataFrame(lines)
    for (mode_name, response, end), of in found.groupby(["mode", "response", "end"], sort=False):
        print(f"\n{mode_name}, {end} end of {response}: {len(of)} fits; mean sd {of['sd'].mean():.3g}")
        print("  false positives outside, false negatives inside, at a distance of")
        for far in FAR[str(response)]:
            shares = (f"{rule} {p:.2f}, {n:.2f}" for rule, (p, n) in rates(of, far).items())
            print(f"  {far:g} {UNITS[str(response)]}: {'; '.join(shares)}")


if __name__ == "__main__":
    main()
