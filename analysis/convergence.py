"""A row's DEM runs in their order: its responses against their targets, phase by phase."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from calstudy.records import Phase

# Okabe and Ito's colours, and a marker each, so that neither eye nor printer needs the colour.
MARKS = {
    Phase.SAMPLING: ("#999999", "o", "sampling"),
    Phase.START: ("#D55E00", "D", "Kriging optimum"),
    Phase.JACOBIAN: ("#56B4E9", "s", "Jacobian"),
    Phase.TRIAL: ("#0072B2", "^", "trial"),
}


def convergence(
    runs: pd.DataFrame, result: Mapping[str, Any], units: Mapping[str, str], title: str
) -> Figure:
    """Draw one row's ``runs``; ``result`` is its line of calibrations, ``units`` names its targets."""
    runs = runs[["run_id", "phase", *units]].reset_index(drop=True)
    height = max(5.0, 1.0 + 2.0 * len(units))
    figure = Figure(figsize=(9, height))
    # Margins by hand: laying a figure out takes as long as drawing it, and every row has its pictures.
    margins = {"left": 0.1, "right": 0.98, "bottom": 0.5 / height, "top": 1.0 - 0.75 / height, "hspace": 0.08}
    panels = figure.subplots(len(units), 1, sharex=True, squeeze=False, gridspec_kw=margins)[:, 0]
    best_ids = str(result["dem_run_id"]).split("+")
    for axes, (name, unit) in zip(panels, units.items(), strict=True):
        target = result[f"target_{name}"]
        axes.axhline(target, color="black", lw=1, ls="--", label=f"target ({result['target_kind']})")
        for phase, (colour, marker, label) in MARKS.items():
            chosen = runs[runs["phase"] == phase]
            axes.plot(chosen.index + 1, chosen[name], ls="", color=colour, marker=marker, label=label)
        best = runs[runs["run_id"].isin(best_ids) & (runs["phase"] != Phase.SAMPLING)]
        axes.plot(
            best.index + 1,
            best[name],
            ls="",
            marker="o",
            ms=14,
            mfc="none",
            mec="#D55E00",
            label="DEM optimum",
        )
        axes.set_ylabel(f"{name.removesuffix('_deg').replace('_', ' ')}\nin {unit}")
    panels[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=6, fontsize=8, frameon=False)
    panels[-1].set_xlabel("DEM run, phase by phase")
    figure.suptitle(title, fontsize=11)
    return figure
