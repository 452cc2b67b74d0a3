"""The solution space in the report of ``calibrate``: in words, as tables, as a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from calstudy.analysis.exhibit import Column, Picture, Table, render
from calstudy.calibration.narrowing import in_words, made_up_for, narrowed
from calstudy.calibration.solutions import NEAR, NOISE_FACTOR, failing_share
from calstudy.report.pictures import draw_profiles, pairs
from calstudy.study.directory.store import write_table
from calstudy.study.reading import Result

SEED = 0
"""Of what a further measurement might give."""
WORTHWHILE = 0.95
"""A further measurement narrows a parameter if its standard deviation falls below this share."""


def solutions_in_words(result: Result) -> str:
    """Size of the solution space, and what it assumes, in words."""
    s, units = result.solutions, result.units
    errors = " and ".join(f"{name} {sd:.2g} {units[name]}" for name, sd in s.errors.items())
    share = failing_share(result.definition.task, result.surrogates)
    failing = f" They leave out {share:.0%} of the box, where runs are expected to fail." if share else ""
    return (
        f"The solutions are {len(s.points)} parameter sets drawn from the posterior, which fills about "
        f"{s.share:.2g} of the box. Standard deviations of the measured values: {errors}; the surrogates' "
        f"doubts count, too.{failing}"
    )


def made_up_for_in_words(result: Result) -> list[str]:
    """Which changes of parameters make up for each other, by the solution space."""
    space = result.definition.task.space
    box = space.box
    directions = made_up_for(box.to_unit(result.solutions.points))
    return [in_words(direction, box.width, space.axes) for direction in directions]


def outside(result: Result, name: str, low: float, high: float) -> str:
    """Why the DEM optimum lies outside the middle 90 % of the solutions; empty if it does not.

    ``low`` and ``high`` are the coordinates of its ends.
    """
    box = result.surrogates.space.box
    k = box.names.index(name)
    value = result.optimum_point[k]
    if not (value < low or value > high):
        return ""
    at = result.optimum_point[None]
    expected = dict(zip(result.surrogates.names, result.surrogates.predict(at)[0], strict=True))
    targets = result.settings.target.values
    missed = [
        response
        for response, error in result.solutions.errors.items()
        if abs(expected[response] - targets[response]) > NOISE_FACTOR * error
    ]
    drawn = dict(zip(result.surrogates.names, result.solutions.responses.mean(axis=0), strict=True))
    if hardly := [
        name for name in missed if abs(drawn[name] - targets[name]) > abs(expected[name] - targets[name])
    ]:
        return f"outside the 90 %: {' and '.join(hardly)} is hardly reached, and comes nearest here"
    if missed:
        return (
            f"outside the 90 %: by the surrogates {' and '.join(missed)} would miss there, where the DEM run "
            "came nearer by its noise or by their error"
        )
    for end, bound in (("lower", box.lower[k]), ("upper", box.upper[k])):
        if abs(value - bound) <= NEAR * box.width[k]:
            return f"outside the 90 %: on its {end} bound, and as good by the surrogates"
    return "outside the 90 %: one of the other 10 %, as good by the surrogates"


def correlations_table(result: Result) -> Table:
    """Correlations of the parameters over the solution space, and what makes up for what."""
    names = result.definition.task.space.box.names
    frame = pd.DataFrame(result.solutions.correlations, columns=list(names))
    frame.insert(0, "parameter", names)
    columns = (Column("parameter", ""), *(Column(name, name, "+.2f") for name in names))
    notes = ["Over the solutions. Near +1 or -1, one parameter makes up for the other."]
    notes += [f"{line}." for line in made_up_for_in_words(result)]
    return Table("correlations", "Correlations in the solution space", frame, columns, notes)


def narrowing_table(result: Result) -> Table:
    """What a measurement with half the error would leave of each parameter's standard deviation."""
    s, box = result.solutions, result.definition.task.space.box
    names = result.definition.task.cost.responses
    errors = np.array([s.errors[name] for name in names])
    left = narrowed(box.to_unit(s.points), s.responses, s.doubts, errors, SEED)
    frame = pd.DataFrame(left, columns=list(box.names))
    doubt = np.sqrt(np.mean(s.doubts**2, axis=0))
    for k, (column, values) in enumerate((("response", names), ("error", errors), ("doubt", doubt))):
        frame.insert(k, column, values)
    frame["unit"] = [result.units[name] for name in names]
    columns = (
        Column("response", "Response"),
        Column("error", "Its error now", ".2g"),
        Column("doubt", "Surrogate's doubt", ".2g"),
        Column("unit", "Unit"),
        *(Column(name, name, ".2f") for name in box.names),
    )
    i, j = np.unravel_index(np.argmin(left), left.shape)
    note = (
        f"Most is gained by measuring {names[i]} more exactly: it narrows {box.names[j]} to {left[i, j]:.2f} "
        "of its standard deviation."
        if left[i, j] < WORTHWHILE
        else "No parameter is narrowed by a twentieth. Another test, or more DEM runs, tells more."
    )
    doubted = [name for name, e, d in zip(names, errors, doubt, strict=True) if d > e]
    notes = [f"Shares of each parameter's standard deviation that are left if the error is halved. {note}"]
    if doubted:
        notes.append(
            f"Of {' and '.join(doubted)} the surrogate's doubt is larger than the error: more DEM runs tell "
            "more than a better measurement."
        )
    return Table("narrowing", "What a more exact measurement would tell", frame, columns, notes)


def spread_picture(result: Result) -> Picture:
    """The solutions pair by pair."""
    drawn = pairs(result.solutions.points, result.optimum_point, result.definition.task.space)
    said = [solutions_in_words(result), *(f"{line}." for line in made_up_for_in_words(result))]
    return Picture("solutions", "Solution space", render(drawn, ["svg"]), said)


def pictures_of(result: Result) -> list[Picture]:
    """The solutions pair by pair, and the profile of each parameter."""
    space, optimum = result.definition.task.space, result.optimum_point
    points = result.solutions.points
    profiled = (
        "Bars: how the solutions are spread over each interval. Line: the best that the other parameters can "
        "do at each value, as a share of the best of all. Where the line is high and the bars are low, few "
        "parameter sets do it."
    )
    return [
        spread_picture(result),
        Picture(
            "profiles",
            "Profiles",
            render(draw_profiles(points, result.profiles, optimum, space), ["svg"]),
            [profiled],
        ),
    ]


def write_solutions(result: Result, path: Path, study: Path) -> None:
    """Write the solutions as Parquet; SetupError: it cannot be written."""
    s, task, units = result.solutions, result.definition.task, result.units
    names, targets = task.space.box.names, task.cost.responses
    fields = [pa.field(n, pa.float64(), metadata={"unit": units[n]}) for n in (*names, *targets)]
    fields += [pa.field(f"doubt_{n}", pa.float64(), metadata={"unit": units[n]}) for n in targets]
    fields.append(pa.field("weight", pa.float64(), metadata={"unit": "-"}))
    parameters = [task.space.values(name, s.points) for name in names]
    values = np.column_stack([*parameters, s.responses, s.doubts, s.weights])
    write_table(
        path, pd.DataFrame(values, columns=[field.name for field in fields]), pa.schema(fields), study
    )
