"""What more material tests buy: recovery, solution space, runs and the pull of WRL, by number of tests."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
import pandas as pd

from calstudy.analysis.by_tests.rows import rows
from calstudy.analysis.exhibit import Column
from calstudy.analysis.statistics.estimates import Estimate
from calstudy.plan import PARAMETERS, Plan
from calstudy.study.reading import Study

TITLE = "What more tests buy: recovery, solution space, DEM runs and the pull of WRL by number of tests"
MOST = 4
"""Tests of the shipped plan."""
COLUMNS = (
    Column("quantity", "Quantity"),
    Column("parameter", "Parameter"),
    *(
        Column(f"tests_{k}", f"{k} test{'s' * (k > 1)} [95 %]", ".3g", f"low_{k}", f"high_{k}")
        for k in range(1, MOST + 1)
    ),
)
EVEN = 1.0 / np.sqrt(12.0)
"""Standard deviation of a parameter that is even over its interval."""
NORMAL = 1.96

Statistic = Callable[..., float]
"""A number of the rows with one number of tests, about a ``parameter``."""


def off(lines: pd.DataFrame, parameter: str) -> float:
    """Root mean square distance of the DEM optimum from the truth, as a share of the interval; WRL 0."""
    found = lines.loc[lines["WRL"] == 0, f"off_{parameter}"]
    return float(np.sqrt(np.mean(found**2)))


def left(lines: pd.DataFrame, parameter: str) -> float:
    """Root mean square width of the solution space as a share of that of the whole interval; WRL 0."""
    found = lines[f"sd_{parameter}"].dropna()
    return float(np.sqrt(np.mean(found**2)) / EVEN)


def volume(lines: pd.DataFrame, parameter: str = "") -> float:
    """Share of the box's volume that is left: e to the power of minus the mean nats; WRL 0."""
    return float(np.exp(-lines["nats"].dropna().mean()))


def runs(lines: pd.DataFrame, parameter: str = "") -> float:
    """Mean number of DEM runs, of all tests."""
    return float(lines["runs"].mean())


def sets(lines: pd.DataFrame, parameter: str = "") -> float:
    """Mean number of parameter sets that were run."""
    return float(lines["sets"].mean())


def pull(lines: pd.DataFrame, parameter: str) -> float:
    """Mean place of the DEM optimum in its interval with WRL 1 less that with WRL 0."""
    at = lines.groupby("WRL")[f"at_{parameter}"].mean()
    return float(at.get(1.0, np.nan) - at.get(0.0, np.nan))


QUANTITIES: tuple[tuple[str, Statistic, tuple[str, ...]], ...] = (
    ("distance of the optimum from the truth, share of the interval", off, PARAMETERS),
    ("width of the solution space, share of the interval's", left, PARAMETERS),
    ("volume of the solution space, share of the box", volume, ("",)),
    ("pull of WRL from 0 to 1, share of the interval", pull, PARAMETERS),
    ("parameter sets", sets, ("",)),
    ("DEM runs", runs, ("",)),
)
"""Name, statistic and parameters of each group of lines."""


def by_tests(study: Study) -> pd.DataFrame:
    """One line for each quantity and parameter; a column, with its interval, for each number of tests."""
    return table_of(lines_of(study), study.plan)


@lru_cache(maxsize=2)
def lines_of(study: Study) -> pd.DataFrame:
    """Rows of the replicates, or of the study itself where there are none."""
    return rows(study).assign(replicate=0) if study.replicated_tests is None else study.replicated_tests


def table_of(lines: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """The same of rows of replicates (columns of `rows`, and ``replicate``)."""
    found = []
    for quantity, statistic, parameters in QUANTITIES:
        for parameter in parameters:
            line: dict[str, object] = {"quantity": quantity, "parameter": parameter}
            for k in range(1, len(plan.tests) + 1):
                of = lines[lines["TESTS"] == k]
                e = jackknifed(of, partial(statistic, parameter=parameter))
                line |= {f"tests_{k}": e.value, f"low_{k}": e.low, f"high_{k}": e.high}
            found.append(line)
    return pd.DataFrame(found)


def jackknifed(lines: pd.DataFrame, statistic: Callable[[pd.DataFrame], float]) -> Estimate:
    """A number of some rows, with the 95 % interval by leaving out one replicate at a time.

    NaN without rows; an interval needs two replicates.
    """
    numbers = lines["replicate"].unique()
    if lines.empty:
        return Estimate(np.nan, np.nan, np.nan, 0, "no row is finished")
    value = statistic(lines)
    without = np.array([statistic(lines[lines["replicate"] != number]) for number in numbers])
    n = len(numbers)
    if n < 2:
        return Estimate(value, np.nan, np.nan, n)
    error = np.sqrt((n - 1) / n * np.sum((without - without.mean()) ** 2))
    return Estimate(value, value - NORMAL * error, value + NORMAL * error, n)


def provenance(study: Study) -> str:
    """What the numbers are of."""
    lines = lines_of(study)
    if study.replicated_tests is None:
        return study.provenance()
    settings = study.settings
    return (
        f"{lines['replicate'].nunique()} replicates of the plan's {study.planned} rows on {settings.engine}, "
        f"each with samples, noise, draw and truth of its own; {settings.at}, {settings.mode} mode."
    )


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    named = [f"{test.model} ({', '.join(test.targets)})" for test in study.plan.tests]
    tests = "; ".join(f"{k}: {name}" for k, name in enumerate(named, start=1))
    return [
        f"Tests, each with those before it: {tests}.",
        "Distance, width and volume: rows with WRL 0. Of truths that are even over the middle eight tenths "
        "of the interval a guess that is even over all of it is off by 0.37, the centre by 0.23. Width and "
        "volume: by each row's own runs, with a target that scatters as one DEM run does. Intervals leave "
        "out one replicate at a time.",
        provenance(study),
    ]
