"""DEM optima run again with fresh seeds: what a reported optimum is worth.

The second optimisation reports the best of many noisy runs, which is better than the same parameters are on
average. Runs with fresh seeds at each row's DEM optimum lie beside the study, as a sweep writes them::

    FOLDER/paper/                    the study
    FOLDER/confirmed/runs.parquet    runs with the label "paper ROW"
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from calstudy.errors import StoreError
from calstudy.models.heap import MEASURED
from calstudy.plan import PARAMETERS
from calstudy.study.directory.store import read_part
from calstudy.study.reading import Study
from calstudy.study.schema import schema_of, sweep_columns

FOLDER, RUNS = "confirmed", "runs.parquet"
SAME = 1e-12
"""Relative difference of parameters that a design's text may make."""


def confirmed_label(directory: Path, row: int) -> str:
    """What a design calls the runs at the DEM optimum of a row."""
    return f"{directory.resolve().name} {row}"


def runs_beside(directory: Path) -> Path:
    """Where fresh runs at the optima of the study in ``directory`` lie."""
    return directory.resolve().parent / FOLDER / RUNS


def with_confirmed(directory: Path, study: Study) -> Study:
    """The study with the fresh runs at its DEM optima, and what they say in new columns of its calibrations.

    The columns, NaN where no run is usable: ``confirmed_runs``, and ``confirmed_`` with each response and
    ``sum_of_squares``, means over a row's usable fresh runs. The study as it is where none lie beside it.
    StoreError where runs are damaged, of another model, or not at the row's DEM optimum.
    """
    path = runs_beside(directory)
    if not path.is_file():
        return study
    schema = schema_of(sweep_columns(study.settings.quantities), "sweep")
    runs = read_part(path, schema, "run the sweep that made it again").to_pandas()
    rows = {confirmed_label(directory, row): row for row in map(int, study.ok["row"])}
    runs = runs[runs["label"].isin(rows)]
    if runs.empty:
        return study
    runs = runs.assign(row=runs["label"].map(rows).astype(int)).reset_index(drop=True)
    _require_same(path, study, runs)
    usable = runs.dropna(subset=list(MEASURED))
    lines = {}
    for row, of in usable.groupby("row"):
        totals = np.sum(study.residuals(int(row), of) ** 2, axis=1)
        means = {f"confirmed_{name}": float(of[name].mean()) for name in MEASURED}
        lines[row] = {"confirmed_runs": len(of), **means, "confirmed_sum_of_squares": float(totals.mean())}
    columns = pd.DataFrame.from_dict(lines, orient="index")
    calibrations = study.calibrations.join(columns, on="row")
    calibrations["confirmed_runs"] = calibrations["confirmed_runs"].fillna(0).astype(int)
    return replace(study, calibrations=calibrations, confirmed=runs)


def _require_same(path: Path, study: Study, runs: pd.DataFrame) -> None:
    """StoreError unless the runs are those of the study's model at its optima."""
    if set(runs["model_hash"]) != {study.settings.model_hash}:
        raise StoreError(f"{path}: the runs are of another model than the study; move them away")
    optima = study.ok.set_index("row").loc[runs["row"], [f"dem_{name}" for name in PARAMETERS]]
    is_same = np.isclose(runs[list(PARAMETERS)], optima.to_numpy(float), rtol=SAME, atol=0.0).all(axis=1)
    if not is_same.all():
        label = runs["label"].to_numpy()[~is_same][0]
        raise StoreError(f"{path}: {label!r} is not at that row's DEM optimum; move the runs away")


def in_words(study: Study) -> str:
    """How often the optima were run again; empty where they were not."""
    if study.confirmed is None:
        return ""
    each = study.confirmed.groupby("row").size()
    seeds = f"{each.min()}" if each.min() == each.max() else f"{each.min()} to {each.max()}"
    failed = int(study.confirmed[list(MEASURED)].isna().any(axis=1).sum())
    lost = f", of which {failed} gave no response" if failed else ""
    return (
        f"Run again: {len(study.confirmed)} runs with fresh seeds at the DEM optima of {len(each)} of "
        f"{len(study.ok)} rows, {seeds} a row{lost}."
    )
