"""Figure of the rows that were calibrated on the DEM model among their replicates on the emulator."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from calstudy.analysis.labels import PICTURE_UNITS, axis
from calstudy.analysis.replicates.rows_beside import (
    SUM_OF_SQUARES,
    provenance,
    replicates_beside,
    rows_in_both,
)
from calstudy.analysis.statistics.estimates import LEVELS
from calstudy.plan import PARAMETERS
from calstudy.study.reading import Study

TITLE = "Rows calibrated on the DEM model, among their replicates on the emulator"
REPLICATE, BAND, DEM = "#56B4E9", "#0072B2", "#D55E00"
ACROSS = 5
"""Panels side by side."""


def rows_beside_figure(study: Study) -> Figure:
    """A panel for each quantity at the DEM optimum: all replicates, the band, and the DEM model's value."""
    here = rows_in_both(study)
    free = [p for p in PARAMETERS if here[f"calibrated_{p}"].any()]
    targets = study.settings.target.values
    names = {r: f"dem_{r}" for r in targets} | {SUM_OF_SQUARES: "dem_sum_of_squares"}
    names |= {"runs_optimisation": "runs_optimisation"} | {p: f"dem_{p}" for p in free}
    lines = math.ceil(len(names) / ACROSS)
    figure = Figure(figsize=(12.5, lines * (1.1 + 0.34 * max(len(here), 1))), layout="constrained")
    panels = dict(zip(names, figure.subplots(lines, ACROSS, squeeze=False).flat, strict=False))
    for name, axes in panels.items():
        _panel(axes, study, names[name], PICTURE_UNITS.get(name, ("", 1.0))[1])
        axes.set_title(axis(name), fontsize=8)
    for response, value in targets.items():
        panels[response].axvline(value, color="black", lw=0.8, ls=":")
    panels[SUM_OF_SQUARES].set_xscale("log")
    for axes in figure.axes[len(panels) :]:
        axes.set_axis_off()
    handles: list[Artist] = [
        Line2D([], [], color=REPLICATE, marker=".", ls="", label="a replicate on the emulator"),
        Line2D([], [], color=BAND, lw=2, label="5 to 95 %"),
        Line2D([], [], color=DEM, marker="D", ls="", ms=5, label="DEM model"),
        Line2D([], [], color="black", lw=0.8, ls=":", label="target"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    return figure


def _panel(axes: Axes, study: Study, column: str, factor: float) -> None:
    """One quantity, with a line for each row except those that hold the parameter constant."""
    here, replicates = rows_in_both(study), replicates_beside(study)
    calibrated = column.replace("dem_", "calibrated_")
    for y, row in enumerate(here.to_dict("records")):
        if not row.get(calibrated, True):
            continue
        there = replicates.loc[replicates["row"] == row["row"], column].to_numpy(float) * factor
        # Spread over the line's height in the order of the replicates, which is random.
        heights = y + 0.5 * (np.arange(len(there)) / max(len(there) - 1, 1) - 0.5)
        axes.plot(there, heights, ".", ms=2.5, color=REPLICATE)
        axes.hlines(y, *np.quantile(there, LEVELS), color=BAND, lw=2)
        axes.plot(row[column] * factor, y, "D", ms=5, color=DEM)
    axes.set_yticks(range(len(here)), [f"row {row}" for row in here["row"]], fontsize=7)
    axes.set_ylim(len(here) - 0.4, -0.6)
    axes.tick_params(labelsize=7)


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return provenance(study)
