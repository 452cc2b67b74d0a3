"""What runs of a project wrote is kept, and read anew after a reader or a marker was corrected.

A run is kept by what made it, not by what is read of it. A model whose readers were corrected makes the same
runs, so none has to be run again.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from calstudy.disk.files import Journal, cannot_write
from calstudy.disk.kept import KeptRuns
from calstudy.disk.ours import discard, scratch_of_ours
from calstudy.engines.cluster import WorkersEngine
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Engine
from calstudy.engines.queue import cores
from calstudy.errors import Stopped
from calstudy.models.find import is_shipped
from calstudy.models.folder import FolderModel
from calstudy.records import Evaluation, Phase, Request
from calstudy.study.directory.journal import encode

KEPT = "kept"
"""Directory of a project's kept runs, beside its studies."""
REREAD = "reread.jsonl"
"""Journal of a project's runs that were read anew, beside its studies."""


@dataclass(frozen=True, slots=True)
class Reread:
    """Kept runs of a model that were read anew."""

    model: FolderModel
    evaluations: tuple[Evaluation, ...]
    """With what is read now; some may give no result."""

    @property
    def read(self) -> tuple[Evaluation, ...]:
        """Those that gave a result."""
        return tuple(evaluation for evaluation in self.evaluations if not evaluation.run.broke)

    def but(self, known: Collection[str]) -> Reread:
        """Without the runs of these ids."""
        return replace(self, evaluations=tuple(e for e in self.evaluations if e.run_id not in known))

    @property
    def reasons(self) -> list[str]:
        """Why others gave none."""
        return list(dict.fromkeys(e.run.reason for e in self.evaluations if e.run.broke))

    @property
    def in_words(self) -> str:
        """How many there are, for a message."""
        less = len(self.evaluations) - len(self.read)
        why = f"; {less} give no result: {self.reasons[0]}" if less else ""
        return f"Read anew: {len(self.read)} kept run(s) of {self.model.name}{why}"


def keeping(engine: Engine, project: Path) -> Engine:
    """The engine; that of a model of one's own on this machine keeps what each run writes."""
    if not isinstance(engine, ProgramEngine) or isinstance(engine, WorkersEngine):
        return engine
    model = engine.model
    if not isinstance(model, FolderModel) or is_shipped(model.name):
        return engine
    kept = KeptRuns(project.absolute() / KEPT, model.outputs, model.keep) if model.keep else None
    return ProgramEngine(model, engine.program, engine.prefix, kept)


def reread(
    engines: Sequence[Engine], project: Path, known: Collection[str], scratch: Path, stop: threading.Event
) -> list[Reread]:
    """Read the project's kept runs with the models as they are now, but for the ids that are ``known``.

    Raises Stopped when ``stop`` is set. Without kept runs of a model there is nothing for it.
    """
    found = []
    for engine in engines:
        if not isinstance(engine, ProgramEngine) or engine.kept is None:
            continue
        asked = [request for request in _made_by(engine) if _run_id(request, engine) not in known]
        if not asked:
            continue
        plain = ProgramEngine(engine.model, engine.program, kept=engine.kept)  # names as the model has them
        answer = partial(_answer, plain, scratch, stop)
        with ThreadPoolExecutor(cores()) as threads:
            answers = list(threads.map(answer, asked))
        if evaluations := tuple(told for told in answers if told is not None):
            found.append(Reread(engine.model, evaluations))
    return found


def remember(found: Sequence[Reread], project: Path) -> None:
    """Keep what was read for the calibrations of the project. SetupError: it cannot be written."""
    journal = Journal(project / REREAD)
    try:
        for of_model in found:
            for evaluation in of_model.read:
                journal.append(encode(evaluation))
    except OSError as error:
        raise cannot_write(project / REREAD, error) from error


def _made_by(engine: ProgramEngine[FolderModel]) -> list[Request]:
    """Kept runs that this engine would make just so."""
    assert engine.kept is not None
    requests: list[Request] = []
    for making, about in engine.kept.all():
        there = about["parameters"]
        if about["engine"] != engine.identity or not set(engine.model.parameters) <= set(there):
            continue
        own = {name: float(there[name]) for name in engine.model.parameters}
        if engine.making(own, about["seed"]) == making:
            requests.append(Request(0, Phase.SAMPLING, len(requests), own, about["seed"]))
    return requests


def _run_id(request: Request, engine: Engine) -> str:
    return request.run_id(engine.model_hash, engine.identity)


def _answer(
    engine: ProgramEngine[FolderModel], scratch: Path, stop: threading.Event, request: Request
) -> Evaluation | None:
    if stop.is_set():
        raise Stopped("interrupted")
    run_id = _run_id(request, engine)
    directory = scratch_of_ours(scratch, "reread") / f"reread-{run_id}"
    discard(directory)
    try:
        run = engine.reread(request.parameters, request.seed, directory)
    finally:
        discard(directory)
    return None if run is None else Evaluation(request, run_id, run, engine.model_hash)
