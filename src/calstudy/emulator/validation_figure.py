"""The figure of an emulator's validation."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calstudy.emulator.emulator import Emulator
from calstudy.emulator.validation import HALF_WIDTH

REFERENCE, CHEAP = "#D55E00", "#999999"


def validation_figure(emulator: Emulator, predicted: pd.DataFrame, fresh: pd.DataFrame | None) -> Figure:
    """Measured over predicted with 95 % intervals: runs left out of the fit, and fresh points where given."""
    columns = 1 if fresh is None else 2
    figure = Figure(figsize=(4.2 * columns, 7.6), layout="constrained")
    panels = figure.subplots(len(emulator.responses), columns, squeeze=False)
    units = {r.name: r.unit for r in emulator.similarity.responses if r.proportional_to is None}
    for row, response in zip(panels, emulator.responses, strict=True):
        unit = units.get(response.name)
        label = response.name.removesuffix(f"_{unit}").replace("_", " ") + (f" in {unit}" if unit else "")
        of = predicted[predicted["response"] == response.name]
        for fidelity, runs in of.groupby("fidelity", sort=False):
            name = f"{fidelity!s}: " if fidelity else ""
            is_reference = fidelity == emulator.origin.fidelity
            color = REFERENCE if is_reference else CHEAP
            _panel(row[0], runs, color, f"{name}{runs['inside'].sum()} of {len(runs)} inside")
        row[0].set_title("each run predicted without its point", fontsize=9)
        if fresh is not None:
            points = fresh[fresh["response"] == response.name]
            name = f"{emulator.origin.fidelity}: " if emulator.origin.fidelity else ""
            said = f"{name}{points['inside'].sum()} of {len(points)} inside"
            _panel(row[1], points, REFERENCE, said)
            row[1].set_title("fresh points, means over their seeds", fontsize=9)
        for axes in row:
            low, high = axes.get_xlim()
            axes.plot([low, high], [low, high], color="black", lw=0.8, zorder=0)
            axes.locator_params(nbins=6)
            axes.set_xlabel(f"predicted {label}")
            axes.set_ylabel(f"measured {label}")
            axes.legend(fontsize=8, loc="upper left", frameon=False)
    origin = emulator.origin
    figure.suptitle(
        f"emulator {emulator.version} of {origin.in_words}; bars: 95 % intervals",
        fontsize=9,
    )
    return figure


def _panel(axes: Axes, points: pd.DataFrame, color: str, label: str) -> None:
    axes.errorbar(
        points["predicted"],
        points["measured"],
        xerr=HALF_WIDTH * points["sd"],
        fmt="o",
        ms=3.5,
        color=color,
        ecolor=color,
        elinewidth=0.6,
        label=label,
    )
