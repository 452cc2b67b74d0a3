"""Before a study: which rows of the plan can reach its targets at a fidelity.

    python reports/angle_of_repose/gate.py

The responses' means over the box come from Kriging (mode robust, known noise) of the 5 mm runs on `ring` in
plate/ and noise/. For each set of calibrated parameters: the least and the largest mean of each response, the
other parameters at their constants (Table 2). No new DEM runs.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import qmc

from calstudy.calibration.kriging.universal import UniversalKriging
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED
from calstudy.models.noise import known_noise
from calstudy.parameters import Array
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan

HERE = Path(__file__).parent
FIDELITY, VARIANT = "soft", "ring"
PLAN = load_plan()
LOWER, UPPER = (np.array([getattr(p, end) for p in PLAN.parameters]) for end in ("lower", "upper"))
TARGETS = PLAN.targets
INSIDE = 4096
"""Points within a box, besides its corners."""


def real_runs() -> pd.DataFrame:
    """Usable runs of the fidelity and variant."""
    runs = pd.concat([pd.read_parquet(HERE / name / "runs.parquet") for name in ("plate", "noise")])
    chosen = (runs["fidelity"] == FIDELITY) & (runs["variant"] == VARIANT) & (runs["outcome"] == "ok")
    return runs[chosen].reset_index(drop=True)


def box(calibrated: tuple[str, ...]) -> Array:
    """Points (n, 6) of the box of some parameters, its corners too; the others have their constants."""
    d = len(calibrated)
    unit = np.vstack([list(itertools.product((0.0, 1.0), repeat=d)), qmc.Sobol(d, seed=1).random(INSIDE)])
    points = np.tile([p.lower if p.constant is None else p.constant for p in PLAN.parameters], (len(unit), 1))
    columns = [PARAMETERS.index(name) for name in calibrated]
    points[:, columns] = LOWER[columns] + unit * (UPPER - LOWER)[columns]
    return points


def markdown() -> list[str]:
    """The table, and what it says."""
    runs = real_runs()
    noise = known_noise("angle_of_repose", load_model(PLAN.fixed, FIDELITY, VARIANT).hash)
    if noise is None:
        raise SystemExit(f"{FIDELITY}, {VARIANT}: no noise was measured for this version of the model")
    design = runs[list(PARAMETERS)].to_numpy(float)
    density = PARAMETERS.index("DENS")
    divisors = {ANGLE_OF_REPOSE: lambda x: np.ones(len(x)), BULK_DENSITY: lambda x: x[:, density]}
    surrogates = {
        name: UniversalKriging(
            LOWER,
            UPPER,
            mode="robust",
            trend="constant",
            noise_sd=noise[name] / float(divisors[name](design).mean()),
        ).fit(design, runs[name].to_numpy(float) / divisors[name](design))
        for name in MEASURED
    }
    rows = pd.Series({row.run: row.calibrated for row in PLAN.rows})
    lines = [
        f"Means at `{FIDELITY}` on `{VARIANT}` by Kriging of {len(runs)} runs; "
        "DENS and RF_PP are always calibrated.",
        "",
        "| also calibrated | rows | angle, deg | 22 deg | bulk density, kg/m3 | 1500 kg/m3 |",
        "|---|---|---|---|---|---|",
    ]
    outside = []
    for calibrated in sorted(set(rows), key=lambda names: (len(names), names)):
        points = box(calibrated)
        cells = []
        for name in MEASURED:
            means = surrogates[name].predict(points) * divisors[name](points)
            reached = means.min() <= TARGETS[name] <= means.max()
            cells += [f"{means.min():.1f} to {means.max():.1f}", "inside" if reached else "outside"]
        of_set = [int(row) for row in rows.index[rows == calibrated]]
        outside += of_set if "outside" in cells else []
        also = ", ".join(name for name in calibrated if name not in ("DENS", "RF_PP")) or "none"
        lines.append(f"| {also} | {', '.join(map(str, of_set))} | {' | '.join(cells)} |")
    return [
        *lines,
        "",
        f"A target is outside for {len(outside)} of {len(rows)} rows: "
        f"{', '.join(map(str, sorted(outside)))}.",
    ]


if __name__ == "__main__":
    print(*markdown(), sep="\n")
