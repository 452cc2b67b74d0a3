"""Table B-1 (Appendix B): the experimental plan, with the state of each row in this study."""

from __future__ import annotations

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.plan import TESTS
from calstudy.study.reading import Study

TITLE = "Table B-1: experimental plan, and the state of its rows in this study"
COLUMNS = (
    Column("run", "no.", "d"),
    Column("WRL", "WRL", "g"),
    Column("SPP", "SPP", "d"),
    Column("MU_PP", "MU_PP", "d"),
    Column("MU_PW", "MU_PW", "d"),
    Column("YM", "YM", "d"),
    Column("RF_PW", "RF_PW", "d"),
    Column(TESTS, TESTS, "d"),
    Column("state", "this study"),
)


def table_b1(study: Study) -> pd.DataFrame:
    """Rows of the plan; ``state`` is ok, failed or not finished."""
    outcome = dict(zip(study.calibrations["row"], study.calibrations["outcome"], strict=True))
    return pd.DataFrame(
        [study.plan.cells(row) | {"state": outcome.get(row.run, "not finished")} for row in study.plan.rows]
    )


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    return ["Of the switches MU_PP to RF_PW, 1 means calibrated, 0 constant.", study.provenance()]
