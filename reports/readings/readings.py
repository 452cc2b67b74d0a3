"""Which reading of the paper explains the paper: a likelihood over all of its signatures at once.

    python reports/readings/readings.py emulators [NAME ...]   makes readings' emulators, in studies/readings
    reports/readings/run [NAME ...]                            runs the replicated studies on them
    python reports/readings/readings.py table                  writes likelihoods.csv, likelihoods.png and
                                                               signatures.csv here
    python reports/readings/page.py                            prints the page's tables from what is here

The rule (RULE, SIGNATURES) was committed before the replicates of `plate_65`, `height` and all later ones
were run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats
from threadpoolctl import threadpool_limits

from calstudy.emulator.emulator import fit_emulator, write_emulator
from calstudy.emulator.similarity import Similarity
from calstudy.models.find import DEFAULT_MODEL, Declared, declaration
from calstudy.models.folder.file import load_folder
from calstudy.plan_file import load_plan

Array = NDArray[np.float64]

HERE = Path(__file__).parent
REPORTS = HERE.parent
STUDIES = HERE.parents[1] / "studies" / "readings"
ROWS = 72
CHEAP = "appendix_a"
"""Name of the cheap level of a reading by another rule: runs at `soft` that Appendix A measures."""
RULES = ("top30", "flank", "cone")
STORED = {
    "ring": Path("../../liggghts_models/angle_of_repose/emulators/soft-ring/runs.parquet"),
    "plate_65": Path("plate_65_runs.parquet"),
    "square": Path("square_runs.parquet"),
    "rules": Path("rules.parquet"),
    "wide": Path("wide/runs.parquet"),
}
"""Runs that the readings are made of."""
BOTTOM_LAYER = 0.005
"""Of the height, in m: the diameter of a bead, which step 6 of Appendix A takes off."""
BOOTSTRAP = 2000
CLEARLY = np.log(20.0)
"""RULE. A reading replaces the default, the ring at `full`, if its log likelihood is larger by this at least,
also at the lower end of the bootstrap's 90 % interval, and if more than 5 % of its own replicates are as far
from their others as the paper is."""
ADEQUATE = 0.05


def logit_of_share(x: Array) -> Array:
    """Of a share of the rows; a share of 0 or 1 is half a row away."""
    k = np.clip(ROWS * x, 0.5, ROWS - 0.5)
    return np.log(k / (ROWS - k))


def log_p(x: Array) -> Array:
    """Decimal logarithm of a p, down to what R prints as the smallest."""
    return np.log10(np.maximum(x, 2.2e-16))


@dataclass(frozen=True, slots=True)
class Signature:
    """A number of the paper, where the replicates have it, and a scale on which it is nearly normal."""

    where: str
    entry: str
    paper: float
    scale: Callable[[Array], Array]


SIGNATURES = (
    Signature("C01", "share within 15 %", 0.75, logit_of_share),
    Signature("Table 4", "angle of repose", 0.7186, np.arctanh),
    Signature("Table 6", "MU_PP:RF_PP", -0.659, np.arctanh),
    Signature("C14", "fewest", 10.0, np.log),
    Signature("C14", "most", 55.0, np.log),
    Signature("Table 5", "DEM: MU_PW", 0.0969, log_p),
    Signature("Table 5", "DEM: RF_PW", 8.98e-9, log_p),
)
"""RULE. These and nothing else: share of angles in reach, the two correlations, the smallest and largest
number of runs, and the p of the two wall parameters."""


@dataclass(frozen=True, slots=True)
class Reading:
    """One reading of what the paper leaves open."""

    name: str
    meaning: str
    replicates: Path


READINGS = (
    Reading("full-ring", "the plate ends at the ring (default)", REPORTS / "emulated" / "full-ring"),
    Reading("soft-ring", "the same at soft", REPORTS / "emulated" / "soft-ring"),
    Reading("soft-wide", "a wide plate, at soft", REPORTS / "emulated" / "soft-wide"),
    Reading("plate_65", "the plate ends 15 mm outside the ring, at soft", HERE / "plate_65"),
    Reading("height", "Appendix A takes the bottom layer off twice, at soft", HERE / "height"),
    Reading("top30", "the angle by the thirty highest beads, at soft", HERE / "top30"),
    Reading("flank", "the angle by the flanks of six side views, at soft", HERE / "flank"),
    Reading("cone", "the angle by a cone through the surface's beads, at soft", HERE / "cone"),
    Reading("square", "a square of an infinite plane, 50 mm to each side, at soft", HERE / "square"),
)


def signatures(replicates: pd.DataFrame) -> Array:
    """Signatures of each replicate on their scales, (n, 7); of `Table 5` the sequential p, as the paper's."""
    columns = []
    for s in SIGNATURES:
        chosen = replicates[(replicates["where"] == s.where) & (replicates["entry"] == s.entry)]
        columns.append(s.scale(chosen.sort_values("replicate")["value"].to_numpy(float)))
    X = np.column_stack(columns)
    return X[np.isfinite(X).all(axis=1)]


def paper() -> Array:
    """The paper's own signatures on their scales, (7,)."""
    return np.array([float(s.scale(np.array([s.paper]))[0]) for s in SIGNATURES])


def log_likelihood(X: Array, x: Array) -> float:
    """Log density of a next replicate at ``x`` (p,), given replicates ``X`` (n, p) of a normal distribution.

    Multivariate t of n - p degrees of freedom: mean and covariance are integrated out under Jeffreys' prior
    (Gelman et al., Bayesian Data Analysis, 3rd ed., section 3.6). NaN where a signature never varies.
    """
    if (np.ptp(X, axis=0) == 0.0).any():
        return float("nan")
    n, p = X.shape
    scale = np.cov(X, rowvar=False, ddof=1) * (n - 1) * (n + 1) / (n * (n - p))
    return float(stats.multivariate_t.logpdf(x, X.mean(axis=0), scale, n - p))


def as_far(X: Array, x: Array) -> float:
    """Share of replicates that are at least as far from the others as ``x``, itself counted (Mahalanobis)."""
    both = np.vstack([X, x])

    def distance(k: int) -> float:
        others = np.delete(both, [k, len(X)], axis=0)
        step = both[k] - others.mean(axis=0)
        return float(step @ np.linalg.pinv(np.cov(others, rowvar=False)) @ step)

    own = distance(len(X))
    return (1 + sum(distance(k) >= own for k in range(len(X)))) / (len(X) + 1)


def resampled(X: Array, x: Array) -> Array:
    """Log likelihoods of `BOOTSTRAP` draws of the replicates with replacement."""
    rng = np.random.default_rng(0)
    return np.array([log_likelihood(X[rng.integers(len(X), size=len(X))], x) for _ in range(BOOTSTRAP)])


def replicated_ones() -> list[Reading]:
    """Readings whose study was replicated."""
    return [reading for reading in READINGS if (reading.replicates / "replicates.parquet").exists()]


def replicated(reading: Reading) -> Array:
    """Signatures of a reading's replicates on their scales, (n, 7)."""
    return signatures(pd.read_parquet(reading.replicates / "replicates.parquet"))


def table() -> pd.DataFrame:
    """A line for each reading: log likelihood with interval, alone and over the default, and `as_far`."""
    x, lines, default, default_reached = paper(), [], None, None
    for reading in replicated_ones():
        X = replicated(reading)
        drawn, reached = resampled(X, x), resampled(X[:, 1:], x[1:])
        default = (log_likelihood(X, x), drawn) if default is None else default
        default_reached = reached if default_reached is None else default_reached
        low, high = np.quantile(drawn, [0.05, 0.95])
        over_low, over_high = np.quantile(drawn - default[1], [0.05, 0.95])
        without = {
            f"without {s.where} {s.entry}": log_likelihood(np.delete(X, k, axis=1), np.delete(x, k))
            for k, s in enumerate(SIGNATURES)
        }
        without_low, without_high = np.quantile(reached - default_reached, [0.05, 0.95])
        lines.append(
            {
                "reading": reading.name,
                "meaning": reading.meaning,
                "replicates": len(X),
                "log_likelihood": log_likelihood(X, x),
                "low": low,
                "high": high,
                "over_default": log_likelihood(X, x) - default[0],
                "over_default_low": over_low,
                "over_default_high": over_high,
                "as_far": as_far(X, x),
                **without,
                "without_C01_low": without_low,
                "without_C01_high": without_high,
                "as_far_without_C01": as_far(X[:, 1:], x[1:]),
            }
        )
    return pd.DataFrame(lines)


def spread(names: Sequence[str]) -> pd.DataFrame:
    """A line for each reading and signature: the paper's value, median and 90 % range of the replicates."""
    lines = []
    for name in names:
        of = pd.read_parquet(next(r for r in READINGS if r.name == name).replicates / "replicates.parquet")
        for s in SIGNATURES:
            values = of.loc[(of["where"] == s.where) & (of["entry"] == s.entry), "value"]
            low, median, high = np.quantile(values, [0.05, 0.5, 0.95])
            line = {"reading": name, "signature": f"{s.where} {s.entry}", "paper": s.paper}
            lines.append(line | {"low": low, "median": median, "high": high})
    return pd.DataFrame(lines)


def by_rule(rule: str, ring: pd.DataFrame) -> pd.DataFrame:
    """Runs of the ring: kept heaps by a rule, and all others by Appendix A as the cheap level."""
    kept = pd.read_parquet(HERE / STORED["rules"])
    others = ring[~ring["run_id"].isin(kept["run_id"])]
    measured = kept.assign(angle_of_repose_deg=kept[rule])[ring.columns]
    return pd.concat([others.assign(fidelity=CHEAP), measured], ignore_index=True)


def emulators(*names: str) -> None:
    """Emulators of readings that are not shipped, from stored runs; without names all."""
    plan, heap = load_plan(), declaration(DEFAULT_MODEL)
    ring, plate_65, square = (pd.read_parquet(HERE / STORED[n]) for n in ("ring", "plate_65", "square"))
    lower = np.degrees(np.arctan((ring["heap_height"] - BOTTOM_LAYER) / ring["heap_radius"]))
    made: dict[str, tuple[pd.DataFrame, Declared]] = {
        "plate_65": (plate_65, heap),
        "height": (ring.assign(angle_of_repose_deg=lower), heap),
        "square": (square, load_folder(HERE / "models" / "square")),
    }
    made |= {rule: (by_rule(rule, ring), heap) for rule in RULES}
    for name in names or made:
        runs, model = made[name]
        similarity = Similarity.of(model, plan.parameters)
        fitted = fit_emulator(runs, plan.parameters, similarity, reference="soft")
        write_emulator(STUDIES / name / "emulator", fitted)


def picture(found: pd.DataFrame) -> None:
    """Log likelihoods with their intervals, and each reading's signatures beside the paper's."""
    x = paper()
    fig, axes = plt.subplots(2, 4, figsize=(12, 5.5), layout="constrained")
    ends = np.abs(found[["low", "high"]].to_numpy().T - found["log_likelihood"].to_numpy())
    places = np.arange(len(found))
    axes.flat[0].errorbar(found["log_likelihood"], places, xerr=ends, fmt="o", color="black", capsize=3)
    for place in places[found["log_likelihood"].isna()]:
        axes.flat[0].text(found["log_likelihood"].min(), place, "not defined", va="center")
    axes.flat[0].set(title="log likelihood, 90 % interval", yticks=places, yticklabels=found["reading"])
    axes.flat[0].invert_yaxis()
    known = {reading.name: reading for reading in READINGS}
    for k, (signature, ax) in enumerate(zip(SIGNATURES, axes.flat[1:], strict=True)):
        drawn = [replicated(known[name])[:, k] for name in found["reading"]]
        ax.boxplot(drawn, orientation="horizontal", positions=places, whis=(5, 95), showfliers=False)
        ax.axvline(x[k], color="tab:red")
        ax.set(title=f"{signature.where}: {signature.entry}", yticks=places, yticklabels=[])
        ax.invert_yaxis()
    fig.savefig(HERE / "likelihoods.png", dpi=110)


def main(what: str, *names: str) -> None:
    """Make the readings' emulators, or the table and its picture."""
    if what == "emulators":
        with threadpool_limits(1):
            emulators(*names)
        return
    found = table()
    found.to_csv(HERE / "likelihoods.csv", index=False, float_format="%.4g", lineterminator="\n")
    spread(found["reading"].tolist()).to_csv(
        HERE / "signatures.csv", index=False, float_format="%.4g", lineterminator="\n"
    )
    picture(found)
    print(found.drop(columns=["meaning"]).round(3).to_string(index=False))


if __name__ == "__main__":
    main(*(sys.argv[1:] or ["table"]))
