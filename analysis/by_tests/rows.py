"""Rows of a plan with the number of material tests as a factor: where they end, and what they leave open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd

from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES
from calstudy.calibration.posterior import log_likelihood
from calstudy.calibration.sampling import sobol
from calstudy.calibration.task import cost_of
from calstudy.errors import NumericsError
from calstudy.models.find import declaration
from calstudy.models.noise import known_noise
from calstudy.parameters import Array
from calstudy.records import proportional
from calstudy.study.reading import Study

POINTS = 2**13
"""Points of the unit cube that the solution space is weighed at."""


def rows(study: Study) -> pd.DataFrame:
    """One line for each successful row.

    Columns: ``row``, ``TESTS``, ``WRL``, ``SPP``, ``runs`` (DEM runs of all its tests), ``sets`` (of
    parameters); of each parameter ``at_NAME``, the place of the DEM optimum in its interval from 0 to 1,
    ``off_NAME``, that less the truth's, and ``kriging_NAME``, the place of the Kriging optimum; of rows
    without WRL ``nats`` and ``sd_NAME`` of the solution space (`left_open`).
    """
    truth, noise = study.settings.target.truth or {}, noise_of_tests(study)
    lines = []
    for line in study.ok.to_dict("records"):
        row = study.plan.row(line["row"])
        runs = study.evaluations[study.evaluations["row"] == row.run]
        found: dict[str, float] = {
            **{name: getattr(row, name) or np.nan for name in ("TESTS", "SPP")},
            "row": row.run,
            "WRL": row.WRL,
            "runs": line["runs_total"],
            "sets": len(runs),
        }
        for parameter in study.plan.parameters:
            width = parameter.upper - parameter.lower
            right = truth.get(parameter.name, np.nan)
            for column, value, base in (
                ("at", line[f"dem_{parameter.name}"], parameter.lower),
                ("off", line[f"dem_{parameter.name}"], right),
                ("kriging", line[f"kriging_{parameter.name}"], parameter.lower),
            ):
                found[f"{column}_{parameter.name}"] = (value - base) / width
        if row.WRL == 0:
            found |= left_open(study, row.run, noise)
        lines.append(found)
    return pd.DataFrame(lines)


def noise_of_tests(study: Study) -> dict[str, float]:
    """Known standard deviation of a run of each response of the study's tests, by its name there."""
    settings = study.settings
    found: dict[str, float] = {}
    hashes = {str(labels["model"]): model_hash for model_hash, labels in (settings.tests or {}).items()}
    hashes[settings.model] = settings.model_hash
    for test in study.plan.tests:
        known = known_noise(test.model, hashes[test.model]) or {}
        found |= {f"{study.plan.prefix(test)}{name}": sd for name, sd in known.items()}
    return found


def left_open(study: Study, row: int, noise: Mapping[str, float]) -> dict[str, float]:
    """The solution space of a row by its own runs: nats that it tells, standard deviations of the parameters.

    Surrogates are those of `robust`, with YM and DENS as two inputs; a target is taken to scatter as one run
    does. Standard deviations are shares of the intervals. NaN where too few runs are usable.
    """
    planned, runs = study.plan.row(row), study.evaluations[study.evaluations["row"] == row]
    space, cost = study.plan.space(planned), cost_of(study.plan, planned, study.settings.target)
    points = runs[list(space.box.names)].to_numpy(float)
    try:
        fitted = Surrogates.fit(
            replace(MODES["robust"].kriging, divisors=_divisors(study)),
            space,
            cost.responses,
            points,
            runs[list(cost.responses)].to_numpy(float),
            noise,
        )
    except NumericsError:
        return {"nats": np.nan}
    unit = _unit(space.box.dimension)
    means, doubts = fitted.predict_with_deviations(space.box.from_unit(unit))
    errors = np.array([noise[name] for name in cost.responses])
    log = log_likelihood(cost.deviations(means), doubts, errors)
    weights = np.exp(log - log.max())
    weights /= weights.sum()
    told = weights[weights > 0]
    mean = weights @ unit
    sd = np.sqrt(weights @ (unit - mean) ** 2)
    spread = {f"sd_{name}": float(of) for name, of in zip(space.box.names, sd, strict=True)}
    return {"nats": float(np.sum(told * np.log(told * len(unit)))), **spread}


def _divisors(study: Study) -> dict[str, str]:
    """Parameter that a response is proportional to, by the response's name in the study."""
    return {
        f"{study.plan.prefix(test)}{name}": parameter
        for test in study.plan.tests
        for name, parameter in proportional(declaration(test.model).responses).items()
    }


@cache
def _unit(dimension: int) -> Array:
    return sobol(POINTS, dimension)
