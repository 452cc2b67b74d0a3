"""Correlations of the calibrated parameters at the DEM optima, as they are and given the other parameters.

Where a target ties several parameters together, a plain correlation of two of them mixes what they do to each
other with what a third does to both; the partial one leaves the third out (beyond the paper's Table 6).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.statistics.estimates import (
    Estimate,
    correlation,
    correlation_interval,
    impossible,
    is_constant,
)
from calstudy.parameters import Array
from calstudy.plan import PARAMETERS
from calstudy.study.reading import Study

TITLE = "Partial correlations of the calibrated parameters at the DEM optima"
COLUMNS = (
    Column("pair", "Parameters"),
    Column("correlation", "Correlation [95 %]", "z.4f", "low", "high"),
    Column("partial", "Given the others [95 %]", "z.4f", "partial_low", "partial_high"),
    Column("given", "Others that vary"),
    Column("n", "n", "d"),
    Column("df", "df", "d"),
    Column("why_not", "Why not"),
)
SMALLEST_RESIDUAL = 1e-9
"""Share of a column's scatter; what the others leave below it is rounding."""


def partial_correlations(study: Study) -> pd.DataFrame:
    """One line for each pair of parameters, over the rows in which both were calibrated."""
    lines = []
    for a, b in combinations(PARAMETERS, 2):
        rows = study.where_calibrated(a, b)
        x, y = (rows[f"dem_{name}"].to_numpy(float) for name in (a, b))
        others = {name: rows[f"dem_{name}"].to_numpy(float) for name in PARAMETERS if name not in (a, b)}
        varying = {name: values for name, values in others.items() if not is_constant(values)}
        plain = correlation(x, y)
        given = np.column_stack([np.empty((len(rows), 0)), *varying.values()])
        partial, df = partial_correlation(x, y, given)
        lines.append(
            {
                "pair": f"{a}:{b}",
                "correlation": plain.value,
                "low": plain.low,
                "high": plain.high,
                "partial": partial.value,
                "partial_low": partial.low,
                "partial_high": partial.high,
                "given": ", ".join(varying),
                "n": partial.n,
                "df": df,
                "why_not": plain.why_not or partial.why_not,
            }
        )
    return pd.DataFrame(lines)


def partial_correlation(x: Array, y: Array, others: Array) -> tuple[Estimate, int]:
    """Correlation of two columns (n,) given ``others`` (n, k), and its degrees of freedom, n - 2 - k.

    It is that of the residuals of both on the others; the interval is Fisher's, with n - k in place of n. A
    column of the others that the rest of them determines is not counted in k.
    """
    n = len(x)
    scaled = _standardised(others)
    k = int(np.linalg.matrix_rank(scaled)) if scaled.size else 0
    df = max(n - 2 - k, 0)
    if n - k < 3:
        needed = f"n = {n}: a correlation given {k} others needs {k + 3} rows"
        return impossible(n, needed), df
    if is_constant(x) or is_constant(y):
        return impossible(n, "constant over these rows"), df
    columns = _standardised(np.column_stack([x, y]))
    left = columns - scaled @ np.linalg.lstsq(scaled, columns, rcond=None)[0]
    if (left.std(axis=0) < SMALLEST_RESIDUAL).any():
        return impossible(n, "determined by the others"), df
    p, q = left.T
    r = float(np.clip(p @ q / np.sqrt((p @ p) * (q @ q)), -1.0, 1.0))
    if n - k < 4:
        return impossible(n, f"n = {n}: an interval given {k} others needs {k + 4} rows", r), df
    return replace(correlation_interval(r, n - k), n=n), df


def _standardised(columns: Array) -> Array:
    """Columns (n, k) with mean 0 and standard deviation 1; their units differ by a factor of 1e10."""
    if not columns.size:
        return columns
    centred: Array = (columns - columns.mean(axis=0)) / columns.std(axis=0)
    return centred


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        "Rows in which both parameters were calibrated. Given the others: the correlation of what is left of "
        "both after a linear fit to those of the other parameters that vary over these rows; one that "
        "was constant in some of them counts with its constant there. df = n - 2 - number of the others; "
        "intervals by Fisher's z with them. A linear fit does not take out a curved dependence.",
        study.provenance(),
    ]
