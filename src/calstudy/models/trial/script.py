"""What an input script says of its parameters, read without running it.

LIGGGHTS and LAMMPS share the language: one command a line, ``&`` at its end goes on, ``#`` begins a
comment, ``include`` reads another script, ``${NAME}`` and ``v_NAME`` use a variable. Scripts can branch, so
what is read here is the order in which the lines stand; what a loop or a jump makes of them is the trial
run's to show.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

SETTABLE = "index"
"""The one style of a script's own variable that a command line takes the place of."""
PLACEHOLDER = re.compile(r"\{\{\s*(\w+)\s*\}\}|\{%")
_COMMENT = re.compile(r"""("[^"]*"|'[^']*')|#.*""")


@dataclass(frozen=True, slots=True)
class Command:
    """A command of a script: the file and the line that it begins in, and its words."""

    file: str
    line: int
    words: tuple[str, ...]

    @property
    def place(self) -> str:
        """Where it stands, as messages say it."""
        return f"{self.file}, line {self.line}"


@dataclass(frozen=True, slots=True)
class Script:
    """What a run reads: the folder's files, the first of them, and how parameters reach it."""

    name: str
    files: Mapping[str, bytes]
    include: str | None
    """File at whose end parameters are set; None where the command line sets them."""
    names: tuple[str, ...]
    """Parameters and seeds."""
    has_end: bool
    """Whether the log must say a mark of the end."""
    is_lammps: bool = True
    """Whether it is in the language of LAMMPS; of another one only the names are looked for."""

    @property
    def commands(self) -> list[Command]:
        """Commands in the order in which their lines stand, included files in their place."""
        return list(_walk(self.name, self.files, ()))


@dataclass(frozen=True, slots=True)
class Objection:
    """Why a script cannot work."""

    about: str
    """Key of model.toml, or name of a variable."""
    text: str
    """What is wrong, where, and the remedy."""


def objections(script: Script) -> list[Objection]:
    """What cannot work; empty where nothing speaks against a run."""
    if not script.is_lammps:
        return list(_unmentioned(script))
    commands = script.commands
    return [found for check in CHECKS for found in check(script, commands)]


def _walk(name: str, files: Mapping[str, bytes], above: tuple[str, ...]) -> Iterator[Command]:
    """Commands of a file and of those that it includes; one that includes itself is not followed."""
    for command in commands_of(name, files.get(name, b"").decode(errors="replace")):
        yield command
        included = _included(command)
        if included in files and included not in (*above, name):
            yield from _walk(included, files, (*above, name))


def commands_of(file: str, text: str) -> Iterator[Command]:
    """Commands of a script's text: without comments, lines that end with & joined."""
    words: list[str] = []
    begin = 0
    for number, line in enumerate(text.splitlines(), start=1):
        bare = _COMMENT.sub(lambda found: found[1] or "", line).strip()
        begin = begin if words else number
        words += bare.removesuffix("&").split()
        if words and not bare.endswith("&"):
            yield Command(file, begin, tuple(words))
            words = []
    if words:
        yield Command(file, begin, tuple(words))


def _in_folder(name: str) -> str:
    return posixpath.normpath(name.strip("\"'"))


def _included(command: Command) -> str:
    """File that the command includes; empty for any other command."""
    return _in_folder(command.words[1]) if command.words[0] == "include" and command.words[1:] else ""


def _uses(command: Command, name: str) -> bool:
    """Whether a command takes the value of a variable."""
    said = " ".join(command.words)
    short = rf"|\${name}" if len(name) == 1 else ""
    return re.search(rf"\$\{{{name}\}}|\bv_{name}\b{short}", said) is not None


def _defines(command: Command, name: str) -> bool:
    return command.words[:2] == ("variable", name) and command.words[2:3] not in ((), ("delete",))


# ---- checks ---------------------------------------------------------------------------------------


def _placeholders(script: Script, commands: Sequence[Command]) -> Iterator[Objection]:
    for command in commands:
        if found := PLACEHOLDER.search(" ".join(command.words)):
            name = found[1] or "NAME"
            yield Objection(
                "script",
                f"{command.place}: {found[0]} is a template's placeholder, which nobody fills; write "
                f"${{{name}}}, or name the file with template = ['{command.file}'] in model.toml",
            )
            return


def _other_include(script: Script, commands: Sequence[Command]) -> Iterator[Objection]:
    """A file of the parameters' name that lies elsewhere, or is never included."""
    if script.include is None:
        return
    place, there = _in_folder(script.include), [c for c in commands if _included(c)]
    names = [_included(command) for command in there]
    if place in names or any("$" in name for name in names):
        return
    base = posixpath.basename(place)
    for command, name in zip(there, names, strict=True):
        if posixpath.basename(name) == base:
            yield Objection(
                "include",
                f"{command.place}: includes {name}, while the parameters are written into the run's own "
                f"{script.include}; write 'include {script.include}'",
            )
            return
    yield Objection(
        "include",
        f"{script.name} never includes {script.include}; write 'include {script.include}' at its beginning",
    )


def _redefined(script: Script, commands: Sequence[Command]) -> Iterator[Objection]:
    """A variable that the script sets itself, so that the parameter's value is refused or lost."""
    for name in script.names:
        own = [command for command in commands if _defines(command, name)]
        if script.include is None:
            fixed = [command for command in own if command.words[2] != SETTABLE]
            for command in fixed[:1]:
                value = " ".join(command.words[3:])
                yield Objection(
                    name,
                    f"{command.place}: sets {name} as a variable of style {command.words[2]}, which the "
                    f"command line cannot; write 'variable {name} {SETTABLE} {value}'",
                )
            continue
        place = _in_folder(script.include)
        last = max((k for k, c in enumerate(commands) if _included(c) == place), default=len(commands))
        after = (c for c in commands[last:] if c.file != place and _defines(c, name))
        for command in [c for c in after if c.words[2] != SETTABLE][:1]:
            yield Objection(
                name,
                f"{command.place}: sets {name} again after {script.include}, so the parameter's value is "
                "lost; remove the line",
            )


def _unused(script: Script, commands: Sequence[Command]) -> Iterator[Objection]:
    """A parameter that stands in comments and definitions alone."""
    if any(c.words[0] in ("include", "jump") and "$" in " ".join(c.words[1:]) for c in commands):
        return
    read = {command.file for command in commands}
    others = [content for file, content in script.files.items() if file not in read]
    for name in script.names:
        if any(_uses(command, name) for command in commands):
            continue
        if not _mentioned(name, others):
            yield Objection(
                name,
                f"{script.name} never uses {name}: it has neither ${{{name}}} nor v_{name} outside comments, "
                "so the parameter would change nothing; use it, or correct the name",
            )


def _mentioned(name: str, contents: Iterable[bytes]) -> bool:
    """Whether a file has the name as a word, or as v_NAME."""
    word = re.compile(rf"(?<![A-Za-z0-9_])(v_)?{name}(?![A-Za-z0-9_])".encode())
    return any(word.search(content) for content in contents)


def _unmentioned(script: Script) -> Iterator[Objection]:
    for name in script.names:
        if not _mentioned(name, script.files.values()):
            yield Objection(
                name,
                f"no file of the folder mentions {name}, so it would change nothing; correct the name",
            )


def _quits(script: Script, commands: Sequence[Command]) -> Iterator[Objection]:
    """LIGGGHTS's quit ends it with exit code 1, so that only a mark can tell a run from a failure."""
    if script.has_end:
        return
    for command in commands:
        if "quit" in command.words:
            yield Objection(
                "script",
                f"{command.place}: LIGGGHTS ends 'quit' with exit code 1, as it ends a failure; remove it, "
                "or print a text before it and name that text as 'finished' in model.toml",
            )
            return


Check = Callable[[Script, Sequence[Command]], Iterator[Objection]]
CHECKS: tuple[Check, ...] = (_placeholders, _other_include, _redefined, _unused, _quits)
"""What is looked for, in the order in which it is told."""
