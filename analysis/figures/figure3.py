"""Figure 3 (section 3.1): how far the calibrated responses are from the desired ones."""

from __future__ import annotations

from functools import partial

import numpy as np
from matplotlib.figure import Figure

from calstudy.analysis.figures.boxes import COLOURS, TARGET, boxes, label_above, nothing, sheet, under
from calstudy.analysis.fresh_runs import in_words
from calstudy.analysis.labels import LABELS, PICTURE_UNITS
from calstudy.analysis.published import BETWEEN_DECKS
from calstudy.models.heap import ANGLE_OF_REPOSE, MEASURED
from calstudy.study.reading import Study

TITLE = "Figure 3: absolute difference between desired and calibrated angle of repose and bulk density"
SHORT = ("AoR", "BD")
TOLERANCE = 0.15
"""The paper: at least 75 % of the rows lie within about 15 % of the desired angle."""


def figure3(study: Study) -> Figure:
    """Boxplots of the absolute differences at the DEM optima."""
    if study.ok.empty:
        return nothing("no row is finished")
    figure, panels = sheet(len(MEASURED))
    again = study.confirmed
    for axes, response, short in zip(panels, MEASURED, SHORT, strict=True):
        groups = {f"{short}\nas reported" if again is not None else short: study.deviation(response).abs()}
        if again is not None:
            groups[f"{short}\nrun again"] = (again[response] - study.settings.target.values[response]).abs()
        boxes(axes, groups, ("white", COLOURS[0]))
        axes.set_ylabel(f"|{LABELS[response]} - target| in {PICTURE_UNITS[response][0]}")
        axes.set_ylim(bottom=0)
        desired = study.settings.target.values[response]
        to_percent, from_percent = partial(np.multiply, 100 / desired), partial(np.multiply, desired / 100)
        percent = axes.secondary_yaxis("right", functions=(to_percent, from_percent))
        percent.set_ylabel("% of the target")
        if response == ANGLE_OF_REPOSE:
            limit = TOLERANCE * desired
            axes.axhline(limit, color=TARGET, lw=1.2, ls="--", label=f"{TOLERANCE:.0%} of the target")
            axes.set_ylim(top=max(axes.get_ylim()[1], 1.1 * limit))
            label_above(axes)
    return under(figure, study)


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    again = [] if study.confirmed is None else [in_words(study), "What is reported is the best of many runs."]
    said = ["At the DEM optima.", *again, "Box: quartiles; whiskers: 1.5 times the box."]
    return [" ".join(said), BETWEEN_DECKS, study.provenance()]
