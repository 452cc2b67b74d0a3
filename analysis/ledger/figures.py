"""Figures that decide the paper's claims, each taken from a study."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from calstudy.analysis.ledger import rules
from calstudy.analysis.statistics.estimates import (
    Estimate,
    correlation_interval,
    impossible,
    is_constant,
    mean,
    median,
)
from calstudy.analysis.statistics.linear_model import factor_effect, linear_effects, slopes
from calstudy.analysis.statistics.verdicts import (
    Requirement,
    exact,
    largest_of_plan,
    p_value,
    share_of_plan,
    smallest_of_plan,
    unless_complete,
)
from calstudy.analysis.tables.second_phase import gains
from calstudy.analysis.tables.table5 import tests
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import Phase, Stop
from calstudy.study.reading import SWITCHES, Study

AT_A_BOUND = 0.01
"""Share of the interval within which an optimum counts as being at its bound."""


def share(study: Study, hits: pd.Series) -> Estimate:
    """Share of the plan's rows. Finished rows that failed count as misses."""
    return share_of_plan(int(hits.sum()), len(study.calibrations), study.planned)


def close(study: Study, response: str, tolerance: float) -> pd.Series:
    """Whether each successful row's response is within a share of its target."""
    return study.deviation(response).abs() <= tolerance * study.settings.target.values[response]


def stopped(study: Study, model: str) -> Estimate:
    """Share of the plan's rows whose optimisation ended by the 2 % criterion."""
    if study.settings.mode != "paper":
        return impossible(len(study.ok), f"mode {study.settings.mode} has no 2 % criterion")
    return share(study, study.ok[f"{model}_stop"].isin([Stop.IMPROVEMENT, Stop.EXACT]))


def correlations(frame: pd.DataFrame, names: str) -> dict[str, Estimate]:
    """Correlations of a table that compares them with published ones, by its column ``names``."""
    return {
        line[names]: Estimate(line["correlation"], line["low"], line["high"], line["n"], line["why_not"])
        for line in frame.to_dict("records")
    }


def planned_with(study: Study, parameter: str) -> int:
    """Rows of the plan that calibrate a parameter."""
    return sum(parameter in row.calibrated for row in study.plan.rows)


def could_end(study: Study, parameter: str) -> int:
    """Rows of the plan that calibrate a parameter, without those that failed: these have no optimum."""
    failed = [study.plan.row(int(row)) for row in study.failed["row"]]
    return planned_with(study, parameter) - sum(parameter in row.calibrated for row in failed)


def range_of(study: Study, parameter: str) -> Estimate:
    """Range of the optima as a share of the interval. Unfinished rows may widen it to 1."""
    places = study.position(parameter)
    if len(places) < 2:
        return impossible(len(places), f"n = {len(places)}: a range needs 2 rows")
    return largest_of_plan(float(np.ptp(places)), len(places), planned_with(study, parameter), limit=1.0)


def between_quartiles(study: Study, parameter: str) -> Estimate:
    """Interquartile range of the optima as a share of the interval; open where many rows are unfinished."""
    places, planned = study.position(parameter), could_end(study, parameter)
    if len(places) < 4:
        return impossible(len(places), f"n = {len(places)}: quartiles need 4 rows")
    low, high = np.quantile(places, (0.25, 0.75))
    figure = exact(float(high - low), len(places))
    return unless_complete(figure, len(places), planned, "where the quartiles lie", (0.0, 1.0))


def at_a_bound(study: Study, parameter: str) -> Estimate:
    """Share of the rows that end which do so within 1 % of a bound. Unfinished rows may be either."""
    places = study.position(parameter)
    hits = int((np.abs(places - 0.5) >= 0.5 - AT_A_BOUND).sum())
    return share_of_plan(hits, len(places), could_end(study, parameter))


def place_by_weight(study: Study, parameter: str) -> dict[float, Estimate]:
    """Median place of the optimum in its interval, at each WRL of the plan."""
    weights = study.where_calibrated(parameter)["WRL"].to_numpy(float)
    places = study.position(parameter)
    return {
        float(weight): median(places[weights == weight])
        for weight in sorted({row.WRL for row in study.plan.rows})
    }


def close_again(study: Study, response: str, tolerance: float) -> Estimate:
    """Share of fresh runs at the DEM optima that are close, averaged over rows. Failed runs are not close."""
    if study.confirmed is None:
        return impossible(0, "no optimum was run again")
    runs = study.confirmed[study.confirmed["row"].isin(study.ok["row"])]
    target = study.settings.target.values[response]
    is_close = (runs[response] - target).abs() <= tolerance * target
    found = mean(is_close.groupby(runs["row"]).mean())
    return replace(found, low=max(found.low, 0.0), high=min(found.high, 1.0))


def fisher(found: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """The same correlations with Fisher's intervals."""
    return {
        name: r if math.isnan(r.value) else correlation_interval(r.value, r.n) for name, r in found.items()
    }


def p_values(study: Study, model: str) -> tuple[Mapping[str, float], int, int]:
    """p-values by term; NaN for a term that was not tested, or only in a smaller model than the paper's."""
    found = tests(study, model)
    whole = any(":" in term for term in found.sequential) and not found.left_out
    p = {
        term: found.sequential[term].p if whole and term in found.sequential else float("nan")
        for term in (*PARAMETERS, *rules.INTERACTIONS)
    }
    return p, found.n, study.planned


def effects_of(
    study: Study, factor: str, response: str, with_MU_PP: bool | None = None
) -> tuple[Estimate, dict[tuple[float, float], Estimate]]:
    """p-value of a factor, and its effects between levels: those of this plan, and those of the paper's.

    Over all rows, or those that calibrate MU_PP, or those that hold it.
    """
    other = {"WRL": "SPP", "SPP": "WRL"}[factor]
    frame, rows = study.factors(), list(study.plan.rows)
    if with_MU_PP is not None:
        frame = frame[frame["MU_PP"] == with_MU_PP]
        rows = [row for row in rows if ("MU_PP" in row.calibrated) is with_MU_PP]
    found = factor_effect(frame, response, factor, [other, *SWITCHES])
    levels = sorted({float(getattr(row, factor)) for row in (*rows, *load_plan().rows)})
    pairs = [(a, b) for k, a in enumerate(levels) for b in levels[k + 1 :]]
    missing = impossible(found.n, found.why_not or "a level is missing")
    return p_value(found.p, found.n, len(rows)), {
        pair: found.differences.get(pair, missing) for pair in pairs
    }


def no_effect(
    study: Study,
    factor: str,
    response: str,
    name: str,
    with_MU_PP: bool | None = None,
    every_pair: bool = False,
) -> list[Requirement]:
    """Requirements for a factor not to affect a response, over the rows of `effects_of`.

    Its effects are those from the lowest level, or with ``every_pair`` those between any two levels.
    """
    p, effects = effects_of(study, factor, response, with_MU_PP)
    margin = rules.MARGINS[response]
    if response == BULK_DENSITY:
        margin *= study.settings.target.values[response]
    lowest = min(effects)[0]
    named = {f"{a:g} to {b:g}": e for (a, b), e in effects.items() if every_pair or a == lowest}
    return rules.no_effect(name, p, named, margin)


def no_effect_of_samples(study: Study, every_pair: bool) -> list[Requirement]:
    """Requirements for SPP not to affect the measured responses."""
    names = {ANGLE_OF_REPOSE: "angle, SPP", BULK_DENSITY: "density, SPP"}
    return [
        requirement
        for response, name in names.items()
        for requirement in no_effect(study, "SPP", response, name, every_pair=every_pair)
    ]


def slopes_of(study: Study) -> dict[float, Estimate]:
    """Slope of the second optimisation's runs over SPP, by WRL."""
    found = slopes(study.factors(), "runs_optimisation", "SPP", "WRL", SWITCHES)
    missing = impossible(len(study.ok), "no finished row has this WRL")
    return {weight: found.get(weight, missing) for weight in (0.0, 0.5, 1.0)}


def extreme_runs(study: Study) -> tuple[Estimate, Estimate]:
    """Smallest and largest number of runs of a second optimisation."""
    runs = study.ok["runs_optimisation"]
    if runs.empty:
        nothing = impossible(0, "no row is finished")
        return nothing, nothing
    n, planned = len(study.calibrations), study.planned
    budget = float("inf") if study.settings.budget is None else float(study.settings.budget)
    return smallest_of_plan(float(runs.min()), n, planned), largest_of_plan(
        float(runs.max()), n, planned, limit=max(budget, float(runs.max()))
    )


def cost_of_time(study: Study) -> tuple[Estimate, Estimate]:
    """Minutes of a DEM run and hours of 72 rows; without interval at a fidelity that makes them cheaper."""
    if study.settings.is_emulated:
        nothing = impossible(0, "an emulator ran no DEM model")
        return nothing, nothing
    minutes = mean(study.evaluations["wall_time"] / 60)
    of_rows = study.evaluations.groupby("row")["wall_time"].sum().loc[study.ok["row"]]
    hours = mean(72 * of_rows / 3600)
    if study.settings.fidelity == "full":
        return minutes, hours
    why_not = f"{study.settings.fidelity} fidelity is cheaper than the paper's by design"
    return impossible(minutes.n, why_not, minutes.value), impossible(hours.n, why_not, hours.value)


def improvement(study: Study, without_optimum: bool) -> pd.Series:
    """Cost around the DEM optimum minus that around the Kriging optimum, for rows that have both.

    ``without_optimum`` leaves out the run that was chosen as the DEM optimum, and so is lucky.
    """
    return gains(study, without_optimum).dropna()


def without_largest(values: pd.Series, count: int) -> pd.Series:
    """Values without the ``count`` largest in magnitude."""
    return values.loc[values.abs().sort_values(kind="stable").index[: max(len(values) - count, 0)]]


def of_gains(estimate: Callable[[pd.Series], Estimate], values: pd.Series) -> Estimate:
    """An estimate of the improvements, or the reason why there is none."""
    if values.empty:
        return impossible(0, "no Jacobian was run at both optima of a row")
    return estimate(values)


def effect_of_modulus(study: Study) -> dict[str, Estimate]:
    """Effect of YM's whole interval on each measured response, with the other parameters in the model."""
    rows = study.calibrations.loc[study.calibrations["calibrated_YM"], "row"]
    runs = study.evaluations[
        study.evaluations["row"].isin(rows) & (study.evaluations["phase"] == Phase.SAMPLING)
    ].drop_duplicates([*PARAMETERS, *MEASURED])  # rows may share their samples
    unit = pd.DataFrame(
        {p.name: (runs[p.name] - p.lower) / (p.upper - p.lower) for p in study.plan.parameters}
    )
    varied = [name for name in PARAMETERS if not is_constant(unit[name].to_numpy())]
    if "YM" not in varied:
        return dict.fromkeys(MEASURED, impossible(0, "no finished row calibrated YM"))
    frame = unit.assign(**{name: runs[name] for name in MEASURED})
    return {name: linear_effects(frame, name, varied)["YM"] for name in MEASURED}
