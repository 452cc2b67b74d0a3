"""What the replicates of a study say to the paper's numbers: the entries that bands are made from."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import pandas as pd
from threadpoolctl import threadpool_limits

from calstudy.analysis.entries import entries, half_of
from calstudy.plan import FULL_FACTORIAL
from calstudy.replicates import CALIBRATIONS, RUNS, Tables, read_replicate
from calstudy.store import finished_replicates
from calstudy.study import Study

MANY = 8
"""Replicates from which further processes are worth their start."""


def with_replicates(directory: Path, study: Study, workers: int) -> Study:
    """The study with the entries of its finished replicates; four columns say of which one.

    They are ``replicate``, ``rows`` (number of rows of the plan), ``calibrations`` (finished of these) and
    ``failed`` (calibrations that failed). On the full factorial each replicate has its entries twice, of the
    paper's half, too. StoreError where a replicate is damaged or of another study. Without replicates the
    study as it is.
    """
    numbers = finished_replicates(directory)
    if not numbers:
        return study
    none = study.evaluations.iloc[:0]
    bare = replace(
        study, evaluations=none, heaps=study.heaps.iloc[:0], calibrations=study.calibrations.iloc[:0]
    )
    tasks = [(directory, bare, number) for number in numbers]
    pool = (
        ProcessPoolExecutor(min(workers, len(numbers)), mp_context=get_context("spawn"))
        if workers > 1 and len(numbers) >= MANY
        else nullcontext()
    )
    with pool as helpers:
        parts = list(helpers.map(_entries, tasks, chunksize=2) if helpers else map(_entries, tasks))
    return replace(study, replicated=pd.concat(parts, ignore_index=True))


def replicate_study(study: Study, tables: Tables) -> Study:
    """A replicate as a study of its own."""
    calibrations = tables[CALIBRATIONS]
    settings = replace(
        study.settings, seed=int(calibrations["seed"].iloc[0]), engine=str(calibrations["engine"].iloc[0])
    )
    return replace(
        study,
        settings=settings,
        calibrations=calibrations,
        evaluations=tables[RUNS],
        heaps=study.heaps.iloc[:0],
    )


def _entries(task: tuple[Path, Study, int]) -> pd.DataFrame:
    directory, study, number = task
    whole = replicate_study(study, read_replicate(directory, study.settings.id, number))
    parts: Sequence[Study] = [whole]
    if study.plan.name == FULL_FACTORIAL:
        parts = [half_of(whole), whole]
    with threadpool_limits(1):
        return pd.concat(
            [
                entries(part).assign(
                    replicate=number,
                    rows=part.planned,
                    calibrations=len(part.calibrations),
                    failed=len(part.failed),
                )
                for part in parts
            ],
            ignore_index=True,
        )
