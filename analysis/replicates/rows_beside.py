"""Rows that were calibrated on the DEM model beside the same rows on draws of its emulator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.labels import LABELS
from calstudy.analysis.statistics.estimates import LEVELS, band, percentile
from calstudy.plan import PARAMETERS
from calstudy.records import RAYLEIGH_TIME_STEP
from calstudy.study.reading import OPTIMA, Study

TITLE = "Rows calibrated on the DEM model, among their replicates on the emulator"
COLUMNS = (
    Column("row", "Row", "d"),
    Column("of", "Of"),
    Column("quantity", "Quantity"),
    Column("value", "DEM model", "z.5g"),
    Column("median", "Emulator: median [5 %; 95 %]", "z.5g", "low", "high"),
    Column("inside", "In the band"),
    Column("percentile", "DEM model lies at %", ".0f"),
    Column("n", "Replicates", "d"),
)
SAMPLES, SUM_OF_SQUARES = "samples", "sum of squares"
ROUNDING = 1e-9
"""Relative tolerance of a band without width, such as that of a parameter on its bound in every replicate."""


def rows_beside(study: Study) -> pd.DataFrame:
    """One line for each quantity of a row: its value on the DEM model and its band over the replicates."""
    replicates = replicates_beside(study)
    lines = []
    for row in rows_in_both(study).to_dict("records"):
        there = replicates[replicates["row"] == row["row"]]
        for (of, quantity), column in quantities(study, row).items():
            at = {"row": row["row"], "of": of, "quantity": quantity}
            lines.append(at | among(float(row[column]), there[column]))
    return pd.DataFrame(lines, columns=[name for c in COLUMNS for name in (c.name, c.low, c.high) if name])


def among(value: float, replicates: pd.Series) -> dict[str, object]:
    """A number of the DEM model in the band of its replicates: whether it is inside, and its percentile."""
    b = band(replicates)
    is_inside = b.low - ROUNDING * abs(value) <= value <= b.high + ROUNDING * abs(value)
    return {
        "value": value,
        "median": b.median,
        "low": b.low,
        "high": b.high,
        "inside": "" if math.isnan(b.median) else "yes" if is_inside else "no",
        "percentile": percentile(value, replicates),
        "n": b.n,
    }


def expected(table: pd.DataFrame) -> float:
    """Mean share of values inside bands of n replicates, if they were further replicates.

    A quantile of n values is itself uncertain: a further one lies between two of them with (n - 1) / (n + 1)
    of the probability between their levels.
    """
    n = table.loc[table["inside"] != "", "n"]
    return float((LEVELS[1] - LEVELS[0]) * ((n - 1) / (n + 1)).mean())


def replicates_beside(study: Study) -> pd.DataFrame:
    """Successful calibrations of the replicates of the study beside this one; there must be some."""
    other = study.beside
    assert other is not None and other.replicated_rows is not None, "the report asks for it there alone"
    found = other.replicated_rows
    return found[found["outcome"] == "ok"]


def rows_in_both(study: Study) -> pd.DataFrame:
    """Successful calibrations of those rows that were also replicated."""
    return study.ok[study.ok["row"].isin(replicates_beside(study)["row"])]


def quantities(study: Study, row: Mapping[Any, Any]) -> dict[tuple[str, str], str]:
    """Column of each quantity of a calibration, by its part (samples or an optimum) and its name."""
    units = study.settings.quantities.units
    targets = study.settings.target.values
    named = {r: f"{LABELS[r]}, {units[r]}" for r in (*targets, RAYLEIGH_TIME_STEP)}
    free = [p for p in PARAMETERS if row[f"calibrated_{p}"]]
    found = {
        (SAMPLES, f"{word} {named[r]}"): f"sampled_{r}_{end}"
        for r in targets
        for word, end in (("smallest", "min"), ("largest", "max"))
    }
    for model, of in OPTIMA.items():
        found |= {(of, p if units[p] == "-" else f"{p}, {units[p]}"): f"{model}_{p}" for p in free}
        found |= {(of, name): f"{model}_{r}" for r, name in named.items()}
        found[of, SUM_OF_SQUARES] = f"{model}_sum_of_squares"
    found[OPTIMA["dem"], LABELS["runs_optimisation"]] = "runs_optimisation"
    return found


def provenance(study: Study) -> list[str]:
    """Origin of both sides, for captions."""
    other, there = study.beside, replicates_beside(study)
    assert other is not None
    failed = len(other.replicated_rows if other.replicated_rows is not None else ()) - len(there)
    without = sorted(set(study.ok["row"]) - set(there["row"]))
    return [
        f"DEM model: {study.provenance()}",
        f"Emulator: {there['replicate'].nunique()} replicates, each with samples and noise of its own seed "
        f"on its own draw of {other.settings.engine}."
        + (f" {failed} calibrations failed and are left out." if failed else "")
        + (f" Not replicated: row {', '.join(map(str, without))}." if without else ""),
    ]


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    table = rows_beside(study)
    inside, all_of = (int(table["inside"].isin(said).sum()) for said in (("yes",), ("yes", "no")))
    return [
        f"{inside} of {all_of} values found on the DEM model lie in the bands. Were a calibration on the "
        f"emulator the same as one on the DEM model, {expected(table):.0%} would on average, though not "
        "independently: the numbers of a row depend on each other. DEM model lies at: share of the "
        "replicates below, equal ones half.",
        *provenance(study),
    ]
