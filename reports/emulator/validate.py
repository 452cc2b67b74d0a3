"""Write validation.csv: emulators held against runs that they were not fitted to, response by response.

    python reports/emulator/validate.py [NAME ...]

Only the lines of the emulators named are made anew, such as `square` or `soft-ring`; without names all are.
The shipped ones stand beside those of designed runs alone, which were shipped before them. Where there are no
other runs, each is predicted without those at its point. The emulators of the readings are those that
`python reports/readings/readings.py emulators` makes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from calstudy.emulator.benchmark.emulated import KEPT
from calstudy.emulator.emulator import Emulator, fit_emulator, read_emulator, shipped_emulator
from calstudy.emulator.similarity import Similarity
from calstudy.emulator.validation import HALF_WIDTH, fresh_points, left_out, unexplained
from calstudy.models.find import DEFAULT_MODEL, declaration
from calstudy.parameters import Array
from calstudy.plan_file import load_plan
from calstudy.study.reading import read_study

HERE = Path(__file__).parent
REPORTS = HERE.parent
READINGS = REPORTS.parent / "studies" / "readings"
MADE = ("plate_65", "height", "top30", "flank", "cone", "square")
"""Emulators of readings of the paper."""
DRAWS, LEVELS = 60, (0.05, 0.5, 0.95)
MU_PP, RF_PP = 0, 2
"""Places of the inputs whose interaction is printed."""


def shipped(name: str) -> Emulator:
    """The emulator that studies find by themselves."""
    return read_emulator(shipped_emulator(DEFAULT_MODEL, *name.split("-")))


def designed(name: str) -> Emulator:
    """The emulator of designed runs alone; that of `fast` is fitted to the runs of the one of `full`."""
    kept = KEPT / DEFAULT_MODEL
    if (kept / name).is_dir():
        return read_emulator(kept / name)
    runs = pd.read_parquet(kept / "full-ring" / "runs.parquet")
    plan = load_plan()
    similarity = Similarity.of(declaration(DEFAULT_MODEL), plan.parameters)
    return fit_emulator(runs[runs["fidelity"] == name.split("-")[0]], plan.parameters, similarity)


def sweep(folder: str) -> pd.DataFrame:
    """Runs of a sweep."""
    return pd.read_parquet(REPORTS / folder / "runs.parquet")


def rows_at_fast() -> pd.DataFrame:
    """Runs of the two rows at `fast`."""
    runs = read_study(REPORTS / "fast" / "paper").evaluations
    return runs.assign(label=[f"row {row}, {k}" for k, row in enumerate(runs["row"])])


def fresh(emulator: Emulator, runs: pd.DataFrame) -> pd.DataFrame:
    """A line a point and response: error of the measured mean, its standard deviation as said, seeds."""
    points = fresh_points(emulator, runs[~runs["run_id"].isin(emulator.runs["run_id"])])
    return points.assign(error=points["measured"] - points["predicted"])


def by_others(emulator: Emulator) -> pd.DataFrame:
    """The same of the fitted runs at the reference fidelity, each without its point."""
    runs = left_out(emulator)
    runs = runs[runs["fidelity"] == emulator.origin.fidelity]
    return runs.assign(error=runs["measured"] - runs["predicted"], seeds=1)


def summary(
    name: str, held_against: str, emulator: Emulator, errors: pd.DataFrame
) -> list[dict[str, object]]:
    """A line a response."""
    lines: list[dict[str, object]] = []
    told = {one.response: one.share for one in unexplained(emulator)}
    for response, of in errors.groupby("response", sort=False):
        process = next(r.process for r in emulator.responses if r.name == response)
        effect = (
            np.quantile(
                [interaction(process.draw(np.random.default_rng(k))[0]) for k in range(DRAWS)], LEVELS
            )
            if response.endswith("deg")
            else np.full(3, np.nan)
        )
        lines.append(
            {
                "emulator": name,
                "version": emulator.version,
                "held_against": held_against,
                "response": response,
                "runs": int(of["seeds"].sum()),
                "points": len(of),
                "bias": of["error"].mean(),
                "bias_se": of["error"].std(ddof=1) / np.sqrt(len(of)),
                "rms_error": np.sqrt((of["error"] ** 2).mean()),
                "rms_expected": np.sqrt((of["sd"] ** 2).mean()),
                "inside": int((of["error"].abs() <= HALF_WIDTH * of["sd"]).sum()),
                "unexplained": told[response],
                "MU_PP:RF_PP": effect[1],
                "low": effect[0],
                "high": effect[2],
            }
        )
    return lines


def interaction(path: Callable[[Array], Array]) -> float:
    """Growth of RF_PP's effect over its interval from the lower end of MU_PP's to the upper one."""
    points = np.random.default_rng(1).random((256, 5))
    total = np.zeros(256)
    for a in (0.0, 1.0):
        for b in (0.0, 1.0):
            points[:, [MU_PP, RF_PP]] = a, b
            total += (1.0 if a == b else -1.0) * path(points)
    return float(total.mean())


def main(*names: str) -> None:
    """Read, compare, write."""
    lines: list[dict[str, object]] = []
    at_soft, at_full = sweep("soft/confirmed"), sweep("emulator/full-ring-fresh")
    held = (
        ("soft-ring", "optima run again", at_soft),
        ("soft-ring", "least parameters", sweep("soft/least")),
        ("fast-ring", "rows 10 and 59", rows_at_fast()),
        ("full-ring", "fresh points", at_full),
    )
    for name, against, runs in held:
        for which, of in (("designed runs", designed), ("shipped", shipped)):
            if not names or name in names:
                emulator = of(name)
                lines += summary(f"{name}, {which}", against, emulator, fresh(emulator, runs))
    for name in ("soft-wide", *MADE):
        if not names or name in names:
            emulator = read_emulator(READINGS / name / "emulator") if name in MADE else shipped(name)
            of_it = name if name in MADE else f"{name}, shipped"
            lines += summary(of_it, "its own runs, left out", emulator, by_others(emulator))
    table = pd.DataFrame(lines)
    if names:
        there = pd.read_csv(HERE / "validation.csv", dtype={"version": str})
        table = pd.concat([there[~there["emulator"].isin(table["emulator"])], table], ignore_index=True)
    table.to_csv(HERE / "validation.csv", index=False, float_format="%.4g", lineterminator="\n")
    print(table.to_string(index=False))


if __name__ == "__main__":
    with threadpool_limits(1):
        main(*sys.argv[1:])
