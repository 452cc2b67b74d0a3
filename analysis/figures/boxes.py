"""Boxplots as in the paper's Figures 3 to 7: large black outliers, small grey values."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cbook import boxplot_stats
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from calstudy.study.reading import Study

# Okabe and Ito's colours. Place and label distinguish the levels, too.
COLOURS = ("#56B4E9", "#E69F00", "#009E73")
TARGET = "#D55E00"
LEAST_FOR_A_BOX = 5
"""With fewer values a box of five numbers would claim more than they say. Only points are drawn."""
DOT: Mapping[str, Any] = {"ls": "", "marker": "o", "mec": "white", "zorder": 3}
VALUE: Mapping[str, Any] = {**DOT, "ms": 3.2, "mfc": "#6E6E6E", "mew": 0.3}
OUTLIER: Mapping[str, Any] = {**DOT, "ms": 5.0, "mfc": "black", "mew": 0.6}
"""Large enough to stand out, and with a white edge, so that neighbours do not merge into a blob."""


def sheet(panels: int, width: float = 3.4, height: float = 4.0) -> tuple[Figure, Sequence[Axes]]:
    """Figure with panels side by side."""
    figure = Figure(figsize=(max(width * panels, 6.0), height), layout="constrained")
    return figure, list(np.ravel(figure.subplots(1, panels, squeeze=False)))


def box(axes: Axes, place: float, values: ArrayLike, colour: str = "white", width: float = 0.6) -> None:
    """Draw a box with Tukey's whiskers, and each of its values (n,) once, spread over its width."""
    x = np.asarray(values, float)
    x = np.sort(x[np.isfinite(x)])
    # The golden ratio spreads neighbouring values over the width, always in the same way.
    beside = place + 0.7 * width * ((0.5 + 0.6180339887 * np.arange(len(x))) % 1.0 - 0.5)
    if len(x) < LEAST_FOR_A_BOX:
        fill = VALUE["mfc"] if colour == "white" else colour
        axes.plot(beside, x, **{**OUTLIER, "mfc": fill, "mec": "black"})
        return
    (drawn,) = boxplot_stats(x)
    axes.bxp(
        [drawn],
        positions=[place],
        widths=width,
        patch_artist=True,
        manage_ticks=False,
        showfliers=False,
        medianprops={"color": "black", "linewidth": 1.6},
        boxprops={"facecolor": colour, "alpha": 0.55},
    )
    out = (x < drawn["whislo"]) | (x > drawn["whishi"])
    axes.plot(beside[~out], x[~out], **VALUE)
    if out.any():
        axes.plot(beside[out], x[out], **OUTLIER)


def boxes(axes: Axes, groups: Mapping[str, ArrayLike], colours: Sequence[str] = ("white",)) -> None:
    """Draw boxes side by side, each labelled with its group and n."""
    for k, values in enumerate(groups.values()):
        box(axes, k, values, colours[k % len(colours)])
    names = [f"{name}\nn = {np.isfinite(np.asarray(v, float)).sum()}" for name, v in groups.items()]
    axes.set_xticks(range(len(groups)), names)
    axes.set_xlim(-0.6, len(groups) - 0.4)
    finish(axes)


def finish(axes: Axes) -> None:
    """Draw light horizontal lines, and remove the frame at the top and right."""
    axes.grid(axis="y", color="#DDDDDD", lw=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def target_line(axes: Axes, value: float, kind: str) -> None:
    """Draw the target."""
    axes.axhline(value, color=TARGET, lw=1.2, ls="--", label=f"target ({kind})", zorder=1)
    label_above(axes)


def label_above(axes: Axes) -> None:
    """Put the legend above the panel, where it hides no point."""
    axes.legend(fontsize=8, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)


def under(figure: Figure, study: Study) -> Figure:
    """Write n, fidelity, engine and what was left out under the panels."""
    width = int(15 * figure.get_figwidth())
    figure.supxlabel(_wrapped(study, width), fontsize=7.5)
    return figure


def _wrapped(study: Study, width: int) -> str:
    lines = textwrap.wrap(study.provenance(), width)
    return "\n".join(lines[:4]) + (" …" if len(lines) > 4 else "")


def nothing(reason: str) -> Figure:
    """An empty figure with the reason."""
    figure = Figure(figsize=(6.0, 1.2))
    figure.text(0.5, 0.5, f"Nothing to draw: {reason}", ha="center", va="center")
    return figure
