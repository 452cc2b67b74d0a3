"""The calibrated values as lines of a LIGGGHTS script: in full for the program, rounded for people."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.parameters import Array
from calstudy.study.definition import Definition

STEP = 0.05
"""Step of the slopes as a share of the interval: long enough that noise in the surrogates averages out."""
SHARE = 0.1
"""A value is rounded to a place of at most this share of the change that a run's noise hides."""


def liggghts_lines(definition: Definition, head: str, values: Mapping[str, float]) -> list[str]:
    """Values (SI) of all parameters as lines of a LIGGGHTS script, with all digits."""
    texts = {p.name: p.said(values[p.name]) for p in definition.task.space.parameters if p.texts}
    set_to = {name: f"equal {value!r}" for name, value in values.items()}
    set_to |= {name: f"index {text}" for name, text in texts.items()}
    lines = [head, *(f"variable {name} {what}" for name, what in set_to.items())]
    for chosen in definition.models:
        if of_material := chosen.model.script_lines(values):
            return [*lines, *of_material]
    return lines


def rounded(surrogates: Surrogates, noise: Mapping[str, float], optimum: Array) -> dict[str, float]:
    """The calibrated values of an optimum (d,), each rounded to what the noise of a run supports.

    The last place of a value is at most a tenth of the change that, by the surrogates, moves a response by
    one standard deviation of its noise. Values stay within their intervals; listed ones are not rounded.
    """
    box = surrogates.space.box
    step = STEP * box.width
    ends = [np.clip(optimum + sign * np.diag(step), box.lower, box.upper) for sign in (-1.0, 1.0)]
    change = surrogates.predict(ends[1]) - surrogates.predict(ends[0])
    slopes = np.abs(change / np.diag(ends[1] - ends[0])[:, None])
    sd = np.array([noise[name] for name in surrogates.names])
    found = {}
    for k, p in enumerate(surrogates.space.free):
        hidden = min(
            [s / slope for s, slope in zip(sd, slopes[k], strict=True) if slope > 0], default=math.inf
        )
        value = p.value(float(optimum[k]))
        place = SHARE * min(hidden, float(box.width[k])) * (math.log(10) * value if p.is_log else 1.0)
        if place > 0 and not p.values:
            value = round(value, -math.floor(math.log10(place)))
        found[p.name] = min(max(value, p.lower), p.upper)
    return found
