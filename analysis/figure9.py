"""Figure 9: the heap of a row's DEM optimum, top (a) and side (b), with what Appendix A measures."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

MEASURE = "#D55E00"  # vermilion: told apart from black by every eye, and in grey


def figure9(evaluations: pd.DataFrame, heaps: pd.DataFrame, row: int) -> Figure:
    """Draw the heap of ``row`` from the tables of evaluations and heaps; lengths in mm.

    The circle has the radius r_f; the triangle has the height h_f and stands one particle diameter up,
    where Appendix A puts its foot.
    """
    heap = heaps[heaps["row"] == row]
    run = evaluations[(evaluations["row"] == row) & evaluations["run_id"].isin(heap["run_id"])].iloc[0]
    beads = 1e3 * heap[["x", "y", "z"]].to_numpy(float)
    diameter = 1e3 * float(heap["particle_diameter"].iloc[0])
    radius, height = 1e3 * run["heap_radius"], 1e3 * run["heap_height"]
    centre = beads[:, :2].mean(axis=0)

    figure = Figure(figsize=(9, 4.6), layout="constrained")
    top, side = figure.subplots(1, 2)
    _discs(top, beads[:, :2], diameter)
    angles = np.linspace(0, 2 * np.pi, 181)
    top.plot(centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles), color=MEASURE, lw=2)
    top.set(title=f"(a) top: r = {radius:.1f} mm", xlabel="x in mm", ylabel="y in mm")
    _discs(side, beads[:, [0, 2]], diameter)
    foot = diameter
    side.plot(
        centre[0] + radius * np.array([-1, 0, 1, -1]),
        foot + height * np.array([0, 1, 0, 0]),
        color=MEASURE,
        lw=2,
    )
    side.set(title=f"(b) side: h = {height:.1f} mm", xlabel="x in mm", ylabel="z in mm")
    figure.suptitle(
        f"Row {row}, {run['fidelity']} fidelity, {run['variant']}, {len(beads)} beads, {run['engine']}\n"
        f"angle of repose {run['angle_of_repose_deg']:.1f} deg, bulk density {run['bulk_density']:.0f} kg/m3",
        fontsize=11,
    )
    return figure


def _discs(axes: Axes, centres: np.ndarray, diameter: float) -> None:
    sizes = np.full(len(centres), diameter)
    discs = EllipseCollection(
        sizes,
        sizes,
        np.zeros(len(centres)),
        units="xy",
        offsets=centres,
        transOffset=axes.transData,
        facecolor="black",
    )
    axes.add_collection(discs)
    reach = np.abs(centres).max(axis=0) + diameter
    axes.set(xlim=(-reach[0], reach[0]), ylim=(min(0.0, centres[:, 1].min() - diameter), reach[1]))
    axes.set_aspect("equal")
