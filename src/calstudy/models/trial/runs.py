"""A trial of a user's model: two runs at the ends of all intervals, and what they prove.

Both runs have one seed, so that only the parameters differ. Each response must be there at both ends, must
have been made by these runs, and must move. That each single parameter reaches the script is read in the
script (``script``); two runs cannot tell one parameter's effect from another's.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from calstudy.disk.ours import discard, kept
from calstudy.engines.engine import ProgramEngine, write_inputs
from calstudy.engines.queue import Job, run_job
from calstudy.errors import RunError
from calstudy.models.folder import FolderModel
from calstudy.models.readers import Command, PythonFunction, tell
from calstudy.records import Evaluation, Phase, Request, Run

LIKELY: tuple[tuple[str, str], ...] = (
    (
        r"Cannot redefine variable",
        "the script sets a variable of that name in another style; let it be of style index, or name its "
        "file as include",
    ),
    (
        r"Substitution for illegal variable|Variable name .* does not exist|Variable for .* does not exist",
        "the script uses a variable that nothing sets; add it to [parameters], or set it in the script",
    ),
    (
        r"Cannot open|cannot be opened|not be found|No such file",
        "a file that the script reads is not in the model's folder; put it there and name it without a path",
    ),
    (r"Unknown command|Illegal variable command", "the script is not one of this program's version"),
    (r"Lost atoms|Non-numeric", "beads leave the box at these parameters; narrow the intervals"),
    (r"no end after", "the run takes longer than its time limit; raise expected_seconds in model.toml"),
    (r"does not say", "correct 'finished' in model.toml, or see at which line of the script the run ended"),
    (r"no line that begins with", "correct the marker in model.toml, or let the script print it"),
)
"""What a reason may say, and its likely cause or remedy."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Two runs and what they show."""

    evaluations: tuple[Evaluation, ...]
    """At all lower ends, at all upper ends. Fewer where a run failed, none where nothing could be run."""
    shown: Mapping[str, str]
    """Where each response was read in the last run, with the line."""
    faults: tuple[str, ...]
    """What is wrong, each with its likely cause and remedy; empty where a campaign may begin."""

    @property
    def runs(self) -> tuple[Run, ...]:
        """Runs of the evaluations."""
        return tuple(evaluation.run for evaluation in self.evaluations)

    @property
    def seconds(self) -> float:
        """Wall-clock time of the longer run; NaN without one."""
        return max((run.wall_time for run in self.runs), default=math.nan)


def try_model(
    engine: ProgramEngine[FolderModel],
    ends: tuple[Mapping[str, float], Mapping[str, float]],
    seed: int,
    scratch: Path,
    stop: threading.Event,
) -> Trial:
    """Run a model at both ends, in directories below ``scratch`` that are kept where a run failed.

    Raises SetupError where the program cannot be started, Stopped when ``stop`` is set.
    """
    model = engine.model
    own = [{name: end[name] for name in model.parameters} for end in ends]
    faults = list(_old_results(model, scratch / "before", own[0], seed))
    evaluations: list[Evaluation] = []
    shown: dict[str, str] = {}
    for k, parameters in enumerate(own):
        if faults:
            break
        request = Request(0, Phase.SAMPLING, k, parameters, seed)
        run_id = request.run_id(model.hash, engine.identity)
        run = run_job(Job(engine, parameters, seed, run_id, scratch, "trial", keep=True), stop)
        evaluations.append(Evaluation(request, run_id, run, model.hash))
        if run.usable:
            shown = {name: reader.shown(kept(scratch, run_id)) for name, reader in model.readers.items()}
            discard(kept(scratch, run_id))
        else:
            faults.append(
                f"the run at the {('lower', 'upper')[k]} ends of all intervals gave no result: {run.reason}"
                f"{_likely(run)}; its files are in {kept(scratch, run_id)}"
            )
    if not faults:
        faults += _unmoved(model, *(evaluation.run for evaluation in evaluations))
    return Trial(tuple(evaluations), shown, tuple(faults))


def _likely(run: Run) -> str:
    """The first cause that a run's reason hints at."""
    return next((f"; {cause}" for pattern, cause in LIKELY if re.search(pattern, run.reason)), "")


def _old_results(
    model: FolderModel, directory: Path, parameters: Mapping[str, float], seed: int
) -> Iterator[str]:
    """Functions and commands that give a result before anything has run: an old one lies in the folder."""
    functions = {n: r for n, r in model.readers.items() if isinstance(r, PythonFunction | Command)}
    if not functions:
        return
    write_inputs(model.inputs(parameters, seed), directory)
    tell(directory, model.variables(parameters))
    try:
        for name, reader in functions.items():
            try:
                value = reader.read(directory)
            except RunError:
                continue  # as it should: there is nothing to read yet
            yield (
                f"{name}: {_called(reader)} gives {value:g} before anything has run, so it "
                "reads an old result in the model's folder; remove that file, or name the new one in it"
            )
    finally:
        discard(directory)


def _called(reader: PythonFunction | Command) -> str:
    return " ".join(reader.words) if isinstance(reader, Command) else f"{reader.origin}:{reader.function}"


def _unmoved(model: FolderModel, low: Run, high: Run) -> Iterator[str]:
    """Responses that are the same at both ends."""
    for response in model.responses:
        value = low.responses[response.name]
        if value == high.responses[response.name]:
            yield (
                f"{response.name} is {value:g} {response.unit} at the lower and at the upper ends of all "
                "intervals, so no parameter moves it; likely causes: the script sets its own values after "
                "the parameters, the response is read where this run does not write, or it depends on none"
            )
