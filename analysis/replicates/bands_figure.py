"""Figure of the bands: Tables 3 to 6 and the ledger over the replicates, with the published values."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from calstudy.analysis.figures.boxes import nothing
from calstudy.analysis.published import ROWS
from calstudy.analysis.replicates.bands import bands_of, notes_on, provenance, replicated
from calstudy.analysis.replicates.bands_claims import shares_of
from calstudy.analysis.replicates.entries import ALL_ROWS
from calstudy.analysis.statistics.estimates import ALPHA
from calstudy.study.reading import Study

TITLE = "Bands of the paper's numbers: the study many times, on draws of the emulator"
# Okabe and Ito's colours.
BAND, HALF, PUBLISHED = "#0072B2", "#56B4E9", "#D55E00"
SHARES = {"holds": "#009E73", "open": "#DDDDDD", "fails": "#E69F00"}
NAMES = {"holds": "holds", "open": "cannot be decided", "fails": "does not hold"}
POINTS = ("low", "median", "high", "published")
LEAST_P = 1e-17
"""Smaller p-values, the published 2.2e-16 among them, are drawn at the edge."""


def bands_figure(study: Study) -> Figure:
    """Medians with bands of Tables 3, 4 and 6, of Table 5's p-values, and the shares of the verdicts."""
    if study.replicated is None:
        return nothing("the study has no replicates")
    lines = replicated(study)
    sets = {study.planned: bands_of(lines[lines["rows"] == study.planned])}
    if sets[study.planned].empty or sets[study.planned]["median"].isna().all():
        return nothing("no number of Tables 3 to 6 exists in any replicate")
    if study.planned != ROWS and (lines["rows"] == ROWS).any():
        sets[ROWS] = bands_of(lines[lines["rows"] == ROWS])
    figure = Figure(figsize=(12.5, 9.5), layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=(6, 3, 6), width_ratios=(1, 1.1, 1.1))
    for k, where in enumerate(("Table 3", "Table 4", "Table 6")):
        axes = figure.add_subplot(grid[k, 0])
        draw_bands(axes, sets, where)
    draw_bands(figure.add_subplot(grid[:, 1]), sets, "Table 5")
    _shares(figure.add_subplot(grid[:, 2]), shares_of(lines[lines["rows"] == study.planned]))
    handles: list[Artist] = [
        Line2D([], [], color=colour, lw=width, label=f"{rows} rows: median, 5 to 95 %")
        for (rows, _), colour, width in zip(sets.items(), (BAND, HALF), (4, 2), strict=False)
    ]
    handles.append(Line2D([], [], color=PUBLISHED, marker="D", ls="", ms=4, label="published"))
    handles += [Patch(color=colour, label=NAMES[name]) for name, colour in SHARES.items()]
    handles.append(Line2D([], [], color="black", marker="|", ls="", label="values alone hold"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    figure.suptitle(f"{study.settings.engine}, {study.settings.fidelity} fidelity", fontsize=10)
    return figure


def draw_bands(axes: Axes, sets: dict[int, pd.DataFrame], where: str) -> None:
    """Bands of one table from one number of rows or two, its first entry on top.

    Published values stand beside them, and where there is a column ``value`` those of another study.
    Correlations over all rows are in the table alone.
    """
    for k, found in enumerate(sets.values()):
        of = found[(found["where"] == where) & ~found["entry"].str.endswith(ALL_ROWS.format(""))]
        y = np.arange(len(of))[::-1] - 0.28 * k
        least = LEAST_P if where == "Table 5" else None
        at = {name: of[name].clip(lower=least) for name in (*POINTS, "value") if name in of}
        low, median, high, published = (at[name] for name in POINTS)
        axes.hlines(y, low, high, color=(BAND, HALF)[k], lw=(4, 2)[k])
        axes.plot(median, y, "|", color="black", ms=8, zorder=3)
        if k == 0:
            axes.plot(published, y, "D", color=PUBLISHED, ms=4, zorder=4)
            if "value" in at:
                axes.plot(at["value"], y, "o", mfc="white", mec="black", ms=5, zorder=5)
            axes.set_yticks(y, of["entry"], fontsize=7)
            axes.set_ylim(-0.7, len(of) - 0.4)
    axes.set_title(where, fontsize=9)
    if where == "Table 5":
        axes.set(xscale="log", xlim=(0.1 * LEAST_P, 2.0), xlabel="p, sequential MANOVA")
        axes.axvline(ALPHA, color="black", lw=0.8, ls=":", zorder=0)
    else:
        axes.set(xlabel="correlation")
    if where == "Table 6":
        axes.set(xlim=(-1.0, 1.0))
        axes.axvline(0.0, color="black", lw=0.6, zorder=0)


def _shares(axes: Axes, shares: pd.DataFrame) -> None:
    y, left = np.arange(len(shares))[::-1], np.zeros(len(shares))
    for name, colour in SHARES.items():
        axes.barh(y, shares[name], left=left, color=colour, height=0.7)
        left += shares[name].to_numpy()
    axes.plot(shares["met"], y, "|", color="black", ms=11, mew=2)
    axes.set_yticks(y, shares.index, fontsize=7)
    axes.set(xlim=(0, 1), ylim=(-0.7, len(shares) - 0.4), xlabel="share of the replicates")
    axes.set_title("Ledger of claims", fontsize=9)


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return [
        f"p-values below {LEAST_P:g} are drawn at the edge; the dotted line is p = {ALPHA:g}. {notes_on()}",
        *([] if study.replicated is None else [provenance(study)]),
    ]
