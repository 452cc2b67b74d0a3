"""Both modes on real LIGGGHTS: what rows of the plan cost, and how good what they found is.

    python benchmarks/real_rows.py design reports/coarse-rows        (writes again/design.csv)
    calstudy sweep reports/coarse-rows/again/design.csv --out reports/coarse-rows/again
    python benchmarks/real_rows.py table reports/coarse-rows

The folder holds a study of each mode, ``paper/`` and ``robust/``, with the same target. A mode that takes the
luckiest of many noisy runs looks better than it is, so both modes' optima are run again with fresh seeds: the
same for all. From them come the sum of squares of the mean residuals (time-step included), the
scatter of the mean taken off, and its standard error by leaving out one seed at a time.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd

from calstudy.parameters import Array
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.study.reading import Study, read_study
from calstudy.study.sweep import DESIGN_COLUMNS

MODES = ("paper", "robust")
SEEDS = range(9001, 9009)


def studies(folder: Path) -> tuple[dict[str, Study], list[int]]:
    """Study of each mode, and the rows that both have."""
    found = {mode: read_study(folder / mode) for mode in MODES}
    rows = set.intersection(*(set(study.ok["row"]) for study in found.values()))
    if found["paper"].settings.target != found["robust"].settings.target:
        raise SystemExit(f"{folder}: the two studies have different targets")
    return found, sorted(map(int, rows))


def design(folder: Path) -> None:
    """Write the optima as a design for ``calstudy sweep``."""
    found, rows = studies(folder)
    lines = []
    for seed in SEEDS:
        for row in rows:
            for mode, study in found.items():
                best = study.ok.set_index("row").loc[row]
                about = (f"{mode} {row}", study.settings.fidelity, study.settings.variant, seed)
                lines.append([*about, *(best[f"dem_{name}"] for name in PARAMETERS)])
    path = folder / "again" / "design.csv"
    path.parent.mkdir(exist_ok=True)
    pd.DataFrame(lines, columns=list(DESIGN_COLUMNS)).to_csv(path, index=False, float_format="%.17g")
    print(f"{path}: {len(lines)} runs")


def sum_of_squares(each: Array) -> float:
    """Sum of squares of the mean residuals, without what their scatter adds; may be below zero."""
    return float(np.sum(each.mean(axis=0) ** 2 - each.var(axis=0, ddof=1) / len(each)))


def table(folder: Path) -> None:
    """Print the rows side by side, and the means."""
    plan = load_plan()
    found, rows = studies(folder)
    again = pd.read_parquet(folder / "again" / "runs.parquet")
    print(
        "| row | WRL | parameters | samples | second optimisation, paper | robust "
        "| sum of squares as found, paper | robust | run again, paper | robust |"
    )
    print("|" + "---|" * 10)
    means = []
    for row in rows:
        cells = []
        for mode, study in found.items():
            best = study.ok.set_index("row").loc[row]
            runs = again[(again["label"] == f"{mode} {row}") & (again["outcome"] == "ok")]
            each = study.residuals(row, runs)
            left_out = [sum_of_squares(np.delete(each, k, axis=0)) for k in range(len(each))]
            error = np.sqrt((len(each) - 1) * np.var(left_out))
            cells.append((best["runs_optimisation"], best["dem_sum_of_squares"], sum_of_squares(each), error))
        (runs_p, found_p, true_p, error_p), (runs_r, found_r, true_r, error_r) = cells
        means.append([runs_p, runs_r, found_p, found_r, true_p, true_r])
        of = plan.row(row)
        print(
            f"| {row} | {of.WRL:g} | {len(of.calibrated)} | {of.samples} | {runs_p} | {runs_r} "
            f"| {found_p:.5f} | {found_r:.5f} | {true_p:.5f} ± {error_p:.5f} | {true_r:.5f} ± {error_r:.5f} |"
        )
    runs_p, runs_r, *rest = np.mean(means, axis=0)
    print(f"| mean | | | | {runs_p:.1f} | {runs_r:.1f} | {' | '.join(f'{value:.5f}' for value in rest)} |")


def main() -> None:
    """Parse and do."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", choices=("design", "table"))
    parser.add_argument("folder", type=Path)
    a = parser.parse_args()
    {"design": design, "table": table}[a.work](a.folder)


if __name__ == "__main__":
    main()
