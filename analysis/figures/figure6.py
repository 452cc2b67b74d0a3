"""Figure 6 (section 3.5): DEM runs of the second optimisation, and in all, over the samples per parameter."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from calstudy.analysis.figures.boxes import COLOURS, box, finish, nothing, sheet, under
from calstudy.study.reading import Study

TITLE = "Figure 6: DEM runs of the second optimisation (left) and in all (right) over SPP, for each WRL"
PANELS = {"runs_optimisation": "DEM runs, second optimisation", "runs_total": "DEM runs in all"}


def figure6(study: Study) -> Figure:
    """A box for each SPP and WRL."""
    if study.ok.empty:
        return nothing("no row is finished")
    figure, panels = sheet(len(PANELS), width=4.8)
    samples = sorted({row.SPP for row in study.plan.rows})
    weights = sorted({row.WRL for row in study.plan.rows})
    for axes, (count, label) in zip(panels, PANELS.items(), strict=True):
        for k, spp in enumerate(samples):
            for j, weight in enumerate(weights):
                chosen = (study.ok["SPP"] == spp) & (study.ok["WRL"] == weight)
                box(axes, k + 0.27 * (j - 1), study.ok[count][chosen], COLOURS[j], width=0.22)
        totals = [f"{spp}\nn = {(study.ok['SPP'] == spp).sum()}" for spp in samples]
        axes.set_xticks(range(len(samples)), totals)
        axes.set(xlim=(-0.6, len(samples) - 0.4), xlabel="SPP", ylabel=label)
        axes.set_ylim(bottom=0)
        finish(axes)
    marks = [Patch(facecolor=c, edgecolor="black", alpha=0.55) for c in COLOURS]
    names = [f"WRL = {w:g}" for w in weights]
    figure.legend(marks, names, loc="outside upper center", ncols=3, frameon=False)
    return under(figure, study)


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return [
        "Within each SPP from left to right WRL = 0, 0.5, 1. Runs in all are samples plus runs of the second "
        "optimisation. Fewer than five values are drawn as points without a box.",
        study.provenance(),
    ]
