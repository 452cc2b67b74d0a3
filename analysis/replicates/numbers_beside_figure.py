"""Figure of the paper's numbers from rows on the DEM model, among those of the same rows on its emulator."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from calstudy.analysis.replicates.bands_figure import BAND, LEAST_P, PUBLISHED, draw_bands
from calstudy.analysis.replicates.numbers_beside import TITLE as TITLE
from calstudy.analysis.replicates.numbers_beside import common_rows, numbers_beside
from calstudy.analysis.replicates.numbers_beside import notes as notes_on_table
from calstudy.analysis.statistics.estimates import ALPHA
from calstudy.study.reading import Study


def numbers_beside_figure(study: Study) -> Figure:
    """Bands of Tables 3 to 6 over the replicates, with what the DEM model gave and the published values."""
    found = {study.planned: numbers_beside(study)}
    figure = Figure(figsize=(9.0, 9.0), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(6, 3, 6), width_ratios=(1, 1.1))
    for k, where in enumerate(("Table 3", "Table 4", "Table 6")):
        draw_bands(figure.add_subplot(grid[k, 0]), found, where)
    draw_bands(figure.add_subplot(grid[:, 1]), found, "Table 5")
    handles = [
        Line2D([], [], color=BAND, lw=4, label="replicates on the emulator: 5 to 95 %"),
        Line2D([], [], color="black", marker="|", ls="", ms=8, label="their median"),
        Line2D([], [], color="black", marker="o", mfc="white", ls="", ms=5, label="DEM model"),
        Line2D([], [], color=PUBLISHED, marker="D", ls="", ms=4, label="published"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    rows = len(common_rows(study))
    figure.suptitle(
        f"{rows} of the plan's {study.planned} rows, {study.settings.fidelity} fidelity", fontsize=10
    )
    return figure


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    edge = f"p-values below {LEAST_P:g} are drawn at the edge; the dotted line is p = {ALPHA:g}."
    return [edge, *notes_on_table(study)]
