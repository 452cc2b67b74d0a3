"""Heaps at `soft` whose positions are kept, measured by other rules than Appendix A's.

    python reports/readings/rules.py

Writes rules.parquet, of the runs of reports/soft/confirmed and reports/angle_of_repose/noise, and circle.csv,
of the heaps on the wide plate (wide/): the circle of equal area read in two other ways.
"""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from calstudy.models.measurement import MID_GREY, Mask, equal_area_radius, measure_heap
from calstudy.models.photograph.rules import angles
from calstudy.models.silhouette import top_view
from calstudy.parameters import Array

HERE = Path(__file__).parent
REPORTS = HERE.parent
KEPT = (REPORTS / "soft" / "confirmed", REPORTS / "angle_of_repose" / "noise")
DIAMETER = 0.005
"""Of a bead, in m."""
OF_CALSTUDY = ("angle_of_repose_top30_deg", "angle_of_repose_flank_deg")
COLUMNS = ("top30", "flank", "cone")
CORNERS, EDGES = 8, 4
"""Neighbours of a pixel: those that it touches by a corner, and those by an edge."""


def cone(centres: Array) -> float:
    """Slope in degrees of the line through top and distance of the beads that lie on the surface.

    ``centres`` (n, 3) in m. On the surface lies a bead above the bottom layer (top more than a diameter up)
    with no higher centre within a diameter in plan; the distance is from the centroid of all beads.
    """
    plan, z = centres[:, :2], centres[:, 2]
    near = cKDTree(plan).query_ball_point(plan, DIAMETER)
    surface = np.array([z[others].max() <= z[k] for k, others in enumerate(near)])
    surface &= z + DIAMETER / 2 > DIAMETER
    distance = np.hypot(*(plan[surface] - plan.mean(axis=0)).T)
    return math.degrees(math.atan(-np.polyfit(distance, z[surface], 1)[0]))


def measured(folder: Path) -> pd.DataFrame:
    """Runs of a folder at `soft` on `ring` whose positions are kept, with the angles in deg by each rule."""
    runs = pd.read_parquet(folder / "runs.parquet")
    runs = runs[(runs["fidelity"] == "soft") & (runs["variant"] == "ring")].set_index("run_id", drop=False)
    heaps = pd.read_parquet(folder / "heaps.parquet")
    lines = []
    for run_id, beads in heaps[heaps["run_id"].isin(runs.index)].groupby("run_id", sort=False):
        centres = beads[["x", "y", "z"]].to_numpy(float)
        found = angles(OF_CALSTUDY, centres, DIAMETER, measure_heap(centres, DIAMETER))
        values = (*found.values(), cone(centres))
        lines.append(runs.loc[run_id].to_dict() | dict(zip(COLUMNS, values, strict=True)))
    return pd.DataFrame(lines)


def from_above(centres: Array, neighbours: int) -> Mask:
    """Pixels of the heap on its top view, the largest object of all, the reference sphere among them."""
    black = (top_view(centres, DIAMETER / 2) < MID_GREY).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(black, connectivity=neighbours)
    return np.asarray(labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA]))


def inside(heap: Mask) -> Mask:
    """What the first round of steps 4 and 5 leaves: pixels within the circle of equal area."""
    row, column = np.nonzero(heap)
    near = np.hypot(row - row.mean(), column - column.mean()) <= math.sqrt(len(row) / math.pi)
    left = np.zeros_like(heap)
    left[row[near], column[near]] = True
    return left


def circle(folder: Path) -> pd.DataFrame:
    """Angle in deg of each kept heap of a sweep: by Appendix A, with edges alone, with a third round."""
    runs = pd.read_parquet(folder / "runs.parquet").set_index("run_id")
    heaps = pd.read_parquet(folder / "heaps.parquet")
    lines = []
    for run_id, beads in heaps.groupby("run_id", sort=False):
        centres = beads[["x", "y", "z"]].to_numpy(float)
        measured, heap = measure_heap(centres, DIAMETER), from_above(centres, CORNERS)
        ratios = {
            name: equal_area_radius(mask) / equal_area_radius(heap)
            for name, mask in (("edges", from_above(centres, EDGES)), ("third", inside(heap)))
        }
        by = {k: math.degrees(math.atan(measured.height / measured.radius / r)) for k, r in ratios.items()}
        lines.append({"label": runs.loc[run_id, "label"], "appendix_a": measured.angle_of_repose_deg} | by)
    return pd.DataFrame(lines)


if __name__ == "__main__":
    table = pd.concat([measured(folder) for folder in KEPT], ignore_index=True)
    table.to_parquet(HERE / "rules.parquet", index=False)
    print(table.groupby("label")[["angle_of_repose_deg", *COLUMNS]].mean().describe().round(2).to_string())
    rounds = circle(HERE / "wide")
    rounds.to_csv(HERE / "circle.csv", index=False, float_format="%.4f", lineterminator="\n")
    print(rounds.to_string(index=False))
