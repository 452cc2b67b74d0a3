"""What is worth saying of a calibration before it is run."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from calstudy.models.material.regime import cautions
from calstudy.parameters import Space
from calstudy.study.definition.file import Definition

FEW = 2
"""Unknowns for which the procedure is more than is needed (section 2.3.3)."""
WIDE = 1.5
"""Ratio of the largest to the smallest Rayleigh time-step beyond which WRL decides more than the targets."""


def advice(definition: Definition) -> Iterator[str]:
    """Lines about a calibration that is larger, otherwise weighed or faster than its file may mean."""
    task = definition.task
    corners = list(_corners(task.space))
    for chosen in definition.models:
        yield from cautions(chosen.model, corners)
    names = task.space.box.names
    if len(names) <= FEW:
        yield (
            f"Only {' and '.join(names)} {'is' if len(names) == 1 else 'are'} calibrated: for one or two "
            "unknowns this procedure is more than is needed (section 2.3.3). A few runs over the interval "
            "and a line through them (calstudy sweep) say the same."
        )
    cost = task.cost
    if cost.WRL == 0:
        return
    slowest, fastest = cost.extreme_time_steps
    if fastest / slowest > WIDE:
        moving = " and ".join(cost.time_step_moves_with)
        worth = "standard error(s)" if cost.target.sd else "times a target"
        yield (
            f"Over the intervals the Rayleigh time-step changes by a factor of {fastest / slowest:.2g}. WRL "
            f"{cost.WRL:g} counts that as {cost.WRL:g} {worth}, and pulls the parameters to its larger end, "
            f"whatever the targets say: narrow {moving} to what you know, or lower WRL (section 2.3)."
        )


def _corners(space: Space) -> Iterator[dict[str, float]]:
    """Parameters at the ends of DENS and YM, the others in the middle of their intervals."""
    box = space.box
    ends = [
        (low, high) if name in ("DENS", "YM") else (middle,)
        for name, low, high, middle in zip(box.names, box.lower, box.upper, box.centre, strict=True)
    ]
    for point in itertools.product(*ends):
        yield space.complete(np.array(point))
