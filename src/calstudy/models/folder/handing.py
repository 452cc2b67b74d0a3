"""How parameters reach the script: on the command line, or in a file that the script includes."""

from __future__ import annotations

import json
import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Protocol

from calstudy.engines.interface import Inputs
from calstudy.models.folder.content import PLACEHOLDER, inside
from calstudy.tomlfile import Section
from calstudy.written import choice

LINES = {
    "assign": "{name} = {number}\n",
    "equal": "variable {name} equal {number}\n",
    "index": "variable {name} delete\nvariable {name} index {number}\n",
}
LARGEST_WHOLE = 2**53
"""Whole numbers below it are the same as a number with digits behind the point."""


class Handing(Protocol):
    """A way to hand variables to a script."""

    @property
    def include(self) -> str | None:
        """File at whose end they are set; None if they are set on the command line."""

    @property
    def style(self) -> str:
        """Style of the variables in that file."""

    def inputs(self, script: str, files: Mapping[str, bytes], values: Mapping[str, float | str]) -> Inputs:
        """Script, files and arguments of a run with these values of the variables."""


@dataclass(frozen=True, slots=True)
class CommandLine:
    """``-var NAME VALUE``, which takes the place of a variable of style index."""

    include: None = None
    style: str = "equal"

    def inputs(self, script: str, files: Mapping[str, bytes], values: Mapping[str, float | str]) -> Inputs:
        """The files as they are, and an option for each variable."""
        pairs = [part for name, value in values.items() for part in ("-var", name, _written(value))]
        return Inputs(script, files, tuple(pairs))


@dataclass(frozen=True, slots=True)
class IncludeFile:
    """A line for each variable at the end of a file, of the folder or not there yet."""

    include: str
    style: str = "equal"
    """``equal``, or ``index``, whose digits LIGGGHTS never rounds."""

    def inputs(self, script: str, files: Mapping[str, bytes], values: Mapping[str, float | str]) -> Inputs:
        """The files with the lines in the included one."""
        there = files.get(self.include, b"")
        there += b"" if there.endswith(b"\n") or not there else b"\n"
        # A variable of another style must go first: LIGGGHTS does not change a variable's style.
        text_style = "index" if self.style == "equal" else self.style  # equal takes numbers alone
        lines = "".join(
            LINES[text_style if isinstance(value, str) else self.style].format(
                name=name, number=_written(value)
            )
            for name, value in values.items()
        )
        return Inputs(script, {**files, self.include: there + lines.encode()})


@dataclass(frozen=True, slots=True)
class OwnCommand:
    """Arguments of a program that is not in the language of LAMMPS: one's own, or YADE, which needs none.

    In them {NAME} stands for a variable and {script} for the script. With ``include`` the variables are in a
    file, too: as JSON or CSV by its suffix, else as lines.
    """

    arguments: tuple[str, ...]
    include: str | None = None
    style: str = "assign"

    def inputs(self, script: str, files: Mapping[str, bytes], values: Mapping[str, float | str]) -> Inputs:
        """The files, with that of the variables, and the arguments with their values."""
        written = {name: _written(value) for name, value in values.items()}
        arguments = tuple(_filled(argument, written | {"script": script}) for argument in self.arguments)
        if self.include is None:
            return Inputs(script, files, arguments)
        suffix = PurePosixPath(self.include).suffix
        if suffix == ".json":
            quoted = {n: json.dumps(v) if isinstance(v, str) else written[n] for n, v in values.items()}
            content = "{" + ", ".join(f'"{name}": {value}' for name, value in quoted.items()) + "}\n"
        elif suffix == ".csv":
            content = f"{','.join(written)}\n{','.join(written.values())}\n"
        else:
            there = IncludeFile(self.include, self.style).inputs(script, files, values)
            return Inputs(script, there.files, arguments)
        return Inputs(script, {**files, self.include: content.encode()}, arguments)


def fill(content: bytes, values: Mapping[str, float | str]) -> bytes:
    """A template's file with values in place of the names in double braces."""
    return PLACEHOLDER.sub(lambda found: _written(values[found[1].decode()]).encode(), content)


def _filled(argument: str, values: Mapping[str, str]) -> str:
    """An argument with values in place of the names in braces."""
    return re.sub(r"\{(\w+)\}", lambda found: values.get(found[1], found[0]), argument)


def _written(value: float | str) -> str:
    """All digits of a value; a whole number has no point, since LIGGGHTS takes no 100.0 where it counts."""
    if isinstance(value, str):
        return value
    is_whole = float(value).is_integer() and abs(value) < LARGEST_WHOLE
    return repr(int(value) if is_whole else float(value))


def handing_in(top: Section, script: str, is_lammps: bool = True) -> Handing:
    """What ``include``, ``style`` and ``command`` of model.toml ask for.

    ``is_lammps`` says whether the program's scripts are in the language of LAMMPS. InputError with the line
    for what cannot work.
    """
    include = top.get("include", "text") if "include" in top else None
    if include is not None and not inside(include):
        raise top.wrong(f"include {include} leads out of the folder; name a file in it", "include")
    if include is not None:
        _require_other(top, include, script)
    default = "equal" if is_lammps else "assign"
    style = top.get("style", "text") if "style" in top else default
    if style not in LINES or (include is None and "style" in top):
        raise top.wrong(f"style {style!r} of the lines in an include file: {choice(style, LINES)}", "style")
    if "command" in top:
        return OwnCommand(command_in(top)[1:], include, style)
    if include is None:
        return CommandLine()
    return IncludeFile(include, style) if is_lammps else OwnCommand((), include, style)


def command_in(top: Section) -> tuple[str, ...]:
    """Words of ``command``; InputError for none."""
    words = tuple(top.typed(word, "text", "command", k) for k, word in enumerate(top.get("command", "list")))
    if not words:
        raise top.wrong("command has no words; write ['program', '{script}']", "command")
    return words


def _require_other(top: Section, include: str, script: str) -> None:
    """Refuse an include that would come too late."""
    if posixpath.normpath(include) == posixpath.normpath(script):
        raise top.wrong(
            "include is the script itself, at whose end parameters come too late; name a file that the "
            "script includes at its beginning, or leave include out and set them by the command line",
            "include",
        )
