"""Pictures of an advice: what each test leaves of each parameter, and which responses say the same."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calstudy.emulator.advice.advice import Advice

SHORT = {
    "angle_of_repose": "heap",
    "uniaxial_compression": "compression",
    "draw_down": "draw-down",
    "shear_cell": "shear cell",
    "rotating_drum": "drum",
}


def short(test: str) -> str:
    """What pictures call a test, or a pair of them."""
    return " + ".join(SHORT.get(name, name) for name in test.split(" + "))


def said(response: str) -> str:
    """What pictures call a response."""
    return response.removesuffix("_deg").replace("_", " ")


def draw_left(advice: Advice) -> Figure:
    """Shares of each parameter's standard deviation, and of the volume, that are left: a line each test or
    pair."""
    table = advice.tests_table()
    singles = advice.responses_table()
    lines = [short(name) for name in table["tests"]]
    lines += [f"{short(t)}: {said(r)}" for t, r in zip(singles["test"], singles["response"], strict=True)]
    names = list(advice.names)
    ways = [c for c in table if str(c).startswith("direction_")]
    columns = [f"left_{name}" for name in names] + ways
    values = np.vstack([table[columns].to_numpy(float), singles[columns].to_numpy(float)])
    figure = Figure(figsize=(3.4 + 0.75 * len(columns), 1.6 + 0.27 * len(lines)), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(values, cmap="viridis", vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), value in np.ndenumerate(values):
        axes.text(
            j,
            i,
            f"{value:.2f}",
            ha="center",
            va="center",
            fontsize=7,
            color="black" if value > 0.6 else "white",
        )
    axes.axhline(len(table) - 0.5, color="white", lw=3)
    axes.set_xticks(range(len(columns)), [*names, *(f"way {k + 1}" for k in range(len(ways)))], fontsize=8)
    axes.set_yticks(range(len(lines)), lines, fontsize=8)
    axes.xaxis.tick_top()
    figure.colorbar(image, label="share of the standard deviation that is left", shrink=0.6)
    return figure


def draw_overlap(advice: Advice) -> Figure:
    """How much two responses say the same, as a triangle of pairs; the diagonal has the nats of each
    alone."""
    singles, pairs = advice.responses_table(), advice.overlap()
    keys = list(zip(singles["test"], singles["response"], strict=True))
    place = {key: k for k, key in enumerate(keys)}
    n = len(keys)
    values = np.full((n, n), np.nan)
    for line in pairs.to_dict("records"):
        i, j = (place[line[t], line[r]] for t, r in (("test", "response"), ("other_test", "other_response")))
        values[max(i, j), min(i, j)] = line["overlap"]
    figure = Figure(figsize=(3.6 + 0.45 * n, 2.2 + 0.4 * n), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(values, cmap="cividis", vmin=0.0, vmax=1.0)
    for (i, j), value in np.ndenumerate(values):
        if i == j:
            axes.text(
                j, i, f"{singles['nats'].iloc[i]:.1f}", ha="center", va="center", fontsize=8, weight="bold"
            )
        elif not np.isnan(value):
            shade = "black" if value > 0.6 else "white"
            axes.text(
                j, i, f"{value:.2f}".lstrip("0") or "0", ha="center", va="center", fontsize=6, color=shade
            )
    labels = [f"{short(test)}: {said(response)}" for test, response in keys]
    axes.set_xticks(range(n), labels, fontsize=7, rotation=90)
    axes.set_yticks(range(n), labels, fontsize=7)
    for spine in axes.spines.values():
        spine.set_visible(False)
    figure.colorbar(image, label="overlap", shrink=0.5)
    return figure
