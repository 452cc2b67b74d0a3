"""Effect of a factor of the plan on a response, with the other factors in the model (least squares)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from calstudy.analysis.statistics.estimates import ALPHA, Estimate, impossible, is_constant
from calstudy.parameters import Array

TOLERANCE = 1e-9
"""A column depends on those before it if less than this share of it is independent of them."""


@dataclass(frozen=True, slots=True)
class FactorEffect:
    """Joint test of a factor's levels and the difference of each pair, or the reason why there is none."""

    n: int
    f: float
    num_df: int
    den_df: int
    p: float
    differences: Mapping[tuple[float, float], Estimate]
    """Response at the second level minus that at the first, other factors held equal."""
    why_not: str = ""


def factor_effect(frame: pd.DataFrame, response: str, factor: str, others: Sequence[str]) -> FactorEffect:
    """Test a categorical factor in an additive model with ``others``, categorical too.

    Lines without the response are left out. Tests are two-sided, intervals those of one difference.
    """
    used = _used(frame, response, [factor, *others])
    n, levels = len(used), sorted(used[factor].unique())
    if len(levels) < 2:
        return _no_effect(n, f"n = {n} with one level of {factor} or none")
    own = _dummies(used, factor)
    base = _independent(np.ones((n, 1)), [_dummies(used, name) for name in others])
    exog = _independent(base, [own])
    if exog.shape[1] < base.shape[1] + own.shape[1]:
        return _no_effect(
            n, f"the levels of {factor} are confounded with the other factors in these {n} rows"
        )
    fit, why_not = _fit(used[response], exog)
    if why_not:
        return _no_effect(n, why_not)
    k = base.shape[1]
    joint = fit.f_test(np.eye(exog.shape[1])[k:])
    # The first level is the base, so its coefficient is zero.
    place = {level: np.eye(exog.shape[1])[k + i] for i, level in enumerate(levels[1:])}
    place[levels[0]] = np.zeros(exog.shape[1])
    differences = {
        (float(a), float(b)): _contrast(fit, place[b] - place[a], n) for a, b in combinations(levels, 2)
    }
    return FactorEffect(
        n, float(joint.fvalue), int(joint.df_num), int(joint.df_denom), float(joint.pvalue), differences
    )


def slopes(
    frame: pd.DataFrame, response: str, along: str, within: str, others: Sequence[str]
) -> dict[float, Estimate]:
    """Slope of the response along a numerical factor, at each level of another factor."""
    used = _used(frame, response, [along, within, *others])
    n, levels = len(used), sorted(used[within].unique())
    lines = [np.where(used[within] == level, used[along], 0.0)[:, None] for level in levels]
    base = _independent(np.ones((n, 1)), [_dummies(used, name) for name in (within, *others)])
    exog = _independent(base, lines)
    if exog.shape[1] < base.shape[1] + len(lines):
        why_not = f"{along} does not vary enough within each {within} in these {n} rows"
        return {float(level): impossible(n, why_not) for level in levels}
    fit, why_not = _fit(used[response], exog)
    if why_not:
        return {float(level): impossible(n, why_not) for level in levels}
    rows = np.eye(exog.shape[1])[base.shape[1] :]
    return {float(level): _contrast(fit, row, n) for level, row in zip(levels, rows, strict=True)}


def linear_effects(frame: pd.DataFrame, response: str, along: Sequence[str]) -> dict[str, Estimate]:
    """Slopes of a response along several numbers together."""
    used = _used(frame, response, list(along))
    n = len(used)
    exog = _independent(np.ones((n, 1)), [used[[name]].to_numpy() for name in along])
    if exog.shape[1] < 1 + len(along):
        return {name: impossible(n, f"too few or dependent points, n = {n}") for name in along}
    fit, why_not = _fit(used[response], exog)
    if why_not:
        return {name: impossible(n, why_not) for name in along}
    rows = np.eye(exog.shape[1])[1:]
    return {name: _contrast(fit, row, n) for name, row in zip(along, rows, strict=True)}


def _used(frame: pd.DataFrame, response: str, factors: list[str]) -> pd.DataFrame:
    return frame[[response, *factors]].astype(float).dropna()


def _dummies(frame: pd.DataFrame, name: str) -> Array:
    """Indicator columns of all levels but the first, shape (n, levels - 1)."""
    levels = sorted(frame[name].unique())[1:]
    columns = [(frame[name] == level).to_numpy(float) for level in levels]
    return np.column_stack(columns) if columns else np.empty((len(frame), 0))


def _independent(base: Array, blocks: Sequence[Array]) -> Array:
    """``base`` (n, k), and those columns of the blocks (n, ...) that are independent of all before them."""
    exog = base
    for column in (block[:, k] for block in blocks for k in range(block.shape[1])):
        rest = column - exog @ np.linalg.lstsq(exog, column, rcond=None)[0]
        if np.linalg.norm(rest) > TOLERANCE * np.linalg.norm(column):
            exog = np.column_stack([exog, column])
    return exog


def _fit(response: pd.Series, exog: Array) -> tuple[Any, str]:
    """Least squares fit on ``exog`` (n, k), or the reason why there is no test."""
    from statsmodels.regression.linear_model import OLS

    n, k = exog.shape
    y = response.to_numpy()
    if n <= k:
        return None, f"n = {n} rows leave no residual degree of freedom beside {k} coefficients"
    if is_constant(y):
        return None, f"{response.name} is the same in all {n} rows"
    fit = OLS(y, exog).fit()
    if np.linalg.norm(fit.resid) <= TOLERANCE * np.linalg.norm(y - y.mean()):
        return None, f"{response.name} is fitted exactly, so that there is no residual to test against"
    return fit, ""


def _contrast(fit: Any, row: Array, n: int) -> Estimate:
    """A combination, with the weights of ``row`` (k,), of a fit's k coefficients."""
    found = fit.t_test(row)
    low, high = np.ravel(found.conf_int(alpha=ALPHA))
    return Estimate(float(np.ravel(found.effect)[0]), float(low), float(high), n)


def _no_effect(n: int, why_not: str) -> FactorEffect:
    nan = float("nan")
    return FactorEffect(n, nan, 0, 0, nan, {}, why_not)
