"""Ledger of the paper's statements: what decides each, this study's figures, and the verdict.

The rules are in ``claim_rules``; here each figure is taken from the study.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from calstudy.analysis.exhibit import Column, printed
from calstudy.analysis.ledger import rules
from calstudy.analysis.ledger.of_the_paper import paper_requirements
from calstudy.analysis.published import published
from calstudy.analysis.statistics.estimates import Estimate, impossible, is_constant, mean, median
from calstudy.analysis.statistics.linear_model import factor_effect, linear_effects, slopes
from calstudy.analysis.statistics.verdicts import (
    Requirement,
    Verdict,
    decide,
    largest_of_plan,
    p_value,
    share_of_plan,
    smallest_of_plan,
)
from calstudy.analysis.tables.second_phase import gains
from calstudy.analysis.tables.table3 import table3
from calstudy.analysis.tables.table4 import table4
from calstudy.analysis.tables.table5 import tests
from calstudy.analysis.tables.table6 import table6
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED
from calstudy.plan import PARAMETERS
from calstudy.plan_check import check
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP, Phase, Stop
from calstudy.study.reading import SWITCHES, Study

TITLE = "Ledger of the paper's statements"
COLUMNS = (
    Column("claim", "No."),
    Column("where", "Where"),
    Column("statement", "Statement, in our words"),
    Column("published", "Published"),
    Column("this_study", "This study"),
    Column("n", "n", "s"),
    Column("verdict", "Verdict"),
    Column("because", "Because"),
    Column("on_the_papers_numbers", "The rule on the paper's own numbers"),
    Column("rule", "Rule"),
)


def claims(study: Study) -> pd.DataFrame:
    """One line a statement; a verdict never stands without the figures that decide it."""
    found = requirements(study)
    paper = paper_requirements()
    lines = []
    for line in published("claims").to_dict("records"):
        required = found[line["claim"]]
        numbers = [r.figure.n for r in required]
        verdict = decide(required)
        own = paper.get(line["claim"])
        lines.append(
            line
            | {
                "this_study": "; ".join(map(_figure, required)),
                "n": f"{min(numbers)}" if len(set(numbers)) == 1 else f"{min(numbers)} to {max(numbers)}",
                "verdict": str(verdict),
                "because": _because(required, verdict),
                "on_the_papers_numbers": str(decide(own)) if own else "prints no number that decides it",
            }
        )
    return pd.DataFrame(lines)[[c.name for c in COLUMNS]]


def requirements(study: Study) -> dict[str, list[Requirement]]:
    """What decides each statement, with this study's figures."""
    return {name: figures(study) for name, figures in _FIGURES.items()}


def notes(study: Study) -> list[str]:
    """What the table's reader must know."""
    said = [
        "A statement holds when every figure's interval lies within the limits of its rule, does not hold "
        "when one lies outside as a whole, and cannot be decided otherwise. In brackets: 95 % intervals, or "
        "what the rows not yet finished can still make of a count.",
    ]
    kind = study.settings.target.kind
    if kind != "paper":
        said.append(
            f"The target is not the paper's 22 deg and 1500 kg/m3 ({kind}): deviations are from this target."
        )
    if study.settings.fidelity != "full":
        said.append(
            f"{study.settings.fidelity.capitalize()} fidelity is another DEM model than the paper's: a "
            "verdict is on the calibration procedure at this fidelity."
        )
    return [*said, study.provenance()]


def _figure(required: Requirement) -> str:
    e = required.figure
    value = "–" if np.isnan(e.value) else _number(e.value)
    if np.isnan(e.low) or e.low == e.high:
        return f"{required.name} {value}"
    return f"{required.name} {value} [{_number(e.low)}; {_number(e.high)}]"


def _number(value: float) -> str:
    return printed(value, ".4g")


def _because(required: list[Requirement], verdict: Verdict) -> str:
    """Which figures were decisive, and why those that decide nothing do not."""
    if verdict is Verdict.HOLDS:
        return ""
    said = []
    for r in required:
        if r.verdict is verdict:
            reason = r.figure.why_not or _limits(r)
            said.append(f"{r.name}: {reason}")
    return "; ".join(said[:4]) + (f"; and {len(said) - 4} more" if len(said) > 4 else "")


def _limits(required: Requirement) -> str:
    where = "outside" if required.verdict is Verdict.FAILS else "neither inside nor outside"
    if np.isinf(required.most):
        return f"{where} what is above {required.least:.4g}"
    if np.isinf(required.least):
        return f"{where} what is below {required.most:.4g}"
    return f"{where} [{required.least:.4g}; {required.most:.4g}]"


# ---- figures -----------------------------------------------------------------------------------------


def _share(study: Study, hits: pd.Series) -> Estimate:
    """Share of the plan's rows; finished rows that failed count, as no hits."""
    return share_of_plan(int(hits.sum()), len(study.calibrations), study.planned)


def _close(study: Study, response: str, tolerance: float) -> pd.Series:
    return study.deviation(response).abs() <= tolerance * study.settings.target.values[response]


def _stopped(study: Study, model: str) -> Estimate:
    if study.settings.mode != "paper":
        return impossible(len(study.ok), f"mode {study.settings.mode} has no 2 % criterion")
    return _share(study, study.ok[f"{model}_stop"].isin([Stop.IMPROVEMENT, Stop.EXACT]))


def _correlations(frame: pd.DataFrame, names: str) -> dict[str, Estimate]:
    """Correlations of a table that has them beside the published ones."""
    return {
        line[names]: Estimate(line["correlation"], line["low"], line["high"], line["n"], line["why_not"])
        for line in frame.to_dict("records")
    }


def _range(study: Study, parameter: str) -> Estimate:
    """Range over the interval's width; rows not finished can widen it to 1."""
    places = study.position(parameter)
    if len(places) < 2:
        return impossible(len(places), f"n = {len(places)}: a range needs 2 rows")
    planned = sum(parameter in row.calibrated for row in study.plan.rows)
    return largest_of_plan(float(np.ptp(places)), len(places), planned, limit=1.0)


def _p_values(study: Study, model: str) -> tuple[Mapping[str, float], int, int]:
    """p by term, NaN where a term was not tested or only in a smaller model than the paper's."""
    found = tests(study, model)
    whole = any(":" in term for term in found.sequential) and not found.left_out
    p = {
        term: found.sequential[term].p if whole and term in found.sequential else float("nan")
        for term in (*PARAMETERS, *rules.INTERACTIONS)
    }
    return p, found.n, study.planned


def _effects(
    study: Study, factor: str, response: str
) -> tuple[Estimate, dict[tuple[float, float], Estimate]]:
    """p of a factor, and its effects between levels: those of the plan, and those of the paper's."""
    other = {"WRL": "SPP", "SPP": "WRL"}[factor]
    found = factor_effect(study.factors(), response, factor, [other, *SWITCHES])
    levels = sorted({float(getattr(row, factor)) for row in (*study.plan.rows, *load_plan().rows)})
    pairs = [(a, b) for k, a in enumerate(levels) for b in levels[k + 1 :]]
    missing = impossible(found.n, found.why_not or "a level is missing")
    return p_value(found.p, found.n, study.planned), {
        pair: found.differences.get(pair, missing) for pair in pairs
    }


def _no_effect(study: Study, factor: str, response: str, name: str) -> list[Requirement]:
    p, effects = _effects(study, factor, response)
    margin = rules.MARGINS[response]
    if response == BULK_DENSITY:
        margin *= study.settings.target.values[response]
    named = {f"{a:g} to {b:g}": effect for (a, b), effect in effects.items() if a == min(effects)[0]}
    return rules.no_effect(name, p, named, margin)


def _slopes(study: Study) -> dict[float, Estimate]:
    found = slopes(study.factors(), "runs_optimisation", "SPP", "WRL", SWITCHES)
    missing = impossible(len(study.ok), "no finished row has this WRL")
    return {weight: found.get(weight, missing) for weight in (0.0, 0.5, 1.0)}


def _extreme_runs(study: Study) -> tuple[Estimate, Estimate]:
    runs = study.ok["runs_optimisation"]
    if runs.empty:
        nothing = impossible(0, "no row is finished")
        return nothing, nothing
    n, planned = len(study.calibrations), study.planned
    budget = float("inf") if study.settings.budget is None else float(study.settings.budget)
    return smallest_of_plan(float(runs.min()), n, planned), largest_of_plan(
        float(runs.max()), n, planned, limit=max(budget, float(runs.max()))
    )


def _cost_of_time(study: Study) -> tuple[Estimate, Estimate]:
    """Minutes of a DEM run and hours of 72 rows; no interval where the fidelity makes them cheaper."""
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


def _improvement(study: Study) -> Estimate:
    """Mean over the rows of the cost around the DEM optimum less that around the Kriging optimum."""
    found = mean(gains(study))
    if found.n == 0:
        return impossible(0, "no Jacobian was run at both optima of a row")
    return found


def _effect_of_modulus(study: Study) -> dict[str, Estimate]:
    """Effect of YM's interval on each measured response, other parameters in the model."""
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


def _c07(study: Study) -> list[Requirement]:
    return rules.c07(_correlations(table4(study), "response"))


def _c11(study: Study) -> list[Requirement]:
    _, effects = _effects(study, "WRL", RAYLEIGH_TIME_STEP)
    return rules.c11(effects[(0.0, 0.5)], effects[(0.0, 1.0)])


def _c13(study: Study) -> list[Requirement]:
    _, effects = _effects(study, "WRL", BULK_DENSITY)
    return rules.c13(effects[(0.0, 1.0)], study.settings.target.values[BULK_DENSITY])


def _c16(study: Study) -> list[Requirement]:
    _, effects = _effects(study, "SPP", "runs_total")
    return rules.c16(effects[(3.0, 6.0)], effects[(6.0, 9.0)])


def _c18(study: Study) -> list[Requirement]:
    names = {ANGLE_OF_REPOSE: "angle, SPP", BULK_DENSITY: "density, SPP"}
    return [r for response, name in names.items() for r in _no_effect(study, "SPP", response, name)]


def _c19(study: Study) -> list[Requirement]:
    p = load_plan().published  # the paper's, whatever plan the study has
    return rules.c19(check(study.plan).word_lengths[2:5], p.decimals, (p.A3, p.A4, p.A5))


_FIGURES: Mapping[str, Callable[[Study], list[Requirement]]] = {
    "C01": lambda s: rules.c01(_share(s, _close(s, ANGLE_OF_REPOSE, rules.ANGLE_TOLERANCE))),
    "C02": lambda s: rules.c02(_share(s, _close(s, BULK_DENSITY, rules.DENSITY_TOLERANCE))),
    "C03": lambda s: rules.c03(_stopped(s, "kriging"), _stopped(s, "dem")),
    "C04": lambda s: rules.c04(median(s.position("DENS")), median(s.position("YM"))),
    "C05": lambda s: rules.c05({name: _range(s, name) for name in ("MU_PW", "RF_PW")}),
    "C06": lambda s: rules.c06(_correlations(table3(s), "parameter")),
    "C07": _c07,
    "C08": lambda s: rules.c08(*_p_values(s, "kriging")),
    "C09": lambda s: rules.c09(*_p_values(s, "dem")),
    "C10": lambda s: rules.c10(_correlations(table6(s), "pair")),
    "C11": _c11,
    "C12": lambda s: _no_effect(s, "WRL", ANGLE_OF_REPOSE, "WRL"),
    "C13": _c13,
    "C14": lambda s: rules.c14(*_extreme_runs(s)),
    "C15": lambda s: rules.c15(_slopes(s), len(s.ok), s.planned),
    "C16": _c16,
    "C17": lambda s: rules.c17(mean(s.ok["runs_total"])),
    "C18": _c18,
    "C19": _c19,
    "C20": lambda s: rules.c20(*_cost_of_time(s)),
    "C21": lambda s: rules.c21(_correlations(table6(s), "pair")),
    "C22": lambda s: rules.c22(_improvement(s)),
    "C23": lambda s: rules.c23(_effect_of_modulus(s), s.settings.target.values[BULK_DENSITY]),
}
