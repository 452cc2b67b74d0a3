"""The lines of the page's tables, from what is shipped beside it.

python reports/readings/page.py
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from readings import HERE, RULES, STORED, Array, log_likelihood, paper, replicated, replicated_ones

from calstudy.models.find import DEFAULT_MODEL, declaration
from calstudy.plan_file import load_plan

FEWER, SUBSETS = 40, 400
"""Replicates of the readings that have fewest, and how often so many are drawn of those that have more."""
SHOWN = ("Table 6 MU_PP:RF_PP", "Table 4 angle of repose", "C14 fewest")
"""Signatures of the table of readings that lower the angle."""
LOWER = ("height", "top30", "flank", "cone", "full-ring")


def page(found: pd.DataFrame) -> list[str]:
    """Lines of the page's table."""
    without = found["without C01 share within 15 %"]
    lines = []
    for k, one in found.iterrows():
        default = k == 0
        over = [one[f"over_default{end}"] for end in ("", "_low", "_high")]
        rest = [without[k] - without[0], one["without_C01_low"], one["without_C01_high"]]
        cells = (
            f"`{one['reading']}`: {one['meaning']}",
            str(one["replicates"]),
            number(one["log_likelihood"]),
            "" if default else in_words(over),
            f"{one['as_far']:.3f}",
            "" if default else in_words(rest),
            f"{one['as_far_without_C01']:.3f}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def number(value: float) -> str:
    """With one digit."""
    return f"{value:.1f}" if math.isfinite(value) else "not defined"


def in_words(ends: Sequence[float] | Array) -> str:
    """A number with its interval, as far as they are defined."""
    value, *interval = ends
    if not np.isfinite(interval).all():
        return number(value) + (" (not defined)" if math.isfinite(value) else "")
    return f"{number(value)} ({' to '.join(map(number, interval))})"


def paired(runs: pd.DataFrame, others: pd.DataFrame, on: Sequence[str]) -> str:
    """Difference of the angles of two tables of runs at equal points and seeds, with its standard error."""
    both = runs.merge(others, on=list(on), suffixes=("", "_other"))
    step = both["angle_of_repose_deg"] - both["angle_of_repose_deg_other"]
    return f"{step.mean():+.2f} ± {step.std(ddof=1) / np.sqrt(len(step)):.2f} deg at {len(step)} points"


def effect(runs: pd.DataFrame, name: str) -> str:
    """What a parameter does to the angle over the plan's interval, all others beside it, linearly."""
    parameters = load_plan().parameters
    unit = [(runs[p.name] - p.lower) / (p.upper - p.lower) for p in parameters]
    A = np.column_stack([np.ones(len(runs)), *unit])
    y = runs["angle_of_repose_deg"].to_numpy(float)
    b, rest, *_ = np.linalg.lstsq(A, y)
    k = 1 + [p.name for p in parameters].index(name)
    error = math.sqrt(rest[0] / (len(y) - A.shape[1]) * np.linalg.inv(A.T @ A)[k, k])
    return f"{b[k]:+.1f} ± {error:.1f} deg"


def figures() -> list[str]:
    """Lines of the page's table of what the runs say before anything is emulated."""
    runs = {name: pd.read_parquet(HERE / path) for name, path in STORED.items()}
    ring, square, smooth = runs["ring"], runs["square"], runs["wide"].iloc[:4]
    point = [*declaration(DEFAULT_MODEL).parameters, "seed"]
    kept = runs["rules"].groupby("label")[["angle_of_repose_deg", *RULES]].mean()
    shifts = kept[list(RULES)].sub(kept["angle_of_repose_deg"], axis=0)
    left = smooth["reason"].str.extract(r"beads_heap (\d+)")[0].astype(int)
    circle = pd.read_csv(HERE / "circle.csv")
    x, rng = paper(), np.random.default_rng(1)
    fewer = {
        r.name: [log_likelihood(X[rng.choice(len(X), FEWER, replace=False)], x) for _ in range(SUBSETS)]
        for r in replicated_ones()
        if len(X := replicated(r)) > FEWER
    }
    told = {
        **{
            f"log likelihood of `{name}` by {FEWER} of its replicates": in_words(
                np.quantile(drawn, [0.5, 0.05, 0.95])
            )
            for name, drawn in fewer.items()
        },
        "`square` less `soft-ring`, equal points and seeds": paired(square, ring, point),
        "`square`, mean radius": f"{1e3 * square['heap_radius'].mean():.1f} mm",
        "`soft-ring`, mean radius there": f"{1e3 * at_points_of(square, ring, point):.1f} mm",
        **{
            f"`{name}`, RF_PW's whole interval": effect(runs[name], "RF_PW")
            for name in ("square", "plate_65")
        },
        **{
            f"`{rule}` less Appendix A": f"{shifts[rule].mean():+.2f} deg, standard deviation "
            f"{shifts[rule].std():.2f}, {len(runs['rules'])} heaps at {len(kept)} points"
            for rule in RULES
        },
        "walls without rolling friction": f"{(smooth['outcome'] == 'ok').sum()} of {len(smooth)} at rest, "
        f"{left.min()} to {left.max()} beads left on the plate",
        **{
            f"wide plate, {words}": f"{(circle[rule] - circle['appendix_a']).mean():+.2f} deg, of "
            f"{circle['appendix_a'].mean():.1f} in the mean of {len(circle)} heaps"
            for rule, words in (("edges", "edges alone"), ("third", "a third round"))
        },
        **{
            f"processor time, {name}": f"{of['cpu_time'].sum() / 3600:.2f} h for {len(of)} runs"
            for name, of in runs.items()
            if name in ("plate_65", "square", "wide")
        },
    }
    return [f"| {what} | {value} |" for what, value in told.items()]


def at_points_of(runs: pd.DataFrame, others: pd.DataFrame, on: Sequence[str]) -> float:
    """Mean radius in m of other runs at the points of these."""
    return float(runs[list(on)].merge(others, on=list(on))["heap_radius"].mean())


def lower(found: pd.DataFrame) -> list[str]:
    """Lines of the table of readings that lower the angle, indented: median and 90 % range of signatures."""
    by = found.set_index(["reading", "signature"])
    of_paper = [f"{by.loc[(LOWER[0], s), 'paper']:.2f}".removesuffix(".00") for s in SHOWN]
    lines = [["paper", *of_paper]]
    for reading in LOWER:
        cells = [by.loc[(reading, s), ["median", "low", "high"]].to_list() for s in SHOWN]
        words = [f"{m:.2f} ({low:.2f} to {high:.2f})" for m, low, high in cells[:-1]]
        lines.append([f"`{reading}`", *words, f"{cells[-1][0]:g}"])
    return [f"  | {' | '.join(line)} |" for line in lines]


def lines() -> list[str]:
    """All lines."""
    likelihoods, ranges = (pd.read_csv(HERE / f"{name}.csv") for name in ("likelihoods", "signatures"))
    return [*page(likelihoods), *lower(ranges), *figures()]


if __name__ == "__main__":
    print("\n".join(lines()))
