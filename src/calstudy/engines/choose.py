"""The engines by name."""

from __future__ import annotations

import threading
from argparse import Namespace
from collections.abc import Sequence

from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Model
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.engines.queue import Executor, LocalExecutor, cores


def engines_and_executor(
    a: Namespace, models: Sequence[tuple[Model, str]], stop: threading.Event
) -> tuple[list[ProgramEngine[Model]], Executor]:
    """What runs each model (with the prefix of its responses), and where: threads here, or a cluster."""
    if a.scheduler is None:
        program = LIGGGHTS.find(a.liggghts)
        here = [ProgramEngine(model, program, prefix) for model, prefix in models]
        return here, LocalExecutor(a.workers or cores(), stop)
    from calstudy.engines.cluster import DaskExecutor, WorkersEngine

    cluster = DaskExecutor(a.scheduler, a.workers)
    try:
        there = cluster.program(LIGGGHTS, a.liggghts, stop)
        return [WorkersEngine(model, there, a.liggghts, prefix) for model, prefix in models], cluster
    except BaseException:
        cluster.close()
        raise
