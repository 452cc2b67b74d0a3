"""Estimates with 95 % intervals. They are functions of arrays, so that they can serve many studies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts are loaded when they are first used, which a process that only draws never does
from numpy.typing import ArrayLike

from calstudy.parameters import Array

LEVEL = 0.95
"""Confidence level of every interval."""
ALPHA = 0.05
"""The paper's level of significance (section 3.2)."""
PERFECT = 1.0 - 1e-12
"""Correlation from which on z is rounding."""
WIDENED = 1.5
"""Factor of the jackknife's interval. A row that goes far is missing from many a study, which then does not
show how much its correlation may be off: over replicates the plain interval holds the median in 0.76 to 0.96,
and this one in 0.90 to 1.00 (``benchmarks/coverage.py``)."""
LARGE = 1e6
"""F times its degrees of freedom from which on the noncentral F is taken at its limit: SciPy's ends there."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its interval. NaN if it cannot be computed; then ``why_not`` says why."""

    value: float
    low: float
    high: float
    n: int
    why_not: str = ""


def impossible(n: int, why_not: str, value: float = math.nan) -> Estimate:
    """An estimate without interval, and perhaps without value."""
    return Estimate(value, math.nan, math.nan, n, why_not)


def is_constant(values: Array) -> bool:
    """Whether values (n,) differ only by rounding."""
    return bool(np.ptp(values) <= 1e-12 * np.abs(values).max(initial=0.0)) if len(values) else True


def correlation(x: ArrayLike, y: ArrayLike) -> Estimate:
    """Pearson's correlation of two columns (n,), with Fisher's interval. Pairs with a NaN are left out."""
    pairs = _pairs(x, y)
    r, why_not = _pearson(pairs)
    return impossible(len(pairs), why_not) if why_not else correlation_interval(r, len(pairs))


def correlation_by_jackknife(x: ArrayLike, y: ArrayLike) -> Estimate:
    """The same correlation, with an interval that does not assume a normal distribution of the rows.

    Fisher's z, its standard error by leaving out one row at a time, and Student's t with n - 1 degrees of
    freedom (Arvesen 1969), `WIDENED`. It is for two optima of the same rows, which agree but for a few of
    them: there Fisher's own standard error is too small by a factor of 2 to 7.
    """
    pairs = _pairs(x, y)
    n = len(pairs)
    r, why_not = _pearson(pairs)
    if why_not:
        return impossible(n, why_not)
    if n < 4:
        return impossible(n, f"n = {n}: an interval needs 4 rows", r)
    if abs(r) >= PERFECT:
        return Estimate(r, r, r, n)
    others = np.nonzero(~np.eye(n, dtype=bool))[1].reshape(n, n - 1)
    without = pairs[others]  # (n, n - 1, 2)
    if any(is_constant(column) for kept in without for column in kept.T):
        return impossible(n, "constant but for one row", r)
    without -= without.mean(axis=1, keepdims=True)
    without /= np.linalg.norm(without, axis=1, keepdims=True)  # their units differ by a factor of 1e10
    z = np.arctanh(np.clip(without.prod(axis=2).sum(axis=1), -PERFECT, PERFECT))
    error = math.sqrt((n - 1) * float(z.var()))
    reach = WIDENED * float(scipy.stats.t.ppf(0.5 + LEVEL / 2, n - 1)) * error
    return Estimate(r, math.tanh(math.atanh(r) - reach), math.tanh(math.atanh(r) + reach), n)


def _pairs(x: ArrayLike, y: ArrayLike) -> Array:
    """Pairs (m, 2) of two columns (n,), without those that have a NaN."""
    pairs = np.column_stack([np.asarray(x, float), np.asarray(y, float)])
    complete: Array = pairs[np.isfinite(pairs).all(axis=1)]
    return complete


def _pearson(pairs: Array) -> tuple[float, str]:
    """Correlation of pairs (n, 2), or why there is none."""
    if len(pairs) < 3:
        return math.nan, f"n = {len(pairs)}: a correlation needs 3 rows"
    if is_constant(pairs[:, 0]) or is_constant(pairs[:, 1]):
        return math.nan, "constant over these rows"
    # Both columns standardised, for their units differ by a factor of 1e10.
    scaled = (pairs - pairs.mean(axis=0)) / pairs.std(axis=0)
    return float(np.clip(scipy.stats.pearsonr(*scaled.T).statistic, -1.0, 1.0)), ""


def correlation_interval(r: float, n: int) -> Estimate:
    """Fisher's interval of a correlation of which only the number is known, such as a published one."""
    if n < 4:
        return impossible(n, f"n = {n}: an interval needs 4 rows", r)
    if abs(r) >= 1.0:
        return Estimate(r, r, r, n)
    reach = scipy.stats.norm.ppf(0.5 + LEVEL / 2) / math.sqrt(n - 3)
    return Estimate(r, math.tanh(math.atanh(r) - reach), math.tanh(math.atanh(r) + reach), n)


def mean(values: ArrayLike) -> Estimate:
    """Mean of a column (n,), with Student's interval."""
    x = _finite(values)
    if len(x) < 2:
        return impossible(
            len(x), f"n = {len(x)}: an interval needs 2 rows", float(x[0]) if len(x) else math.nan
        )
    centre = float(x.mean())
    reach = float(scipy.stats.t.ppf(0.5 + LEVEL / 2, len(x) - 1) * x.std(ddof=1) / math.sqrt(len(x)))
    return Estimate(centre, centre - reach, centre + reach, len(x))


def median(values: ArrayLike) -> Estimate:
    """Median of a column (n,), with an interval between order statistics (binomial, distribution-free)."""
    x = _finite(values)
    if len(x) < 6:
        why_not = f"n = {len(x)}: a {LEVEL:.0%} interval of a median needs 6 rows"
        return impossible(len(x), why_not, float(np.median(x)) if len(x) else math.nan)
    found: Any = scipy.stats.quantile_test(x, q=0.0, p=0.5).confidence_interval(LEVEL)
    return Estimate(float(np.median(x)), float(found.low), float(found.high), len(x))


def partial_eta_squared(f: float, num_df: float, den_df: float, n: int) -> Estimate:
    """Partial eta squared of an exact F test, with an interval by inverting the noncentral F distribution.

    Smithson (2003): noncentrality L gives L / (L + num_df + den_df + 1).
    """
    low, high = (
        found / (found + num_df + den_df + 1.0)
        for found in (noncentrality(f, num_df, den_df, p) for p in (0.5 + LEVEL / 2, 0.5 - LEVEL / 2))
    )
    return Estimate(f * num_df / (f * num_df + den_df), low, high, n)


def noncentrality(f: float, num_df: float, den_df: float, probability: float) -> float:
    """Noncentrality at which an F up to ``f`` has the given probability; 0 if there is none."""
    if float(scipy.stats.f.cdf(f, num_df, den_df)) <= probability:
        return 0.0
    if f * num_df > LARGE:
        # The numerator's own scatter is lost beside its noncentrality; the denominator's is left.
        return float(f * num_df * scipy.stats.chi2.ppf(1.0 - probability, den_df) / den_df)

    def excess(noncentrality: float) -> float:
        return float(scipy.stats.ncf.cdf(f, num_df, den_df, noncentrality)) - probability

    top = 2.0 * (f * num_df + 10.0)
    while excess(top) > 0.0:
        top *= 2.0
    return float(scipy.optimize.brentq(excess, 1e-12, top, xtol=1e-9, rtol=1e-10))


def _finite(values: ArrayLike) -> Array:
    """Finite values (m,) of those given (n,)."""
    x = np.asarray(values, float)
    chosen: Array = x[np.isfinite(x)]
    return chosen


LEVELS = (0.05, 0.95)
"""Ends of a band, as shares of the replicates."""


@dataclass(frozen=True, slots=True)
class Band:
    """Median and ends of a band; NaN if the number exists in no replicate."""

    median: float
    low: float
    high: float
    n: int
    """Replicates in which the number exists."""
    undefined: int
    """Replicates in which it does not, such as a correlation with a constant column."""

    @property
    def width(self) -> float:
        """Distance between the ends."""
        return self.high - self.low


def band(values: ArrayLike) -> Band:
    """Band of a number from its values (n,). NaN marks replicates in which it does not exist."""
    x = np.asarray(values, float)
    there = x[np.isfinite(x)]
    if not len(there):
        return Band(math.nan, math.nan, math.nan, 0, len(x))
    low, median, high = (float(v) for v in np.quantile(there, (LEVELS[0], 0.5, LEVELS[1])))
    return Band(median, low, high, len(there), len(x) - len(there))


def percentile(value: float, values: ArrayLike) -> float:
    """Share in % of the ``values`` (n,) below ``value``; equal ones count half. NaN without values."""
    x = np.asarray(values, float)
    there = x[np.isfinite(x)]
    if not len(there) or math.isnan(value):
        return math.nan
    return float(100.0 * (np.sum(there < value) + 0.5 * np.sum(there == value)) / len(there))
