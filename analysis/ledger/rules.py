"""When a claim of the paper holds: rules on plain numbers.

Each takes figures with their intervals, of a study or of the paper, and returns the limits between which
they must lie. ``published/claims.csv`` has the same rules in words. They were written before there was any
data of a study, except those whose old form is in ``before``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from calstudy.analysis.labels import LABELS
from calstudy.analysis.statistics.estimates import ALPHA, Estimate, correlation_interval, impossible
from calstudy.analysis.statistics.manova import terms_of
from calstudy.analysis.statistics.verdicts import Requirement, exact, p_value, unless_complete
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED
from calstudy.plan import PARAMETERS
from calstudy.records import RAYLEIGH_TIME_STEP

Requirements = list[Requirement]

ANGLE_TOLERANCE = 0.15
DENSITY_TOLERANCES = (0.05, 0.1)
"""Section 4's scatter of measured bulk densities: what "closely" may mean."""
MARGINS = {ANGLE_OF_REPOSE: 2.0, BULK_DENSITY: 0.05}
"""Effects that do not matter: deg, and a share of the target; section 4's scatter of measurements."""
NEGLIGIBLE = 0.25
"""Correlations that section 3.3 calls negligible."""
SPREAD = 1 / 3
"""Least distance between the quartiles of what is spread: of 36 points from a uniform distribution, for which
it is a half, about one set in forty is below."""
LARGEST = 5
"""Changes of the cost without which an improvement must stand."""
NOTHING = 1e-12
"""Change of a cost that is rounding."""
TENTH = 0.1
"""What "about" and "approximately" allow."""
INTERACTIONS = tuple(term for term in terms_of(PARAMETERS) if ":" in term)
SIGNIFICANT_ON_DEM = ("DENS:MU_PP", "DENS:RF_PP", "DENS:YM", "MU_PP:RF_PP")
STRONG_PAIR = "MU_PP:RF_PP"
WALLS = ("MU_PW", "RF_PW")


def c01(reported: Estimate, again: Estimate) -> Requirements:
    """Shares within 15 % of the desired angle: of rows as reported, and of fresh runs at their optima."""
    return [
        Requirement("share within 15 %", reported, 0.75, 1.0),
        Requirement("share within 15 %, run again", again, 0.75, 1.0),
    ]


def c02(reported: Mapping[float, Estimate], again: Mapping[float, Estimate]) -> Requirements:
    """Shares within 5 and within 10 % of the desired bulk density, by tolerance: as in `c01`."""
    both = {"share within 5 to 10 %": reported, "share within 5 to 10 %, run again": again}
    return [Requirement(name, _either(shares), 0.9, 1.0) for name, shares in both.items()]


def _either(shares: Mapping[float, Estimate]) -> Estimate:
    """A share at an unknown tolerance: its bounds are those at the smallest and at the largest one."""
    least, most = shares[min(shares)], shares[max(shares)]
    return replace(least, high=most.high)


def c03(first: Estimate, second: Estimate) -> Requirements:
    """Shares of rows that ended by the criterion."""
    return [Requirement("1st phase", first, 1.0, 1.0), Requirement("2nd phase", second, 1.0, 1.0)]


def c04(density: Mapping[float, Estimate], modulus: Mapping[float, Estimate]) -> Requirements:
    """Median positions in the interval, by WRL."""
    return [
        *(Requirement(f"DENS, WRL {weight:g}", place, 0.5, 1.0) for weight, place in density.items()),
        *(Requirement(f"YM, WRL {weight:g}", place, 0.0, 0.5) for weight, place in modulus.items()),
    ]


def c05(quartiles: Mapping[str, Estimate], at_a_bound: Mapping[str, Estimate]) -> Requirements:
    """Interquartile range of the optima as a share of the interval, and share of them at a bound."""
    return [
        *(Requirement(f"{name}, between quartiles", quartiles[name], SPREAD, 1.0) for name in WALLS),
        *(Requirement(f"{name}, share at a bound", at_a_bound[name], 0.0, 0.5) for name in WALLS),
    ]


def c06(correlations: Mapping[str, Estimate]) -> Requirements:
    """Correlations of both optima, by parameter."""
    return [Requirement(name, correlations[name], 0.9, 1.0) for name in PARAMETERS]


def c07(correlations: Mapping[str, Estimate]) -> Requirements:
    """Correlations of both models' responses."""
    angle = correlations[ANGLE_OF_REPOSE]
    others = [correlations[name] for name in (BULK_DENSITY, RAYLEIGH_TIME_STEP)]
    # It is below both others if the gap between the intervals is; the gap has the bounds of its ends.
    lead = Estimate(
        min(o.value for o in others) - angle.value,
        min(o.low for o in others) - angle.high,
        min(o.high for o in others) - angle.low,
        angle.n,
    )
    return [
        Requirement("angle of repose", angle, 0.5, 1.0),
        Requirement("bulk density", others[0], 0.9, 1.0),
        Requirement("Rayleigh time-step", others[1], 0.9, 1.0),
        Requirement("lead of the others over the angle", lead, 0.0),
    ]


def c08(p: Mapping[str, float], n: int, planned: int) -> Requirements:
    """p-values by term on the Kriging optima."""
    required = [Requirement(name, p_value(p[name], n, planned), 0.0, ALPHA) for name in PARAMETERS]
    tested = [p[name] for name in INTERACTIONS if not math.isnan(p[name])]
    smallest = min(tested, default=math.nan)
    if smallest < ALPHA:
        # One of fifteen below 0.05 is chance as often as not. Only a corrected one counts against the claim.
        corrected = min(1.0, smallest * len(INTERACTIONS))
        found = Estimate(smallest, smallest, corrected, n)
    else:
        found = p_value(smallest if len(tested) == len(INTERACTIONS) else math.nan, n, planned)
    return [*required, Requirement("smallest of the interactions", found, ALPHA, 1.0)]


def c09(p: Mapping[str, float], n: int, planned: int) -> Requirements:
    """p-values by term on the DEM optima."""
    return [
        *(Requirement(name, p_value(p[name], n, planned), 0.0, ALPHA) for name in SIGNIFICANT_ON_DEM),
        Requirement("MU_PW", p_value(p["MU_PW"], n, planned), ALPHA, 1.0),
    ]


def c10(correlations: Mapping[str, Estimate]) -> Requirements:
    """Correlations by pair of friction coefficients: the strong one, and how much weaker the others are."""
    strong = correlations[STRONG_PAIR]
    return [
        Requirement(STRONG_PAIR, strong, -1.0, -NEGLIGIBLE),
        *(
            Requirement(f"|{pair}| less |{STRONG_PAIR}|", _weaker(r, strong), -1.0, 0.0)
            for pair, r in correlations.items()
            if pair != STRONG_PAIR
        ),
    ]


def _weaker(r: Estimate, strong: Estimate) -> Estimate:
    """Magnitude of a correlation minus that of a negative one, with an interval from both (Zou 2007).

    The two are taken as independent.
    """
    if math.isnan(r.low) or math.isnan(strong.low):
        return impossible(min(r.n, strong.n), r.why_not or strong.why_not)
    size = Estimate(abs(r.value), max(r.low, -r.high, 0.0), max(-r.low, r.high), r.n)
    gap = size.value + strong.value
    below = math.hypot(size.value - size.low, strong.value - strong.low)
    above = math.hypot(size.high - size.value, strong.high - strong.value)
    return Estimate(gap, gap - below, gap + above, min(r.n, strong.n))


def c11(to_half: Estimate, to_one: Estimate) -> Requirements:
    """Effects of WRL on the time-step."""
    return [Requirement("WRL 0 to 0.5", to_half, 0.0), Requirement("WRL 0 to 1", to_one, 0.0)]


def no_effect(name: str, p: Estimate, effects: Mapping[str, Estimate], margin: float) -> Requirements:
    """An effect that is not significant, and cannot be large enough to matter (C12, C18)."""
    return [
        Requirement(f"p of {name}", p, ALPHA, 1.0),
        *(Requirement(f"{name} {levels}", effect, -margin, margin) for levels, effect in effects.items()),
    ]


def c13(effect: Estimate, target: float) -> Requirements:
    """Effect of WRL 0 to 1 on the bulk density in kg/m3."""
    return [Requirement("WRL 0 to 1", effect, 0.0, MARGINS[BULK_DENSITY] * target)]


def c14(fewest: Estimate, most: Estimate) -> Requirements:
    """Smallest and largest number of runs of the second optimisation."""
    least, largest = 10 * (1 - TENTH), 55 * (1 + TENTH)
    return [Requirement("fewest", fewest, least, largest), Requirement("most", most, least, largest)]


def c15(slopes: Mapping[float, Estimate], n: int, planned: int) -> Requirements:
    """Slopes of those runs over SPP, by WRL, from ``n`` of the plan's rows."""
    end = slopes[1.0].high
    # The slope's upper end must be above 0: there may be no trend.
    upper = Estimate(end, end, end, slopes[1.0].n, slopes[1.0].why_not)
    if end > 0:
        upper = unless_complete(upper, n, planned, "that no trend is seen")
    return [
        Requirement("WRL 0", slopes[0.0], -math.inf, 0.0),
        Requirement("WRL 0.5", slopes[0.5], -math.inf, 0.0),
        Requirement("WRL 1, upper end", upper, 0.0),
    ]


def c16(three_to_six: Estimate, six_to_nine: Estimate) -> Requirements:
    """Effects of SPP on all runs."""
    return [Requirement("SPP 3 to 6", three_to_six, 0.0), Requirement("SPP 6 to 9", six_to_nine, 0.0)]


def c17(mean: Estimate) -> Requirements:
    """Mean number of DEM runs of a row."""
    return [Requirement("mean", mean, 51 * (1 - TENTH), 51 * (1 + TENTH))]


def c19(lengths: Sequence[float], decimals: int, published: Sequence[float]) -> Requirements:
    """Word lengths A3 to A5."""
    return [
        Requirement(f"A{k}", exact(round(found, decimals), 72), printed, printed)
        for k, (found, printed) in enumerate(zip(lengths, published, strict=True), start=3)
    ]


def c20(minutes: Estimate, hours: Estimate) -> Requirements:
    """Minutes of a DEM run, and hours of all rows' runs one after the other."""
    return [
        Requirement("minutes a run", minutes, 3.0, 12.0),
        Requirement("hours of 72 rows", hours, 175.0, 700.0),
    ]


def c21(correlations: Mapping[str, Estimate]) -> Requirements:
    """Correlations by pair of friction coefficients; those of a static with a rolling one count."""
    mixed = {pair: r for pair, r in correlations.items() if "MU" in pair and "RF" in pair}
    return [Requirement(pair, _decidable(r), -NEGLIGIBLE, NEGLIGIBLE) for pair, r in mixed.items()]


def _decidable(r: Estimate) -> Estimate:
    """A correlation, with the reason if no value could be shown to be negligible at its n."""
    least = correlation_interval(0.0, r.n).high
    overlaps = not (r.low > NEGLIGIBLE or r.high < -NEGLIGIBLE)
    if not (least > NEGLIGIBLE and overlaps):
        return r
    return replace(r, why_not=f"undecidable by design: at n = {r.n} even r = 0 leaves ±{least:.2f}")


def c22(mean: Estimate, median: Estimate, without_largest: Estimate) -> Requirements:
    """Change of the cost from around the Kriging optimum to around the DEM optimum, three averages of it."""
    named = {"mean": mean, "median": median, f"mean without the {LARGEST} largest": without_largest}
    return [Requirement(f"change of the cost, {name}", e, -math.inf, -NOTHING) for name, e in named.items()]


def c23(effects: Mapping[str, Estimate], target_density: float) -> Requirements:
    """Effects of YM's whole interval on the measured responses."""
    margins = {
        ANGLE_OF_REPOSE: MARGINS[ANGLE_OF_REPOSE],
        BULK_DENSITY: MARGINS[BULK_DENSITY] * target_density,
    }
    return [Requirement(LABELS[name], effects[name], -margins[name], margins[name]) for name in MEASURED]
