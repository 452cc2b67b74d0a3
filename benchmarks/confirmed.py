"""Run the DEM optima of a study again: what the best of many noisy runs is worth.

    python benchmarks/confirmed.py design reports/soft/paper      (writes reports/soft/confirmed/design.csv)
    calstudy sweep reports/soft/confirmed/design.csv --out reports/soft/confirmed
    python benchmarks/confirmed.py table reports/soft/paper

``calstudy analyse`` then shows reported and confirmed side by side: table ``confirmed``, Figure 3, C01, C02.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from calstudy.analysis.fresh_runs import confirmed_label, runs_beside, with_confirmed
from calstudy.analysis.ledger.figures import close_again
from calstudy.analysis.statistics.estimates import Estimate, mean
from calstudy.analysis.tables.confirmed import confirmed, luck, notes
from calstudy.models.heap import ANGLE_OF_REPOSE
from calstudy.plan import PARAMETERS
from calstudy.study.reading import Study, read_study
from calstudy.study.sweep import Line, write_design

SEEDS = range(9101, 9105)


def design(directory: Path, out: Path) -> None:
    """Write each DEM optimum with each seed to ``out``, for ``calstudy sweep``."""
    study = read_study(directory)
    lines = [
        Line(
            confirmed_label(directory, int(line["row"])),
            study.settings.fidelity,
            study.settings.variant,
            seed,
            {name: float(line[f"dem_{name}"]) for name in PARAMETERS},
        )
        for seed in SEEDS
        for line in study.ok.to_dict("records")
    ]
    write_design(out, lines)
    print(f"{out}: {len(lines)} runs")


def said(estimate: Estimate) -> str:
    """An estimate with its interval."""
    return f"{estimate.value:.4g} ({estimate.low:.4g} to {estimate.high:.4g}), {estimate.n} rows"


def table(directory: Path) -> None:
    """Print reported and confirmed side by side, and what luck made of them."""
    study = with_confirmed(directory, read_study(directory))
    print(confirmed(study).round(5).to_string(index=False))
    for note in notes(study):
        print(note)
    for name, gap in luck(study).items():
        print(f"reported less run again, {name}: {said(gap)}")
    print(f"share of fresh runs within 15 % of the angle: {said(close_again(study, ANGLE_OF_REPOSE, 0.15))}")
    for name, rows in groups(study).items():
        of = study.ok[rows]
        gap = mean(of[f"dem_{ANGLE_OF_REPOSE}"] - of[f"confirmed_{ANGLE_OF_REPOSE}"])
        again = mean(of[f"confirmed_{ANGLE_OF_REPOSE}"])
        print(f"{name}: angle run again {said(again)}; reported less that {said(gap)}")


def groups(study: Study) -> dict[str, np.ndarray]:
    """Rows by what decides how much luck there is: the reach of the target, and the runs to choose from."""
    runs = study.ok["runs_optimisation"].to_numpy()
    holds = ~study.ok["calibrated_MU_PP"].to_numpy(bool)
    return {
        "MU_PP held": holds,
        "MU_PP calibrated": ~holds,
        "20 runs or fewer": runs <= 20,
        "21 to 40 runs": (runs > 20) & (runs <= 40),
        "more than 40 runs": runs > 40,
    }


def main() -> None:
    """Parse and do."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", choices=("design", "table"))
    parser.add_argument("study", type=Path)
    default = "default: confirmed/design.csv beside the study"
    parser.add_argument("--out", type=Path, help=default)
    a = parser.parse_args()
    if a.work == "design":
        design(a.study, a.out or runs_beside(a.study).with_name("design.csv"))
    else:
        table(a.study)


if __name__ == "__main__":
    main()
