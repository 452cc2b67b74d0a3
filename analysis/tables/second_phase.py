"""Section 2.3.3: what the second optimisation gains in each row, and what luck alone would gain.

The Jacobian's runs lie 0.1 % of a parameter to either side of a point (one side at a bound). If the two of a
pair differ as much as two seeds do, the slope between them is noise, and the runs of the second optimisation
are draws at practically one point. Then the best of them is the luckiest, and the first as good as any other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pandas as pd
from scipy import stats

from calstudy.analysis.exhibit import Column
from calstudy.analysis.labels import LABELS
from calstudy.analysis.statistics.estimates import LEVEL, mean
from calstudy.calibration.optimise import LevenbergMarquardt
from calstudy.models.heap import ANGLE_OF_REPOSE, MEASURED
from calstudy.models.noise import known_noise, noise_freedom
from calstudy.plan import PARAMETERS
from calstudy.records import Outcome, Phase
from calstudy.study.reading import OPTIMA, Study

NEAR = 2.5
"""Difference steps within which runs count as being at an optimum."""
TITLE = "The second optimisation, row by row: what it gained, and how far it went"
COLUMNS = (
    Column("row", "Row", "d"),
    Column("runs", "DEM runs", "d"),
    Column("reach", "Widest range of a parameter, share of its interval", ".3f"),
    Column("angle_sd", "Standard deviation of the angle of repose over the runs in deg", ".2f"),
    Column("start", "Sum of squares at the start", ".5f"),
    Column("average", "Mean of all runs", ".5f"),
    Column("best", "Best", ".5f"),
    Column("better", "Share of the later runs that are better than the start", ".2f"),
)


def second_phase(study: Study) -> pd.DataFrame:
    """One line for each successful row whose second optimisation has more runs than its start."""
    lines = []
    for row, runs in _second(study):
        if len(runs) < 2 or runs["phase"].iloc[0] != Phase.START:
            continue
        box = study.plan.space(study.plan.row(row)).box
        points = runs[list(box.names)].to_numpy(float)
        totals = np.sum(study.residuals(row, runs) ** 2, axis=1)
        lines.append(
            {
                "row": row,
                "runs": len(runs),
                "reach": float(np.ptp(box.to_unit(points), axis=0).max()),
                "angle_sd": float(runs[ANGLE_OF_REPOSE].std(ddof=1)),
                "start": float(totals[0]),
                "average": float(totals.mean()),
                "best": float(totals.min()),
                "better": float(np.mean(totals[1:] < totals[0])),
            }
        )
    return pd.DataFrame(lines, columns=[column.name for column in COLUMNS])


def pairs(study: Study) -> pd.DataFrame:
    """Both runs of each central difference: row, parameter, and the difference of each response."""
    lines = []
    for row, runs in _second(study):
        runs = runs[runs["phase"] == Phase.JACOBIAN].reset_index(drop=True)
        points = runs[list(PARAMETERS)].to_numpy(float)
        k = 0
        while k + 1 < len(runs):
            (moved,) = np.nonzero(points[k] != points[k + 1])
            # A one-sided difference has one run, and the next one moves another parameter.
            if len(moved) != 1:
                k += 1
                continue
            between = {name: runs[name][k + 1] - runs[name][k] for name in MEASURED}
            lines.append({"row": row, "parameter": PARAMETERS[moved[0]], **between})
            k += 2
    return pd.DataFrame(lines, columns=["row", "parameter", *MEASURED])


def gains(study: Study, without_optimum: bool = False) -> pd.Series:
    """Cost around the DEM optimum minus that around the Kriging optimum, as in `costs_around`, by row."""
    around = costs_around(study, without_optimum)
    return around["dem"] - around["kriging"]


def costs_around(study: Study, without_optimum: bool = False) -> pd.DataFrame:
    """Mean cost of the Jacobian's runs around the optima ``kriging`` and ``dem``, by row; NaN without runs.

    They lie within ``NEAR`` difference steps of the optimum. Their mean is free of the luck that chose the
    smallest of many noisy values, except that the DEM optimum may be one of these runs; ``without_optimum``
    leaves out runs with exactly its parameters.
    """
    step = LevenbergMarquardt()
    lines = []
    usable = study.evaluations[study.evaluations["phase"] == Phase.JACOBIAN].dropna(subset=list(MEASURED))
    by_row = dict(list(usable.groupby("row")))
    for line in study.ok.to_dict("records"):
        row = line["row"]
        names = study.plan.space(study.plan.row(row)).box.names
        runs = by_row.get(row, usable.iloc[:0])
        points = runs[list(names)].to_numpy(float)
        costs = np.sum(study.residuals(row, runs) ** 2, axis=1)
        optima = {model: np.array([line[f"{model}_{name}"] for name in names]) for model in OPTIMA}
        counted = ~(points == optima["dem"]).all(axis=1) if without_optimum else np.full(len(points), True)
        means = {}
        for model, optimum in optima.items():
            far = NEAR * step.relative_step * np.maximum(np.abs(optimum), step.least_magnitude)
            near = counted & (np.abs(points - optimum) <= far).all(axis=1)
            means[model] = costs[near].mean() if near.any() else math.nan
        lines.append(means)
    return pd.DataFrame(lines, index=list(study.ok["row"]), columns=list(OPTIMA), dtype=float)


def notes(study: Study) -> list[str]:
    """Notes under the table: on the pairs, and on the rank of the start."""
    lines = second_phase(study)
    parts = [
        "Runs at parameters within so small a range have nearly the same mean responses. Were they draws at "
        "one point, half of the later runs would be better than the start, and the best the luckiest."
    ]
    if len(lines) > 1:
        share = mean(lines["better"])
        parts.append(
            f"Mean share of later runs that are better than the start: {share.value:.2f} "
            f"[{max(share.low, 0.0):.2f}; {min(share.high, 1.0):.2f}] over {share.n} rows."
        )
    between = pairs(study)
    model = (study.settings.model, study.settings.model_hash)
    noise = known_noise(*model)
    if noise is None:
        parts.append("The scatter from seed to seed was not measured for this model.")
    elif len(between):
        said = []
        for name in MEASURED:
            value, low, high = ratio(between[name].to_numpy(float), noise[name], noise_freedom(*model))
            said.append(f"{LABELS[name]} {value:.2f} [{low:.2f}; {high:.2f}]")
        parts.append(
            f"Central differences, {len(between)} pairs: root mean square of the difference between the two "
            "runs, divided by that of two runs which differ in their seed alone (1 where a slope is nothing "
            f"but noise): {', '.join(said)}."
        )
    return [*parts, study.provenance()]


def ratio(differences: np.ndarray, sd: float, freedom: int) -> tuple[float, float, float]:
    """Root mean square of differences (n,) over sqrt(2) sd, with its 95 % interval.

    ``sd`` is itself measured, with ``freedom`` degrees of freedom, so the interval is that of a ratio of two
    variances (F).
    """
    n = len(differences)
    value = math.sqrt(float(np.mean(differences**2)) / 2.0) / sd
    quantiles = stats.f.ppf([0.5 + LEVEL / 2, 0.5 - LEVEL / 2], n, freedom)
    low, high = value / np.sqrt(quantiles)
    return value, float(low), float(high)


def _second(study: Study) -> Iterator[tuple[int, pd.DataFrame]]:
    """Each successful row with the usable runs of its second optimisation.

    The start comes first, then they are in order of request by phase. A row without such runs is left out.
    """
    runs = study.evaluations
    runs = runs[(runs["phase"] != Phase.SAMPLING) & (runs["outcome"] == Outcome.OK)]
    order = runs["phase"].map({str(phase): k for k, phase in enumerate(Phase)})
    by_row = dict(list(runs.assign(order=order).sort_values(["order", "index"]).groupby("row")))
    for row in map(int, study.ok["row"]):
        if row in by_row:
            yield row, by_row[row].reset_index(drop=True)
