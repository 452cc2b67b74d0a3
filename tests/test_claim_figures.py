"""The ledger's figures of a made-up study, whose numbers are known."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pandas as pd
import pytest

from calstudy.analysis import table3, table5, table6
from calstudy.analysis.ledger import rules
from calstudy.analysis.published import CALIBRATED_TOGETHER
from calstudy.analysis.statistics.linear_model import factor_effect
from calstudy.analysis.statistics.manova import manova, terms_of
from calstudy.analysis.statistics.verdicts import Verdict, decide
from calstudy.analysis.tables.second_phase import costs_around
from calstudy.calibration.task import cost_of
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, RESPONSES
from calstudy.plan import FACTORS, PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP, Target
from calstudy.study.reading import Study
from closed_form import study_settings

ledger = import_module("calstudy.analysis.ledger.claims")  # of that name there is a function, too
PLAN = load_plan()
TARGET = Target({ANGLE_OF_REPOSE: 20.0, BULK_DENSITY: 1500.0}, "set", "made up")
PLACES = {
    "dem": {
        "DENS": (0.6, 1.0),
        "MU_PP": (0.1, 0.9),
        "MU_PW": (0.02, 0.95),
        "RF_PP": (0.2, 0.8),
        "RF_PW": (0.1, 0.8),
        "YM": (0.0, 0.2),
    },
    "kriging": {
        "DENS": (0.0, 0.5),
        "MU_PP": (0.3, 0.5),
        "MU_PW": (0.3, 0.6),
        "RF_PP": (0.5, 0.6),
        "RF_PW": (0.4, 0.7),
        "YM": (0.5, 0.9),
    },
}
"""Least and largest place in its interval of each optimum; between them they are spread evenly."""


def made_up_calibrations(rng):
    """All rows of the plan; every column is a shuffled one whose mean, range or median is known."""
    c = pd.DataFrame([{"row": row.run, "WRL": row.WRL, "SPP": row.SPP} for row in PLAN.rows])
    c["outcome"] = "ok"
    for model, places in PLACES.items():
        for p in PLAN.parameters:
            calibrated = np.array([p.name in row.calibrated for row in PLAN.rows])
            c[f"calibrated_{p.name}"] = calibrated
            place = rng.permutation(np.linspace(*places[p.name], calibrated.sum()))
            c[f"{model}_{p.name}"] = np.full(72, p.constant, float)  # NaN for what every row calibrates
            c.loc[calibrated, f"{model}_{p.name}"] = p.lower + (p.upper - p.lower) * place
        for response in RESPONSES:
            c[f"{model}_{response}"] = 1.0 + 0.1 * rng.standard_normal(72)
    c["kriging_stop"] = np.repeat(["improvement", "exact", "budget"], [60, 10, 2])
    c["dem_stop"] = np.repeat(["improvement", "exact", "budget"], [60, 9, 3])
    # 54 angles are within 15 % and 18 are not; 48 densities within 5 %, and all within 15 %.
    angles = rng.permutation([*np.linspace(-0.14, 0.14, 54), *np.linspace(0.16, 0.3, 18)])
    densities = rng.permutation([*np.linspace(-0.045, 0.045, 48), *np.linspace(0.06, 0.14, 24)])
    c[f"dem_{ANGLE_OF_REPOSE}"], c[f"dem_{BULK_DENSITY}"] = 20 * (1 + angles), 1500 * (1 + densities)
    c["runs_optimisation"] = rng.permutation(np.arange(12, 84))
    for spp, runs in {3: 40.0, 6: 50.0, 9: 80.0}.items():
        c.loc[c["SPP"] == spp, "runs_total"] = runs + rng.permutation(np.linspace(-5, 5, 24))
    return c


def made_up_runs(c, rng):
    """Four samples of each row, of which only those with YM count, and a run at each of its optima."""
    lines = []
    for line in c.to_dict("records"):
        for _ in range(4):
            u = rng.uniform(size=6) if line["calibrated_YM"] else np.full(6, 0.5)
            at = {p.name: p.lower + x * (p.upper - p.lower) for p, x in zip(PLAN.parameters, u, strict=True)}
            angle, density = (25 + 3 * u[5], 1400 - 40 * u[5]) if line["calibrated_YM"] else (90, 9000)
            noise = 0.01 * rng.standard_normal()
            lines.append(("sampling", at, angle + noise, density + noise, line["row"]))
        for model, angle in (("kriging", 24.0), ("dem", 22.0)):
            at = {name: line[f"{model}_{name}"] for name in PARAMETERS}
            lines.append(("jacobian", at, angle, 1500.0, line["row"]))
    runs = pd.DataFrame(
        [
            {"row": row, "phase": phase, ANGLE_OF_REPOSE: angle, BULK_DENSITY: density, **at}
            for phase, at, angle, density, row in lines
        ]
    )
    return runs.assign(wall_time=rng.permutation(np.linspace(300, 420, len(runs))))


@pytest.fixture(scope="module")
def study():
    rng = np.random.default_rng(12)
    calibrations = made_up_calibrations(rng)
    settings = replace(study_settings(target=TARGET), fidelity="full")
    heaps = pd.DataFrame({"row": []})
    return Study(settings, PLAN, calibrations, made_up_runs(calibrations, rng), heaps)


@pytest.fixture(scope="module")
def figures(study):
    """Each figure with its limits, by claim and name."""
    return by_name(ledger.requirements(study))


@pytest.fixture(scope="module")
def before(study):
    """The same of the rules that were changed since."""
    return by_name(ledger.requirements_before(study))


def by_name(found):
    return {claim: {r.name: r for r in required} for claim, required in found.items()}


def values(required):
    return {name: r.figure.value for name, r in required.items()}


@pytest.mark.parametrize(
    ("claim", "known"),
    [
        ("C03", {"1st phase": 70 / 72, "2nd phase": 69 / 72}),
        ("C14", {"fewest": 12, "most": 83}),
        ("C16", {"SPP 3 to 6": 10, "SPP 6 to 9": 30}),
        ("C17", {"mean": 170 / 3}),
        ("C20", {"minutes a run": 6, "hours of 72 rows": 6 * 6 * 72 / 60}),  # six runs a row
    ],
)
def test_a_figure_is_what_was_put_into_the_study(figures, claim, known):
    assert values(figures[claim]) == pytest.approx(known)


@pytest.mark.parametrize(
    ("claim", "known"),
    [
        ("C01", {"share within 15 %": 54 / 72}),
        ("C02", {"share within 5 %": 48 / 72}),
        ("C04", {"DENS": 0.8, "YM": 0.1}),
        ("C05", {"MU_PW": 0.93, "RF_PW": 0.7}),
    ],
)
def test_a_figure_of_a_rule_before_is_what_was_put_into_the_study(before, claim, known):
    assert values(before[claim]) == pytest.approx(known)


def test_shares_are_bounded_by_the_tolerances_and_optima_that_were_not_run_again_leave_them_open(figures):
    reported, again = figures["C02"].values()
    assert (reported.figure.low, reported.figure.high) == (48 / 72, 60 / 72)
    assert again.figure.why_not == figures["C01"]["share within 15 %, run again"].figure.why_not
    assert again.figure.why_not == "no optimum was run again"


def test_places_are_medians_at_each_weight(study, figures):
    c, (dens, *_) = study.calibrations, PLAN.parameters
    for weight in (0.0, 0.5, 1.0):
        values_there = (c.loc[c["WRL"] == weight, "dem_DENS"] - dens.lower) / (dens.upper - dens.lower)
        assert figures["C04"][f"DENS, WRL {weight:g}"].figure.value == pytest.approx(values_there.median())
        assert figures["C04"][f"YM, WRL {weight:g}"].figure.n == 12


def test_quartiles_and_bounds_are_those_of_the_places(study, figures):
    # 36 places from 0.02 to 0.95 and from 0.1 to 0.8, evenly: half of that between the quartiles.
    assert values(figures["C05"]) == pytest.approx(
        {
            "MU_PW, between quartiles": 0.93 / 2,
            "RF_PW, between quartiles": 0.7 / 2,
            "MU_PW, share at a bound": 0.0,
            "RF_PW, share at a bound": 0.0,
        }
    )
    c = study.calibrations.copy()
    ends = c.index[c["calibrated_RF_PW"]][:9]
    c.loc[ends, "dem_RF_PW"] = [0.001, 0.1, 0.0019] * 3  # within 1 % of 0.099
    at_ends = by_name(ledger.requirements(replace(study, calibrations=c)))["C05"]
    assert at_ends["RF_PW, share at a bound"].figure.value == 9 / 36


def test_a_weight_is_tested_among_the_rows_that_calibrate_mu_pp_and_among_those_that_hold_it(study, figures):
    c = study.calibrations
    for name, rows in (
        ("WRL, MU_PP calibrated", c[c["calibrated_MU_PP"]]),
        ("WRL, MU_PP held", c[~c["calibrated_MU_PP"]]),
    ):
        means = rows.groupby("WRL")[f"dem_{ANGLE_OF_REPOSE}"].mean()
        for other in (0.5, 1.0):
            effect = figures["C12"][f"{name} 0 to {other:g}"]
            assert effect.figure.value == pytest.approx(means[other] - means[0.0])
            assert (effect.figure.n, effect.least, effect.most) == (36, -2, 2)
        # A lack of significance counts, for the 36 rows are all that the plan has.
        p = figures["C12"][f"p of {name}"].figure
        assert p.low == p.high == p.value


def test_the_effect_of_ym_is_that_of_its_whole_interval_on_the_samples_that_varied_it(figures):
    angle, density = figures["C23"].values()
    assert (angle.figure.value, density.figure.value) == pytest.approx((3, -40), abs=0.02)
    assert (angle.least, angle.most, density.least, density.most) == (-2, 2, -75, 75)


def test_the_improvement_is_the_difference_of_the_costs_around_both_optima(study, figures, before):
    # The angle is 24 deg at the Kriging optimum, 22 deg at the other, and 23 deg a difference step beside it.
    beside = study.evaluations[study.evaluations[ANGLE_OF_REPOSE] == 22.0].copy()
    beside["DENS"] *= 1.001
    beside[ANGLE_OF_REPOSE] = 23.0
    more = replace(study, evaluations=pd.concat([study.evaluations, beside]))
    changes, without = [], []
    for line in study.calibrations.to_dict("records"):
        cost = cost_of(PLAN, PLAN.row(line["row"]), TARGET)
        names = list(cost.space.box.names)
        ends = [np.array([line[f"{m}_{n}"] for n in names]) for m in ("kriging", "dem")]
        ends.append(np.where(np.array(names) == "DENS", 1.001, 1.0) * ends[1])
        first, after, next_to = (cost.residuals(end, [20, 1500])[-1] ** 2 for end in ends)
        changes.append(0.1**2 + after - 0.2**2 - first)
        without.append(0.15**2 + next_to - 0.2**2 - first)
    assert values(before["C22"]) == pytest.approx({"change of the cost": np.mean(changes)})
    by_size = sorted(without, key=abs)
    assert list(values(by_name(ledger.requirements(more))["C22"]).values()) == pytest.approx(
        [np.mean(without), np.median(without), np.mean(by_size[:-5])]
    )
    # The chosen run alone says nothing.
    assert all(np.isnan(r.figure.value) for r in figures["C22"].values())


def test_a_row_that_failed_ends_nowhere_and_one_not_finished_may_end_anywhere(study):
    calibrate = study.calibrations["calibrated_MU_PW"]
    lost = study.calibrations.index[calibrate][::4]
    failed = study.calibrations.copy()
    failed.loc[lost, "outcome"] = "failed"
    of_failed, of_missing = (
        by_name(ledger.requirements(replace(study, calibrations=c)))["C05"]
        for c in (failed, study.calibrations.drop(index=lost))
    )
    for name in ("MU_PW, between quartiles", "MU_PW, share at a bound"):
        known, open_ = of_failed[name].figure, of_missing[name].figure
        assert (known.value, known.n) == (open_.value, 27) == (open_.value, open_.n)
        assert known.low == known.high == known.value
        assert open_.low < open_.high


def test_the_optimums_own_run_can_be_left_out_of_what_is_around_it(study, figures):
    # Each row has one run at either optimum; one more beside that of the DEM model costs something else.
    beside = study.evaluations[study.evaluations[ANGLE_OF_REPOSE] == 22.0].copy()
    beside["DENS"] *= 1.001
    beside[ANGLE_OF_REPOSE] = 26.0
    more = replace(study, evaluations=pd.concat([study.evaluations, beside]))
    alone, both, without = costs_around(study), costs_around(more), costs_around(more, without_optimum=True)
    assert alone["kriging"].equals(both["kriging"]) and alone["kriging"].equals(without["kriging"])
    np.testing.assert_allclose(both["dem"], (alone["dem"] + without["dem"]) / 2)
    assert (without["dem"] > alone["dem"]).all()
    assert costs_around(study, without_optimum=True)["dem"].isna().all()


@pytest.mark.parametrize(("claim", "model", "data"), [("C08", "kriging", "Kriging"), ("C09", "dem", "DEM")])
def test_p_values_are_those_of_the_optima_that_the_statement_is_on(study, figures, claim, model, data):
    parameters, responses = (
        study.calibrations[[f"{model}_{name}" for name in names]].set_axis(list(names), axis=1)
        for names in (PARAMETERS, RESPONSES)
    )
    found = manova(parameters, responses)
    p = {term: test.p for term, test in found.sequential.items()}
    if claim == "C08":
        p["smallest of the interactions"] = min(p[term] for term in rules.INTERACTIONS)
    assert values(figures[claim]) == pytest.approx({name: p[name] for name in figures[claim]})
    table = table5(study).query("data == @data").set_index("term")
    assert table["p"].to_dict() == pytest.approx({term: p[term] for term in terms_of(PARAMETERS)})
    given_others = {term: test.p for term, test in found.marginal.items()}
    assert table["p_given_all_others"].to_dict() == pytest.approx(given_others)
    # Nothing comes after the last term; what does after the first one takes part of its credit.
    assert given_others["RF_PW:YM"] == pytest.approx(p["RF_PW:YM"])
    assert given_others["DENS"] != pytest.approx(p["DENS"], rel=0.01)


def r(x, y):
    return float(np.corrcoef(x, y)[0, 1])


def test_correlations_are_those_of_the_rows_that_calibrated_and_in_the_tables_of_all_rows_too(
    study, figures, before
):
    c = study.calibrations
    calibrated = {name: c[c[f"calibrated_{name}"]] for name in PARAMETERS}
    optima = {name: r(rows[f"kriging_{name}"], rows[f"dem_{name}"]) for name, rows in calibrated.items()}
    assert values(figures["C06"]) == pytest.approx(optima)
    everywhere = {name: r(c[f"kriging_{name}"], c[f"dem_{name}"]) for name in PARAMETERS}
    assert table3(study).set_index("parameter")["correlation_all_rows"].to_dict() == pytest.approx(everywhere)

    pairs = {}
    for pair in CALIBRATED_TOGETHER:
        a, b = pair.split(":")
        rows = c[c[f"calibrated_{a}"] & c[f"calibrated_{b}"]]
        pairs[pair] = r(rows[f"dem_{a}"], rows[f"dem_{b}"])
        everywhere[pair] = r(c[f"dem_{a}"], c[f"dem_{b}"])
    assert values(before["C10"]) == pytest.approx(pairs)
    mixed = {pair: value for pair, value in pairs.items() if pair not in ("MU_PP:MU_PW", "RF_PP:RF_PW")}
    assert values(figures["C21"]) == pytest.approx(mixed)
    found = table6(study).set_index("pair")["correlation_all_rows"].to_dict()
    assert found == pytest.approx({pair: everywhere[pair] for pair in pairs})

    responses = [r(c[f"kriging_{name}"], c[f"dem_{name}"]) for name in RESPONSES]
    assert list(values(figures["C07"]).values())[:3] == pytest.approx(responses)


def test_effects_are_the_differences_of_the_means_of_a_balanced_plans_levels(study, figures, before):
    def between(factor, response, a, b):
        means = study.calibrations.groupby(factor)[f"dem_{response}"].mean()
        return means[b] - means[a]

    for claim, factor, response, name, levels, margin in (
        ("C11", "WRL", RAYLEIGH_TIME_STEP, "WRL", (0, 0.5, 1), None),
        ("C12", "WRL", ANGLE_OF_REPOSE, "WRL", (0, 0.5, 1), 2),
        ("C18", "SPP", ANGLE_OF_REPOSE, "angle, SPP", (3, 6, 9), 2),
        ("C18", "SPP", BULK_DENSITY, "density, SPP", (3, 6, 9), 75),
    ):
        of = before if claim == "C12" else figures
        first, second, third = levels
        pairs = [(first, second), (first, third), *([(second, third)] if claim == "C18" else [])]
        for one, other in pairs:
            required = of[claim][f"{name} {one} to {other}"]
            assert required.figure.value == pytest.approx(between(factor, response, one, other))
            assert margin is None or (required.least, required.most) == (-margin, margin)
        if margin is not None:
            p = factor_effect(study.factors(), response, factor, [f for f in FACTORS if f != factor]).p
            assert of[claim][f"p of {name}"].figure.value == pytest.approx(p)
        named = {f"{name} {one} to {other}" for one, other in pairs} | {f"p of {name}"}
        assert {n for n in of[claim] if name in n} == (named - {f"p of {name}"} if margin is None else named)
    (rise,) = figures["C13"].values()
    assert rise.figure.value == pytest.approx(between("WRL", BULK_DENSITY, 0, 1))
    assert (rise.least, rise.most) == (0, 75)


def test_slopes_are_those_of_each_weights_own_rows(study, figures):
    half, none, one = (
        np.polyfit(rows["SPP"], rows["runs_optimisation"], 1)[0]
        for rows in (study.calibrations[study.calibrations["WRL"] == w] for w in (0.5, 0, 1))
    )
    found = values(figures["C15"])
    assert (found["WRL 0"], found["WRL 0.5"]) == pytest.approx((none, half))
    assert found["WRL 1, upper end"] > one


@pytest.mark.parametrize("weights", [(0.0,), (0.0, 1.0)])
def test_statements_on_levels_that_a_plan_lacks_do_not_hold(study, weights):
    rows = tuple(row for row in PLAN.rows if row.WRL in weights)
    part = replace(study.only({row.run for row in rows}), plan=replace(PLAN, rows=rows))
    found = ledger.requirements(part)
    for claim in ("C11", "C12", *([] if 1.0 in weights else ["C13"])):
        assert decide(found[claim]) is not Verdict.HOLDS
