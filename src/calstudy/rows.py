"""Rows of a plan as calibrations: what each one calibrates, and against which cost."""

from __future__ import annotations

from collections.abc import Mapping

from calstudy.calibration import Task
from calstudy.cost import Cost
from calstudy.modes import Mode
from calstudy.plan import Plan, Row
from calstudy.records import Target


def cost_of(plan: Plan, row: Row, target: Target) -> Cost:
    """Cost of a row: its intervals, its WRL, the plan's particles."""
    return Cost(plan.space(row), target, row.WRL, (plan.fixed.particles,))


def tasks_of(
    plan: Plan,
    target: Target,
    mode: Mode,
    seed: int,
    share_samples: bool = False,
    noise: Mapping[str, float] | None = None,
) -> dict[int, Task]:
    """Each row's calibration, by run number.

    ``share_samples`` gives rows that differ in WRL alone the same samples; ``noise`` is the responses' known
    standard deviation from seed to seed.
    """
    return {
        row.run: Task(
            row=row.run,
            space=plan.space(row),
            samples=row.samples,
            cost=cost_of(plan, row, target),
            mode=mode,
            seed=seed,
            sampled_as=plan.sampled_as(row.run) if share_samples else row.run,
            noise=noise,
        )
        for row in plan.rows
    }
