"""How far an emulator can be trusted: its predictions beside runs that it was not fitted to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import pandas as pd
from scipy import stats

from calstudy.emulator.emulator import Emulator, numbered_points
from calstudy.emulator.ensemble import Ensemble
from calstudy.emulator.process import Observations
from calstudy.emulator.similarity import inputs_of, reduced_responses
from calstudy.errors import InputError
from calstudy.records import Outcome

HALF_WIDTH = 1.959963984540054
"""Of a normal 95 % interval, in standard deviations."""
MOST_UNEXPLAINED = 0.15
"""Share of a response's variance that left-out runs may leave unexplained: up to there, 95 % intervals of the
mean of steep functions hold nearly so often, beyond it they may hold 0.4 (``benchmarks/steep.py``)."""


@dataclass(frozen=True, slots=True)
class Fresh:
    """What fresh points say of one response."""

    response: str
    points: int
    inside: int
    """Points whose measured mean lies in its 95 % interval."""
    rms_error: float
    """Root mean square of the measured minus the emulated means."""
    error: float
    """The same without the noise of the validation runs; 0 if the noise is larger."""
    noise: float
    """Standard deviation of a single run from seed to seed, pooled over the points with several."""


class Trust(StrEnum):
    """Whether a response's 95 % intervals can be trusted."""

    YES = "yes"
    NO = "no"
    UNDECIDED = "undecided"


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What neither the emulator nor the noise explains of a response, at the reference fidelity.

    A process takes what it cannot follow for noise. Then its errors look as they should, and its intervals of
    the mean are too narrow all the same. What tells noise is runs that are repeated.
    """

    response: str
    runs: int
    repeats: int
    """Degrees of freedom of the noise: runs that are repeats of another one."""
    share: float
    """Of the variance that is not noise; the noise is that of the repeats, or 0 without any."""
    least: float
    """The same with the largest noise that the repeats allow (95 %); 0 without any."""

    @property
    def trust(self) -> Trust:
        """Yes up to `MOST_UNEXPLAINED`; no where the repeats show more; undecided where they cannot tell."""
        if self.share <= MOST_UNEXPLAINED:
            return Trust.YES
        return Trust.NO if self.least > MOST_UNEXPLAINED else Trust.UNDECIDED

    @property
    def in_words(self) -> str:
        """What is wrong, and the remedy; nothing where the intervals can be trusted."""
        if self.trust is Trust.YES:
            return ""
        found = (
            f"{self.response}: left-out runs leave {self.share:.2f} of the variance unexplained (at most "
            f"{MOST_UNEXPLAINED:g})"
        )
        if self.trust is Trust.NO:
            return f"{found}, and repeats show that this is not noise: its intervals are too narrow; run more"
        known = f"{self.repeats} repeats cannot" if self.repeats else "no run is repeated, which could"
        return f"{found}, and {known} tell whether this is noise; repeat points with other seeds"


def unexplained(emulator: Emulator) -> list[Unexplained]:
    """How much of each response left-out runs show to be neither followed nor noise."""
    return [unexplained_of(response.name, response.process) for response in emulator.responses]


def unexplained_of(name: str, process: Ensemble) -> Unexplained:
    """The same of one response."""
    data, at = process.data, process.data.is_reference
    points = numbered_points(data.U)
    error, _ = process.left_out(points)
    y = data.y[at]
    _, place, counts = np.unique(points[at], return_inverse=True, return_counts=True)
    if len(counts) < 2:  # nothing is left out of one point
        return Unexplained(name, len(y), 0, 1.0, 0.0)
    apart = y - (np.bincount(place, y) / counts)[place]
    freedom = len(y) - len(counts)
    squares, squared = float(apart @ apart), float(np.mean(error[at] ** 2))
    noise = squares / freedom if freedom else 0.0
    largest = squares / float(stats.chi2.ppf(0.05, freedom)) if freedom else math.inf
    variance = float(y.var(ddof=1))
    share, least = (_beyond(squared, variance, of) for of in (noise, largest))
    return Unexplained(name, len(y), freedom, share, least)


def _beyond(squared_error: float, variance: float, noise: float) -> float:
    """Share of the variance without noise that the errors without noise are; 0 of nothing but noise."""
    return max(squared_error - noise, 0.0) / (variance - noise) if noise < variance else 0.0


def left_out(emulator: Emulator) -> pd.DataFrame:
    """Each run that was fitted, predicted from the runs at all other points; the hyperparameters stay.

    Columns label, fidelity, response, measured, predicted, sd (noise of the run included), inside (whether
    the 95 % interval holds it).
    """
    parts = []
    for response in emulator.responses:
        data = response.process.data
        error, sd = response.process.left_out(numbered_points(data.U))
        parts.append(_lines(emulator, response.name, np.ones(len(sd), bool), data, error, sd))
    return pd.concat(parts, ignore_index=True)


def cross_validated(emulator: Emulator, folds: int) -> pd.DataFrame:
    """Each run predicted by a fit, hyperparameters and all, without its fold of the points; as `left_out`.

    Points go to the folds in turn. InputError for fewer than two folds.
    """
    if folds < 2:
        raise InputError(f"{folds} folds are none; use 2 at least")
    parts = []
    for response in emulator.responses:
        data = response.process.data
        fold = _in_order(numbered_points(data.U)) % folds
        for k in range(folds):
            chosen = fold == k
            error, sd = Ensemble.fit(data.without(chosen)).errors_elsewhere(data, chosen)
            parts.append(_lines(emulator, response.name, chosen, data, error, sd))
    return pd.concat(parts, ignore_index=True)


def coverage(predicted: pd.DataFrame) -> pd.DataFrame:
    """Runs, share inside their 95 % intervals and root mean square error, by response and fidelity."""
    squared = predicted.assign(squared=(predicted["measured"] - predicted["predicted"]) ** 2)
    grouped = squared.groupby(["response", "fidelity"], sort=False)
    table = grouped.agg(runs=("inside", "size"), inside=("inside", "sum"), squared=("squared", "mean"))
    table = table.reset_index()
    table["share"] = table["inside"] / table["runs"]
    table["error"] = np.sqrt(table.pop("squared"))
    return table


def fresh_points(emulator: Emulator, runs: pd.DataFrame) -> pd.DataFrame:
    """Points of runs that the emulator has not seen: measured means beside its predictions.

    Columns label, response, seeds, measured (mean over the seeds), measured_variance (between them; NaN for
    one), predicted, sd (of the mean: the emulator's, and the noise over the square root of the seeds),
    inside. InputError for runs of another model than the emulator's reference, or ones that it was fitted
    to. Runs that are not ok, and points where nothing is emulated, are left out.
    """
    origin = emulator.origin
    if set(runs["model_hash"]) != {origin.model_hash} or set(runs["engine"]) != {origin.engine}:
        raise InputError(
            f"the fresh runs are not of {origin.model}, {origin.fidelity} fidelity, {origin.variant}, "
            f"{origin.engine}, as the emulator is"
        )
    usable = runs[runs["outcome"] == Outcome.OK]
    if set(usable["run_id"]) & set(emulator.runs["run_id"]):
        raise InputError("the emulator was fitted to some of the fresh runs; give others")
    unit = np.vstack(
        [np.empty((0, emulator.box.dimension)), emulator.box.to_unit(inputs_of(usable, emulator.similarity))]
    )
    points = _in_order(numbered_points(unit))
    lines = []
    for response, values in zip(
        emulator.responses, reduced_responses(usable, emulator.similarity).T, strict=True
    ):
        for number in range(points.max(initial=-1) + 1):
            here = points == number
            at = np.clip(unit[here][:1], 0.0, 1.0)
            if response.region is not None and response.region.contains(at)[0]:
                continue
            mean, sd = (float(v[0]) for v in response.process.mean_and_sd(at))
            noise = float(response.process.noise_sd(at)[0])
            n = int(here.sum())
            total = float(np.hypot(sd, noise / np.sqrt(n)))
            measured = float(values[here].mean())
            lines.append(
                {
                    "label": usable["label"].to_numpy()[here][0],
                    "response": response.name,
                    "seeds": n,
                    "measured": measured,
                    "measured_variance": float(values[here].var(ddof=1)) if n > 1 else np.nan,
                    "predicted": mean,
                    "sd": total,
                    "inside": abs(measured - mean) <= HALF_WIDTH * total,
                }
            )
    if not lines:
        raise InputError("no fresh run is ok where the emulator answers; give others")
    return pd.DataFrame(lines)


def fresh_summary(points: pd.DataFrame) -> list[Fresh]:
    """What a table of `fresh_points` comes to; InputError where no point has several seeds."""
    found = []
    for name, of in points.groupby("response", sort=False):
        freedom = of["seeds"] - 1
        if not freedom.sum():
            raise InputError("no fresh point has runs with several seeds; their noise is not known")
        noise = float((freedom * of["measured_variance"].fillna(0.0)).sum() / freedom.sum())
        squared = float(((of["measured"] - of["predicted"]) ** 2).mean())
        of_noise = float((noise / of["seeds"]).mean())
        found.append(
            Fresh(
                response=str(name),
                points=len(of),
                inside=int(of["inside"].sum()),
                rms_error=math.sqrt(squared),
                error=math.sqrt(max(squared - of_noise, 0.0)),
                noise=math.sqrt(noise),
            )
        )
    return found


def _lines(
    emulator: Emulator, name: str, chosen: np.ndarray, data: Observations, error: np.ndarray, sd: np.ndarray
) -> pd.DataFrame:
    """Table of the predictions of some of the fitted runs (mask ``chosen``)."""
    off = next(response.off for response in emulator.responses if response.name == name)
    runs = emulator.runs[~emulator.runs["run_id"].isin(off)].reset_index(drop=True)[chosen]
    measured = data.y[chosen]
    return pd.DataFrame(
        {
            "label": runs["label"].to_numpy(),
            "fidelity": runs["fidelity"].to_numpy(),
            "response": name,
            "measured": measured,
            "predicted": measured - error,
            "sd": sd,
            "inside": np.abs(error) <= HALF_WIDTH * sd,
        }
    )


def _in_order(points: np.ndarray) -> np.ndarray:
    """Numbers of points (n,) anew, in the order in which they come first."""
    numbers, first = np.unique(points, return_index=True)
    place = np.empty(len(numbers), int)
    place[np.argsort(first)] = np.arange(len(numbers))
    return place[np.searchsorted(numbers, points)]
