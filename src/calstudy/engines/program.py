"""An external program as data: how it is found, asked for its version and called, and what it leaves.

A ``Profile`` says what a program is, wherever it is installed; a ``Program`` is one that was found and
answers. Neither knows the models that are run.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from calstudy.errors import SetupError

ANSWER_SECONDS = 60.0


@dataclass(frozen=True, slots=True)
class Profile:
    """What a program is."""

    name: str
    """As messages and the engine's identity have it."""
    command: str
    """How it is called where nobody says otherwise."""
    variable: str
    """Environment variable that may hold another command."""
    option: str
    """Option of the command line that may hold another one."""
    how_to_install: str
    banner: re.Pattern[str]
    """What it says when asked for its version, which is the first group."""
    called: str
    """The name by which the banner calls it."""
    call: tuple[str, ...]
    """Arguments of a run; {script} and {log} stand for the names of these files."""
    log: str
    """File that it writes its log into."""
    question: tuple[str, ...] = ("-help",)
    """Arguments at which it prints the banner and ends."""
    output: str = "output.txt"
    """File that takes what it says on the screen."""
    error: str = "ERROR"
    """What a line of its log begins with that tells why it failed."""
    environment: tuple[tuple[str, str], ...] = ()
    """Variables that are set for a run."""
    proven_version: str = ""
    """Version that calstudy is tested with."""

    @property
    def remedy(self) -> str:
        """What to do where it is not there."""
        return f"{self.how_to_install} or point to it with {self.option} PATH or {self.variable}=PATH"

    def find(self, command: str | None = None) -> Program:
        """Find the program: the given command, else the environment variable, else the search path.

        The command may hold arguments (a container, say). Raises SetupError that says how to get it.
        """
        chosen = command or os.environ.get(self.variable) or self.command
        try:
            argv = tuple(shlex.split(chosen))
        except ValueError as error:
            raise SetupError(f"{chosen!r} is no command ({error}); {self.remedy}") from error
        there = shutil.which(argv[0]) if argv else None
        if there is None:
            raise SetupError(f"{self.name} was not found as {chosen!r}; {self.remedy}")
        # Each run has a directory of its own, from which a relative path would lead elsewhere.
        argv = (str(Path(there).absolute()), *argv[1:])
        try:
            # In a directory of its own: LIGGGHTS 3.8.0 writes its log even when it only answers -help.
            with tempfile.TemporaryDirectory(prefix="calstudy-") as directory:
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
    """A program that was found and answers; without a command, one that is only known by its version."""

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

    def command(self, script: str, arguments: Sequence[str] = ()) -> list[str]:
        """Command that runs a script in the current directory."""
        files = {"script": script, "log": self.profile.log}
        return [*self.argv, *(part.format_map(files) for part in self.profile.call), *arguments]
