"""Bands: what a number is over the replicates of a study, and where a published one lies among them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

LEVELS = (0.05, 0.95)
"""Ends of a band, as shares of the replicates."""


@dataclass(frozen=True, slots=True)
class Band:
    """Median and the ends of the band (NaN where the number exists in no replicate)."""

    median: float
    low: float
    high: float
    n: int
    """Replicates in which the number exists."""
    undefined: int
    """Replicates in which it does not, such as a correlation with a constant column."""

    @property
    def width(self) -> float:
        """From end to end."""
        return self.high - self.low


def band(values: ArrayLike) -> Band:
    """Band of a number's values (n,), NaN where it does not exist; quantiles of the others."""
    x = np.asarray(values, float)
    there = x[np.isfinite(x)]
    if not len(there):
        return Band(math.nan, math.nan, math.nan, 0, len(x))
    low, median, high = (float(v) for v in np.quantile(there, (LEVELS[0], 0.5, LEVELS[1])))
    return Band(median, low, high, len(there), len(x) - len(there))


def percentile(value: float, values: ArrayLike) -> float:
    """Share in % of the ``values`` (n,) that lie below ``value``, equal ones half; NaN without any."""
    x = np.asarray(values, float)
    there = x[np.isfinite(x)]
    if not len(there) or math.isnan(value):
        return math.nan
    return float(100.0 * (np.sum(there < value) + 0.5 * np.sum(there == value)) / len(there))
