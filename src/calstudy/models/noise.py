"""Noise and bias of the fidelities: what runs that differ in their seed, or their fidelity alone, say."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from calstudy.errors import SetupError
from calstudy.models.find import NOISE_FILE, Declared, shipped_noise
from calstudy.records import Outcome

POINT = ("fidelity", "variant", "label", "model_hash")
"""What a point of a table of noise is known by, besides its parameters."""
CONFIDENCE = 0.90


def noise_table(runs: pd.DataFrame, model: Declared, truth: str = "full") -> pd.DataFrame:
    """Mean, standard deviation and bias of each of a model's responses at each point and fidelity.

    ``runs`` has a sweep's columns; runs that lack a response are counted as failed and left out.
    Columns, for each measured response r: ``r`` (mean over the seeds), ``r_sd`` (n - 1), ``r_bias`` (mean
    less that of the fidelity ``truth`` at the same point and variant) and ``r_bias_half_width`` (of its
    90 % interval, Welch); NaN where there is nothing to compare with, and for ``truth`` itself. Besides
    ``n``, ``failed`` and ``cpu_time`` (mean, s).
    """
    lines = []
    point = (*POINT, *model.parameters)
    for keys, all_of_it in runs.groupby(list(point), sort=False):
        line = dict(zip(point, keys, strict=True))
        usable = all_of_it[all_of_it["outcome"] == Outcome.OK]
        same = pd.Series({name: line[name] for name in ("variant", *model.parameters)})
        there = runs[
            (runs["fidelity"] == truth)
            & (runs["outcome"] == Outcome.OK)
            & (runs[same.index] == same).all(axis=1)
        ]
        line |= {"n": len(usable), "failed": len(all_of_it) - len(usable)}
        for name in (response.name for response in model.responses):
            values = usable[name].to_numpy()
            line[name] = values.mean() if len(values) else math.nan
            line[f"{name}_sd"] = values.std(ddof=1) if len(values) > 1 else math.nan
            compared = there[name].to_numpy() if line["fidelity"] != truth else np.empty(0)
            bias, half = difference(values, compared)
            line |= {f"{name}_bias": bias, f"{name}_bias_half_width": half}
        line["cpu_time"] = all_of_it["cpu_time"].mean()
        lines.append(line)
    return pd.DataFrame(lines)


def difference(values: np.ndarray, others: np.ndarray) -> tuple[float, float]:
    """Mean of ``values`` less that of ``others``, and the half-width of its 90 % interval (Welch).

    NaN where either holds fewer than two.
    """
    if min(len(values), len(others)) < 2:
        return math.nan, math.nan
    interval = stats.ttest_ind(values, others, equal_var=False).confidence_interval(CONFIDENCE)
    return float(values.mean() - others.mean()), float((interval.high - interval.low) / 2)


def pooled_sd(table: pd.DataFrame) -> dict[str, float]:
    """Standard deviation of each measured response from seed to seed, pooled over the points of a table.

    Points weigh by their degrees of freedom; NaN where no point has two runs.
    """
    freedom = (table["n"] - 1).clip(lower=0)
    total = freedom.sum()
    return {
        name.removesuffix("_sd"): float(np.sqrt((freedom * table[name].fillna(0.0) ** 2).sum() / total))
        if total
        else math.nan
        for name in map(str, table)
        if name.endswith("_sd")
    }


def known_noise(model: str, model_hash: str) -> Mapping[str, float] | None:
    """Standard deviation of each response as measured for this very version of a shipped model, or None.

    SetupError where the model's noise.csv is damaged.
    """
    return noise_in(shipped_noise(model), model_hash)


def noise_freedom(model: str, model_hash: str) -> int:
    """Degrees of freedom of :func:`known_noise`: runs less points; 0 where nothing was measured."""
    return int(sum(max(n - 1, 0) for n in _measured(shipped_noise(model), model_hash)["n"]))


def noise_in(table: str, model_hash: str) -> Mapping[str, float] | None:
    """Standard deviation of each response that a noise.csv holds of a model; None where one was not measured.

    Its columns are ``model_hash``, ``n`` (runs that differ in their seed alone) and ``RESPONSE_sd`` of each
    response, others besides. SetupError where it is damaged.
    """
    wanted = _measured(table, model_hash)
    found = pooled_sd(wanted) if len(wanted) else {}
    return found if found and all(sd > 0 for sd in found.values()) else None  # NaN is not above 0


@dataclass(frozen=True, slots=True)
class Difference:
    """By how much the mean responses of two models differ at one point."""

    at: Mapping[str, float]
    """The point's parameters."""
    offsets: Mapping[str, tuple[float, float]]
    """Of each response the first model's mean less the second's, with its standard deviation."""


def difference_in(table: str, models: tuple[str, str], parameters: Iterable[str]) -> Difference | None:
    """Difference of two models, given by their hashes, at the first point that a noise.csv has of both.

    The noise of a run is pooled over both, for either has few runs. None where the table has no such point.
    """
    lines = csv.DictReader(io.StringIO(table))
    of: dict[str, dict[str, Mapping[str, str]]] = {model_hash: {} for model_hash in models}
    for line in lines:
        if line.get("model_hash") in of and int(line["n"]) > 1:
            of[line["model_hash"]][line["label"]] = line
    label = next((label for label in of[models[0]] if label in of[models[1]]), None)
    if label is None:
        return None
    first, second = (of[model_hash][label] for model_hash in models)
    n, m = int(first["n"]), int(second["n"])
    offsets = {}
    for name in (column.removesuffix("_sd") for column in first if column.endswith("_sd")):
        squares = (n - 1) * float(first[f"{name}_sd"]) ** 2 + (m - 1) * float(second[f"{name}_sd"]) ** 2
        sd = math.sqrt(squares / (n + m - 2) * (1 / n + 1 / m))
        offsets[name] = (float(first[name]) - float(second[name]), sd)
    return Difference({name: float(first[name]) for name in parameters}, offsets)


def _measured(table: str, model_hash: str) -> pd.DataFrame:
    """The lines of a noise.csv that are this very model's: n and deviations."""
    if not table:
        return pd.DataFrame(columns=["n"])
    try:
        reader = csv.DictReader(io.StringIO(table))
        columns = ["n", *(name for name in reader.fieldnames or () if name.endswith("_sd"))]
        lines = [
            (int(line["n"]), *(float(line[name]) for name in columns[1:]))
            for line in reader
            if line["model_hash"] == model_hash
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise SetupError(
            f"a model's {NOISE_FILE} is damaged; restore it, or install calstudy again"
        ) from error
    return pd.DataFrame(lines, columns=columns)
