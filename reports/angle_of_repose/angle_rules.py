"""Rules of the angle of repose beside Appendix A: noise, bias over the box, and what a run is worth.

    python reports/angle_of_repose/angle_rules.py           (prints the tables)
    python reports/angle_of_repose/angle_rules.py write     (writes rules.csv beside the model's noise.csv)

Noise from the heaps of noise/heaps.parquet: runs that differ in their seed alone, at five points. Bias over
the box from the heaps of reports/soft/confirmed: the DEM optima of the study of 72 rows, run again with four
seeds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from calstudy.models.angle_of_repose import RULES_FILE, load_model
from calstudy.models.find import SHIPPED
from calstudy.models.heap import ANGLE_OF_REPOSE
from calstudy.models.measurement import measure_heap
from calstudy.models.photograph.rules import RULES, angles
from calstudy.plan_file import load_plan

HERE = Path(__file__).parent
CONFIRMED = HERE.parent / "soft" / "confirmed"
MODEL = "angle_of_repose"
NAMES = (ANGLE_OF_REPOSE, *RULES)


def read(folder: Path) -> pd.DataFrame:
    """Runs of a folder with kept heaps, with the angle by each rule in deg; those without a heap left out."""
    runs = pd.read_parquet(folder / "runs.parquet").set_index("run_id", drop=False)
    kept = pd.read_parquet(folder / "heaps.parquet")
    fixed = load_plan().fixed
    lines = []
    for run_id, beads in kept.groupby("run_id", sort=False):
        run = runs.loc[run_id]
        model = load_model(fixed, run["fidelity"], run["variant"])
        if run["outcome"] != "ok":
            continue
        if run["model_hash"] != model.hash:
            raise SystemExit(f"{folder}: made by another version of the model; make it again")
        centres = beads[["x", "y", "z"]].to_numpy(float)
        measured = measure_heap(
            centres,
            model.particle_diameter,
            pixels_per_mm=model.pixels_per_mm,
            sphere_diameter=model.sphere_diameter,
        )
        found = angles(tuple(RULES), centres, model.particle_diameter, measured)
        lines.append(run.to_dict() | {ANGLE_OF_REPOSE: measured.angle_of_repose_deg} | found)
    return pd.DataFrame(lines)


def noise(runs: pd.DataFrame) -> pd.DataFrame:
    """Mean, deviation and number of runs at each fidelity and point (rules.csv)."""
    lines = []
    for (fidelity, variant, label, model_hash), point in runs.groupby(
        ["fidelity", "variant", "label", "model_hash"], sort=False
    ):
        line = {"fidelity": fidelity, "variant": variant, "label": label, "model_hash": model_hash}
        line["n"] = len(point)
        for name in RULES:
            line |= {name: round(point[name].mean(), 4), f"{name}_sd": round(point[name].std(ddof=1), 5)}
        lines.append(line)
    return pd.DataFrame(lines)


def worth(runs: pd.DataFrame) -> list[list[str]]:
    """By fidelity and rule: pooled deviation, range of the means, and how many runs of Appendix A one is."""
    rows = []
    for fidelity, there in runs.groupby("fidelity", sort=False):
        points = there.groupby("label")
        if len(points) < 2:
            continue
        signals = {name: np.ptp(points[name].mean()) for name in NAMES}
        deviations = {name: np.sqrt((points[name].var(ddof=1)).mean()) for name in NAMES}
        base = deviations[ANGLE_OF_REPOSE] / signals[ANGLE_OF_REPOSE]
        for name in NAMES:
            fewer = (base / (deviations[name] / signals[name])) ** 2
            cells = [f"{deviations[name]:.2f}", f"{signals[name]:.1f}", f"{fewer:.1f}"]
            rows.append([f"`{fidelity}`", f"`{name}`", str(len(there)), *cells])
    return rows


def bias(runs: pd.DataFrame) -> list[list[str]]:
    """How each rule differs from Appendix A over the box: mean, deviation, and a line on the angle."""
    points = runs.groupby(["fidelity", "label"])[list(NAMES)].mean()
    by = points[ANGLE_OF_REPOSE].to_numpy()
    rows = []
    for name in RULES:
        difference = points[name].to_numpy() - by
        slope, offset = np.polyfit(by - 25.0, difference, 1)
        rest = np.std(difference - offset - slope * (by - 25.0), ddof=2)
        cells = [f"{difference.mean():+.2f}", f"{difference.std(ddof=1):.2f}"]
        cells += [f"{offset:+.2f} {slope:+.3f} (angle - 25)", f"{rest:.2f}"]
        rows.append([f"`{name}`", str(len(points)), f"{by.min():.1f} to {by.max():.1f}", *cells])
    return rows


def table(columns: list[str], rows: list[list[str]]) -> str:
    """Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [columns, ["---"] * len(columns), *rows])


def main() -> None:
    """Print the tables, and write rules.csv if that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", nargs="?", choices=("write",))
    a = parser.parse_args()
    of_seeds, of_box = read(HERE / "noise"), read(CONFIRMED)
    if a.work:
        noise(of_seeds).to_csv(SHIPPED / MODEL / RULES_FILE, index=False, lineterminator="\n")
    columns = ["fidelity", "response", "runs", "sd from seed to seed, deg", "range of the means, deg"]
    print(table([*columns, "one run is worth"], worth(of_seeds)))
    columns = ["response", "points", "by Appendix A, deg", "less Appendix A, deg", "sd of the points"]
    print("\n" + table([*columns, "line, deg", "sd about it"], bias(of_box)))


if __name__ == "__main__":
    main()
