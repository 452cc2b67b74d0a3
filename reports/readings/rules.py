"""Heaps at `soft` whose positions are kept, measured by other rules than Appendix A's: writes rules.parquet.

    python reports/readings/rules.py

The runs are those of reports/soft/confirmed and reports/angle_of_repose/noise.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from calstudy.models.measurement import measure_heap
from calstudy.models.photograph.rules import angles
from calstudy.parameters import Array

HERE = Path(__file__).parent
REPORTS = HERE.parent
KEPT = (REPORTS / "soft" / "confirmed", REPORTS / "angle_of_repose" / "noise")
DIAMETER = 0.005
"""Of a bead, in m."""
OF_CALSTUDY = ("angle_of_repose_top30_deg", "angle_of_repose_flank_deg")
COLUMNS = ("top30", "flank", "cone")


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


if __name__ == "__main__":
    table = pd.concat([measured(folder) for folder in KEPT], ignore_index=True)
    table.to_parquet(HERE / "rules.parquet", index=False)
    print(table.groupby("label")[["angle_of_repose_deg", *COLUMNS]].mean().describe().round(2).to_string())
