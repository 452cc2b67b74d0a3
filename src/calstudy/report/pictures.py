"""Pictures of one calibration: its DEM runs against the targets, its heap, its solution space."""

from __future__ import annotations

import io
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calstudy.analysis import figure9
from calstudy.calibration.narrowing import Profile
from calstudy.disk.files import write_atomically
from calstudy.disk.ours import make_directory
from calstudy.errors import SetupError
from calstudy.parameters import Array, Parameter, Space
from calstudy.records import Phase
from calstudy.study.directory.store import finished_rows
from calstudy.study.reading import Study, read_study

# Okabe and Ito's colours, each with a marker of its own, so that colour is not needed.
MARKS = {
    Phase.SAMPLING: ("#999999", "o", "sampling"),
    Phase.START: ("#D55E00", "D", "Kriging optimum"),
    Phase.JACOBIAN: ("#56B4E9", "s", "Jacobian"),
    Phase.TRIAL: ("#0072B2", "^", "trial"),
    Phase.CHEAP: ("#cccccc", ".", "cheap fidelity"),
    Phase.CONFIRMATION: ("#009E73", "v", "run again"),
}


def convergence(
    runs: pd.DataFrame, result: Mapping[str, Any], units: Mapping[str, str], title: str
) -> Figure:
    """Draw the ``runs`` of a calibration in order, phase by phase.

    ``result`` is its line of the table of calibrations; ``units`` has the unit of each response with a
    target.
    """
    runs = runs[["run_id", "phase", *units]].reset_index(drop=True)
    further = (runs["phase"] == Phase.START) & runs["phase"].duplicated()
    runs["phase"] = runs["phase"].mask(further, Phase.TRIAL)  # of a round, the first is the Kriging optimum
    height = max(5.0, 1.0 + 2.0 * len(units))
    figure = Figure(figsize=(9, height))
    # Margins by hand: automatic layout takes as long as drawing, and every row has its pictures.
    margins = {"left": 0.1, "right": 0.98, "bottom": 0.5 / height, "top": 1.0 - 0.75 / height, "hspace": 0.08}
    panels = figure.subplots(len(units), 1, sharex=True, squeeze=False, gridspec_kw=margins)[:, 0]
    best_ids = str(result["dem_run_id"]).split("+")
    for axes, (name, unit) in zip(panels, units.items(), strict=True):
        target = result[f"target_{name}"]
        axes.axhline(target, color="black", lw=1, ls="--", label=f"target ({result['target_kind']})")
        for phase, (colour, marker, label) in MARKS.items():
            chosen = runs[runs["phase"] == phase]
            if chosen.empty:
                continue
            axes.plot(chosen.index + 1, chosen[name], ls="", color=colour, marker=marker, label=label)
        best = runs[runs["run_id"].isin(best_ids) & (runs["phase"] != Phase.SAMPLING)]
        axes.plot(
            best.index + 1,
            best[name],
            ls="",
            marker="o",
            ms=14,
            mfc="none",
            mec="#D55E00",
            label="DEM optimum",
        )
        axes.set_ylabel(f"{name.removesuffix('_deg').replace('_', ' ')}\nin {unit}")
    panels[0].legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=6, fontsize=8, frameon=False)
    panels[-1].set_xlabel("DEM run, phase by phase")
    figure.suptitle(title, fontsize=11)
    return figure


def draw_runs(study: Study, row: int) -> Figure:
    """Draw a row's DEM runs, phase by phase."""
    runs = study.evaluations[study.evaluations["row"] == row]
    result = study.calibrations[study.calibrations["row"] == row].to_dict("records")[0]
    title = f"Row {row}: {len(runs)} DEM runs at {result['fidelity']} fidelity"
    line = cast(dict[str, Any], result)
    return convergence(runs, line, study.settings.aims(line), title)


def draw_row(directory: Path, study: Study, row: int) -> list[Path]:
    """Draw a finished row's pictures into the study unless they exist; returns their paths.

    SetupError: they cannot be written.
    """
    if row not in set(study.ok["row"]):
        return []
    pictures = directory / "pictures"
    try:
        make_directory(pictures, directory)
    except OSError as error:
        raise SetupError(f"{pictures}: cannot be made: {error.strerror}") from error
    drawings: dict[str, Callable[[], Figure]] = {"runs": lambda: draw_runs(study, row)}
    if row in set(study.heaps["row"]):  # an emulator leaves no beads
        drawings = {"heap": lambda: figure9(study, row), **drawings}
    paths = {name: pictures / f"row-{row:02d}-{name}.png" for name in drawings}
    for name, path in paths.items():
        if not path.exists():
            drawn = io.BytesIO()
            # Little compression: it takes as long as the drawing, and the pictures are small.
            drawings[name]().savefig(drawn, dpi=130, pil_kwargs={"compress_level": 2})
            try:
                write_atomically(path, drawn.getvalue(), directory)
            except OSError as error:
                raise SetupError(
                    f"{path}: cannot be written: {error.strerror}; free space, run again"
                ) from error
    return list(paths.values())


MANY = 12
"""Rows from which on a second process draws pictures meanwhile: it takes seconds to start."""
LOOK_SECONDS = 0.5
GIVE_UP_SECONDS = 5.0
"""Seconds that the second process has for the picture that it is at."""


@contextmanager
def drawn_meanwhile(directory: Path, plan_file: Path | None, rows: Sequence[int]) -> Iterator[None]:
    """Have a second process draw the pictures of rows of a plan that finish during the block.

    What it leaves, as those of the last rows or of all where it cannot work, is for `draw_rows`. A single
    process would draw for a third of the time that 72 rows take on an emulator.
    """
    if len(rows) < MANY:
        yield
        return
    context = get_context("spawn")  # threads of the numerical libraries do not survive a fork
    try:
        end = context.Event()
        helper = context.Process(target=_draw_finished, args=(directory, plan_file, rows, end), daemon=True)
        helper.start()
    except OSError:  # no memory, or no further process
        yield
        return
    try:
        yield
    finally:
        end.set()
        helper.join(GIVE_UP_SECONDS)
        helper.terminate()


def _draw_finished(directory: Path, plan_file: Path | None, rows: Sequence[int], end: Any) -> None:
    """Draw the rows as they finish until the event ``end`` is set, or the process that asked has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the first process says when to stop
    parent = parent_process()
    drawn: set[int] = set()
    while not end.wait(LOOK_SECONDS) and parent is not None and parent.is_alive():
        if new := finished_rows(directory).intersection(rows) - drawn:
            try:
                study = read_study(directory, plan_file)
                for row in sorted(new):
                    if end.is_set():
                        return
                    draw_row(directory, study, row)
            except Exception:
                return  # who asked draws the rest, and tells what is wrong
            drawn |= new


def draw_rows(directory: Path, study: Study, rows: Sequence[int]) -> list[Path]:
    """Draw the pictures of rows as `draw_row` does."""
    return [path for row in rows for path in draw_row(directory, study, row)]


SHOWN = 800
"""Most solutions that are drawn as points; more would make one black area."""


MARGIN = 0.04
"""Margin beside the bounds as a share of the interval, so that a marker on a bound is whole."""


def pairs(points: Array, optimum: Array, space: Space) -> Figure:
    """Draw solutions (n, d) over the intervals, pair by pair, with the DEM optimum (d,)."""
    box, d = space.box, space.box.dimension
    labels = [_labels(parameter) for parameter in space.free]
    figure = Figure(figsize=(max(5.0, 1.9 * d), max(4.5, 1.8 * d)), layout="constrained")
    grid: Any = figure.subplots(d, d, squeeze=False)
    shown = points[:: max(1, len(points) // SHOWN)]
    low: list[float] = (np.array(box.lower) - MARGIN * box.width).tolist()
    high: list[float] = (np.array(box.upper) + MARGIN * box.width).tolist()
    ticks = [_ticks(parameter) for parameter in space.free]
    for i, j in np.ndindex(d, d):
        axes: Axes = grid[i, j]
        if j > i:
            axes.set_axis_off()
            continue
        axes.set_xlim(low[j], high[j])
        if i == j:
            axes.hist(points[:, j], bins=20, range=(box.lower[j], box.upper[j]), color="#56B4E9")
            axes.axvline(float(optimum[j]), color="#D55E00")
            axes.set_yticks([])
        else:
            axes.plot(shown[:, j], shown[:, i], ls="", marker=".", ms=2, color="#0072B2", alpha=0.5)
            (best,) = axes.plot(optimum[j], optimum[i], "o", ms=9, mfc="none", mec="#D55E00", mew=2, zorder=5)
            best.set_clip_on(False)
            axes.set_ylim(low[i], high[i])
            axes.set_yticks(ticks[i])
            axes.yaxis.set_major_formatter(labels[i])
        axes.set_xticks(ticks[j])
        axes.xaxis.set_major_formatter(labels[j])
        axes.tick_params(labelsize=7, labelbottom=i == d - 1, labelleft=j == 0 and i != j)
        axes.tick_params(axis="x", rotation=90)
        if i == d - 1:
            axes.set_xlabel(box.names[j], fontsize=9)
        if j == 0:
            axes.set_ylabel(box.names[i], fontsize=9)
    figure.align_labels()
    figure.suptitle(f"{len(points)} parameter sets that do as well; orange: DEM optimum", fontsize=10)
    return figure


def draw_profiles(points: Array, profiles: Sequence[Profile], optimum: Array, space: Space) -> Figure:
    """Draw each parameter's solutions (n, d) as bars, its profile as a line, and the DEM optimum (d,)."""
    box, d = space.box, space.box.dimension
    across = min(d, 3)
    down = -(-d // across)
    figure = Figure(figsize=(max(5.0, 2.8 * across), 0.6 + 2.1 * down), layout="constrained")
    panels: Any = figure.subplots(down, across, squeeze=False)
    for k, axes in enumerate(panels.flat):
        if k >= d:
            axes.set_axis_off()
            continue
        bars, _ = np.histogram(points[:, k], bins=20, range=(box.lower[k], box.upper[k]))
        edges = np.linspace(box.lower[k], box.upper[k], 21)
        axes.stairs(bars / bars.max(), edges, fill=True, color="#56B4E9")
        at = box.lower[k] + profiles[k].unit * box.width[k]
        axes.plot(at, profiles[k].likelihood, color="black")
        axes.axvline(float(optimum[k]), color="#D55E00")
        axes.set_ylim(0.0, 1.05)
        axes.set_xticks(_ticks(space.free[k]))
        axes.xaxis.set_major_formatter(_labels(space.free[k]))
        axes.set_yticks([0.0, 1.0])
        axes.tick_params(labelsize=7)
        axes.set_xlabel(box.names[k], fontsize=9)
    figure.suptitle("Solutions (bars), profile (line), DEM optimum (orange)", fontsize=10)
    return figure


def _ticks(parameter: Parameter) -> list[float]:
    """Coordinates of its listed values, or of its bounds and their middle."""
    low, high = parameter.ends
    return [float(k) for k in range(len(parameter.values))] or [low, (low + high) / 2, high]


def _labels(parameter: Parameter) -> Callable[[float, float], str]:
    """Labels of ticks at coordinates of a parameter."""

    def label(coordinate: float, _: float) -> str:
        value = parameter.value(coordinate)
        return parameter.said(value) if parameter.texts else _tick(value)

    return label


def _tick(value: float) -> str:
    """Label of a tick with its power of ten; an offset beside the axis would overlap another label."""
    return f"{value:.4g}".replace("e+0", "e").replace("e-0", "e-")
