"""Figure 9 (Appendix A): the heap of a row's DEM optimum, top (a) and side (b), and its measures."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calstudy.analysis.figures.boxes import nothing
from calstudy.analysis.figures.heap import (
    EXEMPLARY,
    MEASURE,
    NO_HEAP,
    HeapPicture,
    exemplary_row,
    heap_of,
    silhouette,
)
from calstudy.study.reading import Study

TITLE = "Figure 9: top view (a) and side view (b) of a heap"


def figure9(study: Study, row: int | None = None) -> Figure:
    """Draw the heap of ``row``, by default that of `exemplary_row`. Lengths in mm."""
    row = exemplary_row(study) if row is None else row
    return nothing(NO_HEAP) if row is None else draw(heap_of(study, row))


def draw(heap: HeapPicture) -> Figure:
    """Draw both views of a heap; the circle has the radius r_f, the triangle the height h_f.

    The triangle stands one particle diameter up, where Appendix A puts its foot.
    """
    figure = Figure(figsize=(9, 4.6))
    # Margins by hand: automatic layout takes as long as drawing, and every row has its pictures.
    margins = {"left": 0.08, "right": 0.98, "bottom": 0.12, "top": 0.84, "wspace": 0.16}
    top, side = figure.subplots(1, 2, gridspec_kw=margins)
    silhouette(top, heap.beads[:, :2], heap.diameter)
    angles = np.linspace(0, 2 * np.pi, 181)
    circle = heap.centre[:, None] + heap.radius * np.array([np.cos(angles), np.sin(angles)])
    top.plot(*circle, color=MEASURE, lw=2)
    top.set(title=f"(a) top: r = {heap.radius:.1f} mm", xlabel="x in mm", ylabel="y in mm")
    silhouette(side, heap.beads[:, [0, 2]], heap.diameter)
    side.plot(*heap.triangle, color=MEASURE, lw=2)
    side.set(title=f"(b) side: h = {heap.height:.1f} mm", xlabel="x in mm", ylabel="z in mm")
    figure.suptitle(heap.says, fontsize=11)
    return figure


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return [
        f"{EXEMPLARY} Circle and triangle: radius r and height h of Appendix A. The reference sphere beside "
        "the heap is left out.",
        study.provenance(),
    ]
