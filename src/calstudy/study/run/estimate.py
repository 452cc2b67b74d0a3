"""Expected cost of calibrations before they are run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calstudy.calibration.expected import (
    expected_batches,
    expected_optimisation_runs,
    least_waves,
    most_further_runs,
    number_of_new_samples,
)
from calstudy.calibration.task import Task
from calstudy.study.directory.store import finished_replicates, finished_rows
from calstudy.study.run.work import Work


@dataclass(frozen=True, slots=True)
class Estimate:
    """Calibrations that are left to be run, and their expected cost."""

    rows: int
    rows_finished: int
    replicates: int
    runs_sampling: int
    runs_optimisation: float
    core_seconds: float
    elapsed_seconds: float
    bytes_stored: float
    """On disk when all is finished."""
    bytes_scratch: float
    """Most on disk before that."""

    @property
    def core_hours(self) -> float:
        """``core_seconds`` in hours."""
        return self.core_seconds / 3600


def estimate(
    work: Work,
    run_seconds: Sequence[float],
    workers: int,
    *,
    cheap_seconds: float = 0.0,
    beads: int = 0,
    row_seconds: float | None = None,
    replicates: int = 0,
) -> Estimate:
    """Expected cost of the rows that are not finished.

    ``run_seconds`` is the time of a DEM run of each material test on one core, ``cheap_seconds`` that of one
    of the cheap fidelity, if there are two, ``beads`` its number of beads, ``replicates`` the number of
    replicates wanted in all. Give ``row_seconds``, the time of a whole calibration, if its runs take less
    than the calibration itself.
    """
    begun = work.other_study is None
    done = finished_rows(work.directory) if begun else set()
    there = finished_replicates(work.directory) if begun else []
    more = sum(number not in there for number in range(1, replicates + 1))
    asked = {row: work.tasks[row] for row in work.rows}
    waiting = [row for row in asked if row not in done]
    each = [_runs({row: asked[row] for row in waiting}, k) for k in range(len(run_seconds))]
    sampling, optimisation = sum(s for s, _ in each), sum(o for _, o in each)
    runs = sampling + optimisation
    seconds = sum((s + o) * of for (s, o), of in zip(each, run_seconds, strict=True))
    if work.cheap:
        further = len(run_seconds) * sum(most_further_runs(asked[row]) for row in waiting)
        mean = sum(run_seconds) / len(run_seconds)
        seconds = optimisation * mean + (sampling + further) * cheap_seconds
    if row_seconds is not None:
        seconds = (len(waiting) + more * len(asked)) * row_seconds
    longest = max((_chain(asked[row], workers, run_seconds, cheap_seconds) for row in waiting), default=0)
    journals = runs * (1_000 + 4 * beads)
    stored = len(waiting) * (62_000 + 10 * beads) + 150 * runs
    if len(done.union(waiting)) < len(work.tasks):
        stored += journals  # they go with the plan's last row
    stored += more * (60_000 + 70 * sum(_runs(asked, 0)))
    return Estimate(
        rows=len(waiting),
        rows_finished=len(asked) - len(waiting),
        replicates=more,
        runs_sampling=sampling,
        runs_optimisation=optimisation,
        core_seconds=seconds,
        elapsed_seconds=max(seconds / workers, longest),
        bytes_stored=stored,
        bytes_scratch=workers * 250 * beads + journals,
    )


def _chain(task: Task, workers: int, run_seconds: Sequence[float], cheap_seconds: float) -> float:
    """Time in s of the DEM runs of a calibration that must run one after another."""
    seconds = run_seconds[: task.tests]
    expensive, cheap = (least_waves(of, len(seconds), workers) for of in expected_batches(task))
    return expensive * sum(seconds) / len(seconds) + cheap * cheap_seconds


def _runs(tasks: Mapping[int, Task], test: int) -> tuple[int, float]:
    """DEM runs of a material test: of the samples, where shared ones count once, and of the second
    optimisations."""
    taking = [task for task in tasks.values() if task.tests is None or test < task.tests]
    sampled = {task.sampled_as: number_of_new_samples(task) for task in taking}
    return sum(sampled.values()), sum(map(expected_optimisation_runs, taking))
