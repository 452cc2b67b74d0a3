"""The optimum is run again with fresh seeds, by which it was not chosen: what it is worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
ROUNDS, UNTIL = 2, 10
"""Most confirmations where no budget is given, and most where a probability is asked for."""
BETTER = 0.05
"""Probability by which another point must promise more to be confirmed in place of one with runs already."""
HOPELESS = 0.05
"""A probability of which the surrogates do not promise more than this anywhere is out of reach."""
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


def promise(task: Task, surrogates: Surrogates, point: Array) -> float:
    """Probability, by the surrogates, that all responses are within their tolerances at a point (d,)."""
    means, deviations = surrogates.predict_with_deviations(point[None])
    scale = np.maximum(deviations[0], np.finfo(float).tiny)
    low, high = (stats.norm.cdf((bound - means[0]) / scale) for bound in task.good)
    within = (high - low)[np.isfinite(high - low)]
    return float(np.prod(within))


def most_promising(
    task: Task, surrogates: Surrogates, points: Sequence[Array], proposal: Array
) -> tuple[Array, float]:
    """Where to confirm next, and the probability that the surrogates promise there.

    It is the best of the ``points`` that were confirmed, whose runs count on, unless the proposal (d,)
    promises more by `BETTER`.
    """
    promises = [promise(task, surrogates, point) for point in points]
    best = int(np.argmax(promises))
    if (there := promise(task, surrogates, proposal)) > promises[best] + BETTER:
        return proposal, there
    return points[best], promises[best]


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


def confirmation_in_words(found: Confirmed, until: float = 0.0) -> str:
    """The confirmation in a sentence; ``until`` is the probability that was asked for."""
    told = f"run again with {found.runs} fresh seed(s)"
    if math.isnan(found.all_within):
        return told
    told = f"{told}, all responses are within tolerance with probability {found.all_within:.2f}"
    if found.all_within < until:
        told += f", and {until:g} was not reached: within the budget, the surrogates promise it nowhere"
    return told
