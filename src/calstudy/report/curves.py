"""Picture of measured curves beside those of the DEM runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from calstudy.analysis.exhibit import Picture, render
from calstudy.study.definition.curves import MeasuredCurve
from calstudy.study.reading import Result

NOTE = "Kriging models scores of the sampled curves' principal components. Each curve weighs as one response."


def curve_pictures(result: Result) -> list[Picture]:
    """The measured curves beside those of the DEM runs; nothing where no curve is a target."""
    curves = result.definition.curves
    if not curves:
        return []
    drawn = curves_figure(curves, result.evaluations, str(result.line["dem_run_id"]).split("+"))
    return [Picture("curves", "Measured curves", render(drawn, ["svg"]), [NOTE])]


def singly_targeted(result: Result) -> dict[str, str]:
    """Responses with a target of their own, with their units."""
    points = {point for curve in result.definition.curves for point in curve.points}
    targeted = result.settings.quantities.targeted
    return {name: unit for name, unit in targeted.items() if name not in points}


def curves_figure(curves: Sequence[MeasuredCurve], runs: pd.DataFrame, best: Sequence[str]) -> Figure:
    """Each measured curve with its errors, the curves of all ``runs``, and that of the optimum.

    ``best`` are the identities of the optimum's runs.
    """
    figure = Figure(figsize=(9, 4.2 * len(curves)), layout="constrained")
    for axes, curve in zip(figure.subplots(len(curves), 1, squeeze=False)[:, 0], curves, strict=True):
        there = runs[["run_id", *curve.points]].dropna()
        for k, (_, run) in enumerate(there.iterrows()):
            label = "DEM runs" if k == 0 else None
            axes.plot(curve.x, run[[*curve.points]], color="#bbbbbb", lw=0.8, label=label)
        optimum = there[there["run_id"].isin(best)][[*curve.points]].to_numpy(float)
        if len(optimum):
            axes.plot(curve.x, optimum[-1], color="#0072B2", lw=2, label="DEM optimum")
        error = np.array(curve.sd) if curve.sd else None
        axes.errorbar(curve.x, curve.y, yerr=error, color="black", ls="", marker="o", ms=4, label=curve.file)
        axes.set_xlabel(f"{curve.of.abscissa}, {curve.of.abscissa_unit}".removesuffix(", -"))
        axes.set_ylabel(f"{curve.name}, {curve.of.unit}".removesuffix(", -"))
        axes.legend()
    return figure
