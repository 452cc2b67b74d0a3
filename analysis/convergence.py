"""A row's DEM runs in their order: both measured responses against their targets, phase by phase."""

from __future__ import annotations

from matplotlib.figure import Figure

from calstudy.records import MEASURED, UNITS, Phase
from calstudy.study import Study

# Okabe and Ito's colours, and a marker each, so that neither eye nor printer needs the colour.
MARKS = {
    Phase.SAMPLING: ("#999999", "o", "sampling"),
    Phase.START: ("#D55E00", "D", "Kriging optimum"),
    Phase.JACOBIAN: ("#56B4E9", "s", "Jacobian"),
    Phase.TRIAL: ("#0072B2", "^", "trial"),
}


def convergence(study: Study, row: int) -> Figure:
    """Draw the runs of ``row``."""
    of_row = study.evaluations["row"] == row
    runs = study.evaluations.loc[of_row, ["run_id", "phase", *MEASURED]].reset_index(drop=True)
    result = study.calibrations[study.calibrations["row"] == row].iloc[0]
    figure = Figure(figsize=(9, 5))
    # Margins by hand: laying a figure out takes as long as drawing it, and every row has its pictures.
    margins = {"left": 0.1, "right": 0.98, "bottom": 0.1, "top": 0.85, "hspace": 0.08}
    panels = figure.subplots(len(MEASURED), 1, sharex=True, gridspec_kw=margins)
    for axes, name in zip(panels, MEASURED, strict=True):
        target = result[f"target_{name}"]
        axes.axhline(target, color="black", lw=1, ls="--", label=f"target ({result['target_kind']})")
        for phase, (colour, marker, label) in MARKS.items():
            chosen = runs[runs["phase"] == phase]
            axes.plot(chosen.index + 1, chosen[name], ls="", color=colour, marker=marker, label=label)
        best = runs[(runs["run_id"] == result["dem_run_id"]) & (runs["phase"] != Phase.SAMPLING)]
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
        axes.set_ylabel(f"{name.removesuffix('_deg').replace('_', ' ')}\nin {UNITS[name]}")
    panels[0].legend(loc="upper center", bbox_to_anchor=(0.5, 1.18), ncols=6, fontsize=8, frameon=False)
    panels[-1].set_xlabel("DEM run, phase by phase")
    figure.suptitle(f"Row {row}: {len(runs)} DEM runs at {result['fidelity']} fidelity", fontsize=11)
    return figure
