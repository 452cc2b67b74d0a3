"""Rules as they were before they were changed with data there. Their verdicts stand beside the new ones.

``published/changed_rules.csv`` has them in words, with the day and the reason of each change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from calstudy.analysis.ledger import figures, rules
from calstudy.analysis.statistics.estimates import Estimate, mean, median
from calstudy.analysis.statistics.verdicts import Requirement
from calstudy.analysis.tables.table3 import table3
from calstudy.analysis.tables.table4 import table4
from calstudy.analysis.tables.table6 import table6
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.study.reading import Study


def _share(study: Study, response: str, tolerance: float, least: float) -> list[Requirement]:
    close = figures.close(study, response, tolerance)
    return [
        Requirement(
            f"share within {tolerance:.0%}".replace("%", " %"), figures.share(study, close), least, 1.0
        )
    ]


def _c04(study: Study) -> list[Requirement]:
    density, modulus = (median(study.position(name)) for name in ("DENS", "YM"))
    return [Requirement("DENS", density, 0.5, 1.0), Requirement("YM", modulus, 0.0, 0.5)]


def _negligible(correlations: Mapping[str, Estimate]) -> list[Requirement]:
    return [Requirement(pair, r, -rules.NEGLIGIBLE, rules.NEGLIGIBLE) for pair, r in correlations.items()]


def c10(correlations: Mapping[str, Estimate]) -> list[Requirement]:
    """The strong pair is below -0.25, and each other pair within 0.25."""
    strong = rules.STRONG_PAIR
    return [
        Requirement(strong, correlations[strong], -1.0, -rules.NEGLIGIBLE),
        *_negligible({pair: r for pair, r in correlations.items() if pair != strong}),
    ]


def c21(correlations: Mapping[str, Estimate]) -> list[Requirement]:
    """Each pair of a static and a rolling coefficient is within 0.25."""
    return _negligible({pair: r for pair, r in correlations.items() if "MU" in pair and "RF" in pair})


def _c22(study: Study) -> list[Requirement]:
    change = figures.of_gains(mean, figures.improvement(study, without_optimum=False))
    return [Requirement("change of the cost", change, -math.inf, 0.0)]


BEFORE: Mapping[str, Callable[[Study], list[Requirement]]] = {
    "C01": lambda s: _share(s, ANGLE_OF_REPOSE, rules.ANGLE_TOLERANCE, 0.75),
    "C02": lambda s: _share(s, BULK_DENSITY, min(rules.DENSITY_TOLERANCES), 0.9),
    "C04": _c04,
    "C05": lambda s: [Requirement(name, figures.range_of(s, name), 0.9, 1.0) for name in rules.WALLS],
    "C06": lambda s: rules.c06(figures.fisher(figures.correlations(table3(s), "parameter"))),
    "C07": lambda s: rules.c07(figures.fisher(figures.correlations(table4(s), "response"))),
    "C10": lambda s: c10(figures.correlations(table6(s), "pair")),
    "C12": lambda s: figures.no_effect(s, "WRL", ANGLE_OF_REPOSE, "WRL"),
    "C18": lambda s: figures.no_effect_of_samples(s, every_pair=False),
    "C21": lambda s: c21(figures.correlations(table6(s), "pair")),
    "C22": _c22,
}
"""What decided a claim then, by claim."""
