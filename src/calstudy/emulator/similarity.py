"""Which numbers the measured responses depend on: the four frictions and YM/DENS.

Gravity, geometry and lifting speed set the scale of time, and every force of the deck is proportional to
DENS or to YM. So DENS and YM multiplied by one factor leave every path as it is: the angle of repose and
the solid fraction (bulk density / DENS) are functions of four frictions and YM/DENS. `similarity_design`
asks LIGGGHTS whether that is so, `similarity_table` reads its answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from calstudy.models.heap import GIVEN, PARAMETER_UNITS
from calstudy.parameters import Array, Box, Parameter
from calstudy.plan import PARAMETERS
from calstudy.records import Outcome, Response
from calstudy.study.schema import Quantities
from calstudy.study.sweep import Line


@dataclass(frozen=True, slots=True)
class Similarity:
    """What a model's responses depend on: an emulator's inputs, and what it answers."""

    parameters: tuple[tuple[str, str], ...]
    """With their units."""
    responses: tuple[Response, ...]
    ratio: tuple[str, str] | None = None
    """Two parameters that act through the quotient of the first by the second alone; None where none do."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that are inputs themselves."""
        return tuple(name for name, _ in self.parameters if name not in (self.ratio or ()))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of all inputs; the quotient comes last."""
        return (*self.names, "/".join(self.ratio)) if self.ratio else self.names

    @property
    def reduced(self) -> tuple[str, ...]:
        """Names of what is a function of the inputs alone: responses, or their quotients by a parameter."""
        return tuple(response.reduced for response in self.responses)

    @property
    def quantities(self) -> Quantities:
        """What the tables of the model's runs have columns for."""
        return Quantities.of(dict(self.parameters), self.responses)


HEAP = Similarity(tuple(PARAMETER_UNITS.items()), GIVEN, ("YM", "DENS"))
"""Of the angle-of-repose model."""
INPUTS = HEAP.inputs
REDUCED = HEAP.reduced
SOLID_FRACTION = REDUCED[1]

CHECK_POINTS = 5
CONFIDENCE = 0.90


def inputs_box(parameters: Sequence[Parameter], model: Similarity = HEAP) -> Box:
    """Intervals of the inputs over the whole box of the parameters."""
    of = {p.name: p for p in parameters}
    lower, upper = ([getattr(of[name], end) for name in model.names] for end in ("lower", "upper"))
    if model.ratio:
        above, below = (of[name] for name in model.ratio)
        lower.append(above.lower / below.upper)
        upper.append(above.upper / below.lower)
    return Box(model.inputs, tuple(lower), tuple(upper))


def inputs(parameters: Mapping[str, float], model: Similarity = HEAP) -> Array:
    """Inputs (d,) of a parameter set."""
    values = [parameters[name] for name in model.names]
    if model.ratio:
        above, below = (parameters[name] for name in model.ratio)
        values.append(above / below)
    return np.array(values)


def inputs_of(runs: pd.DataFrame, model: Similarity = HEAP) -> Array:
    """Inputs of a table's lines, (n,d)."""
    columns = [runs[name].to_numpy(float) for name in model.names]
    if model.ratio:
        above, below = (runs[name].to_numpy(float) for name in model.ratio)
        columns.append(above / below)
    return np.column_stack(columns)


def reduced_responses(runs: pd.DataFrame, model: Similarity = HEAP) -> Array:
    """What is emulated of a table's lines, (n,m): of the heap its angle in deg and its solid fraction."""
    columns = []
    for response in model.responses:
        values = runs[response.name].to_numpy(float)
        divisor = response.proportional_to
        columns.append(values if divisor is None else values / runs[divisor].to_numpy(float))
    return np.column_stack(columns)


def parameter_set(
    point: Array, share: float, parameters: Sequence[Parameter], model: Similarity = HEAP
) -> dict[str, float]:
    """Parameters with the inputs ``point`` (d,).

    Where two of them act through their quotient, as YM and DENS, the second is at ``share`` of where it can
    be inside the box.
    """
    if model.ratio is None:
        return dict(zip(model.inputs, map(float, point), strict=True))
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
