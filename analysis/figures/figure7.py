"""Figure 7 (section 3.5): effect of the samples per parameter on the calibrated responses."""

from __future__ import annotations

from matplotlib.figure import Figure

from calstudy.analysis.figures.figure5 import by_factor, notes
from calstudy.models.heap import MEASURED
from calstudy.study.reading import Study

__all__ = ["TITLE", "figure7", "notes"]
TITLE = "Figure 7: effect of SPP on the angle of repose and the bulk density"


def figure7(study: Study) -> Figure:
    """Responses at the DEM optima, with a box for each SPP."""
    return by_factor(study, "SPP", MEASURED)
