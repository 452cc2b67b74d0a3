"""Figure 1 (section 2.2): the simulated test, as a section through its axis.

Our own drawing, from the numbers of the LIGGGHTS model and the plan. Left: filled; right: cylinder raised.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Rectangle

from calstudy.analysis.figures.heap import MEASURE, discs
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE
from calstudy.parameters import Array
from calstudy.study.reading import Study

TITLE = "Figure 1: the simulated test that gives bulk density and angle of repose"
WALL, BEAD, BEAD_EDGE = "#444444", "#9CC9E3", "#33627F"


def figure1(study: Study) -> Figure:
    """Section through cylinder, ring, plate and beads at ``full`` fidelity, before and after lifting."""
    model = load_model(study.plan.fixed, "full")
    radius = 1e3 * model.geometry["cylinder_diameter"] / 2
    fill, ring = 1e3 * model.geometry["fill_height"], 1e3 * model.fidelity.ring_height
    bead, angle = 1e3 * model.fidelity.particle_diameter, study.plan.targets[ANGLE_OF_REPOSE]
    top = 0.72 * 1e3 * model.geometry["cylinder_top"]
    figure = Figure(figsize=(9, 4.4), layout="constrained")
    filled, raised = figure.subplots(1, 2, sharey=True)

    _bench(filled, radius, ring)
    discs(filled, _packed(radius, bead, lambda x: fill), bead, BEAD, BEAD_EDGE)
    _cylinder(filled, radius, ring, top)
    _length(filled, (-radius, top + 8), (radius, top + 8), f"inner diameter {2 * radius:g}")
    _length(filled, (radius + 12, 0), (radius + 12, fill), f"filled to {fill:g}")
    filled.annotate(
        f"ring {ring:g} high",
        (-radius, ring / 2),
        (-radius - 28, 22),
        ha="center",
        arrowprops={"arrowstyle": "->"},
    )
    filled.set_title("(a) poured, levelled, at rest: bulk density", fontsize=10)

    _bench(raised, radius, ring)
    height = radius * math.tan(math.radians(angle))
    heap = _packed(radius, bead, lambda x: bead + height * (1 - abs(x) / radius))
    discs(raised, heap, bead, BEAD, BEAD_EDGE)
    lift = height + 2.2 * bead
    _cylinder(raised, radius, lift, min(lift + 42, top))
    raised.annotate(
        "",
        (radius + 7, lift + 38),
        (radius + 7, lift + 6),
        arrowprops={"arrowstyle": "-|>", "lw": 1.6},
    )
    raised.text(radius + 10, lift + 22, f"{1e3 * model.schedule['lift_speed']:g} mm/s", va="center")
    raised.plot([-radius, 0, radius], [bead, bead + height, bead], color=MEASURE, lw=2)
    raised.plot([-radius, radius], [bead, bead], color=MEASURE, lw=1, ls="--")
    raised.add_patch(Arc((-radius, bead), 44, 44, theta1=0, theta2=angle, color=MEASURE, lw=2))
    raised.annotate(
        "α",
        (-radius + 21.5, bead + 4),
        (-radius - 8, bead + 24),
        color=MEASURE,
        fontsize=14,
        arrowprops={"arrowstyle": "-", "color": MEASURE},
    )
    raised.set_title("(b) cylinder raised, at rest: angle of repose α", fontsize=10)
    for axes in (filled, raised):
        axes.set(xlim=(-1.75 * radius, 1.75 * radius), ylim=(-10, top + 16), aspect="equal")
        axes.axis("off")
    return figure


def _packed(radius: float, diameter: float, surface: Callable[[float], float]) -> Array:
    """Centres (n, 2) of a hexagonal packing below a surface: an illustration, not a simulation."""
    centres = []
    rise = diameter * math.sqrt(3) / 2
    for layer in range(int(100 / rise)):
        z = diameter / 2 + layer * rise
        shift = (layer % 2) * diameter / 2
        x = np.arange(-radius + diameter / 2 + shift, radius - diameter / 2 + 1e-9, diameter)
        centres += [(place, z) for place in x if z + diameter / 2 <= surface(place)]
    return np.array(centres)


def _bench(axes: Axes, radius: float, ring: float) -> None:
    axes.add_patch(Rectangle((-radius - 3, -5), 2 * radius + 6, 5, color=WALL))
    axes.text(0, -9.5, "steel plate", ha="center", va="center", fontsize=9)
    for side in (-radius - 3, radius):
        axes.add_patch(Rectangle((side, 0), 3, ring, color=WALL))


def _cylinder(axes: Axes, radius: float, bottom: float, top: float) -> None:
    for side in (-radius - 2, radius):
        axes.add_patch(Rectangle((side, bottom), 2, top - bottom, facecolor="#BBBBBB", edgecolor=WALL))


def _length(axes: Axes, start: tuple[float, float], end: tuple[float, float], text: str) -> None:
    axes.annotate("", start, end, arrowprops={"arrowstyle": "<->", "color": MEASURE})
    middle = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    upright = start[0] == end[0]
    axes.text(
        middle[0] + (2 if upright else 0),
        middle[1] + (0 if upright else 1.5),
        text,
        color=MEASURE,
        ha="left" if upright else "center",
        va="center" if upright else "bottom",
    )


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    return [
        "Lengths in mm, those of the paper's model; beads drawn in a regular packing, not simulated. Where "
        "the plate ends is open in the paper: see the model's notes."
    ]
