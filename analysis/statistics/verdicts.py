"""Requirements of a claim: numbers with their bounds, and the limits that they must keep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from calstudy.analysis.statistics.estimates import ALPHA, Estimate

COMPLETE = 0.9
"""Share of the plan's rows from which on the lack of significance says as much as the paper's does."""


class Verdict(StrEnum):
    """Verdict of a study on a claim."""

    HOLDS = "holds"
    FAILS = "does not hold"
    UNDECIDED = "cannot be decided"


@dataclass(frozen=True, slots=True)
class Requirement:
    """A figure that must lie between ``least`` and ``most`` for a claim to hold."""

    name: str
    figure: Estimate
    """Its low and high ends are what the truth may be: an interval, or bounds given what is missing."""
    least: float = -math.inf
    most: float = math.inf

    @property
    def verdict(self) -> Verdict:
        """Holds if the whole interval lies inside the limits, fails if all of it lies outside."""
        low, high = self.figure.low, self.figure.high
        if math.isnan(low) or math.isnan(high):
            return Verdict.UNDECIDED
        if self.least <= low and high <= self.most:
            return Verdict.HOLDS
        if high < self.least or low > self.most:
            return Verdict.FAILS
        return Verdict.UNDECIDED


def decide(requirements: Sequence[Requirement]) -> Verdict:
    """Verdict of several requirements: all must hold, and one that fails decides. Without any it is open."""
    found = {requirement.verdict for requirement in requirements}
    for verdict in (Verdict.FAILS, Verdict.UNDECIDED, Verdict.HOLDS):
        if verdict in found:
            return verdict
    return Verdict.UNDECIDED


def exact(value: float, n: int) -> Estimate:
    """A figure that is counted, not estimated."""
    return Estimate(value, value, value, n)


def share_of_plan(hits: int, looked_at: int, planned: int) -> Estimate:
    """Share of the plan's rows. Its bounds allow for the rows that are not finished."""
    if not looked_at:
        return Estimate(math.nan, math.nan, math.nan, 0, "no row is finished")
    return Estimate(hits / looked_at, hits / planned, (hits + planned - looked_at) / planned, looked_at)


def largest_of_plan(value: float, looked_at: int, planned: int, limit: float = math.inf) -> Estimate:
    """Largest value of the plan's rows. Unfinished rows can only raise it, up to ``limit``."""
    return Estimate(value, value, value if looked_at >= planned else limit, looked_at)


def smallest_of_plan(value: float, looked_at: int, planned: int) -> Estimate:
    """Smallest of non-negative values of the plan's rows. Unfinished rows can only lower it."""
    return Estimate(value, value if looked_at >= planned else 0.0, value, looked_at)


def p_value(p: float, n: int, planned: int) -> Estimate:
    """A p-value as a figure. Significance counts at any n, its absence only on a nearly complete plan."""
    if math.isnan(p):
        return Estimate(p, p, p, n, "not tested")
    if p < ALPHA:
        return exact(p, n)
    return unless_complete(exact(p, n), n, planned, "the lack of significance", (0.0, 1.0))


def unless_complete(
    figure: Estimate, n: int, planned: int, what: str, may_be: tuple[float, float] = (-math.inf, math.inf)
) -> Estimate:
    """A figure that shows a lack of evidence. Only on a nearly complete plan does it have narrow bounds."""
    if n >= COMPLETE * planned:
        return figure
    low, high = may_be
    return replace(figure, low=low, high=high, why_not=f"n = {n} of {planned} rows: {what} says little")
