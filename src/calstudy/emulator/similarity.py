"""Which numbers the measured responses depend on: the four frictions and YM/DENS.

Gravity, geometry and lifting speed set the scale of time, and every force of the deck is proportional to
DENS or to YM. So DENS and YM multiplied by one factor leave every path as it is: the angle of repose and
the solid fraction (bulk density / DENS) are functions of four frictions and YM/DENS. `similarity_design`
asks LIGGGHTS whether that is so, `similarity_table` reads its answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from scipy import stats

from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.parameters import Array, Box, Parameter
from calstudy.plan import PARAMETERS
from calstudy.records import Outcome
from calstudy.study.sweep import Line

RATIO = "YM/DENS"
INPUTS = ("MU_PP", "MU_PW", "RF_PP", "RF_PW", RATIO)
SOLID_FRACTION = "solid_fraction"
REDUCED = (ANGLE_OF_REPOSE, SOLID_FRACTION)
"""Responses that are functions of the inputs alone."""

CHECK_POINTS = 5
CONFIDENCE = 0.90


def inputs_box(parameters: Sequence[Parameter]) -> Box:
    """Intervals of the inputs over the whole box of the six parameters."""
    of = {p.name: p for p in parameters}
    frictions = [of[name] for name in INPUTS[:-1]]
    ratios = of["YM"].lower / of["DENS"].upper, of["YM"].upper / of["DENS"].lower
    return Box(
        INPUTS,
        (*(p.lower for p in frictions), ratios[0]),
        (*(p.upper for p in frictions), ratios[1]),
    )


def inputs(parameters: Mapping[str, float]) -> Array:
    """Inputs (5,) of a parameter set."""
    return np.array([*(parameters[name] for name in INPUTS[:-1]), parameters["YM"] / parameters["DENS"]])


def inputs_of(runs: pd.DataFrame) -> Array:
    """Inputs of a table's lines, (n,5)."""
    columns = [runs[name].to_numpy(float) for name in INPUTS[:-1]]
    return np.column_stack([*columns, runs["YM"].to_numpy(float) / runs["DENS"].to_numpy(float)])


def reduced_responses(runs: pd.DataFrame) -> Array:
    """Angle of repose in deg and solid fraction of a table's lines, (n,2)."""
    density = runs[BULK_DENSITY].to_numpy(float) / runs["DENS"].to_numpy(float)
    return np.column_stack([runs[ANGLE_OF_REPOSE].to_numpy(float), density])


def parameter_set(point: Array, share: float, parameters: Sequence[Parameter]) -> dict[str, float]:
    """Parameters with the inputs ``point`` (5,), DENS at ``share`` of where it can be inside the box."""
    of = {p.name: p for p in parameters}
    ratio = float(point[-1])
    lowest = max(of["DENS"].lower, of["YM"].lower / ratio)
    highest = min(of["DENS"].upper, of["YM"].upper / ratio)
    density = lowest + share * max(highest - lowest, 0.0)
    modulus = min(max(ratio * density, of["YM"].lower), of["YM"].upper)  # rounding must not leave the box
    values = dict(zip(INPUTS, map(float, point), strict=True)) | {"DENS": density, "YM": modulus}
    return {name: values[name] for name in PARAMETERS}


def similarity_design(
    parameters: Sequence[Parameter], fidelity: str, variant: str, seed: int, seeds: int
) -> list[Line]:
    """Runs at equal inputs with DENS and YM at both ends of what the box allows, and doubled.

    Doubling changes no digit of a binary number, so a similar run is the same run to the last bit; it is
    done once a point. Other factors change roundings, which the beads' collisions amplify: there only
    means can be compared, over ``seeds`` runs at either end, their seeds being the same.
    """
    box = inputs_box(parameters)
    of = {p.name: p for p in parameters}
    # Ratios at which DENS can take both its ends.
    low, high = of["YM"].lower / of["DENS"].lower, of["YM"].upper / of["DENS"].upper
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    lines = []
    for k, u in enumerate(rng.random((CHECK_POINTS, len(INPUTS)))):
        point = box.from_unit(u)
        point[-1] = low + u[-1] * (high - low)
        light, heavy = (parameter_set(point, share, parameters) for share in (0.0, 1.0))
        doubled = light | {"DENS": 2.0 * light["DENS"], "YM": 2.0 * light["YM"]}
        label = f"point-{k:02d}"
        for number in range(1, seeds + 1):
            lines += [
                Line(label, fidelity, variant, number, light),
                Line(label, fidelity, variant, number, heavy),
            ]
        lines.append(Line(label, fidelity, variant, 1, doubled))
    return lines


def similarity_table(runs: pd.DataFrame) -> pd.DataFrame:
    """What the runs of a `similarity_design` say, a line for each response.

    ``doubled``: largest difference over the points between the run with DENS and YM doubled and that
    without; 0 where they are similar. ``difference``: mean over the points of heavy less light beads, each
    point's seeds averaged, ``half_width`` that of its 90 % interval, ``noise`` the standard deviation from
    seed to seed. Runs that are not ok are left out.
    """
    usable = runs[runs["outcome"] == Outcome.OK]
    values = pd.DataFrame(reduced_responses(usable), columns=list(REDUCED), index=usable.index)
    table = pd.concat([usable[["label", "seed", "DENS"]], values], axis=1)
    lines = []
    for name in REDUCED:
        doubled, differences, noise = [], [], []
        for _, point in table.groupby("label"):
            densities = sorted(point["DENS"].unique())
            light = point[point["DENS"] == densities[0]].set_index("seed")[name]
            for density in densities[1:]:
                other = point[point["DENS"] == density].set_index("seed")[name]
                if density == 2.0 * densities[0]:
                    doubled += list((other - light).dropna().abs())
                else:
                    differences.append(other.mean() - light.mean())
                    noise += [light.var(ddof=1), other.var(ddof=1)]
        n = len(differences)
        error = np.std(differences, ddof=1) / np.sqrt(n) if n > 1 else np.nan
        lines.append(
            {
                "response": name,
                "doubled": max(doubled, default=np.nan),
                "doubled_pairs": len(doubled),
                "difference": np.mean(differences) if n else np.nan,
                "half_width": stats.t.ppf(0.5 + CONFIDENCE / 2, n - 1) * error if n > 1 else np.nan,
                "points": n,
                "noise": np.sqrt(np.nanmean(noise)) if np.isfinite(noise).any() else np.nan,
            }
        )
    return pd.DataFrame(lines)
