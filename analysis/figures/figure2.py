"""Figure 2 (section 2.3.3): the workflow of a calibration in its three parts. Our own drawing."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from calstudy.study.reading import Study

TITLE = "Figure 2: workflow of a calibration"
PHASES = {
    "sampling": ("#56B4E9", 6.35, 9.15),
    "1st optimisation": ("#E69F00", 3.35, 6.15),
    "2nd optimisation": ("#009E73", 0.35, 3.15),
}
BOXES = {
    "user": (2.3, 9.75, "parameters and intervals,\ndesired responses, WRL, SPP"),
    "lhs": (2.3, 8.45, "Latin hypercube, MAXIMIN\nS = (f$_{cal}$ + 2) · SPP points (Eq. 11)"),
    "runs": (2.3, 7.0, "DEM model: all samples"),
    "kriging": (2.3, 5.45, "universal Kriging,\none model a measured response"),
    "first": (2.3, 4.0, "least squares on the Kriging\nmodels, from the intervals' centre"),
    "second": (2.3, 2.4, "Levenberg-Marquardt on\nresiduals (Eq. 9 and 10)"),
    "dem": (6.4, 2.4, "DEM model: start,\nJacobian, trials"),
    "result": (2.3, 1.0, "improvement below 2 %:\nthe calibrated parameters"),
}
ARROWS = (
    ("user", "lhs", ""),
    ("lhs", "runs", "parameter sets"),
    ("runs", "kriging", "angle of repose, bulk density"),
    ("kriging", "first", ""),
    ("first", "second", "Kriging optimum"),
    ("second", "result", "DEM optimum"),
)


def figure2(study: Study) -> Figure:
    """Parts of a calibration as bands, with the DEM runs that this study's rows took in each."""
    figure = Figure(figsize=(7.6, 7.2), layout="constrained")
    axes = figure.subplots()
    ok = study.ok
    counts = {
        "sampling": ok["runs_sampling"],
        "2nd optimisation": ok["runs_optimisation"],
    }
    for phase, (colour, bottom, top) in PHASES.items():
        axes.add_patch(
            FancyBboxPatch(
                (0.1, bottom), 8.6, top - bottom, boxstyle="round,pad=0.05", fc=colour, alpha=0.22, ec="none"
            )
        )
        axes.text(8.6, top - 0.1, phase, ha="right", va="top", weight="bold")
        if phase in counts and len(ok):
            runs = counts[phase]
            said = (
                f"this study: {runs.mean():.1f} DEM runs a row\n({runs.min()} to {runs.max()}, n = {len(ok)})"
            )
            axes.text(8.6, bottom + 0.1, said, ha="right", va="bottom", fontsize=8.5)
        elif phase == "1st optimisation":
            axes.text(8.6, bottom + 0.1, "no DEM run", ha="right", va="bottom", fontsize=8.5)
    for x, y, text in BOXES.values():
        axes.text(
            x,
            y,
            text,
            ha="center",
            va="center",
            fontsize=9.5,
            bbox={"boxstyle": "round,pad=0.45", "fc": "white", "ec": "black"},
        )
    for start, end, label in ARROWS:
        _arrow(axes, BOXES[start][:2], BOXES[end][:2], label)
    y = BOXES["dem"][1]
    for shift, (left, right), label in ((0.16, (4.0, 5.3), "points"), (-0.16, (5.3, 4.0), "responses")):
        axes.annotate(
            "", (right, y + shift), (left, y + shift), arrowprops={"arrowstyle": "-|>", "fc": "black"}
        )
        axes.text(4.65, y + 1.9 * shift, label, ha="center", va="center", fontsize=8)
    axes.set(xlim=(0, 8.8), ylim=(0.3, 10.2))
    axes.axis("off")
    return figure


def _arrow(axes: Axes, start: tuple[float, float], end: tuple[float, float], label: str) -> None:
    axes.annotate(
        "",
        (end[0], end[1] + 0.42),
        (start[0], start[1] - 0.42),
        arrowprops={"arrowstyle": "-|>", "fc": "black"},
    )
    axes.text(start[0] + 0.15, (start[1] + end[1]) / 2, label, va="center", fontsize=8)


def notes(study: Study) -> list[str]:
    """Notes under the figure."""
    mode = study.settings.mode
    differs = (
        ""
        if mode == "paper"
        else f" Mode {mode} starts the first optimisation from other points, too; in the second it fits the "
        "Kriging models anew to all runs and runs the point that they propose, until little is to be gained."
    )
    return [f"The stages are the paper's.{differs}", study.provenance()]
