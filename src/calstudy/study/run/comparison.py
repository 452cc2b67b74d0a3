"""A row of two studies, compared DEM run by DEM run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calstudy.plan import PARAMETERS
from calstudy.records import ROUNDING, Phase, Request
from calstudy.study.reading import Study
from calstudy.study.schema import VARYING

SAME_NOT_ASKED = ("study", "calstudy", "engine", "run_id", "dem_run_id", *VARYING)
"""Columns that say who made a line, not its result."""
OF_A_RULE = "reachable_"
"""Prefix of columns that are a verdict on what came out, by the rule of the version that wrote them."""


NEGLIGIBLE = 1e-9
"""Numbers of a calibration that differ by less are equal: sums of squares of exact fits are rounding."""
OF_FITS = ("leave_one_out_rmse_", "kriging_noise_")
"""Columns of the quality of fits: small differences of large numbers, which ROUNDING of these changes."""


@dataclass(frozen=True, slots=True)
class RowComparison:
    """Comparison of one row of two studies."""

    row: int
    runs: int
    """DEM runs of the first study's row."""
    runs_again: int
    """DEM runs of the second study's row."""
    equal: int
    """Runs that are equal to the last digit, up to the first that is not."""
    first_difference: str
    """Phase and number of the first run that differs. If all runs are equal, the columns of the calibration
    that differ by more than rounding; "" if there are none."""
    largest: dict[str, float]
    """Largest difference of each response over samples, and further cheap runs, with equal parameters."""

    @property
    def same(self) -> bool:
        """Whether the row is the same in both studies."""
        return not self.first_difference


def compare_row(first: Study, second: Study, row: int) -> RowComparison:
    """Compare a row that is finished in both studies: runs digit by digit, the calibration to ROUNDING."""
    runs, again = (_ordered(study.evaluations, row) for study in (first, second))
    columns = [name for name in runs.columns if name not in SAME_NOT_ASKED]
    equal = 0
    for one, other in zip(_lines(runs, columns), _lines(again, columns), strict=False):
        if one != other:
            break
        equal += 1
    longest = max((runs, again), key=len)
    difference = ""
    if equal < len(longest):
        at = longest.iloc[equal]
        difference = f"{at['phase']} {at['index']}"
    else:
        found = [_of_row(study.calibrations, row) for study in (first, second)]
        columns = [
            name
            for name in first.calibrations.columns
            if name not in SAME_NOT_ASKED and not name.startswith(OF_A_RULE)
        ]
        line, other_line = (dict(zip(columns, _lines(table, columns)[0], strict=True)) for table in found)
        difference = ", ".join(name for name in columns if not _agree(name, line, other_line))
    measured = first.settings.quantities.targets
    samples, others = (_samples(table) for table in (runs, again))
    others = others.reindex(samples.index)
    there, again_there = (table[[*PARAMETERS]] for table in (samples, others))
    same = np.isclose(there, again_there, rtol=ROUNDING, atol=0.0).all(axis=1)
    apart = (samples[[*measured]] - others[[*measured]]).abs()[same]
    largest = {name: float(apart[name].max()) for name in measured}
    return RowComparison(row, len(runs), len(again), equal, difference, largest)


def requests_of(study: Study, rows: Sequence[int]) -> list[Request]:
    """Requests of rows of a study."""
    chosen = study.evaluations[study.evaluations["row"].isin(rows)]
    return [
        Request(
            row=int(line["row"]),
            phase=Phase(line["phase"]),
            index=int(line["index"]),
            parameters={name: float(line[name]) for name in PARAMETERS},
            seed=int(line["seed"]),
        )
        for line in chosen.to_dict("records")
    ]


def times_of(study: Study, row: int) -> dict[tuple[Phase, int], float]:
    """Processor time in s of each run of a row, by its phase and number."""
    runs = _of_row(study.evaluations, row)
    keys = zip(map(Phase, runs["phase"]), map(int, runs["index"]), strict=True)
    return dict(zip(keys, map(float, runs["cpu_time"]), strict=True))


def _samples(runs: pd.DataFrame) -> pd.DataFrame:
    """Samples and cheap runs of a row by phase and number."""
    return runs[runs["phase"].isin([Phase.SAMPLING, Phase.CHEAP])].set_index(["phase", "index"])


def _agree(column: str, line: Mapping[str, object], again: Mapping[str, object]) -> bool:
    """Whether two calibrations agree in a column except for rounding."""
    one, other = line[column], again[column]
    if not (isinstance(one, float) and isinstance(other, float)):
        return one == other
    fitted = next((column.removeprefix(prefix) for prefix in OF_FITS if column.startswith(prefix)), "")
    response = line.get(f"dem_{fitted}")
    least = ROUNDING * abs(response) if isinstance(response, float) else NEGLIGIBLE
    return math.isclose(one, other, rel_tol=ROUNDING, abs_tol=least)


def _of_row(table: pd.DataFrame, row: int) -> pd.DataFrame:
    return table[table["row"] == row]


def _ordered(evaluations: pd.DataFrame, row: int) -> pd.DataFrame:
    """Runs of a row in the order of their requests."""
    runs = _of_row(evaluations, row)
    phase = runs["phase"].map({str(phase): k for k, phase in enumerate(Phase)})
    return runs.assign(order=phase).sort_values(["order", "index"], ignore_index=True).drop(columns="order")


def _lines(table: pd.DataFrame, columns: list[str]) -> list[tuple[object, ...]]:
    """Lines whose missing values equal each other."""
    plain = table[columns].astype(object).where(table[columns].notna(), None)
    return list(plain.itertuples(index=False, name=None))
