"""What the authors' search on the Kriging models leaves behind, and what the DEM model says of it.

    python benchmarks/first_optimisation.py design reports/soft       (writes least/design.csv)
    calstudy sweep reports/soft/least/design.csv --out reports/soft/least
    python benchmarks/first_optimisation.py table reports/soft
    python benchmarks/first_optimisation.py replicates studies/soft-ring      (of a study on an emulator)

The folder holds a study in mode ``paper``, ``paper/``. The Kriging models of each row are fitted to its
samples again, and the least sum of squares on them is looked for by sequential quadratic programming from
the point where the authors' search ended, the centre and six random points of the box. Rows in which the
search ended above twice that least are run at it with fresh seeds. Costs are means over runs, noise
included: around the optimum of either model those of the Jacobian, but for the DEM optimum itself, which
luck chose.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from calstudy.analysis.statistics.estimates import Estimate, mean
from calstudy.analysis.tables.second_phase import costs_around, gains
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES
from calstudy.calibration.optimise import SequentialQuadratic, sequential_quadratic
from calstudy.calibration.procedure import expected_residuals
from calstudy.calibration.task import tasks_of
from calstudy.emulator.replicates import read_replicate
from calstudy.models.heap import ANGLE_OF_REPOSE, MEASURED, PROPORTIONAL
from calstudy.parameters import Array
from calstudy.plan import PARAMETERS
from calstudy.records import Phase
from calstudy.report.replicated import replicate_study
from calstudy.study.directory.store import finished_replicates
from calstudy.study.reading import Study, read_study
from calstudy.study.sweep import DESIGN_COLUMNS

SEEDS = range(9001, 9005)
HAIR = 1e-6
"""Sum of squares below which nothing is left behind."""


def least(study: Study) -> pd.DataFrame:
    """Where the search ended on each row's surrogates, and where they have their least sum of squares."""
    tasks = tasks_of(
        study.plan,
        study.settings.target,
        MODES[study.settings.mode].knowing(PROPORTIONAL),
        study.settings.seed,
    )
    lines = []
    for line in study.ok.to_dict("records"):
        task = tasks[int(line["row"])]
        box = task.space.box
        runs = study.evaluations[
            (study.evaluations["row"] == line["row"]) & (study.evaluations["phase"] == Phase.SAMPLING)
        ]
        at = (runs[list(names)].to_numpy(float) for names in (box.names, MEASURED))
        surrogates = Surrogates.fit(task.mode.kriging, task.space, task.cost.responses, *at)

        def expected(points: Array, task=task, surrogates=surrogates) -> Array:
            return expected_residuals(task, surrogates, points)

        ended = np.array([line[f"kriging_{name}"] for name in box.names])
        starts = (box.centre, ended, *box.from_unit(np.random.default_rng(0).random((6, box.dimension))))
        optima = [sequential_quadratic(expected, start, box, SequentialQuadratic()) for start in starts]
        best = min(optima, key=lambda optimum: optimum.sum_of_squares)
        point = {name: line[f"kriging_{name}"] for name in PARAMETERS} | dict(
            zip(box.names, best.best, strict=True)
        )
        lines.append(
            {
                **{name: line[name] for name in ("row", "WRL", "calibrated_MU_PP")},
                "is_above": line["kriging_sum_of_squares"] > 2 * best.sum_of_squares + HAIR,
                "kriging_angle": line[f"kriging_{ANGLE_OF_REPOSE}"],
                "least_angle": float(surrogates.predict(best.best[None])[0, 0]),
                "kriging_RF_PP": line["kriging_RF_PP"],
                **{f"least_{name}": value for name, value in point.items()},
            }
        )
    return pd.DataFrame(lines)


def design(folder: Path) -> None:
    """Write the least of the rows in which the search ended above twice of it, for ``calstudy sweep``."""
    study = read_study(folder / "paper")
    points = least(study)
    lines = [
        [
            *(f"least {line['row']}", study.settings.fidelity, study.settings.variant, seed),
            *(line[f"least_{name}"] for name in PARAMETERS),
        ]
        for seed in SEEDS
        for line in points[points["is_above"]].to_dict("records")
    ]
    path = folder / "least" / "design.csv"
    path.parent.mkdir(exist_ok=True)
    pd.DataFrame(lines, columns=list(DESIGN_COLUMNS)).to_csv(path, index=False, float_format="%.17g")
    print(f"{path}: {len(lines)} runs")


def costs_again(folder: Path, study: Study) -> pd.Series:
    """Mean cost of the runs with fresh seeds at each row's least."""
    runs = pd.read_parquet(folder / "least" / "runs.parquet")
    rows = runs["label"].str.removeprefix("least ").astype(int)
    return pd.Series(
        {
            row: np.sum(study.residuals(row, of) ** 2, axis=1).mean()
            for row, of in runs[runs["outcome"] == "ok"].groupby(rows)
        }
    )


def said(estimate: Estimate) -> str:
    """An estimate with its interval."""
    return f"{estimate.value:.4f} ({estimate.low:.4f} to {estimate.high:.4f}), {estimate.n} rows"


def table(folder: Path) -> None:
    """Print what was left, what the second optimisation gained in either case, and what the least is."""
    study = read_study(folder / "paper")
    points = least(study)
    above, other = (points.loc[points["is_above"] == which, "row"] for which in (True, False))
    print(f"above twice the least: {len(above)} of {len(points)} rows ({', '.join(map(str, above))})")
    for by in (["WRL"], ["calibrated_MU_PP", "WRL"]):
        columns = ["kriging_angle", "least_angle", "kriging_RF_PP", "least_RF_PP", "is_above"]
        print(points.groupby(by)[columns].mean().round(4).to_string())
    for name, rows in (("all rows", points["row"]), ("above twice the least", above), ("others", other)):
        for without in (False, True):
            gain = said(mean(gains(study, without).loc[rows]))
            print(f"second optimisation, {name}{', without the optimum itself' * without}: {gain}")
    if (folder / "least" / "runs.parquet").exists():
        around = costs_around(study, without_optimum=True).assign(least=costs_again(folder, study)).loc[above]
        for name in around:
            print(f"cost above twice the least, {name}: {said(mean(around[name]))}")
        for name in ("kriging", "dem"):
            print(f"least less {name}: {said(mean(around['least'] - around[name]))}")


def replicates(directory: Path) -> None:
    """Print of each finished replicate how many rows are above, and the gains of these and of the others."""
    study = read_study(directory)
    for number in finished_replicates(directory):
        one = replicate_study(study, read_replicate(directory, study.settings, number))
        points, gain = least(one), gains(one)
        above = points["is_above"]
        means = (gain.loc[points.loc[which, "row"]].mean() for which in (above, ~above))
        print(number, above.sum(), *(f"{value:.4f}" for value in means), flush=True)


def main() -> None:
    """Parse and do."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", choices=("design", "table", "replicates"))
    parser.add_argument("folder", type=Path)
    a = parser.parse_args()
    with threadpool_limits(1):
        {"design": design, "table": table, "replicates": replicates}[a.work](a.folder)


if __name__ == "__main__":
    main()
