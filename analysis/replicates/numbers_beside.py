"""The paper's numbers from rows on the DEM model, among those of the same rows on draws of its emulator."""

from __future__ import annotations

import math

import pandas as pd

from calstudy.analysis.exhibit import Column
from calstudy.analysis.published import BETWEEN_DECKS
from calstudy.analysis.replicates.bands import notes_on, replicated
from calstudy.analysis.replicates.bands import provenance as of_replicates
from calstudy.analysis.replicates.bands_beside import beside
from calstudy.analysis.replicates.entries import entries
from calstudy.analysis.replicates.rows_beside import among, expected
from calstudy.study.reading import Study

TITLE = "The paper's numbers from the DEM model, among those of the same rows on the emulator"
COLUMNS = (
    Column("where", "Where"),
    Column("entry", "Entry"),
    Column("published", "Published", "z.4g"),
    Column("value", "DEM model", "z.4g"),
    Column("median", "Emulator: median [5 %; 95 %]", "z.4g", "low", "high"),
    Column("inside", "In the band"),
    Column("percentile", "DEM model lies at %", ".0f"),
    Column("n", "Replicates", "d"),
)


def numbers_beside(study: Study) -> pd.DataFrame:
    """One line a number of Tables 3 to 6 or of the ledger that the rows of the DEM model give."""
    own = entries(study.only(common_rows(study))).to_dict("records")
    here = {(line["where"], line["entry"]): line for line in own}
    there = replicated(beside(study)).groupby(["where", "entry"], sort=False)["value"]
    lines = []
    for (where, entry), values in there:
        line = here[where, entry]
        if not math.isnan(line["value"]):
            at = {"where": where, "entry": entry, "published": float(line["published"])}
            lines.append(at | among(float(line["value"]), values))
    return pd.DataFrame(lines, columns=[name for c in COLUMNS for name in (c.name, c.low, c.high) if name])


def common_rows(study: Study) -> set[int]:
    """Rows that are finished on the DEM model and were replicated, failed calibrations included.

    Where the replicates' numbers are there alone, both have all rows of the plan.
    """
    replicated_rows = beside(study).replicated_rows
    return set((study.calibrations if replicated_rows is None else replicated_rows)["row"])


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    table = numbers_beside(study)
    table = table[table["low"] < table["high"]]  # what is the plan's own, such as C19, proves nothing
    # The ledger has the tables' numbers, too.
    table = table.drop_duplicates(["value", "median", "low", "high"])
    inside, all_of = (int(table["inside"].isin(said).sum()) for said in (("yes",), ("yes", "no")))
    rows = len(common_rows(study))
    return [
        f"{inside} of {all_of} different numbers that vary, from {rows} of the plan's rows on the DEM model, "
        "lie in the bands of these rows on the emulator. Were both the same, "
        f"{expected(table):.0%} would on average, but not independently: a row enters many numbers. A figure "
        f"of the ledger enters with its value, whatever its interval. {notes_on()}",
        BETWEEN_DECKS,
        f"DEM model: {study.provenance()}",
        f"Emulator: {of_replicates(beside(study))}",
    ]
