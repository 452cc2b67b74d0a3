"""What Table 5's sequential tests find by chance alone in the rows of a study: the numbers of solid.md.

Before it, what MU_PP:RF_PP does in the samples, which are no optima.

python reports/emulated/table5_by_chance.py STUDY
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from statsmodels.api import OLS, add_constant
from threadpoolctl import threadpool_limits

from calstudy.analysis.statistics.estimates import ALPHA
from calstudy.analysis.statistics.manova import Manova, manova
from calstudy.emulator.replicates import read_replicate
from calstudy.models.heap import ANGLE_OF_REPOSE, MEASURED
from calstudy.plan import PARAMETERS
from calstudy.records import Phase
from calstudy.report.replicated import replicate_study
from calstudy.study.directory.store import finished_replicates
from calstudy.study.reading import Study, read_study

DRAWS = 200


def permuted(study: Study, parameter: str, rng: np.random.Generator) -> Manova:
    """MANOVA of the DEM optima with one parameter permuted among the rows that calibrated it."""
    parameters, responses = study.optima("dem")
    here = study.ok[f"calibrated_{parameter}"].to_numpy(bool)
    column = parameters[parameter].to_numpy(copy=True)
    column[here] = rng.permutation(column[here])
    return manova(parameters.assign(**{parameter: column}), responses)


def without_interactions(study: Study, rng: np.random.Generator) -> Manova:
    """MANOVA where both measured responses have main effects alone, their residuals permuted."""
    parameters, responses = study.optima("dem")
    x = np.column_stack([np.ones(len(parameters)), (parameters - parameters.mean()) / parameters.std()])
    drawn = {}
    for name in MEASURED:
        y = responses[name].to_numpy(float)
        fitted = x @ np.linalg.lstsq(x, y, rcond=None)[0]
        drawn[name] = fitted + rng.permutation(y - fitted)
    return manova(parameters, responses.assign(**drawn))


def together(study: Study) -> tuple[float, float]:
    """What MU_PP's interval adds to the effect of RF_PP's on the angle in the samples; its standard error."""
    runs = study.evaluations[study.evaluations["phase"] == Phase.SAMPLING].dropna(subset=[ANGLE_OF_REPOSE])
    unit = pd.DataFrame(
        {p.name: (runs[p.name] - p.lower) / (p.upper - p.lower) - 0.5 for p in study.plan.parameters}
    )
    found = OLS(runs[ANGLE_OF_REPOSE], add_constant(unit.assign(both=unit["MU_PP"] * unit["RF_PP"]))).fit()
    return float(found.params["both"]), float(found.bse["both"])


def main(study: Study) -> None:
    """Print shares of draws with p < 0.05."""
    parameters, responses = study.optima("dem")
    found = manova(parameters, responses)
    print(f"{len(study.ok)} rows; {DRAWS} draws")
    for parameter in PARAMETERS:
        rng = np.random.default_rng(1)
        tests = [permuted(study, parameter, rng) for _ in range(DRAWS)]
        shares = [
            np.mean([which[parameter].p < ALPHA for which in of])
            for of in ([t.sequential for t in tests], [t.marginal for t in tests])
        ]
        p = found.sequential[parameter].p, found.marginal[parameter].p
        print(
            f"{parameter}: p {p[0]:.2g}, given all others {p[1]:.2g}; permuted, p < {ALPHA} in "
            f"{shares[0]:.2f}, given all others in {shares[1]:.2f}"
        )
    rng = np.random.default_rng(1)
    lines = [
        {term: test.p < ALPHA for term, test in without_interactions(study, rng).sequential.items()}
        for _ in range(DRAWS)
    ]
    shares = pd.DataFrame(lines).filter(like=":").mean().sort_values(ascending=False)
    significant = [term for term, test in found.sequential.items() if ":" in term and test.p < ALPHA]
    print(f"significant interactions: {len(significant)} ({', '.join(significant)})")
    each = ", ".join(f"{term} {share:.2f}" for term, share in shares.items())
    print(f"without any in both measured responses: {shares.sum():.1f} on average; {each}")


def samples(directory: Path, study: Study) -> None:
    """Print MU_PP:RF_PP in the samples of a study, and over its replicates where it has some."""
    print("MU_PP:RF_PP in the samples, deg: {:.2f} ± {:.2f}".format(*together(study)))
    replicates = (read_replicate(directory, study.settings, n) for n in finished_replicates(directory))
    found = [together(replicate_study(study, tables))[0] for tables in replicates]
    if found:
        print(
            f"  5, 50 and 95 % of {len(found)} replicates: {np.quantile(found, (0.05, 0.5, 0.95)).round(2)}"
        )


if __name__ == "__main__":
    with threadpool_limits(1):
        whole = read_study(Path(sys.argv[1]))
        samples(Path(sys.argv[1]), whole)
        main(whole)
