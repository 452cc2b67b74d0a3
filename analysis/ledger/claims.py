"""Ledger of the paper's claims: what decides each, this study's figures, and the verdict.

The rules are in ``rules``, the figures in ``figures``; ``before`` has rules as they were before a change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from calstudy.analysis.exhibit import Column, printed
from calstudy.analysis.ledger import figures, rules
from calstudy.analysis.ledger.before import BEFORE
from calstudy.analysis.ledger.of_the_paper import paper_requirements
from calstudy.analysis.published import BETWEEN_DECKS, published
from calstudy.analysis.statistics.estimates import mean, median
from calstudy.analysis.statistics.verdicts import Requirement, Verdict, decide
from calstudy.analysis.tables.table3 import table3
from calstudy.analysis.tables.table4 import table4
from calstudy.analysis.tables.table6 import table6
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.plan_check import check
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP
from calstudy.study.reading import Study

TITLE = "Ledger of the paper's claims"
COLUMNS = (
    Column("claim", "No."),
    Column("where", "Where"),
    Column("statement", "Claim, in our words"),
    Column("published", "Published"),
    Column("this_study", "This study"),
    Column("n", "n", "s"),
    Column("verdict", "Verdict"),
    Column("verdict_before", "By the rule before"),
    Column("changed", "Rule changed after data were seen"),
    Column("because", "Because"),
    Column("on_the_papers_numbers", "The rule on the paper's own numbers"),
    Column("rule", "Rule"),
    Column("rule_before", "Rule before"),
)


def claims(study: Study) -> pd.DataFrame:
    """One line for each claim. Each verdict comes with the figures that decide it."""
    found, before = requirements(study), requirements_before(study)
    paper, changes = paper_requirements(), published("changed_rules").set_index("claim")
    lines = []
    for line in published("claims").to_dict("records"):
        required = found[line["claim"]]
        numbers = [r.figure.n for r in required]
        verdict = decide(required)
        own = paper.get(line["claim"])
        changed = changes.loc[line["claim"]] if line["claim"] in before else None
        lines.append(
            line
            | {
                "this_study": "; ".join(map(_figure, required)),
                "n": f"{min(numbers)}" if len(set(numbers)) == 1 else f"{min(numbers)} to {max(numbers)}",
                "verdict": str(verdict),
                "verdict_before": "" if changed is None else str(decide(before[line["claim"]])),
                "changed": "" if changed is None else f"{changed['changed']}: {changed['reason']}",
                "rule_before": "" if changed is None else changed["rule_before"],
                "because": _because(required, verdict),
                "on_the_papers_numbers": str(decide(own)) if own else "prints no number that decides it",
            }
        )
    return pd.DataFrame(lines)[[c.name for c in COLUMNS]]


def requirements(study: Study) -> dict[str, list[Requirement]]:
    """Requirements of each claim, with this study's figures."""
    return {claim: required(study) for claim, required in _REQUIRED.items()}


def requirements_before(study: Study) -> dict[str, list[Requirement]]:
    """Requirements by the old rules, of those claims whose rule was changed."""
    return {claim: required(study) for claim, required in BEFORE.items()}


def notes(study: Study) -> list[str]:
    """Notes under the table."""
    said = [
        "A claim holds when every figure's interval lies within the limits of its rule, does not hold "
        "when one lies outside as a whole, and cannot be decided otherwise. In brackets: 95 % intervals, or "
        "what the rows not yet finished can still make of a count.",
        f"{len(BEFORE)} rules were changed after data were seen; what they said before stands beside them.",
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
    return [*said, BETWEEN_DECKS, study.provenance()]


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


# ---- what decides each claim ---------------------------------------------------------------------


def _c01(study: Study) -> list[Requirement]:
    tolerance = rules.ANGLE_TOLERANCE
    reported = figures.share(study, figures.close(study, ANGLE_OF_REPOSE, tolerance))
    return rules.c01(reported, figures.close_again(study, ANGLE_OF_REPOSE, tolerance))


def _c02(study: Study) -> list[Requirement]:
    tolerances = rules.DENSITY_TOLERANCES
    reported = {t: figures.share(study, figures.close(study, BULK_DENSITY, t)) for t in tolerances}
    return rules.c02(reported, {t: figures.close_again(study, BULK_DENSITY, t) for t in tolerances})


def _c05(study: Study) -> list[Requirement]:
    return rules.c05(
        {name: figures.between_quartiles(study, name) for name in rules.WALLS},
        {name: figures.at_a_bound(study, name) for name in rules.WALLS},
    )


def _c11(study: Study) -> list[Requirement]:
    _, effects = figures.effects_of(study, "WRL", RAYLEIGH_TIME_STEP)
    return rules.c11(effects[(0.0, 0.5)], effects[(0.0, 1.0)])


def _c13(study: Study) -> list[Requirement]:
    _, effects = figures.effects_of(study, "WRL", BULK_DENSITY)
    return rules.c13(effects[(0.0, 1.0)], study.settings.target.values[BULK_DENSITY])


def _c16(study: Study) -> list[Requirement]:
    _, effects = figures.effects_of(study, "SPP", "runs_total")
    return rules.c16(effects[(3.0, 6.0)], effects[(6.0, 9.0)])


def _c18(study: Study) -> list[Requirement]:
    return figures.no_effect_of_samples(study, every_pair=True)


def _c19(study: Study) -> list[Requirement]:
    p = load_plan().published  # the paper's, whatever plan the study has
    return rules.c19(check(study.plan).word_lengths[2:5], p.decimals, (p.A3, p.A4, p.A5))


def _c12(study: Study) -> list[Requirement]:
    names = {True: "WRL, MU_PP calibrated", False: "WRL, MU_PP held"}
    return [
        r
        for which, name in names.items()
        for r in figures.no_effect(study, "WRL", ANGLE_OF_REPOSE, name, which)
    ]


def _c22(study: Study) -> list[Requirement]:
    changes = figures.improvement(study, without_optimum=True)
    fewer = figures.without_largest(changes, rules.LARGEST)
    averages = ((mean, changes), (median, changes), (mean, fewer))
    return rules.c22(*(figures.of_gains(estimate, of) for estimate, of in averages))


_REQUIRED: Mapping[str, Callable[[Study], list[Requirement]]] = {
    "C01": _c01,
    "C02": _c02,
    "C03": lambda s: rules.c03(figures.stopped(s, "kriging"), figures.stopped(s, "dem")),
    "C04": lambda s: rules.c04(*(figures.place_by_weight(s, name) for name in ("DENS", "YM"))),
    "C05": _c05,
    "C06": lambda s: rules.c06(figures.correlations(table3(s), "parameter")),
    "C07": lambda s: rules.c07(figures.correlations(table4(s), "response")),
    "C08": lambda s: rules.c08(*figures.p_values(s, "kriging")),
    "C09": lambda s: rules.c09(*figures.p_values(s, "dem")),
    "C10": lambda s: rules.c10(figures.correlations(table6(s), "pair")),
    "C11": _c11,
    "C12": _c12,
    "C13": _c13,
    "C14": lambda s: rules.c14(*figures.extreme_runs(s)),
    "C15": lambda s: rules.c15(figures.slopes_of(s), len(s.ok), s.planned),
    "C16": _c16,
    "C17": lambda s: rules.c17(mean(s.ok["runs_total"])),
    "C18": _c18,
    "C19": _c19,
    "C20": lambda s: rules.c20(*figures.cost_of_time(s)),
    "C21": lambda s: rules.c21(figures.correlations(table6(s), "pair")),
    "C22": _c22,
    "C23": lambda s: rules.c23(figures.effect_of_modulus(s), s.settings.target.values[BULK_DENSITY]),
}
