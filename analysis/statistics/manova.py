"""Multivariate analysis of variance as in section 3.2: R's ``manova``, sequential, with Pillai's trace.

Every term has one degree of freedom, so Pillai's, Wilks', Hotelling-Lawley's and Roy's statistics give
one and the same exact F. Both sides are centred and scaled: in raw units (1500 beside 3e-5, and products
of 2500 and 5e8) statsmodels loses rank without a word.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from calstudy.analysis.statistics.estimates import Estimate, is_constant, partial_eta_squared
from calstudy.errors import InputError
from calstudy.parameters import Array

LEAST_RESPONSES = 2
"""Of fewer a test is no multivariate one, and statsmodels refuses it."""
TOLERANCE = 1e-7
"""A column whose share that is new is smaller is aliased, or fitted exactly: the tolerance of R's ``lm``."""


@dataclass(frozen=True, slots=True)
class TermTest:
    """Test of one term."""

    pillai: float
    f: float
    num_df: int
    den_df: int
    p: float

    def partial_eta_squared(self, n: int) -> Estimate:
        """The term's share of the variance of the term and the residuals."""
        return partial_eta_squared(self.f, self.num_df, self.den_df, n)


@dataclass(frozen=True, slots=True)
class Manova:
    """Tests by term, those that could not be made with their reason, and what else was left out."""

    n: int
    residual_df: int
    responses: tuple[str, ...]
    sequential: Mapping[str, TermTest]
    """Each term after those before it, as R's ``manova`` has it."""
    marginal: Mapping[str, TermTest]
    """Each term after all others (type III, centred columns), which no order changes."""
    untested: Mapping[str, str]
    """Reason by term."""
    left_out: Mapping[str, str]
    """Reason by response that the test had to do without."""


def terms_of(factors: Sequence[str]) -> list[str]:
    """Main effects, then two-factor interactions, in R's order of ``(A+B+C)^2``."""
    return [*factors, *(f"{a}:{b}" for a, b in combinations(factors, 2))]


def manova(factors: pd.DataFrame, responses: pd.DataFrame, terms: Sequence[str] = ()) -> Manova:
    """Test ``terms`` (default: main effects and two-factor interactions) on all ``responses`` at once.

    Both frames have one line for each row of the plan. A term is a column of ``factors`` or a product of some
    (``A:B``), taken as a number with one degree of freedom. A category with more than two levels must be
    given as several columns. If the data allow no test, for example because only one response is usable, the
    reason is in ``untested``. InputError: fewer than two responses, a value that is not a finite number, or a
    term that is not in ``factors``.
    """
    n = len(factors)
    terms = list(terms) or terms_of(list(factors.columns))
    _require_numbers(factors, responses, terms)
    columns, untested = _independent_columns(factors, terms)
    kept = list(columns)
    y, left_out = _usable_responses(responses)
    # The intercept comes first, then one coefficient for each term that is kept.
    residual_df = n - 1 - len(kept)
    # With fewer, the residuals are dependent because rows are too few, not because of a response.
    if kept and residual_df >= max(1, y.shape[1]):
        q, r = np.linalg.qr(np.column_stack([np.ones(n), *columns.values()]))
        y, left_out = _not_fitted(y, q, left_out)
    needed = max(1, y.shape[1])
    if not kept:
        reason = "no term varies"
    elif y.shape[1] < LEAST_RESPONSES:
        left = f"{y.columns[0]} alone" if y.shape[1] else "no response"
        reason = f"{left} is left to test: " + "; ".join(f"{k} is {v}" for k, v in left_out.items())
    elif residual_df < needed:
        reason = (
            f"n = {n} rows and {len(kept)} estimable terms of {len(terms)} leave {max(residual_df, 0)} "
            f"residual degree(s) of freedom; the test of {needed} response(s) needs {needed}"
        )
        untested = {}
    else:
        sequential = _tests(y.to_numpy(), q, np.eye(len(kept) + 1)[1:], kept)
        # Coefficient k of the columns in their own coding is row k of the inverse of R times Q's.
        marginal = _tests(y.to_numpy(), q, np.linalg.inv(r)[1:], kept)
        return Manova(n, residual_df, tuple(y.columns), sequential, marginal, untested, left_out)
    untested = {term: untested.get(term, reason) for term in terms}
    return Manova(n, max(residual_df, 0), tuple(y.columns), {}, {}, untested, left_out)


def _require_numbers(factors: pd.DataFrame, responses: pd.DataFrame, terms: Sequence[str]) -> None:
    """Raise InputError if the frames do not hold finite numbers of at least two responses."""
    if responses.shape[1] < LEAST_RESPONSES:
        raise InputError(
            f"manova: {responses.shape[1]} response(s); give {LEAST_RESPONSES} or more, and take an analysis "
            "of variance for one"
        )
    unknown = {part: term for term in terms for part in term.split(":") if part not in factors.columns}
    for part, term in unknown.items():
        raise InputError(
            f"manova: the term {term!r} asks for {part!r}, which is no column of the factors; a term is a "
            "column or a product of columns, A:B"
        )
    for frame in (factors, responses):
        for name in frame.columns:
            column = frame[name]
            if not (pd.api.types.is_numeric_dtype(column) or pd.api.types.is_bool_dtype(column)):
                raise InputError(
                    f"manova: {name} is not numeric; a factor is a number with one degree of freedom: "
                    "give a category as columns of 0 and 1"
                )
            if not np.isfinite(column.to_numpy(float)).all():
                raise InputError(f"manova: {name} has values that are not finite; leave out these rows")


def _tests(y: Array, q: Array, hypotheses: Array, terms: list[str]) -> dict[str, TermTest]:
    """Test each hypothesis (a row) on the coefficients of the orthonormal columns ``q`` (n, k + 1)."""
    from statsmodels.multivariate.manova import MANOVA

    named = [(term, row[None, :] / np.linalg.norm(row)) for term, row in zip(terms, hypotheses, strict=True)]
    # statsmodels also computes Hotelling's F, which has a pole at p + 3 residual degrees of freedom.
    with np.errstate(divide="ignore", invalid="ignore"):
        found = MANOVA(y, q).mv_test(named, skip_intercept_test=True).results
    tests = {}
    for term in terms:
        line = found[term]["stat"].loc["Pillai's trace"]
        num_df, den_df = round(line["Num DF"]), round(line["Den DF"])
        tests[term] = TermTest(
            float(line["Value"]), float(line["F Value"]), num_df, den_df, float(line["Pr > F"])
        )
    return tests


def _independent_columns(
    factors: pd.DataFrame, terms: Sequence[str]
) -> tuple[dict[str, Array], dict[str, str]]:
    """Scaled columns (n,) of the terms independent of those before them, and reasons for the others."""
    n = len(factors)
    scaled = {name: _standardised(factors[name].to_numpy(float)) for name in factors.columns}
    kept: dict[str, Array] = {}
    untested: dict[str, str] = {}
    basis = np.full((n, 1), 1.0 / np.sqrt(max(n, 1)))
    for term in terms:
        parts = term.split(":")
        constant = [name for name in parts if scaled[name] is None]
        if constant:
            untested[term] = f"{' and '.join(constant)} constant over these {n} rows"
            continue
        column = np.prod(np.array([scaled[name] for name in parts], float), axis=0)
        # Twice, because once leaves rounding behind in columns that are almost dependent.
        new = column - basis @ (basis.T @ column)
        new -= basis @ (basis.T @ new)
        size = np.linalg.norm(new)
        if size <= TOLERANCE * np.linalg.norm(column):
            untested[term] = _aliased_with(column, kept)
            continue
        kept[term] = column
        basis = np.column_stack([basis, new / size])
    return kept, untested


def _aliased_with(column: Array, kept: Mapping[str, Array]) -> str:
    """Names of the columns (n,) of which an aliased column (n,) is a combination."""
    before = np.column_stack([np.ones(len(column)), *kept.values()])
    weights = np.linalg.lstsq(before, column, rcond=None)[0][1:]
    named = [term for term, weight in zip(kept, weights, strict=True) if abs(weight) > 1e-6]
    if not named:
        return "aliased: constant over these rows"
    return f"aliased: a combination of {', '.join(named[:4])}{' and others' if len(named) > 4 else ''}"


def _usable_responses(responses: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """Standardised responses that vary, and the names of those that do not."""
    scaled = {name: _standardised(responses[name].to_numpy(float)) for name in responses.columns}
    left_out = {name: "constant over these rows" for name, column in scaled.items() if column is None}
    kept = {name: column for name, column in scaled.items() if column is not None}
    return pd.DataFrame(kept, index=responses.index), left_out


def _not_fitted(
    y: pd.DataFrame, q: Array, left_out: Mapping[str, str]
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Leave out responses without independent residuals: fitted exactly, or repeating the others'."""
    gone = dict(left_out)
    kept: list[str] = []
    basis = np.empty((len(y), 0))
    for name in y.columns:
        column = y[name].to_numpy()
        residual = column - q @ (q.T @ column)
        if np.linalg.norm(residual) <= TOLERANCE * np.linalg.norm(column):
            gone[name] = "fitted exactly by the model, so that it has no residual to test against"
            continue
        new = residual - basis @ (basis.T @ residual)
        if np.linalg.norm(new) <= TOLERANCE * np.linalg.norm(residual):
            gone[name] = f"in its residuals a combination of {', '.join(kept)}"
            continue
        kept.append(name)
        basis = np.column_stack([basis, new / np.linalg.norm(new)])
    return y[kept], gone


def _standardised(column: Array) -> Array | None:
    """A column (n,) with mean 0 and standard deviation 1; None for a constant."""
    if is_constant(column):
        return None
    scaled: Array = (column - column.mean()) / column.std()
    return scaled
