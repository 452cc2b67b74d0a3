"""Figure 4 (section 3.1): where in its interval each calibrated parameter ended.

As the paper draws it: outliers are large black dots, small grey dots the values.
"""

from __future__ import annotations

from matplotlib.figure import Figure

from calstudy.analysis.figures.boxes import boxes, nothing, sheet, under
from calstudy.study.reading import Study

TITLE = "Figure 4: calibrated parameters at the DEM optima"
BOUND = "#0072B2"


def figure4(study: Study) -> Figure:
    """One boxplot for each parameter, of the rows that calibrated it, on an axis as wide as its interval."""
    if study.ok.empty:
        return nothing("no row is finished")
    parameters = study.plan.parameters
    figure, panels = sheet(len(parameters), width=1.75, height=4.2)
    for axes, p in zip(panels, parameters, strict=True):
        scale, unit = (1e-8, "10⁸ Pa") if p.unit == "Pa" else (1.0, p.unit.replace("m3", "m³"))
        boxes(axes, {p.name: scale * study.where_calibrated(p.name)[f"dem_{p.name}"]})
        margin = 0.05 * (p.upper - p.lower)
        axes.set_ylim(scale * (p.lower - margin), scale * (p.upper + margin))
        for bound in (p.lower, p.upper):
            axes.axhline(scale * bound, color=BOUND, lw=1, ls=":")
        axes.set_title("" if unit == "-" else unit, fontsize=9)
    return under(figure, study)


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return [
        "Outliers are large black dots, small grey dots the values; dotted blue: the interval (Table 2). n "
        "counts the rows that calibrated the parameter.",
        study.provenance(),
    ]
