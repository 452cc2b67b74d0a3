"""The engine boundary: a parameter set and a seed go in, one DEM run's record comes out.

``ProgramEngine`` joins three parts that know nothing of each other: the model (which files go in, and how
those that come out are read), the program (which command) and the process (how it is run). A simulation
that goes wrong is an outcome. It never raises.
"""

from __future__ import annotations

import errno
import logging
import math
import os
import signal
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Generic

from calstudy.disk.kept import KeptRuns
from calstudy.disk.ours import discard, make_marked
from calstudy.engines.interface import Inputs, ModelT, Reading
from calstudy.engines.process import Finished, run_process
from calstudy.engines.program import Profile, Program
from calstudy.errors import RunError, SetupError, Stopped
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Run

log = logging.getLogger(__name__)
LEAST_FREE = 5_000_000
"""Bytes. If a run failed and this many cannot be written, it failed because the disk is full."""
FULL = (errno.ENOSPC, errno.EDQUOT)
ATTEMPTS = 3
"""Number of times that a program is started if something else keeps ending it; then the run has failed."""
GRACE_SECONDS = 1.0
"""A batch system that ends our programs tells us to stop within this time."""
TIME_LIMIT_FACTOR = 20.0
SHORTEST_TIME_LIMIT = 120.0
LOG_TAIL_LINES = 3
ELSEWHERE = "see --scratch, or set TMPDIR"
"""Remedy of a full disk. Commands without a study work in the temporary directory."""
LOG_LINE_LENGTH = 200


class ProgramEngine(Generic[ModelT]):
    """Runs a model with an external program."""

    def __init__(
        self, model: ModelT, program: Program, prefix: str = "", kept: KeptRuns | None = None
    ) -> None:
        self.model, self.program = model, program
        self.prefix = prefix
        """Prefix of the responses' names, if another model of the study has responses of the same name."""
        self.kept = kept
        """Where what a run wrote is kept, and read anew in place of an equal run; None to keep nothing."""

    @property
    def identity(self) -> str:
        """Program and version."""
        return self.program.identity

    @property
    def model_hash(self) -> str:
        """Identity of the model, by content."""
        return self.model.hash

    @property
    def expected_seconds(self) -> float:
        """Expected time of one run on one core, in s."""
        return self.model.expected_seconds

    @property
    def particle_diameter(self) -> float:
        """Diameter of the simulated beads in m."""
        return self.model.particle_diameter

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Write the model's files, run the program, check that it finished, read the responses.

        A kept run that was made just so is read in its place, where it gives what is read.
        """
        kept = self.reread(parameters, seed, directory)
        if kept is not None and not kept.broke:
            return kept
        if kept is not None:
            discard(directory)
        finished = self._execute(parameters, seed, directory, stop)
        if self.kept is not None:
            self._keep(self.kept, finished, parameters, seed, directory)
        run = self._read(finished, parameters, directory)
        if run.broke:
            _require_own_failure(directory, stop)
            run = replace(run, reason=f"{run.reason}{_log_tail(directory, self.program.profile)}")
        return run

    def making(self, parameters: Mapping[str, float], seed: int) -> str:
        """Identity of a run by what makes it: the program, its files, parameters, seed, ranks and threads."""
        model = self.model
        return model.inputs(parameters, seed).making(seed, self.identity, model.ranks, model.threads)

    def reread(self, parameters: Mapping[str, float], seed: int, directory: Path) -> Run | None:
        """Read what an equal run left, in a new ``directory``; None, and no directory, where none is kept."""
        making = "" if self.kept is None else self.making(parameters, seed)
        about = None if self.kept is None else self.kept.about(making)
        if self.kept is None or about is None:
            return None
        write_inputs(self.model.inputs(parameters, seed), directory)
        if not self.kept.unpack(making, directory):
            discard(directory)
            return None
        run = self._read(Finished(**about["finished"]), parameters, directory)
        return replace(run, host=about["host"], finished_at=about["finished_at"])

    def _keep(
        self,
        kept: KeptRuns,
        finished: Finished,
        parameters: Mapping[str, float],
        seed: int,
        directory: Path,
    ) -> None:
        """Keep what a run wrote that came to an end of its own, whatever is read of it."""
        if finished.timed_out or finished.exit_code < 0:
            return
        about = {
            "model": self.model.name,
            "parameters": dict(parameters),
            "seed": seed,
            "engine": self.identity,
            "finished": asdict(finished),
            "host": os.uname().nodename,
            "finished_at": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        given = self.model.inputs(parameters, seed).files
        try:
            if not kept.keep(self.making(parameters, seed), about, directory, given):
                log.info("a run of %s is too large to be kept, and cannot be read anew", self.model.name)
        except OSError as error:
            log.info("a run of %s was not kept: %s", self.model.name, error)

    def _read(self, finished: Finished, parameters: Mapping[str, float], directory: Path) -> Run:
        """The run as its directory tells it."""
        try:
            self._require_end(finished, directory)
            reading = self.model.read(directory, parameters)
        except RunError as error:
            nothing = {response.name: math.nan for response in self.model.responses}
            outcome = Outcome.TIMED_OUT if finished.timed_out else Outcome.FAILED
            reading = Reading(nothing, outcome, str(error))
        read = {f.name: getattr(reading, f.name) for f in fields(reading)}
        return Run(
            **read | {"responses": self._named(reading.responses, parameters)},
            wall_time=finished.wall_time,
            cpu_time=finished.cpu_time,
            engine_time_step=self.model.engine_time_step(parameters),
        )

    def _execute(
        self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event
    ) -> Finished:
        """Run the program in the directory. Stopped: ``stop`` was set meanwhile."""
        inputs, profile = self.model.inputs(parameters, seed), self.program.profile
        for attempt in range(ATTEMPTS):
            if attempt:
                discard(directory)
            write_inputs(inputs, directory)
            finished = run_process(
                self.program.command(inputs.script, inputs.arguments, self.model.ranks, self.model.threads),
                directory=directory,
                output=directory / profile.output,
                time_limit=self.time_limit(parameters),
                stop=stop,
                environment={**dict(profile.environment), "OMP_NUM_THREADS": str(self.model.threads)},
                remedy=f"check {profile.option or profile.variable or 'command'} or run 'calstudy doctor'",
            )
            if finished.stopped or (finished.ended_from_outside and stop.wait(GRACE_SECONDS)):
                raise Stopped("interrupted")
            if not finished.ended_from_outside:
                break
        for name, linked in inputs.links.items():
            if not linked.is_untouched:
                raise SetupError(
                    f"{linked.path}: changed while a run used it; if the run wrote it, restore it, and take "
                    f"{name} out of links in model.toml"
                )
        return finished

    def _require_end(self, finished: Finished, directory: Path) -> None:
        """Raise RunError if the program took too long or ended with an error.

        LIGGGHTS ends ``quit`` with an exit code, too; then the model's mark of the end decides.
        """
        if finished.timed_out:
            raise RunError(f"no end after {finished.wall_time:.0f} s, so it was ended")
        if finished.exit_code != 0 and not (finished.exit_code > 0 and self.model.ended(directory)):
            again = f", {ATTEMPTS} times in turn" if finished.ended_from_outside else ""
            raise RunError(f"{self.program.profile.name} ended {_in_words(finished.exit_code)}{again}")

    def time_limit(self, parameters: Mapping[str, float]) -> float:
        """Time in s after which a run is ended: many times the expected one."""
        expected = max(self.expected_seconds, self.model.expected_seconds_at(parameters))
        return max(SHORTEST_TIME_LIMIT, TIME_LIMIT_FACTOR * expected)

    def _named(self, measured: Mapping[str, float], parameters: Mapping[str, float]) -> dict[str, float]:
        """Responses by their names in the study, with the Rayleigh time-step."""
        particles = self.model.particles
        step = math.nan if particles is None else float(particles.rayleigh_time_step(parameters))
        return {f"{self.prefix}{name}": value for name, value in measured.items()} | {
            RAYLEIGH_TIME_STEP: step
        }


def write_inputs(inputs: Inputs, directory: Path) -> None:
    """Write a run's files into a new directory. SetupError: it exists already, or cannot be written."""
    try:
        make_marked(directory)
        for name, content in inputs.files.items():
            path = directory / name
            if name.endswith("/"):
                path.mkdir(parents=True, exist_ok=True)
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(content)
        for name, linked in inputs.links.items():
            (directory / name).parent.mkdir(parents=True, exist_ok=True)
            (directory / name).symlink_to(linked.path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise SetupError(f"{directory}: cannot write the run's files: {reason}; {ELSEWHERE}") from error


def _require_own_failure(directory: Path, stop: threading.Event) -> None:
    """Raise if the machine made a run fail, so that it is not stored as a failure of its parameters."""
    if stop.is_set():  # whoever stops us may have ended the program first
        raise Stopped("interrupted")
    if not directory.is_dir():
        raise SetupError(f"{directory}: gone while the run went on; {ELSEWHERE}")
    try:
        _write_something(directory)
    except OSError as error:
        reason = "the disk is full" if error.errno in FULL else error.strerror or str(error)
        raise SetupError(f"{directory}: {reason}; free space, or {ELSEWHERE}") from error


def _write_something(directory: Path) -> None:
    """Try to write: a quota, for one, shows in no other way."""
    with tempfile.TemporaryFile(dir=directory) as probe:
        probe.write(os.urandom(LEAST_FREE))  # zeros may take no room
        probe.flush()
        os.fsync(probe.fileno())


def _in_words(exit_code: int) -> str:
    """An exit code in words; negative ones are signals."""
    if exit_code >= 0:
        return f"with exit code {exit_code}"
    names = {int(known): known.name for known in signal.Signals}  # some numbers have no name
    hint = " (out of memory?)" if -exit_code == signal.SIGKILL else ""
    return f"by signal {names.get(-exit_code, -exit_code)}{hint}"


def _log_tail(directory: Path, profile: Profile) -> str:
    """The error that the program told, in its log or on the screen, or else the last lines of its log.

    A script that moves its log leaves a banner in the one that we look for.
    """
    told: dict[str, list[str]] = {}
    for name in (profile.log, profile.output):
        try:
            text = (directory / name).read_text(errors="replace")
        except OSError:
            continue  # the program may have ended before it wrote one
        told[name] = [line.strip()[:LOG_LINE_LENGTH] for line in text.splitlines() if line.strip()]
    errors = {name: [ln for ln in lines if ln.startswith(profile.error)][-1:] for name, lines in told.items()}
    tails = {name: lines[-LOG_TAIL_LINES:] for name, lines in told.items()}
    shown = ((name, lines) for of in (errors, tails) for name, lines in of.items() if lines)
    return next((f"; {name} ends: {' | '.join(lines)}" for name, lines in shown), "")
