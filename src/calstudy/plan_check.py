"""Checks of a plan: balance, word lengths, samples, and agreement with the published plan."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import prod

import numpy as np
from numpy.typing import ArrayLike

from calstudy.errors import InputError
from calstudy.parameters import Array
from calstudy.plan import FACTORS, FULL_FACTORIAL, Plan, Row
from calstudy.plan_file import load_plan


@dataclass(frozen=True, slots=True)
class Finding:
    """One check: its name, whether it passed, what was found, and what was expected."""

    name: str
    ok: bool
    found: str
    expected: str


@dataclass(frozen=True, slots=True)
class PlanCheck:
    """All findings on a plan, the most specific first."""

    plan: str
    origin: str
    findings: tuple[Finding, ...]
    samples: tuple[int, ...]
    """S of each row (Eq. 11), in the order of the rows."""
    word_lengths: tuple[float, ...]
    """A1 to A6; empty if a cell is not a level of its factor, because then they cannot be computed."""

    @property
    def ok(self) -> bool:
        """Whether every check passed."""
        return all(finding.ok for finding in self.findings)

    def refuse_if_wrong(self) -> None:
        """Raise InputError if a check failed, in one line that begins with row and column."""
        wrong = [finding for finding in self.findings if not finding.ok]
        if wrong:
            first, *others = wrong
            also = f" (also wrong: {', '.join(finding.name for finding in others)})" if others else ""
            where = self.origin or self.plan
            raise InputError(f"{where}: {first.found}; expected: {first.expected}{also}; correct the file")


def check(plan: Plan, reference: Plan | None = None) -> PlanCheck:
    """Check a plan. Nothing is raised: the findings say what is wrong.

    Each cell is compared with ``reference``; by default that is the embedded plan, if it has the same name or
    is the half of a full factorial. Only this comparison tells row and column of a wrong cell. An unbalanced
    plan shows the column, but not which of its rows is wrong.
    """
    if reference is None:
        embedded = load_plan()
        reference = embedded if plan.name in (embedded.name, FULL_FACTORIAL) else None
    findings = [_run_numbers(plan), _levels(plan)]
    if reference is not None:
        findings.insert(0, _same_cells(plan, reference))
    word_lengths: tuple[float, ...] = ()
    if findings[-1].ok and plan.rows:
        levels = [factor.levels for factor in plan.factors]
        table = [row.levels for row in plan.rows]
        word_lengths = tuple(map(float, word_length_pattern(table, levels)))
        findings += [_balance(plan, 1), _balance(plan, 2), _balance(plan, 3)]
        findings += [_distinct(plan), _samples(plan), _published(plan, word_lengths)]
    samples = tuple(row.samples for row in plan.rows)
    return PlanCheck(plan.name, plan.origin, tuple(findings), samples, word_lengths)


def word_length_pattern(table: ArrayLike, levels: Sequence[ArrayLike]) -> Array:
    """Generalised word length pattern A1 to Ak of a design, shape (k,).

    ``table`` (n, k) has one row for each run, ``levels`` the levels of each of the k factors; factors may
    have different numbers of levels. Aj sums, over all sets of j factors, the squared mean over the rows of
    every product of orthonormal contrasts (Xu & Wu 2001, doi:10.1214/aos/1013699993): 0 if the set is
    balanced, 1 for each contrast that is completely confounded. InputError: the table has no rows, other
    columns than ``levels``, or a value that is not a level.
    """
    cells = np.asarray(table, float)
    if cells.ndim != 2 or len(cells) == 0 or cells.shape[1] != len(levels):
        raise InputError(
            f"a design of {len(levels)} factors needs a table (n, {len(levels)}), not {cells.shape}"
        )
    contrasts = [_contrasts(cells[:, j], np.asarray(levels[j], float)) for j in range(len(levels))]
    pattern = np.zeros(len(levels))
    for size in range(1, len(levels) + 1):
        for chosen in combinations(contrasts, size):
            effects = np.ones((len(cells), 1))
            for columns in chosen:
                effects = (effects[:, :, None] * columns[:, None, :]).reshape(len(cells), -1)
            pattern[size - 1] += np.sum(effects.mean(axis=0) ** 2)
    return pattern


def _contrasts(column: Array, levels: Array) -> Array:
    """Orthonormal contrasts (n, s - 1) of a factor with s levels at each run; mean square 1 over levels."""
    match = column[:, None] == levels
    if not match.any(axis=1).all():
        raise InputError(f"{column[~match.any(axis=1)][0]:g} is not one of the levels {levels.tolist()}")
    scaled: Array = np.sqrt(len(levels)) * _helmert(len(levels)).T
    return scaled[match.argmax(axis=1)]


def _helmert(n: int) -> Array:
    """Orthonormal Helmert contrasts (n - 1, n): level k against the mean of those before it."""
    k = np.arange(n, dtype=float)
    rows = np.tril(np.ones((n, n)), -1) - np.diag(k)
    return np.asarray(rows[1:] / np.sqrt(k[1:] * (k[1:] + 1))[:, None])


def _same_cells(plan: Plan, reference: Plan) -> Finding:
    """Compare each cell with the row of the same run number in the reference.

    The further rows of a full factorial are checked by balance and by being different from all others.
    """
    published = {row.run: row for row in reference.rows}
    is_half = plan.name == FULL_FACTORIAL
    rows = [row for row in plan.rows if row.run in published] if is_half else list(plan.rows)
    first_with = {row.levels: row for row in reversed(reference.rows)}
    differing: list[tuple[Row, str]] = []
    for row in rows:
        twin = published.get(row.run)
        differing += [
            (row, name) for name in FACTORS if twin is None or getattr(row, name) != getattr(twin, name)
        ]
    name = reference.source.rows
    missing = sorted(published.keys() - {row.run for row in plan.rows})
    expected = f"every cell as in {name}"
    if differing:
        row, column = differing[0]
        twin = published.get(row.run)
        value = "has no such row" if twin is None else f"has {getattr(twin, column):g}"
        found = f"row {row.run}, column {column} has {getattr(row, column):g} where {name} {value}"
        double = first_with.get(row.levels)
        found += f", which makes it repeat row {double.run}" if double else ""
        found += f"; {len(differing) - 1} more cells differ" if len(differing) > 1 else ""
        return Finding("cells", False, found, expected)
    if missing:
        return Finding("cells", False, f"row {missing[0]}, column run is not there", expected)
    of = f" of rows 1 to {len(rows)}" if is_half else ""
    return Finding("cells", True, f"all {len(rows) * len(FACTORS)}{of} as in {name}", expected)


def _run_numbers(plan: Plan) -> Finding:
    """Whether each run number from 1 is there once."""
    counts = Counter(row.run for row in plan.rows)
    expected = f"1 to {plan.runs}, each once"
    for run in sorted(counts.keys() | set(range(1, plan.runs + 1))):
        if not 1 <= run <= plan.runs or counts[run] != 1:
            return Finding(
                "run numbers", False, f"row {run}, column run is there {counts[run]} times", expected
            )
    return Finding("run numbers", True, expected, expected)


def _levels(plan: Plan) -> Finding:
    """Whether each cell is a level of its factor."""
    expected = "; ".join(f"{f.name} {', '.join(f'{level:g}' for level in f.levels)}" for f in plan.factors)
    for row in plan.rows:
        for factor in plan.factors:
            value = getattr(row, factor.name)
            if value not in factor.levels:
                found = f"row {row.run}, column {factor.name} has {value:g}, which is not a level"
                return Finding("levels", False, found, expected)
    return Finding("levels", True, expected, expected)


def _balance(plan: Plan, size: int) -> Finding:
    """Whether all combinations of levels of every ``size`` factors are equally frequent."""
    what, many = {1: ("balance", "factors"), 2: ("pairs", "pairs"), 3: ("triples", "triples")}[size]
    sets = list(combinations(plan.factors, size))
    column = {factor.name: [getattr(row, factor.name) for row in plan.rows] for factor in plan.factors}
    expected = f"every combination of levels equally often in all {len(sets)} {many}"
    wrong = []
    times = set()
    for chosen in sets:
        names = [factor.name for factor in chosen]
        counts = Counter(zip(*(column[name] for name in names), strict=True))
        share = len(plan.rows) / prod(len(factor.levels) for factor in chosen)
        times.add(share)
        for levels in product(*(factor.levels for factor in chosen)):
            if counts[levels] != share:
                combination = ", ".join(f"{n}={level:g}" for n, level in zip(names, levels, strict=True))
                wrong.append(f"column {' with '.join(names)}: {combination} comes {counts[levels]} times")
                break
    if wrong:
        found = f"{wrong[0]}; {len(wrong)} of {len(sets)} {many} unbalanced"
        return Finding(what, False, found, expected)
    found = f"all {len(sets)}; each combination {', '.join(f'{n:g}' for n in sorted(times))} times"
    return Finding(what, True, found, expected)


def _distinct(plan: Plan) -> Finding:
    """Whether no two rows have the same levels."""
    expected = "no two rows with the same levels"
    first: dict[tuple[float, ...], int] = {}
    for row in plan.rows:
        if first.setdefault(row.levels, row.run) != row.run:
            columns = f"columns {plan.header[1]} to {plan.header[-1]}"
            found = f"row {row.run}, {columns} repeat row {first[row.levels]}"
            return Finding("distinct rows", False, found, expected)
    return Finding("distinct rows", True, f"{len(first)} different rows", expected)


def _samples(plan: Plan) -> Finding:
    """Whether the samples of all rows (Eq. 11) add up to the published number."""
    samples = [row.samples for row in plan.rows]
    total = plan.total_samples
    return Finding(
        "samples",
        total == plan.published.total_samples,
        f"{min(samples)} to {max(samples)} per row, {total} in all",
        f"{plan.published.total_samples} in all by Eq. 11",
    )


def _published(plan: Plan, word_lengths: Sequence[float]) -> Finding:
    """Compare A3, A4 and A5 with the published values at the printed number of decimals."""
    said, digits = plan.published, plan.published.decimals
    printed = {3: said.A3, 4: said.A4, 5: said.A5}
    ok = all(abs(word_lengths[j - 1] - value) <= 0.5 * 10**-digits for j, value in printed.items())
    found = ", ".join(f"A{j} {abs(value):.{digits}f}" for j, value in enumerate(word_lengths, start=1))
    expected = ", ".join(f"A{j} {value:.{digits}f}" for j, value in printed.items())
    is_whole = plan.runs == prod(len(factor.levels) for factor in plan.factors)
    source = "of all combinations" if is_whole else "as printed"
    return Finding("word lengths", ok, found, f"{expected} {source}")
