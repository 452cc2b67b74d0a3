"""The optimum is run again with fresh seeds, by which it was not chosen: what it is worth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.task import Runs, Task
from calstudy.parameters import Array
from calstudy.records import Phase

WORTH = 4.0
"""Degrees of freedom that the assumed noise is worth beside the one seen."""
APART = 2.5
"""A mean that is so many standard deviations from what the surrogates expect contradicts them."""


SURE = 0.9
"""A response is within its tolerance, or outside it, if that is as probable as this."""


@dataclass(frozen=True, slots=True)
class Confirmed:
    """What k runs at one point say of m responses, in their units."""

    mean: Array
    """(m,)."""
    standard_error: Array
    """Of the mean, from the noise seen and the noise assumed together, (m,)."""
    assumed: Array
    """Noise of a run as it was assumed, (m,)."""
    seen: Array
    """Standard deviation of the runs, (m,); NaN for a single run."""
    within: Array
    """Probability that the mean response is within its tolerance, (m,); NaN without a tolerance."""
    runs: int

    @property
    def all_within(self) -> float:
        """Probability that all responses are within their tolerances; NaN where none has one.

        The responses' noise is taken as independent.
        """
        given = self.within[np.isfinite(self.within)]
        return float(np.prod(given)) if len(given) else float("nan")


def confirmed(responses: Array, bounds: tuple[Array, Array], assumed: Array) -> Confirmed:
    """What responses (k, m) of runs with fresh seeds say.

    ``bounds`` are the least and the largest good values of the responses (m,), NaN without a tolerance.

    The variance of a run is that of the k runs, k - 1 degrees of freedom, pooled with the assumed one, which
    counts `WORTH`; the mean then has Student's distribution.
    """
    k, m = responses.shape
    mean = responses.mean(axis=0)
    squares = np.sum((responses - mean) ** 2, axis=0)
    freedom = k - 1 + WORTH
    error = np.sqrt((squares + WORTH * assumed**2) / freedom / k)
    seen = np.sqrt(squares / (k - 1)) if k > 1 else np.full(m, np.nan)
    scale = np.maximum(error, np.finfo(float).tiny)
    low, high = (stats.t.cdf((bound - mean) / scale, freedom) for bound in bounds)
    return Confirmed(mean, error, assumed, seen, high - low, k)


def confirmed_at(task: Task, runs: Runs, point: Array, noise: Array) -> Confirmed | None:
    """What the confirmation at a point (d,) says; None if no run gave responses.

    ``noise`` (m,) is that of a run, as it is assumed.
    """
    points, responses, usable = runs.data(Phase.CONFIRMATION)
    chosen = usable & np.all(points == point, axis=1)
    if not chosen.any():
        return None
    return confirmed(responses[chosen], task.good, noise)


def contradicts(task: Task, surrogates: Surrogates, point: Array, found: Confirmed) -> bool:
    """Whether a confirmation is not what surrogates from before it expect at the point (d,).

    It is not where the mean is further off than both doubts allow, and where the surrogates expect all
    responses within their tolerances and one is not.
    """
    means, deviations = surrogates.predict_with_deviations(point[None])
    doubt = np.hypot(deviations[0], found.standard_error)
    far: NDArray[np.bool_] = np.abs(found.mean - means[0]) > APART * doubt
    expected, came = (task.cost.residuals(point, values) for values in (means[0], found.mean))
    return bool(far.any() or (task.within(expected) and not task.within(came)))


def tolerance_verdict(deviation: float, tolerance: float, probability: float) -> str:
    """Whether a response is within its tolerance: by a run's deviation, or by fresh runs' probability."""
    if math.isnan(probability):
        return "within tolerance" if abs(deviation) <= tolerance else "outside tolerance"
    if probability >= SURE:
        return "within tolerance"
    return "outside tolerance" if probability <= 1.0 - SURE else "not sure to be within"


def confirmation_in_words(found: Confirmed) -> str:
    """The confirmation in a sentence."""
    told = f"run again with {found.runs} fresh seed(s)"
    if math.isnan(found.all_within):
        return told
    return f"{told}, all responses are within tolerance with probability {found.all_within:.2f}"
