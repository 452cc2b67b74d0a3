"""An external program as data: how it is found, called and asked for its version, and what it writes.

A ``Profile`` describes a program wherever it is installed. A ``Program`` was found on a machine and
answers. Neither knows the models that it runs.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from calstudy.disk.ours import temporary
from calstudy.errors import SetupError

ANSWER_SECONDS = 60.0
OUTPUT = "output.txt"
"""File for what a program says on the screen, unless its profile names another."""
UNKNOWN = "of unknown version"
LAUNCHERS = {"mpirun", "mpiexec", "mpiexec.hydra", "orterun", "prterun"}
"""Programs that start another one on MPI ranks."""


@dataclass(frozen=True, slots=True)
class Profile:
    """Description of a program."""

    name: str
    """Name in messages and in the engine's identity."""
    command: str
    """Default command."""
    variable: str
    """Environment variable for another command; empty if there is none."""
    option: str
    """Option of the command line for another command; empty if there is none."""
    how_to_install: str
    banner: re.Pattern[str]
    """Pattern of its answer to ``question``. The first group is the version."""
    called: str
    """Name of the program in its banner."""
    call: tuple[str, ...]
    """Arguments of a run. {script} and {log} stand for the names of these files, {threads} for a number."""
    log: str
    """Name of its log file."""
    question: tuple[str, ...] = ("-help",)
    """Arguments with which it prints the banner and ends; none if it cannot be asked."""
    output: str = OUTPUT
    """Name of the file for its screen output."""
    error: str = "ERROR"
    """Beginning of a line of its log that says why it failed."""
    environment: tuple[tuple[str, str], ...] = ()
    """Environment variables of a run."""
    proven_version: str = ""
    """Version that calstudy was tested with."""
    reads_lammps: bool = False
    """Whether its scripts are in the language of LAMMPS, which is read for faults before any run."""

    @property
    def remedy(self) -> str:
        """What to do if it was not found."""
        if not self.variable:
            return self.how_to_install
        option = f"{self.option} PATH or " if self.option else ""
        return f"{self.how_to_install} or point to it with {option}{self.variable}=PATH"

    def find(self, command: str | None = None) -> Program:
        """Find the program: the given command, else the environment variable, else the search path.

        The command may have arguments, such as those of a container. SetupError, with the remedy: it was not
        found or does not answer.
        """
        chosen = command or (self.variable and os.environ.get(self.variable)) or self.command
        try:
            argv = tuple(shlex.split(chosen))
        except ValueError as error:
            raise SetupError(f"{chosen!r} is not a command ({error}); {self.remedy}") from error
        if started := [word for word in argv if Path(word).name in LAUNCHERS]:
            raise SetupError(
                f"{chosen!r} begins with {Path(started[0]).name}, whose ranks would neither count nor be "
                "part of a run's identity; name the program alone, with ranks = N in model.toml or --ranks N"
            )
        # Programs that pip installs lie beside Python, which need not be on the search path.
        places = (None, str(Path(sys.executable).parent))
        there = next(filter(None, (shutil.which(argv[0], path=p) for p in places if argv)), None)
        if there is None:
            raise SetupError(f"{self.name} was not found as {chosen!r}; {self.remedy}")
        # Each run has a directory of its own, from which a relative path would lead elsewhere.
        argv = (str(Path(there).absolute()), *argv[1:])
        if not self.question:
            return Program(self, argv, UNKNOWN)
        try:
            # In a directory of its own: LIGGGHTS 3.8.0 writes its log even when it only answers -help.
            with temporary() as directory:
                answer = subprocess.run(
                    [*argv, *self.question],
                    cwd=directory,
                    capture_output=True,
                    text=True,
                    errors="replace",
                    timeout=ANSWER_SECONDS,
                    stdin=subprocess.DEVNULL,
                    check=False,
                )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SetupError(f"{chosen!r} could not be started; {self.remedy}") from error
        found = self.banner.search(answer.stdout + answer.stderr)
        if found is None:
            raise SetupError(f"{chosen!r} does not answer as {self.called}; {self.remedy}")
        return Program(self, argv, found[1])


@dataclass(frozen=True, slots=True)
class Program:
    """A program that was found and answers. Without ``argv`` only its version is known."""

    profile: Profile
    argv: tuple[str, ...]
    version: str

    @property
    def identity(self) -> str:
        """Name and version."""
        return f"{self.profile.name} {self.version}"

    @property
    def described(self) -> str:
        """Name, version and command."""
        return f"{self.identity}, {shlex.join(self.argv)}"

    def command(
        self, script: str, arguments: Sequence[str] = (), ranks: int = 1, threads: int = 1
    ) -> list[str]:
        """Command that runs a script in the current directory, on several MPI ranks if need be.

        SetupError: there is no launcher for the ranks.
        """
        files = {"script": script, "log": self.profile.log, "threads": str(threads)}
        launched = (*launcher(self.argv[0]), str(ranks)) if ranks > 1 else ()
        return [*launched, *self.argv, *(part.format_map(files) for part in self.profile.call), *arguments]


@cache
def launcher(program: str) -> tuple[str, ...]:
    """Words that start a program on MPI ranks, but their number: mpirun beside the program, or on the path.

    Ranks are bound to no core, because runs side by side would share the first ones. SetupError without it.
    """
    places = (str(Path(program).parent), None)
    found = next(filter(None, (shutil.which("mpirun", path=place) for place in places)), None)
    if found is None:
        raise SetupError(
            "mpirun was not found, which ranks need; install it with 'apt-get install openmpi-bin', or "
            "remove ranks from model.toml, or leave --ranks out"
        )
    answer = subprocess.run([found, "--version"], capture_output=True, text=True, check=False, timeout=60)
    if "Open MPI" not in answer.stdout:
        return (found, "-bind-to", "none", "-np")
    root = ("--allow-run-as-root",) if os.geteuid() == 0 else ()
    return (found, *root, "--bind-to", "none", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1", "-np")
