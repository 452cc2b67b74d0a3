"""Table 2 (section 2.3.4): the interval of each parameter, and its value if it is not calibrated."""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.plan import FACTORS
from calstudy.study.reading import Study

TITLE = "Table 2: parameter intervals in the calibration"
COLUMNS = (
    Column("parameter", "Parameter"),
    Column("lower", "Lower", "g"),
    Column("upper", "Upper", "g"),
    Column("unit", "Unit"),
    Column("included", "Included?"),
    Column("constant", "Value if excluded", "g"),
    Column("rows_calibrated", "Rows of this study", "d"),
)


def table2(study: Study) -> pd.DataFrame:
    """Intervals of the study's plan, and the number of successful rows that calibrated each parameter."""
    lines = [
        {
            "parameter": p.name,
            "lower": p.lower,
            "upper": p.upper,
            "unit": p.unit,
            "included": "by the plan" if p.name in FACTORS else "always",
            "constant": float("nan") if p.constant is None else p.constant,
            "rows_calibrated": len(study.where_calibrated(p.name)),
        }
        for p in study.plan.parameters
    ]
    return pd.DataFrame(lines)


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return [
        "Intervals and constants are input; the last column counts the successful rows that calibrated a "
        "parameter.",
        study.provenance(),
    ]
