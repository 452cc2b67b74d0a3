"""Figure 5 (section 3.4): effect of the weight WRL on time-step, angle of repose and bulk density."""

from __future__ import annotations

from matplotlib.figure import Figure

from calstudy.analysis.figures.boxes import COLOURS, boxes, nothing, sheet, target_line, under
from calstudy.analysis.labels import PICTURE_UNITS, axis
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.records import RAYLEIGH_TIME_STEP
from calstudy.study.reading import Study

TITLE = "Figure 5: effect of WRL on the Rayleigh time-step, the angle of repose and the bulk density"


def figure5(study: Study) -> Figure:
    """Responses at the DEM optima, with a box for each WRL."""
    return by_factor(study, "WRL", (RAYLEIGH_TIME_STEP, ANGLE_OF_REPOSE, BULK_DENSITY))


def by_factor(study: Study, factor: str, responses: tuple[str, ...]) -> Figure:
    """One panel for each response, with a box for each level of the factor (Figures 5 and 7)."""
    if study.ok.empty:
        return nothing("no row is finished")
    figure, panels = sheet(len(responses))
    targets = study.settings.target
    for axes, response in zip(panels, responses, strict=True):
        values = study.ok[f"dem_{response}"] * PICTURE_UNITS[response][1]
        levels = sorted({getattr(row, factor) for row in study.plan.rows})
        boxes(axes, {f"{level:g}": values[study.ok[factor] == level] for level in levels}, COLOURS)
        axes.set(ylabel=axis(response), xlabel=factor)
        if response in targets.values:
            target_line(axes, targets.values[response], targets.kind)
    return under(figure, study)


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return ["At the DEM optima; tests are in the table of effects.", study.provenance()]
