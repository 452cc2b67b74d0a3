"""A TOML file written by a user: typed values, and errors with the line and the remedy."""

from __future__ import annotations

import itertools
import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints

from calstudy.errors import InputError
from calstudy.written import DECIMAL_COMMA, choice, shortened, text_of

KINDS: Mapping[str, tuple[type, ...]] = {
    "text": (str,),
    "number": (int, float),
    "whole number": (int,),
    "section": (dict,),
    "list": (list,),
}
_HEADER = re.compile(r"\s*\[(\[?)([^\[\]]+)\]\]?\s*(#.*)?$")
_KEY = re.compile(r"\s*((?:[A-Za-z0-9_-]+|\"[^\"]*\")(?:\s*\.\s*(?:[A-Za-z0-9_-]+|\"[^\"]*\"))*)\s*=")
_COMMA = re.compile(r"=\s*" + DECIMAL_COMMA.pattern)
_PART = re.compile(r"\"([^\"]*)\"|([A-Za-z0-9_-]+)")

_TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*|[\[{]|[\]}]|[.=,\n]'
    r"|[^\s\"'#\[\]{}.=,]+",
    re.DOTALL,
)
LARGEST = 1_000_000
"""Bytes of a file."""
DEEPEST, MOST_PARTS, LONGEST_WORD = 50, 50, 300
"""Brackets in brackets, parts of a key, and characters of a number or a bare name, at most."""

Keys = tuple[str | int, ...]


@dataclass(frozen=True)
class Section:
    """A table of the file, with the keys that lead to it."""

    path: Path
    data: Mapping[str, Any]
    lines: Mapping[Keys, int]
    """Line number of each key, from 1."""
    keys: Keys = ()

    def __contains__(self, name: str) -> bool:
        return name in self.data

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)

    def wrong(self, what: str, *keys: str | int) -> InputError:
        """Error on one of the section's keys, or on the section itself."""
        place = (*self.keys, *keys)
        while place and place not in self.lines:
            place = place[:-1]
        line = f", line {self.lines[place]}" if place else ""
        error = InputError(f"{self.path}{line}: {what}")
        error.keys, error.what = (*self.keys, *keys), what
        return error

    def only(self, *known: str) -> None:
        """Raise InputError if a key is not one of those known here."""
        for name in self.data:
            if name not in known:
                raise self.wrong(f"key {name} is unknown; {choice(name, known, 'known here:')}", name)

    def get(self, name: str, kind: str) -> Any:
        """Value of a required key. Numbers must be finite; they are floats unless they must be whole."""
        if name not in self.data:
            where = f"[{'.'.join(str(key) for key in self.keys)}]" if self.keys else "the file"
            raise self.wrong(f"{where} lacks {name}; add it, as a {kind}")
        return self.typed(self.data[name], kind, name)

    def typed(self, value: Any, kind: str, *keys: str | int) -> Any:
        """A value of the section. InputError: it is not of the kind."""
        if isinstance(value, bool) or not isinstance(value, KINDS[kind]):
            raise self.wrong(f"{'.'.join(map(str, keys))} is {value!r}; give a {kind}", *keys)
        if kind == "number" and isinstance(value, int | float):
            if not math.isfinite(value):
                raise self.wrong(f"{'.'.join(map(str, keys))} is {value}; give a finite number", *keys)
            return float(value)
        return value

    def section(self, name: str) -> Section:
        """A section below this one; empty if it does not exist."""
        data = self.get(name, "section") if name in self.data else {}
        return Section(self.path, data, self.lines, (*self.keys, name))

    def sections(self, name: str) -> list[Section]:
        """All sections with a name in double brackets."""
        found = self.data.get(name, [])
        if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
            raise self.wrong(f"{name} is not a list of sections; write [[{name}]]", name)
        return [Section(self.path, one, self.lines, (*self.keys, name, k)) for k, one in enumerate(found)]


def read_toml(path: Path, text: str | None = None) -> Section:
    """Read a file, or a ``text`` in its place. InputError: it cannot be read, or is not TOML."""
    text = text_of(path, LARGEST) if text is None else text
    _require_simple(path, text)
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"(.*) \(at line (\d+), column \d+\)", str(error))
        what, line = (found[1], f", line {found[2]}") if found else (str(error), "")
        comma = _COMMA.search(text.splitlines()[int(found[2]) - 1]) if found else None
        remedy = f"write {comma[1]}.{comma[2]} with a decimal point" if comma else "correct the line"
        raise InputError(f"{path}{line}: is not TOML ({what}); {remedy}") from error
    return Section(path, data, key_lines(text))


def _require_simple(path: Path, text: str) -> None:
    """Raise InputError for what takes a parser of TOML minutes, or more memory or stack than there is."""
    depth = parts = 0
    line = 1
    for token in _TOKEN.finditer(text):
        word = token[0]
        if word in ("[", "{"):
            depth += 1
        elif word in ("]", "}"):
            depth -= 1
        if word == ".":
            parts += 1
        elif word in ("=", ",", "\n", "[", "{"):
            parts = 0
        bare = word[0] not in "\"'#"
        for much, most, what in (
            (depth, DEEPEST, f"has more than {DEEPEST} brackets in each other"),
            (parts, MOST_PARTS, f"has a key of more than {MOST_PARTS} parts"),
            (len(word) if bare else 0, LONGEST_WORD, f"has a number or name of {len(word)} characters"),
        ):
            if much > most:
                raise InputError(f"{path}, line {line}: {what}; write it more simply")
        line += word.count("\n")


def key_lines(text: str) -> dict[Keys, int]:
    """Line number of each key and header. Keys within a value have the line where the value begins."""
    lines: dict[Keys, int] = {}
    here: Keys = ()
    counts: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            name = tuple(quoted or bare for quoted, bare in _PART.findall(header[2]))
            if header[1]:
                joined = ".".join(name)
                counts[joined] = counts.get(joined, -1) + 1
                here = (*name, counts[joined])
            elif name[0] in counts:  # [models.fixed] belongs to the last of [[models]]
                here = (name[0], counts[name[0]], *name[1:])
            else:
                here = name
            lines.setdefault(here[:1], number)
            lines.setdefault(here, number)
        elif key := _KEY.match(line):
            name = tuple(quoted or bare for quoted, bare in _PART.findall(key[1]))
            lines.setdefault((*here, *name), number)
    return lines


def with_value(text: str, keys: Keys, value: str | None) -> str:
    """The text of a file with another value, in TOML, at ``keys``; without the key for None.

    Everything else stays, comments too. A key that is not there yet follows the last one of its section,
    which is added if it is not there. InputError where a section stands in its place.
    """
    places = key_lines(text)
    begins = [0, *itertools.accumulate(map(len, text.splitlines(keepends=True)))]
    *section, name = keys

    def span(line: int) -> tuple[int, int] | None:
        """Begin and end of the value of the key on a line; None on the line of a section."""
        key = _KEY.match(text, begins[line - 1])
        return key and (key.end(), key.end() + _length(text[key.end() :]))

    if keys in places:
        at = span(places[keys])
        if at is None:
            raise InputError(f"{'.'.join(map(str, keys))} is a section; change it in the file itself")
        if value is not None:
            return f"{text[: at[0]]} {value}{text[at[1] :]}"
        return text[: begins[places[keys] - 1]] + text[at[1] :].partition("\n")[2]
    if value is None:
        return text
    siblings = [line for other, line in places.items() if [*other[:-1]] == section]
    ends = [at[1] for at in map(span, siblings) if at is not None]
    if not ends and tuple(section) in places:
        ends = [begins[places[tuple(section)] - 1]]
    elif not ends and section:
        text = f"{text}\n[{'.'.join(key for key in section if isinstance(key, str))}]\n"
        ends = [len(text)]
    before, after = text[: max(ends, default=0)], text[max(ends, default=0) :]
    rest, newline, after = after.partition("\n") if ends else ("", "", after)
    before += rest + (newline or "\n" * bool(before and not before.endswith("\n")))
    return f"{before}{name} = {value}\n{after}"


def toml_of(value: Any) -> str:
    """A value as it is written in a TOML file, on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key_of(key)} = {toml_of(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_of, value))}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


def _key_of(name: str) -> str:
    return name if re.fullmatch("[A-Za-z0-9_-]+", name) else toml_of(name)


def _length(text: str) -> int:
    """Length of the value that a text begins with, without the comment or line end behind it."""
    depth = end = 0
    for token in _TOKEN.finditer(text):
        word = token[0]
        depth += (word in ("[", "{")) - (word in ("]", "}"))
        if depth <= 0 and (word == "\n" or word[0] == "#"):
            break
        if not word.startswith("#") and word != "\n":
            end = token.end()
    return end


def _build(kind: Any, table: Mapping[str, Any], key: str) -> Any:
    """Make a dataclass from a TOML table. InputError names an unknown or missing key."""
    hints = get_type_hints(kind)
    for name in table:
        if name not in hints:
            raise InputError(f"key {key}{name} is unknown")
    values = {}
    for f in fields(kind):
        if f.name in table:
            values[f.name] = _coerce(table[f.name], hints[f.name], key + f.name)
        elif NoneType in get_args(hints[f.name]):
            values[f.name] = None
        elif f.default is MISSING:
            raise InputError(f"key {key}{f.name} is missing")
    return kind(**values)


def _coerce(value: Any, kind: Any, key: str) -> Any:
    """Convert a TOML value to its declared type. InputError names the key."""
    if is_dataclass(kind) and isinstance(value, dict):
        return _build(kind, value, f"{key}.")
    if get_origin(kind) is Mapping and isinstance(value, dict):
        return {name: _coerce(item, get_args(kind)[1], f"{key}.{name}") for name, item in value.items()}
    if get_origin(kind) is tuple and isinstance(value, list):
        item_kind = get_args(kind)[0]
        return tuple(_coerce(item, item_kind, f"{key}[{k}]") for k, item in enumerate(value))
    if float in (kind, *get_args(kind)):
        if type(value) in (int, float) and math.isfinite(value):
            return float(value)
    elif type(value) is kind:
        return value
    raise InputError(f"key {key}: {shortened(str(value))} has the wrong type")
