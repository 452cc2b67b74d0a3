"""The paper's numbers in each replicate of a study: the entries that bands are made from."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import pandas as pd
from threadpoolctl import threadpool_limits

from calstudy.analysis.by_tests import rows as by_tests
from calstudy.analysis.replicates.entries import entries, half_of
from calstudy.calibration.task import truth_of
from calstudy.disk.files import content_of
from calstudy.disk.parquet import open_parquet
from calstudy.emulator.replicates import CALIBRATIONS, RUNS, Tables, read_replicate
from calstudy.errors import InputError, StoreError
from calstudy.plan import FULL_FACTORIAL
from calstudy.study.directory.store import finished_replicates
from calstudy.study.reading import Study, plan_of
from calstudy.study.schema import TABLES, arrow_schema
from calstudy.study.settings import LARGEST, SETTINGS_FILE, StudySettings
from calstudy.written import json_of

SAME: dict[str, Callable[[StudySettings], object]] = {
    "plan": lambda s: s.plan_hash,
    "model's hash": lambda s: s.model_hash,
    "mode": lambda s: s.mode,
    "budget": lambda s: s.budget,
    "target": lambda s: dict(s.target.values),
}
"""Settings that two studies must share for their rows to be compared."""
ENTRIES_FILE = "replicates.parquet"
"""File in which `analyse` writes the entries of every replicate."""
TESTS_FILE = "by_tests.parquet"
"""File in which `analyse` writes the rows of every replicate of a plan with several material tests."""
MANIFEST_FILE = "manifest.json"
COUNTED = ("replicate", "rows", "calibrations", "failed")
"""Columns of the entries that say of what they are."""
_REMEDY = "analyse that study again"
MANY = 8
"""With fewer replicates, starting more processes is not worth it."""


def with_replicates(
    directory: Path, study: Study, workers: int, rows: Collection[int] | None = None
) -> Study:
    """The study with the entries of its finished replicates, from all their ``rows`` or some.

    Four columns are added: ``replicate``, ``rows`` (number of rows of the plan), ``calibrations`` (how many
    of them are finished) and ``failed`` (how many calibrations failed). On the full factorial each replicate
    has its entries twice: of all rows, and of the paper's half. Without replicates the study is returned as
    it is. StoreError: a replicate is damaged or belongs to another study.
    """
    numbers = finished_replicates(directory)
    if not numbers:
        return study
    none = study.evaluations.iloc[:0]
    bare = replace(
        study, evaluations=none, heaps=study.heaps.iloc[:0], calibrations=study.calibrations.iloc[:0]
    )
    tasks = [(directory, bare, number, rows) for number in numbers]
    parts = _of_each(_entries, tasks, workers)
    return replace(study, replicated=pd.concat(parts, ignore_index=True))


Task = tuple[Path, Study, int, Collection[int] | None]
"""A study's directory, the study, the number of a replicate, and the rows that count; None: all."""


def _of_each(make: Callable[[Task], pd.DataFrame], tasks: Sequence[Task], workers: int) -> list[pd.DataFrame]:
    """What is made of each replicate."""
    pool = (
        ProcessPoolExecutor(min(workers, len(tasks)), mp_context=get_context("spawn"))
        if workers > 1 and len(tasks) >= MANY
        else nullcontext()
    )
    with pool as helpers:
        return list(helpers.map(make, tasks, chunksize=2) if helpers else map(make, tasks))


def with_replicated_tests(directory: Path, study: Study, workers: int) -> Study:
    """The study with the rows of its finished replicates, as ``analysis.by_tests.rows`` has them.

    Column ``replicate`` is added. Without replicates, or without several tests, it is returned as it is.
    """
    numbers = finished_replicates(directory) if study.plan.tests else []
    if not numbers:
        return study
    parts = _of_each(_rows, [(directory, study, number, None) for number in numbers], workers)
    return replace(study, replicated_tests=pd.concat(parts, ignore_index=True))


def _rows(task: Task) -> pd.DataFrame:
    """Rows of one replicate."""
    directory, study, number, _ = task
    with threadpool_limits(1):
        found = by_tests.rows(replicate_study(study, read_replicate(directory, study.settings, number)))
    return found.assign(replicate=number)


def with_replicated_rows(directory: Path, study: Study, like: Study) -> Study:
    """The study with the calibrations of its finished replicates in the rows of ``like``, another study.

    InputError: the studies differ in model, procedure or target. StoreError as in with_replicates.
    """
    _require_same(directory, study, like)
    rows = set(like.calibrations["row"])
    found = [
        read_replicate(directory, study.settings, number)[CALIBRATIONS]
        for number in finished_replicates(directory)
    ]
    lines = pd.concat(found, ignore_index=True)
    return replace(study, replicated_rows=lines[lines["row"].isin(rows)].reset_index(drop=True))


def has_entries(directory: Path) -> bool:
    """Whether `analyse` wrote the entries of replicates there, and it is not itself a study."""
    return (directory / ENTRIES_FILE).is_file() and not (directory / SETTINGS_FILE).is_file()


def read_entries(directory: Path, like: Study | None = None) -> Study:
    """A study without calibrations, from the entries of its replicates that `analyse` wrote there.

    StoreError: the entries are not those that the manifest lists. InputError: ``like``, a study to compare
    with, differs in model, procedure or target, or one of the two lacks rows of the plan.
    """
    path, listed = directory / ENTRIES_FILE, directory / MANIFEST_FILE
    try:
        content, manifest = content_of(path, LARGEST), json_of(content_of(listed, LARGEST))
        settings, known = StudySettings.of_content(manifest["settings"]), manifest["files"][ENTRIES_FILE]
    except OSError as error:
        raise StoreError(f"{error.filename} cannot be read: {error.strerror}; {_REMEDY}") from error
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise StoreError(f"{listed} is damaged ({error}); {_REMEDY}") from error
    if hashlib.sha256(content).hexdigest() != known:
        raise StoreError(f"{path} is not the one that {listed} lists; {_REMEDY}")
    none = (arrow_schema(table, settings.quantities).empty_table().to_pandas() for table in TABLES)
    tables = dict(zip(TABLES, none, strict=True))
    study = Study(settings, plan_of(directory, settings), **tables, replicated=_entries_in(content, path))
    if like is not None:
        _require_same(directory, study, like)
        assert study.replicated is not None
        if like.unfinished or (study.replicated["calibrations"] < study.planned).any():
            raise InputError(
                f"--beside {directory} has only the replicates' numbers, which are for all rows of the plan; "
                "for fewer rows name the study with the replicates themselves"
            )
    return study


def _entries_in(content: bytes, path: Path) -> pd.DataFrame:
    try:
        with open_parquet(content) as file:
            if {*COUNTED} <= {*file.schema_arrow.names}:
                frame: pd.DataFrame = file.read().to_pandas()
                return frame
    except ValueError as error:
        raise StoreError(f"{path} is damaged ({error}); {_REMEDY}") from error
    raise StoreError(f"{path} holds no entries of replicates; {_REMEDY}")


def _require_same(directory: Path, study: Study, like: Study) -> None:
    """Raise InputError if the studies differ in a setting of `SAME`."""
    for name, setting in SAME.items():
        here, there = setting(like.settings), setting(study.settings)
        if here != there:
            raise InputError(
                f"--beside {directory}: its {name} is {there}, not {here}; replicate the rows on an emulator "
                "of the same model, in the same mode, to the same target"
            )


def replicate_study(study: Study, tables: Tables) -> Study:
    """A replicate as a study."""
    calibrations = tables[CALIBRATIONS]
    settings = replace(
        study.settings, seed=int(calibrations["seed"].iloc[0]), engine=str(calibrations["engine"].iloc[0])
    )
    if study.plan.tests:
        values = {n: float(calibrations[f"target_{n}"].max()) for n in settings.target.values}  # one, or NaN
        target = replace(settings.target, values=values, truth=truth_of(study.plan, settings.seed))
        settings = replace(settings, target=target)
    return replace(
        study,
        settings=settings,
        calibrations=calibrations,
        evaluations=tables[RUNS],
        heaps=study.heaps.iloc[:0],
        confirmed=None,
    )


def _entries(task: Task) -> pd.DataFrame:
    """Entries of one replicate, from all its rows or some."""
    directory, study, number, rows = task
    whole = replicate_study(study, read_replicate(directory, study.settings, number))
    if rows is not None:
        whole = whole.only(rows)
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
