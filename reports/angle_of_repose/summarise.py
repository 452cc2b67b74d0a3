"""Turns the model's measurements into what the project ships: tables, the plate's verdict, twins, noise.

    python reports/angle_of_repose/summarise.py

Reads DIR/runs.parquet of what `calstudy sweep` made of DIR/design.csv; writes tables.md here, noise.csv and
twins.csv in the model's folder, plate.png and full_heap.png in docs/images. What is not there is left out.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import gate
import matplotlib
import numpy as np
import pandas as pd
import rules
import statsmodels.api as sm

from calstudy.analysis.figures.figure9 import draw
from calstudy.analysis.figures.heap import heap_of_run
from calstudy.models.angle_of_repose import load_model
from calstudy.models.find import DEFAULT_MODEL, NOISE_FILE, declaration
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, REFERENCE
from calstudy.models.noise import difference, noise_table
from calstudy.models.targets import RepeatedRuns, write_twin
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan

matplotlib.use("Agg")
from matplotlib import pyplot as plt

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
import dem  # noqa: E402 (benchmarks are scripts, not a package)

FOLDER = ROOT / "liggghts_models" / "angle_of_repose"
PLAN = load_plan()
FRICTIONS = ("MU_PP", "RF_PP", "MU_PW", "RF_PW")
TARGET = PLAN.targets[ANGLE_OF_REPOSE]

# The rule of PLATE.md, in its order.
LARGEST_WALL_EFFECT = 1.5
LARGEST_WALL_SHARE = 1 / 3
TOLERANCE = 0.15
LEAST_ROWS = 0.75
LARGEST_GAP = 0.015
LEAST_T = 2.0


def runs_of(name: str) -> pd.DataFrame | None:
    """Runs of a measurement, or None while there are none."""
    path = HERE / name / "runs.parquet"
    return pd.read_parquet(path) if path.exists() else None


def lacking(name: str, runs: pd.DataFrame) -> str:
    """What is to be said of a measurement that is not complete; empty for one that is."""
    planned = len(pd.read_csv(HERE / name / "design.csv"))
    return f"{len(runs)} of {planned} runs are there: no verdict yet." if len(runs) < planned else ""


def markdown(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> list[str]:
    """A Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return [f"| {' | '.join(map(str, line))} |" for line in lines]


def unit(points: pd.DataFrame) -> pd.DataFrame:
    """Parameters scaled to 0..1 over their intervals."""
    return pd.DataFrame({p.name: (points[p.name] - p.lower) / (p.upper - p.lower) for p in PLAN.parameters})


def fitted(runs: pd.DataFrame, response: str) -> sm.regression.linear_model.RegressionResultsWrapper:
    """Least-squares plane through a response over the box."""
    return sm.OLS(runs[response].to_numpy(), sm.add_constant(unit(runs).to_numpy())).fit()


def reachable_rows(effects: np.ndarray, intercept: float) -> float:
    """Share of the plan's rows whose calibrated box comes within the tolerance of the target angle."""
    fixed = {
        p.name: 0.0 if p.constant is None else (p.constant - p.lower) / (p.upper - p.lower)
        for p in PLAN.parameters
    }
    reached = []
    for row in PLAN.rows:
        ends = [
            sorted((0.0, effect)) if name in row.calibrated else (effect * fixed[name],) * 2
            for name, effect in zip(PARAMETERS, effects, strict=True)
        ]
        low, high = (intercept + sum(end[k] for end in ends) for k in (0, 1))
        reached.append(low <= (1 + TOLERANCE) * TARGET and high >= (1 - TOLERANCE) * TARGET)
    return float(np.mean(reached))


def plate(runs: pd.DataFrame) -> tuple[list[str], dict[str, int]]:
    """Table of the plates, and the points that each scores by PLATE.md's rule."""
    columns = ["plate", "n", "angle, deg", *(f"effect of {n}, deg (t)" for n in FRICTIONS), "residual sd"]
    columns += ["heap radius, mm", "largest gap of radii, mm", "rows that reach 22 deg", "points"]
    rows = []
    scores = {}
    for variant, there in runs[runs["outcome"] == "ok"].groupby("variant", sort=False):
        fit = fitted(there, ANGLE_OF_REPOSE)
        effect, t = (dict(zip(PARAMETERS, v[1:], strict=True)) for v in (fit.params, fit.tvalues))
        radii = np.sort(there["heap_radius"].to_numpy())
        gap = float(np.diff(radii).max())
        reached = reachable_rows(fit.params[1:], float(fit.params[0]))
        walls = max(abs(effect["MU_PW"]), abs(effect["RF_PW"]))
        strongest = max(abs(effect["MU_PP"]), abs(effect["RF_PP"]))
        points = [
            walls <= LARGEST_WALL_EFFECT and walls <= LARGEST_WALL_SHARE * strongest,
            reached >= LEAST_ROWS,
            gap <= LARGEST_GAP,
            all(effect[name] > 0 and t[name] > LEAST_T for name in ("MU_PP", "RF_PP")),
        ]
        scores[str(variant)] = sum(points)
        angle = there[ANGLE_OF_REPOSE]
        rows.append(
            [
                f"`{variant}`",
                len(there),
                f"{angle.min():.1f} to {angle.max():.1f}",
                *(f"{effect[n]:+.1f} ({t[n]:.1f})" for n in FRICTIONS),
                f"{math.sqrt(fit.mse_resid):.2f}",
                f"{1e3 * radii[0]:.0f} to {1e3 * radii[-1]:.0f}",
                f"{1e3 * gap:.1f}",
                f"{reached:.0%}",
                "".join("1234"[k] if point else "-" for k, point in enumerate(points)),
            ]
        )
    return markdown(columns, rows), scores


def plate_picture(runs: pd.DataFrame, path: Path) -> None:
    """Angle and heap radius over the frictions, one row of panels for each plate."""
    variants = list(dict.fromkeys(runs["variant"]))
    figure, axes = plt.subplots(
        len(variants),
        len(FRICTIONS),
        figsize=(9, 1.9 * len(variants)),
        sharey=True,
        sharex="col",
        layout="constrained",
    )
    for (row, variant), (column, name) in itertools.product(enumerate(variants), enumerate(FRICTIONS)):
        there = runs[(runs["variant"] == variant) & (runs["outcome"] == "ok")]
        axis = axes[row, column]
        points = axis.scatter(
            there[name],
            there[ANGLE_OF_REPOSE],
            c=1e3 * there["heap_radius"],
            cmap="viridis",
            vmin=45,
            vmax=120,
            s=16,
        )
        axis.axhline(TARGET, color="0.6", lw=0.8)
        if column == 0:
            axis.set_ylabel(f"{variant}\nangle in deg")
        if row == len(variants) - 1:
            axis.set_xlabel(name)
    figure.colorbar(points, ax=axes, label="heap radius in mm", shrink=0.5)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def choices(runs: pd.DataFrame) -> list[str]:
    """Table of what the paper leaves open, against `ring`."""
    columns = ["variant", "runs", "angle, deg", "against `ring`, deg (90 % interval)"]
    columns += ["bulk density, kg/m3", "against `ring`, % (90 % interval)"]
    rows = []
    ring = runs[(runs["variant"] == "ring") & (runs["outcome"] == "ok")]
    for variant, there in runs[runs["outcome"] == "ok"].groupby("variant", sort=False):
        cells = []
        for name, scale in ((ANGLE_OF_REPOSE, 1.0), (BULK_DENSITY, 100 / ring[BULK_DENSITY].mean())):
            values, others = there[name].to_numpy(), ring[name].to_numpy()
            mean, half = difference(values, others)
            cells.append(f"{values.mean():.2f} (sd {values.std(ddof=1):.2f})")
            low, high = scale * (mean - half), scale * (mean + half)
            cells.append("" if variant == "ring" else f"{scale * mean:+.2f} ({low:+.2f} to {high:+.2f})")
        rows.append([f"`{variant}`", len(there), *cells])
    return markdown(columns, rows)


def noise(runs: pd.DataFrame) -> list[str]:
    """Write the noise and the twins into the model's folder; the table."""
    table = noise_table(runs, declaration(DEFAULT_MODEL))
    table.to_csv(FOLDER / NOISE_FILE, index=False, float_format="%.6g", lineterminator="\n")
    for _, line in table[(table["label"] == "reference") & (table["n"] >= 4)].iterrows():
        model = load_model(PLAN.fixed, line["fidelity"], line["variant"])
        if model.hash != line["model_hash"]:
            raise SystemExit(f"noise/runs.parquet was made with another deck: {line['fidelity']}")
        mean = {name: float(line[name]) for name in MEASURED}
        sd = {name: float(line[f"{name}_sd"]) for name in MEASURED}
        found = RepeatedRuns(mean, sd, int(line["n"]), int(line["failed"]))
        engine = str(runs["engine"].iloc[0])
        command = (
            "calstudy sweep reports/angle_of_repose/noise/design.csv --out reports/angle_of_repose/noise"
        )
        write_twin(FOLDER / "twins.csv", model, engine, REFERENCE, found, command)
    columns = ["fidelity", "point", "runs", "angle, deg", "sd", "bias, deg (± 90 % interval)"]
    columns += ["bulk density, kg/m3", "sd", "bias, % (± 90 % interval)", "processor time, s"]
    rows = []
    for _, line in table.iterrows():
        cells = []
        for name, scale in ((ANGLE_OF_REPOSE, 1.0), (BULK_DENSITY, 100.0)):
            bias, half = line[f"{name}_bias"], line[f"{name}_bias_half_width"]
            over = 1.0 if name == ANGLE_OF_REPOSE else line[name] - bias
            words = "" if math.isnan(bias) else f"{scale * bias / over:+.2f} ± {scale * half / over:.2f}"
            cells += [f"{line[name]:.2f}", f"{line[f'{name}_sd']:.2f}", words]
        about = [f"`{line['fidelity']}`", line["label"], line["n"]]
        rows.append([*about, *cells, f"{line['cpu_time']:.1f}"])
    return markdown(columns, rows)


def cost() -> list[str]:
    """What `benchmarks/dem.py` says of the pairs that were kept, one block for each fidelity."""
    parts = []
    for path in sorted((HERE / "pairs").glob("*.parquet")):
        parts += ["", "```", *dem.report(pd.read_parquet(path)), "```"]
    return parts


def full_heap(runs: pd.DataFrame, path: Path) -> None:
    """Both views of the heap of the first run at `full`, as Figure 9 shows one."""
    there = runs[(runs["fidelity"] == "full") & (runs["outcome"] == "ok")]
    if there.empty:
        return
    run = there.sort_values("seed").iloc[0]
    heaps = pd.read_parquet(HERE / "noise" / "heaps.parquet")
    diameter = load_model(PLAN.fixed, "full").fidelity.particle_diameter
    heap = heap_of_run(run, heaps[heaps["run_id"] == run["run_id"]], diameter, "Reference point")
    draw(heap).savefig(path, dpi=90)


def main() -> None:
    """Summarise what is there."""
    parts = [
        "# Measurements of the angle-of-repose model",
        "",
        "Made by `summarise.py` from the tables beside it.",
    ]
    if (runs := runs_of("plate")) is not None and (missing := lacking("plate", runs)):
        parts += ["", "## Which plate?", "", missing]
    elif runs is not None:
        lines, scores = plate(runs)
        best = max(scores.values())
        verdict = next(name for name, score in scores.items() if score == best)
        plate_picture(runs, ROOT / "docs" / "images" / "plate.png")
        parts += ["", "## Which plate?", "", *lines, "", f"By the rule of [PLATE.md](PLATE.md): `{verdict}`."]
    if (HERE / "plate").exists() and (HERE / "noise").exists():
        parts += ["", "## Which rows reach the targets", "", "Made by `gate.py`.", "", *gate.markdown()]
    if (runs := runs_of("choices")) is not None and (missing := lacking("choices", runs)):
        parts += ["", "## What the paper leaves open", "", missing]
    elif runs is not None:
        parts += ["", "## What the paper leaves open", "", *choices(runs)]
    if (runs := runs_of("noise")) is not None:
        parts += ["", "## Noise and bias", "", *noise(runs)]
        parts += ["", "## Rules of the measurement", "", "Made by `rules.py` from kept positions.", ""]
        parts += rules.markdown()
        full_heap(runs, ROOT / "docs" / "images" / "full_heap.png")
    parts += ["", "## Cost of the deck beside a fixed schedule's", ""]
    parts += ["Pairs of `benchmarks/dem.py pairs`; of some, only angles and times were kept.", *cost()]
    (HERE / "tables.md").write_text("\n".join([*parts, ""]))
    print("\n".join(parts))


if __name__ == "__main__":
    main()
