"""What the lines of the benchmark say: each method beside a reference, the same problems, with intervals."""

from __future__ import annotations

import numpy as np
import pandas as pd

RESAMPLES = 2000
CONFIDENCE = 0.95


def score_table(lines: pd.DataFrame, reference: str = "robust") -> pd.DataFrame:
    """Scores of each method on each challenge with each budget.

    Columns: ``challenge``, ``budget``, ``method``, ``n`` (problems), ``paid`` (mean, in runs of the
    fidelity that counts); ``excess``, ``excess_low`` and ``excess_high`` (mean noise-free cost above the
    least of the box, with its 95 % interval by the bootstrap); ``worse_by``, ``worse_low`` and
    ``worse_high`` (the same of the difference to the reference, problem by problem); ``within`` (share of
    problems whose responses are all truly within tolerance); ``said`` (share in which that was said);
    ``said_falsely`` (share of those in which it is not so; NaN where nothing was said); ``surprise`` (root
    mean square of the answers' deviations from what was expected, in the method's own standard deviations);
    ``rounds`` and ``cpu_time`` (s; means); ``failures`` (problems without an answer, or in which the method
    raised an error).
    """
    table = []
    for (name, budget), group in lines.groupby(["challenge", "budget"], sort=False):
        by_method = {method: one.set_index("seed") for method, one in group.groupby("method", sort=False)}
        against = by_method.get(reference)
        for method, one in by_method.items():
            excess = one["excess"].dropna()
            line = {"challenge": name, "budget": budget, "method": method, "n": len(one)}
            line |= {"paid": one["paid"].mean(), "excess": excess.mean()}
            line["excess_low"], line["excess_high"] = interval(excess.to_numpy())
            if against is not None and method != reference:
                difference = (one["excess"] - against["excess"]).dropna()
                line["worse_by"] = difference.mean()
                line["worse_low"], line["worse_high"] = interval(difference.to_numpy())
            said = one["said_within"].fillna(False).astype(bool)
            line |= {"within": one["is_within"].mean(), "said": said.mean()}
            line["said_falsely"] = (~one["is_within"][said]).mean() if said.any() else np.nan
            line["surprise"] = np.sqrt((one["surprise"] ** 2).mean())
            line |= {"rounds": one["rounds"].mean(), "cpu_time": one["cpu_time"].mean()}
            line["failures"] = int(((one["failure"] != "") | one["excess"].isna()).sum())
            table.append(line)
    return pd.DataFrame(table).reindex(columns=SCORES)


SCORES = (
    *("challenge", "budget", "method", "n", "paid", "excess", "excess_low", "excess_high"),
    *("worse_by", "worse_low", "worse_high", "within", "said", "said_falsely", "surprise"),
    *("rounds", "cpu_time", "failures"),
)


def losses(scores: pd.DataFrame) -> pd.DataFrame:
    """Lines of methods that beat the reference: the interval of the difference is below 0."""
    return scores[scores["worse_high"] < 0].reset_index(drop=True)


def interval(values: np.ndarray) -> tuple[float, float]:
    """Interval (95 %) of the mean of values, by the bootstrap; NaN for fewer than two."""
    if len(values) < 2:
        return np.nan, np.nan
    rng = np.random.default_rng(0)
    means = values[rng.integers(0, len(values), (RESAMPLES, len(values)))].mean(axis=1)
    low, high = np.quantile(means, [(1.0 - CONFIDENCE) / 2, (1.0 + CONFIDENCE) / 2])
    return float(low), float(high)
