"""The solution space of a calibration: pairs of parameters that do as well, and each one's histogram."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calstudy.parameters import Array, Box

SHOWN = 800
"""Solutions that are drawn as points; more would be one black area."""


def pairs(points: Array, optimum: Array, box: Box) -> Figure:
    """Draw solutions (n, d) over the whole intervals, with the DEM optimum (d,)."""
    d = box.dimension
    figure = Figure(figsize=(max(5.0, 1.7 * d), max(4.5, 1.7 * d)), layout="constrained")
    grid: Any = figure.subplots(d, d, squeeze=False)
    shown = points[:: max(1, len(points) // SHOWN)]
    for i, j in np.ndindex(d, d):
        axes: Axes = grid[i, j]
        if j > i:
            axes.set_axis_off()
            continue
        axes.set_xlim(box.lower[j], box.upper[j])
        if i == j:
            axes.hist(points[:, j], bins=20, range=(box.lower[j], box.upper[j]), color="#56B4E9")
            axes.axvline(float(optimum[j]), color="#D55E00")
            axes.set_yticks([])
        else:
            axes.plot(shown[:, j], shown[:, i], ls="", marker=".", ms=2, color="#0072B2", alpha=0.5)
            axes.plot(optimum[j], optimum[i], ls="", marker="o", ms=9, mfc="none", mec="#D55E00", mew=2)
            axes.set_ylim(box.lower[i], box.upper[i])
        axes.locator_params(axis="x", nbins=3)
        axes.tick_params(labelsize=7, labelbottom=i == d - 1, labelleft=j == 0 and i != j)
        if i == d - 1:
            axes.set_xlabel(box.names[j], fontsize=9)
        if j == 0:
            axes.set_ylabel(box.names[i], fontsize=9)
    figure.suptitle(f"{len(points)} parameter sets that do as well; orange: DEM optimum", fontsize=10)
    return figure
