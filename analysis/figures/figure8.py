"""Figure 8 (Appendix A): side view of a heap, with the angle of repose as Appendix A measures it."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.patches import Arc

from calstudy.analysis.figures.boxes import nothing
from calstudy.analysis.figures.heap import EXEMPLARY, MEASURE, NO_HEAP, exemplary_row, heap_of, silhouette
from calstudy.study.reading import Study

TITLE = "Figure 8: side view of a heap with the angle of repose α"


def figure8(study: Study, row: int | None = None) -> Figure:
    """Draw the heap of ``row``, by default that of `exemplary_row`."""
    row = exemplary_row(study) if row is None else row
    if row is None:
        return nothing(NO_HEAP)
    heap = heap_of(study, row)
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    axes = figure.subplots()
    silhouette(axes, heap.beads[:, [0, 2]], heap.diameter)
    x, z = heap.triangle
    axes.plot(x, z, color=MEASURE, lw=2)
    foot, span = (x[0], z[0]), 0.55 * heap.radius
    axes.add_patch(Arc(foot, 2 * span, 2 * span, theta1=0, theta2=heap.angle, color=MEASURE, lw=2))
    axes.annotate(
        f"α = {heap.angle:.1f} deg",
        (foot[0] + 0.97 * span, foot[1] + 0.12 * span),
        (x[0] - 0.02 * heap.radius, z[1] + 0.25 * heap.height),
        color=MEASURE,
        fontsize=13,
        ha="left",
        arrowprops={"arrowstyle": "-", "color": MEASURE},
    )
    axes.set(xlabel="x in mm", ylabel="z in mm")
    axes.set_ylim(top=max(axes.get_ylim()[1], z[1] + 0.6 * heap.height))
    figure.suptitle(heap.says, fontsize=11)
    return figure


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return [
        f"{EXEMPLARY} α = arctan(h / r) (Eq. A.1), which need not lie on the heap's flanks.",
        study.provenance(),
    ]
