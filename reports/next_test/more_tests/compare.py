"""The six rows on LIGGGHTS beside the same rows of the replicates: the pull of WRL on the Kriging optima.

    python reports/next_test/more_tests/compare.py

The rows on LIGGGHTS end at the first run of the second optimisation (budget 1), the replicates do not. What
both have is the Kriging optimum, from 18 samples. A line for each number of tests and parameter in
liggghts.csv: its place in the interval with WRL 1 less that with WRL 0 on LIGGGHTS, and the quantiles of the
same difference over the replicates, each with a truth of its own.
"""

from pathlib import Path

import pandas as pd

from calstudy.analysis.by_tests.rows import rows
from calstudy.plan import PARAMETERS
from calstudy.study.reading import read_study

HERE = Path(__file__).parent
LEVELS = (0.05, 0.5, 0.95)


def pulls(lines):
    """Pull on each parameter by number of tests, of rows with 3 samples for each parameter."""
    chosen = lines[lines["SPP"] == 3].set_index(["TESTS", "WRL"])
    columns = [f"kriging_{name}" for name in PARAMETERS]
    return (chosen.xs(1.0, level="WRL")[columns] - chosen.xs(0.0, level="WRL")[columns]).dropna()


def main():
    """Write the table."""
    there = pulls(rows(read_study(HERE / "liggghts")))
    replicates = pd.read_parquet(HERE / "emulated" / "by_tests.parquet")
    each = replicates.groupby("replicate").apply(pulls, include_groups=False)
    lines = []
    for tests, line in there.iterrows():
        for name in PARAMETERS:
            of = each.xs(tests, level="TESTS")[f"kriging_{name}"]
            quantiles = dict(zip(("low", "median", "high"), of.quantile(LEVELS), strict=True))
            found = {"tests": int(tests), "parameter": name, "liggghts": line[f"kriging_{name}"]}
            lines.append(found | quantiles | {"replicates": len(of)})
    table = pd.DataFrame(lines)
    table.to_csv(HERE / "liggghts.csv", index=False, float_format="%.4g", lineterminator="\n")


if __name__ == "__main__":
    main()
