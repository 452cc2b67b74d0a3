"""Targets of a calibration: the paper's, others, or a twin's, whose true parameters are known."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calstudy.disk.files import write_atomically
from calstudy.engines.interface import Model
from calstudy.errors import InputError, RunError, SetupError
from calstudy.models.find import SHIPPED
from calstudy.records import Run, Target
from calstudy.written import number_in, text_of


def twin_columns(parameters: Sequence[str], responses: Sequence[str]) -> tuple[str, ...]:
    """Columns of a model's table of twins."""
    return (
        "fidelity",
        "variant",
        "model_hash",
        "engine",
        *parameters,
        *(f"{name}{end}" for name in responses for end in ("", "_sd")),
        "replicates",
        "command",
    )


@dataclass(frozen=True, slots=True)
class RepeatedRuns:
    """Responses of runs that differ in their seed alone: mean and standard deviation (n - 1)."""

    mean: Mapping[str, float]
    sd: Mapping[str, float]
    used: int
    failed: int


def repeated_runs(runs: Sequence[Run], names: Sequence[str]) -> RepeatedRuns:
    """Mean and standard deviation of the measured responses over the usable runs; NaN where too few."""
    usable = np.array([[run.responses[name] for name in names] for run in runs if run.usable])
    usable = usable.reshape(-1, len(names))
    n = len(usable)
    mean = usable.mean(axis=0) if n else np.full(len(names), np.nan)
    sd = usable.std(axis=0, ddof=1) if n > 1 else np.full(len(names), np.nan)
    return RepeatedRuns(
        mean=dict(zip(names, map(float, mean), strict=True)),
        sd=dict(zip(names, map(float, sd), strict=True)),
        used=n,
        failed=len(runs) - n,
    )


def describe(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Responses with their units, in words."""
    return " and ".join(f"{value:.5g} {units[name]}" for name, value in values.items())


def twin_in(file: str, model: Model, engine: str) -> Target:
    """Twin of a model in a file, or for "" in the model's own table. InputError: it has no twin."""
    source = Path(file) if file else SHIPPED / model.name / "twins.csv"
    units = {response.name: response.unit for response in model.responses}
    try:
        table = list(csv.DictReader(io.StringIO(text_of(source))))
    except InputError as error:
        raise InputError(f"--target twin: {error}, or make it with 'calstudy twin --out FILE'") from error
    remedy = "make it anew with 'calstudy twin'"
    for line in table:
        if (line.get("model_hash"), line.get("engine")) == (model.hash, engine):
            try:
                values = {name: number_in(line[name]) for name in units}
                truth = {name: number_in(line[name]) for name in model.parameters}
            except (AttributeError, KeyError, InputError) as error:
                raise InputError(f"--target twin: {source} is damaged; {remedy}") from error
            if not all(map(math.isfinite, (*values.values(), *truth.values()))):
                raise InputError(f"--target twin: {source} holds a value that is not finite; {remedy}")
            origin = (
                f"twin: mean of {line['replicates']} runs of this fidelity at known parameters, "
                f"{describe(values, units)}"
            )
            return Target(values, "twin", origin, truth)
    labels = {name: label for name, label in model.labels.items() if label}
    at = f" at {'/'.join(labels.values())}" if labels else ""
    options = "".join(f"--{name} {label} " for name, label in labels.items()) or f"--model {model.name} "
    raise InputError(
        f"--target twin: no twin of this version of {model.name}{at} with {engine}; make it: "
        f"calstudy twin {options}--out FILE, then --target twin:FILE"
    )


def write_twin(
    path: Path,
    model: Model,
    engine: str,
    parameters: Mapping[str, float],
    found: RepeatedRuns,
    command: str,
) -> None:
    """Put a twin into a table of twins, in place of an older one of the same fidelity and variant.

    Raises RunError where no run was usable, InputError for a file that is not a table of twins, SetupError
    where it cannot be written.
    """
    if not all(map(math.isfinite, found.mean.values())):
        raise RunError("no run gave all responses, so there is no twin; choose other parameters")
    line = {
        **model.labels,
        "model_hash": model.hash,
        "engine": engine,
        **{name: repr(float(parameters[name])) for name in model.parameters},
        **{name: repr(mean) for name, mean in found.mean.items()},
        **{f"{name}_sd": repr(sd) for name, sd in found.sd.items()},
        "replicates": str(found.used),
        "command": command,
    }
    columns = twin_columns(tuple(model.parameters), tuple(found.mean))
    kept = [
        old
        for old in read_twins(path, columns)
        if (old["fidelity"], old["variant"]) != (line["fidelity"], line["variant"])
    ]
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(sorted([*kept, line], key=lambda old: (old["fidelity"], old["variant"])))
    try:
        write_atomically(path, text.getvalue().encode())
    except OSError as error:
        raise SetupError(f"{path}: cannot be written: {error.strerror}; choose another --out") from error


def read_twins(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """Lines of a table of twins; empty if the file does not exist."""
    if not path.exists():
        return []
    try:
        reader = csv.DictReader(io.StringIO(text_of(path)))
        lines = list(reader)
    except (InputError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as a table of twins; choose another --out") from error
    # A line that is too long has a cell without a column, one that is too short a column without a cell.
    whole = all(None not in line and None not in line.values() for line in lines)
    if tuple(reader.fieldnames or ()) != tuple(columns) or not whole:
        raise InputError(f"{path}: is no table of twins; choose another --out")
    return lines
