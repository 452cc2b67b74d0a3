"""Which numbers a model's responses depend on, and a check of what a model declares of that.

A model may declare a ratio: two parameters that act through their quotient alone, such as YM and DENS. Where
gravity, geometry and prescribed speeds set the scale of time, and every force is proportional to DENS or YM,
both multiplied by one factor leave every path as it is. So the angle of repose and the solid fraction (bulk
density / DENS) of the shipped model are functions of four frictions and YM/DENS.
`similarity_design` asks LIGGGHTS whether that is so, `similarity_table` reads its answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from calstudy.errors import InputError
from calstudy.models.find import Declared
from calstudy.parameters import Array, Box, Parameter
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
    constants: tuple[tuple[str, float], ...] = ()
    """Parameters that are the same in all runs, with their values; they are no inputs."""

    @classmethod
    def of(cls, model: Declared, parameters: Sequence[Parameter]) -> Similarity:
        """Similarity of a model whose parameters have these intervals; one without width is a constant.

        Where a parameter of the ratio is constant, the other one is an input itself.
        """
        constants = tuple((p.name, p.lower) for p in parameters if p.lower == p.upper)
        ratio = None if set(dict(constants)) & set(model.ratio or ()) else model.ratio
        return cls(tuple(model.parameters.items()), model.responses, ratio, constants)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that are inputs themselves."""
        others = {*dict(self.constants), *(self.ratio or ())}
        return tuple(name for name, _ in self.parameters if name not in others)

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
        return Quantities(self.parameters, self.responses, tuple(r.name for r in self.responses))


CHECK_POINTS = 5
CONFIDENCE = 0.90


def inputs_box(parameters: Sequence[Parameter], similarity: Similarity) -> Box:
    """Intervals of the inputs over the whole box of the parameters."""
    of = {p.name: p for p in parameters}
    lower, upper = ([getattr(of[name], end) for name in similarity.names] for end in ("lower", "upper"))
    if similarity.ratio:
        above, below = (of[name] for name in similarity.ratio)
        lower.append(above.lower / below.upper)
        upper.append(above.upper / below.lower)
    return Box(similarity.inputs, tuple(lower), tuple(upper))


def inputs(parameters: Mapping[str, float], similarity: Similarity) -> Array:
    """Inputs (d,) of a parameter set."""
    values = [parameters[name] for name in similarity.names]
    if similarity.ratio:
        above, below = (parameters[name] for name in similarity.ratio)
        values.append(above / below)
    return np.array(values)


def inputs_of(runs: pd.DataFrame, similarity: Similarity) -> Array:
    """Inputs of the lines of a table of runs, (n,d)."""
    columns = [runs[name].to_numpy(float) for name in similarity.names]
    if similarity.ratio:
        above, below = (runs[name].to_numpy(float) for name in similarity.ratio)
        columns.append(above / below)
    return np.column_stack(columns)


def reduced_responses(runs: pd.DataFrame, similarity: Similarity) -> Array:
    """What is emulated of the lines of a table of runs, (n,m): responses, or their quotients."""
    columns = []
    for response in similarity.responses:
        values = runs[response.name].to_numpy(float)
        divisor = response.proportional_to
        columns.append(values if divisor is None else values / runs[divisor].to_numpy(float))
    return np.column_stack(columns)


def parameter_set(
    point: Array, share: float, parameters: Sequence[Parameter], similarity: Similarity
) -> dict[str, float]:
    """Parameters with the inputs ``point`` (d,) and the constants, in the model's order.

    Where two of them act through their quotient, as YM and DENS, the second is at ``share`` of where it can
    be inside the box.
    """
    values = dict(zip(similarity.inputs, map(float, point), strict=True)) | dict(similarity.constants)
    if similarity.ratio is not None:
        of = {p.name: p for p in parameters}
        above, below = (of[name] for name in similarity.ratio)
        quotient = float(point[-1])
        lowest = max(below.lower, above.lower / quotient)
        highest = min(below.upper, above.upper / quotient)
        second = lowest + share * max(highest - lowest, 0.0)
        first = min(max(quotient * second, above.lower), above.upper)  # rounding must not leave the box
        values |= {above.name: first, below.name: second}
    return {name: values[name] for name, _ in similarity.parameters}


def similarity_design(
    parameters: Sequence[Parameter],
    similarity: Similarity,
    seed: int,
    seeds: int,
    fidelity: str = "",
    variant: str = "",
) -> list[Line]:
    """Runs at equal inputs with the ratio's parameters at both ends of what the box allows, and doubled.

    Doubling changes no digit of a binary number, so a similar run is the same run to the last bit; it is
    done once a point. Other factors change roundings, which the beads' collisions amplify: there only
    means can be compared, over ``seeds`` runs at either end, their seeds being the same. InputError for a
    model that declares no ratio, or where the box leaves the two parameters no room at one quotient.
    """
    if similarity.ratio is None:
        raise InputError("the model declares no ratio of two parameters that vary, so there is none to check")
    box = inputs_box(parameters, similarity)
    of = {p.name: p for p in parameters}
    above, below = (of[name] for name in similarity.ratio)
    # Quotients at which the second parameter can take both its ends.
    low, high = above.lower / below.lower, above.upper / below.upper
    if not low < high:
        raise InputError(
            f"no value of {box.names[-1]} leaves {below.name} its whole interval; widen the interval of "
            f"{above.name}, or narrow that of {below.name}"
        )
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,)))
    lines = []
    for k, u in enumerate(rng.random((CHECK_POINTS, len(similarity.inputs)))):
        point = box.from_unit(u)
        point[-1] = low + u[-1] * (high - low)
        light, heavy = (parameter_set(point, share, parameters, similarity) for share in (0.0, 1.0))
        doubled = light | {name: 2.0 * light[name] for name in similarity.ratio}
        label = f"point-{k:02d}"
        for number in range(1, seeds + 1):
            lines += [
                Line(label, fidelity, variant, number, light),
                Line(label, fidelity, variant, number, heavy),
            ]
        lines.append(Line(label, fidelity, variant, 1, doubled))
    return lines


def similarity_table(runs: pd.DataFrame, similarity: Similarity) -> pd.DataFrame:
    """What the runs of a `similarity_design` say, a line for each response.

    ``doubled``: largest difference over the points between the run with both parameters doubled and that
    without; 0 where they are similar. ``difference``: mean over the points of runs at the upper end of the
    ratio's second parameter (heavy beads) less those at its lower end, each point's seeds averaged,
    ``half_width`` that of its 90 % interval, ``noise`` the standard deviation from seed to seed. All are in
    the response's unit over that of what it is proportional to. Runs that are not ok are left out.
    """
    if similarity.ratio is None:
        raise InputError("the model declares no ratio, so its runs cannot be told by it")
    second = similarity.ratio[1]
    usable = runs[runs["outcome"] == Outcome.OK]
    names = list(similarity.reduced)
    values = pd.DataFrame(reduced_responses(usable, similarity), columns=names, index=usable.index)
    table = pd.concat([usable[["label", "seed", second]], values], axis=1)
    lines = []
    for name in names:
        doubled, differences, noise = [], [], []
        for _, point in table.groupby("label"):
            least, *others = sorted(point[second].unique())
            light = point[point[second] == least].set_index("seed")[name]
            for value in others:
                other = point[point[second] == value].set_index("seed")[name]
                if value == 2.0 * least:
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
