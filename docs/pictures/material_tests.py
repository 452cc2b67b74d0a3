"""Pictures of the material tests: side views of beads at the end of a run, a drum's surface, curves.

    python docs/pictures/material_tests.py NAME RUN

RUN is the directory of a run as ``calstudy simulate --model NAME --out RUN`` keeps it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import EllipseCollection
from style import STYLE, save

from calstudy.engines.liggghts import LOG, markers, read_positions


def numbers(run: Path) -> dict[str, float]:
    """What the script marked in its log."""
    return {name: float(text) for name, text in markers(run / LOG).items() if text}


def beads(axes: plt.Axes, points: np.ndarray, diameter: float, depth: int = 1) -> None:
    """Beads (n, 3) in m as circles, seen along the axis ``depth``; what is nearer covers what is farther."""
    across = next(k for k in (0, 1) if k != depth)
    order = np.argsort(-points[:, depth])
    shown = 1e3 * points[order]
    shade = np.linspace(0.55, 0.95, len(shown))
    axes.add_collection(
        EllipseCollection(
            *(np.full(len(shown), x) for x in (1e3 * diameter, 1e3 * diameter, 0.0)),
            units="xy",
            offsets=shown[:, [across, 2]],
            offset_transform=axes.transData,
            facecolors=plt.get_cmap("Blues")(shade),
            edgecolors="k",
            linewidths=0.2,
        )
    )
    axes.autoscale_view()
    axes.set(aspect="equal", xlabel="mm", ylabel="mm")


def draw_down(run: Path) -> plt.Figure:
    """Half of the beads at the end, cut through the axis, and the discharge over time."""
    of, points = numbers(run), read_positions(run / "end.dump")
    figure, (left, right) = plt.subplots(1, 2, figsize=(7, 3.6), width_ratios=(1.4, 1))
    beads(left, points[points[:, 1] > 0], of["bead_diameter"])
    for side in (-1, 1):
        inner, outer = 1e3 * side * of["opening_radius"], 1e3 * side * of["cylinder_radius"]
        left.plot([inner, outer, outer], [0, 0, 70], "k-", lw=1)
    plate = 1e3 * of["plate_radius"]
    left.plot([-plate, plate], [1e3 * of["plate_height"]] * 2, "k-", lw=1)
    time, mass = np.loadtxt(run / "discharge.txt").T
    right.plot(time, mass)
    right.set(xlabel="time, s", ylabel="discharged mass, kg")
    return figure


def rotating_drum(run: Path) -> plt.Figure:
    """The slowly turning bed, and the slope of the surface in each frame at both speeds."""
    of = numbers(run)
    sys.path.insert(0, str(run))
    drum = import_module("rotating_drum")
    figure, (left, right) = plt.subplots(1, 2, figsize=(7, 3.2), width_ratios=(1.2, 1))
    frames = {speed: drum.frames(run / f"{speed}.dump") for speed in ("slow", "fast")}
    beads(left, frames["slow"][-1], of["bead_diameter"])
    left.add_patch(plt.Circle((0, 0), 1e3 * of["drum_radius"], fill=False))
    left.autoscale_view()
    for speed, seen in frames.items():
        slopes = [drum.surface_angle_deg(one, of["bead_diameter"], of["drum_radius"]) for one in seen]
        right.plot(slopes, label=speed)
    right.axvspan(0, len(seen) / 2, color="0.93")
    right.set(xlabel="frame (grey: not counted)", ylabel="slope, deg")
    right.legend(frameon=False)
    return figure


def uniaxial_compression(run: Path) -> plt.Figure:
    """Stress over strain, there and back, and the compressed bed."""
    sys.path.insert(0, str(run))
    curves = import_module("uniaxial_compression").curves(run)
    figure, axes = plt.subplots(figsize=(4.2, 3.2))
    for (strain, stress), name in zip(curves, ("loading", "unloading"), strict=True):
        axes.plot(100 * strain, stress / 1e3, label=name)
    axes.set(xlabel="strain, %", ylabel="stress, kPa")
    axes.legend(frameon=False)
    return figure


def shear_cell(run: Path) -> plt.Figure:
    """Shear stress over the stages, with the ratio to the normal stress, and the sheared bed."""
    of = numbers(run)
    figure, (left, right) = plt.subplots(1, 2, figsize=(7, 3.2), width_ratios=(1, 1.4))
    points = read_positions(run / "preshear.dump")
    beads(left, points, of["bead_diameter"])
    step, stage, _, normal, shear, _ = np.loadtxt(run / "shear.txt").T
    names = {0: "preshear", -1: "back", 1: "shear 1", 2: "preshear again", 3: "shear 2", 4: "wall"}
    for number, name in names.items():
        there = stage == number
        right.plot(step[there], shear[there] / 1e3, ".", ms=2, label=name)
    right.plot(step, normal / 1e3, "k-", lw=0.6, label="normal")
    right.set(xlabel="time-step", ylabel="stress, kPa")
    right.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(0.0, 0.72), markerscale=4)
    return figure


PICTURES: dict[str, Callable[[Path], plt.Figure]] = {
    made.__name__: made for made in (draw_down, rotating_drum, uniaxial_compression, shear_cell)
}

if __name__ == "__main__":
    with plt.rc_context(STYLE):
        save(PICTURES[sys.argv[1]](Path(sys.argv[2])), f"{sys.argv[1]}.png")
