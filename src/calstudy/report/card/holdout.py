"""Hold-out: whether the optimum gives what it was not calibrated to."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calstudy.analysis.exhibit import Column, Table
from calstudy.records import Phase
from calstudy.study.definition.holdout import HeldOut
from calstudy.study.reading import Result


@dataclass(frozen=True, slots=True)
class Held:
    """A response that was held out, with the mean of the runs at the optimum, in its unit."""

    of: HeldOut
    mean: float
    """NaN where no run gave it."""
    standard_error: float
    """From the scatter of the runs; NaN for a single one."""
    runs: int
    fresh: bool
    """Whether the runs confirm the optimum with fresh seeds; else it is the one that it was chosen by."""

    @property
    def passed(self) -> bool:
        """Whether the mean is within the tolerance of the value: the criterion that the file fixed."""
        return abs(self.mean - self.of.value) <= self.of.tolerance


def held_out(result: Result) -> list[Held]:
    """What the runs at the optimum give of each response that was held out.

    Runs with fresh seeds count alone where there are any: a heap that was chosen for its luck in one response
    is lucky in another.
    """
    runs = result.evaluations
    names = list(result.definition.task.space.box.names)
    there = runs[np.all(runs[names].to_numpy(float) == np.array([*result.optimum.values()]), axis=1)]
    again = there[there["phase"] == Phase.CONFIRMATION]
    best = there[there["run_id"].isin(str(result.line["dem_run_id"]).split("+"))]
    found = []
    for one in result.definition.held_out:
        values = again[one.response].dropna().to_numpy(float)
        is_fresh = len(values) > 0
        if not is_fresh:
            values = best[one.response].dropna().to_numpy(float)
        n = len(values)
        error = float(values.std(ddof=1)) / math.sqrt(n) if n > 1 else math.nan
        found.append(Held(one, float(values.mean()) if n else math.nan, error, n, is_fresh))
    return found


def holdout_table(result: Result) -> Table:
    """Each response that was held out, its criterion, and whether it passed."""
    lines = [
        {
            "response": held.of.response,
            "value": held.of.value,
            "tolerance": held.of.tolerance,
            "mean": held.mean,
            "standard_error": held.standard_error,
            "runs": held.runs,
            "unit": held.of.unit,
            "verdict": "passed" if held.passed else "FAILED",
        }
        for held in held_out(result)
    ]
    columns = (
        Column("response", "Response"),
        Column("value", "Measured", ".5g"),
        Column("tolerance", "Tolerance", ".3g"),
        Column("mean", "Mean at the optimum", ".5g"),
        Column("standard_error", "Its standard error", ".2g"),
        Column("runs", "Runs"),
        Column("unit", "Unit"),
        Column("verdict", "Verdict"),
    )
    note = (
        "Not calibrated to. The criterion was fixed before any run: the mean of the runs with fresh seeds is "
        "within the tolerance."
    )
    if any(not held.fresh for held in held_out(result)):
        note += " Without runs that confirm the optimum (confirm), its own run stands in for them."
    return Table("holdout", "Hold-out", pd.DataFrame(lines), columns, [note])


def holdout_in_words(result: Result) -> str:
    """The verdicts in a line; empty where nothing was held out."""
    return "; ".join(
        f"hold-out {held.of.response} {'passed' if held.passed else 'FAILED'}: {held.mean:.4g}, measured "
        f"{held.of.value:.4g} +- {held.of.tolerance:.3g} {held.of.unit}"
        for held in held_out(result)
    )
