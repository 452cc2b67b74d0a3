"""Pictures of a calibration under way, and bars of solutions that are held by hand."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from calstudy.analysis.exhibit import Picture, render
from calstudy.analysis.figures.figure9 import draw
from calstudy.calibration.solutions import errors_of, solve
from calstudy.errors import NumericsError
from calstudy.parameters import Array
from calstudy.report.calibration import heaps_of
from calstudy.report.curves import singly_targeted
from calstudy.report.pictures import convergence, pairs
from calstudy.study.reading import Result

POINTS = 500
"""Parameter sets in the picture of the box; fewer than of a result, since it is drawn after each run."""
BARS = 24


def pictures_so_far(result: Result, finished: bool) -> tuple[list[Picture], str]:
    """The latest heap, all runs and, until it is finished, what the surrogates make of the box.

    The text says why there is no picture of the box; it is empty otherwise.
    """
    pictures = [_picture("The heap of the latest run", draw(heap)) for heap in heaps_of(result)[-1:]]
    if of := singly_targeted(result):
        title = f"{result.evaluations['run_id'].nunique()} DEM runs"
        pictures.append(_picture("DEM runs so far", convergence(result.evaluations, result.line, of, title)))
    if finished:
        return pictures, ""
    try:
        return [*pictures, _picture("What the surrogates make of the box", _box(result))], ""
    except NumericsError as error:
        return pictures, f"No surrogates yet: {error}"


def _box(result: Result) -> Figure:
    task = result.definition.task
    found = solve(task, result.surrogates, errors_of(task, result.noise), POINTS)
    return pairs(found.points, result.optimum_point, task.space)


def _picture(title: str, figure: Figure) -> Picture:
    return Picture(title, title, render(figure, ["svg"]), ())


def bars_of(values: Array, before: Array, now: Array, optimum: float) -> str:
    """Histograms of a parameter (n,), in shares of its interval, by two sets of weights (n,), as SVG.

    ``before`` are the weights of all solutions, ``now`` those of the ones that are left.
    """
    parts = []
    for weights, colour in ((before, "#bbb"), (now, "#0072B2")):
        heights, _ = np.histogram(values, BARS, (0, 1), weights=weights)
        path = "".join(
            f"M{100 * i / BARS:.2f} 30v{-28 * h / heights.max():.2f}h{100 / BARS:.2f}V30z"
            for i, h in enumerate(heights)
        )
        parts.append(f'<path d="{path}" fill="{colour}" fill-opacity="0.65"/>')
    parts.append(
        f'<path d="M{100 * optimum:.2f} 0V30" stroke="#D55E00" stroke-width="2" '
        'vector-effect="non-scaling-stroke"/>'
    )
    return f'<svg viewBox="0 0 100 30" preserveAspectRatio="none" aria-hidden="true">{"".join(parts)}</svg>'
