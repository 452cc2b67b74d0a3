"""A model folder made of an input script: what it sets, what it gives, and the smallest change to its text.

Only what stands in the script is taken. Where it does not tell, a unit say, the model.toml asks in a comment.
"""

from __future__ import annotations

import difflib
import posixpath
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from calstudy.models.trial.script import Command, commands_of

END = "calstudy: finished"
"""What an adopted script prints last."""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
SETTABLE = ("equal", "index")
UNITS: tuple[tuple[str, str], ...] = (
    (r"(?i)dens", "kg/m3"),
    (r"(?i)young|modulus|\bYM\b", "Pa"),
    (r"(?i)fric|mu_?(pp|pw)?$|rest|cor\b|poisson|ratio|roll|rf_", "-"),
    (r"(?i)radius|diam|height|width|depth|length", "m"),
    (r"(?i)angle|repose|aor", "deg"),
    (r"(?i)time", "s"),
    (r"(?i)mass", "kg"),
    (r"(?i)force", "N"),
    (r"(?i)torque", "N m"),
    (r"(?i)stress|pressure", "Pa"),
)
"""Units that a name suggests."""


@dataclass(frozen=True, slots=True)
class Adopted:
    """A script as a model folder."""

    files: Mapping[str, str]
    """Changed scripts and model.toml, by name."""
    changes: str
    """Unified difference of the scripts; empty where nothing had to be changed."""
    questions: tuple[str, ...]
    """What model.toml cannot say without its owner."""


def adopt(script: str, texts: Mapping[str, str]) -> Adopted:
    """Make a model folder of a script and the files that it includes (by name, the script among them)."""
    changed = {name: _adapted(name, text, name == script) for name, text in texts.items()}
    commands = [command for name, text in texts.items() for command in commands_of(name, text)]
    parameters = _parameters(commands)
    seeds = [name for name in parameters if "seed" in name.lower()]
    calibrated = {name: value for name, value in parameters.items() if name not in seeds}
    responses, outputs = _responses(commands)
    toml, questions = _model_toml(script, calibrated, seeds, responses, outputs)
    return Adopted(
        files={name: text for name, text in changed.items() if text != texts[name] or name == script}
        | {"model.toml": toml},
        changes="".join(
            line
            for name, text in texts.items()
            for line in difflib.unified_diff(
                text.splitlines(True), changed[name].splitlines(True), name, f"{name} (adopted)", n=1
            )
        ),
        questions=tuple(questions),
    )


def included(text: str) -> list[str]:
    """Files that a script includes by a name without variables."""
    words = [c.words for c in commands_of("", text) if c.words[0] == "include" and len(c.words) > 1]
    return [word[1].strip("\"'") for word in words if "$" not in word[1]]


def _adapted(name: str, text: str, is_first: bool) -> str:
    """The text with variables that the command line may set, its own folder's includes, and an end."""
    lines = text.splitlines(True)
    changes = {c.line - 1: change for c in commands_of(name, text) if (change := _changed(c)) is not None}
    for k, (old, new) in changes.items():
        lines[k] = lines[k].replace(old, new, 1) if old else ""
    changed = "".join(lines)
    end = "" if changed.endswith("\n") or not changed else "\n"
    return f'{changed}{end}print "{END}"\n' if is_first else changed


def _changed(command: Command) -> tuple[str, str] | None:
    """What is to be replaced in a command's line, and by what; an empty text removes the line."""
    words = command.words
    if words[0] == "quit":
        return "", ""
    if words[0] == "include" and len(words) > 1 and posixpath.isabs(path := words[1].strip("\"'")):
        return path, posixpath.basename(path)
    if words[0] == "variable" and words[2:3] == ("equal",) and NUMBER.fullmatch(" ".join(words[3:])):
        return "equal", "index"
    return None


def _parameters(commands: Sequence[Command]) -> dict[str, str]:
    """Variables that a script sets to a number, with that number."""
    found: dict[str, str] = {}
    for command in commands:
        words = command.words
        if words[0] == "variable" and len(words) == 4 and words[2] in SETTABLE and NUMBER.fullmatch(words[3]):
            found.setdefault(words[1], words[3])
    return found


def _responses(commands: Sequence[Command]) -> tuple[dict[str, str], list[str]]:
    """Texts that a script prints before one number, by the name of a response; and files that it writes."""
    printed: dict[str, str] = {}
    files: list[str] = []
    for command in commands:
        said = " ".join(command.words)
        one = re.match(r"print [\"']([^\"'$]*?)\$\{(\w+)\}[^$]*[\"']", said)
        if one and (marker := one[1].strip()):
            name = re.sub(r"\W+", "_", marker).strip("_").lower() or one[2]
            printed[name if name[0].isalpha() else f"r_{name}"] = marker
        words = command.words
        if words[0] == "dump" and len(words) > 5:
            files.append(words[5])
        elif words[0] == "fix" and "file" in words[:-1]:
            files.append(words[words.index("file") + 1])
    return printed, list(dict.fromkeys(files))


def _unit(name: str) -> str:
    return next((unit for pattern, unit in UNITS if re.search(pattern, name)), "")


def _model_toml(
    script: str,
    parameters: Mapping[str, str],
    seeds: Sequence[str],
    responses: Mapping[str, str],
    outputs: Sequence[str],
) -> tuple[str, list[str]]:
    """Text of the model.toml, and what is left to its owner."""
    questions = []

    def unit(name: str) -> str:
        if known := _unit(name):
            return f'"{known}"'
        questions.append(f"the unit of {name}")
        return '"-"  # ? unit'

    lines = [
        f'script = "{script}"',
        f'finished = "{END}"',
        "expected_seconds = 60  # ? 'calstudy try' shows how long a run takes",
    ]
    if seeds:
        named = ", ".join(f'"{name}"' for name in seeds[:3])
        lines.append(f"seeds = [{named}]")
    lines += ["", "[parameters]  # keep those that are calibrated; the others keep the script's values"]
    lines += [f"{name} = {unit(name)}  # {value} in the script" for name, value in parameters.items()]
    if not parameters:
        questions.append("which numbers are parameters: the script has none as 'variable NAME index NUMBER'")
    for name, marker in responses.items():
        lines += ["", f"[responses.{name}]", f"unit = {unit(name)}", f'log = "{marker}"']
    if not responses:
        questions.append("which result is read: the script prints no number behind a text")
        lines += ["", "# [responses.NAME]", '# unit = "-"', '# log = "NAME ="  # or file, python, silhouette']
    lines += [f"# The script writes {name}." for name in outputs]
    return "\n".join([*lines, ""]), questions
