"""The beads of a heap as black discs, from the top or the side, for Figures 8 and 9."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection

from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.parameters import Array
from calstudy.study.reading import Study

MEASURE = "#D55E00"  # vermilion: told apart from black by every eye, and in grey


@dataclass(frozen=True)
class HeapPicture:
    """A heap with its measures by Appendix A. Lengths in mm."""

    beads: Array
    diameter: float
    radius: float
    height: float
    angle: float
    says: str

    @property
    def centre(self) -> Array:
        """Centre (2,) of the top view, in mm."""
        place: Array = self.beads[:, :2].mean(axis=0)
        return place

    @property
    def triangle(self) -> tuple[Array, Array]:
        """Appendix A's cone seen from the side: radius r_f, height h_f, one particle diameter up."""
        x = self.centre[0] + self.radius * np.array([-1, 0, 1, -1])
        return x, self.diameter + self.height * np.array([0, 1, 0, 0])


def exemplary_row(study: Study) -> int | None:
    """Row with the median angle of repose of the rows with a heap; None without any."""
    with_heap = study.ok[study.ok["row"].isin(study.heaps["row"])]
    if with_heap.empty:
        return None
    ordered = with_heap.sort_values([f"dem_{ANGLE_OF_REPOSE}", "row"])
    return int(ordered["row"].iloc[(len(ordered) - 1) // 2])


def heap_of(study: Study, row: int) -> HeapPicture:
    """The heap of a row that has one."""
    beads = study.heaps[study.heaps["row"] == row]
    runs = study.evaluations[study.evaluations["row"] == row]
    run = runs[runs["run_id"].isin(beads["run_id"])].iloc[0]
    return heap_of_run(run, beads, float(beads["particle_diameter"].iloc[0]), f"Row {row}")


def heap_of_run(run: pd.Series, beads: pd.DataFrame, particle_diameter: float, name: str) -> HeapPicture:
    """The heap of a stored run: its line, the lines of its beads, their diameter in m, what it is called."""
    return HeapPicture(
        beads=1e3 * beads[["x", "y", "z"]].to_numpy(float),
        diameter=1e3 * particle_diameter,
        radius=1e3 * run["heap_radius"],
        height=1e3 * run["heap_height"],
        angle=run[ANGLE_OF_REPOSE],
        says=f"{name}, {run['fidelity']} fidelity, {run['variant']}, {len(beads)} beads, {run['engine']}\n"
        f"angle of repose {run[ANGLE_OF_REPOSE]:.1f} deg, bulk density {run[BULK_DENSITY]:.0f} kg/m3",
    )


def discs(axes: Axes, centres: Array, diameter: float, face: str = "black", edge: str = "none") -> None:
    """Draw beads with centres (n, 2) as discs, in the units of the axes."""
    sizes = np.full(len(centres), diameter)
    axes.add_collection(
        EllipseCollection(
            sizes,
            sizes,
            np.zeros(len(centres)),
            units="xy",
            offsets=centres,
            transOffset=axes.transData,
            facecolor=face,
            edgecolor=edge,
            linewidth=0.5,
        )
    )


def silhouette(axes: Axes, centres: Array, diameter: float) -> None:
    """Draw a heap's beads in black, with the same scale on both axes."""
    discs(axes, centres, diameter)
    reach = np.abs(centres).max(axis=0) + diameter
    axes.set(xlim=(-reach[0], reach[0]), ylim=(min(0.0, centres[:, 1].min() - diameter), reach[1]))
    axes.set_aspect("equal")


NO_HEAP = "no finished row has a heap"
EXEMPLARY = (
    "The row whose angle of repose is the median of the study's; from the stored beads of its DEM optimum."
)
