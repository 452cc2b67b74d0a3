"""The engines by name."""

from __future__ import annotations

import threading
from argparse import Namespace
from collections.abc import Sequence

from calstudy.engines.engine import LiggghtsEngine
from calstudy.engines.interface import Model
from calstudy.engines.liggghts import find_liggghts
from calstudy.engines.queue import Executor, LocalExecutor, cores


def engines_and_executor(
    a: Namespace, models: Sequence[tuple[Model, str]], stop: threading.Event
) -> tuple[list[LiggghtsEngine[Model]], Executor]:
    """What runs each model (with the prefix of its responses), and where: threads here, or a cluster."""
    if a.scheduler is None:
        program = find_liggghts(a.liggghts)
        here = [LiggghtsEngine(model, program, prefix) for model, prefix in models]
        return here, LocalExecutor(a.workers or cores(), stop)
    from calstudy.engines.cluster import DaskExecutor, WorkersEngine

    cluster = DaskExecutor(a.scheduler, a.workers)
    try:
        version = cluster.liggghts_version(a.liggghts, stop)
        return [WorkersEngine(model, version, a.liggghts, prefix) for model, prefix in models], cluster
    except BaseException:
        cluster.close()
        raise
