"""What people write: text files, numbers and names. If one is wrong, what was probably meant."""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from calstudy.errors import InputError

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,9})?")
_WHOLE = re.compile(r"[+-]?[0-9]{1,4000}")
LIKENESS = 0.65
"""Smallest similarity of a name that was probably meant: run for rnu has 0.67, fast for finest 0.6."""
DECIMAL_COMMA = re.compile(r"([+-]?[0-9]+),([0-9]+(?:[eE][+-]?[0-9]+)?)")


LARGEST_TEXT = 100_000_000
"""Bytes of a text file that is read."""
_CONTROL = re.compile("[\x00-\x08\x0b\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
"""Characters that move a terminal's cursor, end a line elsewhere or turn the direction of writing."""


def text_of(file: Path | Traversable, most: int = LARGEST_TEXT) -> str:
    """Text of a file, without the byte order mark that spreadsheets write.

    InputError: it cannot be read, is larger than ``most`` bytes, is not UTF-8, or holds control characters.
    """
    try:
        with file.open("rb") as source:
            content = source.read(most + 1)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror}); check the name") from error
    if len(content) > most:
        raise InputError(f"{file}: is larger than {most / 1e6:g} MB; check the name")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{file}: is not UTF-8 text; save it as UTF-8") from error
    if found := _CONTROL.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise InputError(f"{file}, line {line}: holds the control character {found[0]!r}; remove it")
    return text


def json_of(content: bytes) -> Any:
    """What JSON text says. ValueError: it is not JSON, nested too deeply, or holds control characters."""
    try:
        found = json.loads(content)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error
    waiting = [found]
    while waiting:
        value = waiting.pop()
        if isinstance(value, dict):
            waiting += [*value, *value.values()]
        elif isinstance(value, list):
            waiting += value
        elif isinstance(value, str) and (control := re.search(r"[\n\r\t]", value) or _CONTROL.search(value)):
            raise ValueError(f"a name or text holds the control character {control[0]!r}")
    return found


def number_in(text: str) -> float:
    """Number written in a text; blanks around it are allowed.

    InputError: anything else, even if Python accepts it, such as 2_500, nan, inf or digits of other scripts.
    """
    stripped = text.strip()
    if comma := DECIMAL_COMMA.fullmatch(stripped):
        raise InputError(f"{stripped!r} has a decimal comma; write {comma[1]}.{comma[2]}")
    if not _NUMBER.fullmatch(stripped):
        raise InputError(f"{shortened(stripped)} is not a finite number; write it like 0.3 or 5.06e8")
    if not math.isfinite(number := float(stripped)):
        raise InputError(f"{shortened(stripped)} is too large; give a finite number")
    return number


def whole_number_in(text: str) -> int:
    """Whole number written in a text. InputError: anything else, as in `number_in`."""
    if not _WHOLE.fullmatch(text.strip()):
        raise InputError(f"{shortened(text.strip())} is not a whole number")
    return int(text)


def choice(name: str, known: Iterable[str], there_are: str = "choose one of") -> str:
    """Remedy for an unknown name: the known name that resembles it, or all known names."""
    by_lower = {one.lower(): one for one in known}
    near = get_close_matches(name.lower(), by_lower, 1, LIKENESS)
    return f"did you mean {by_lower[near[0]]}?" if near else f"{there_are} {', '.join(by_lower.values())}"


def printable(text: str) -> str:
    """The text with control characters as their codes, such as \\x1b, except new lines and tabs."""
    return _CONTROL.sub(lambda found: ascii(found[0])[1:-1], text).replace("\r", "\\r").replace("\f", "\\x0c")


def shortened(text: str) -> str:
    """Quote a user's text on one line, cut after 40 characters."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def html_table(caption: str, headings: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A small table as HTML with all text escaped, which a notebook shows for a result."""
    head = "".join(f"<th>{html.escape(text)}</th>" for text in headings)
    body = "".join(f"<tr>{''.join(f'<td>{html.escape(text)}</td>' for text in line)}</tr>" for line in lines)
    top = f"<thead><tr>{head}</tr></thead>" if head else ""
    return f"<table><caption>{html.escape(caption)}</caption>{top}<tbody>{body}</tbody></table>"


def is_missing(value: object) -> bool:
    """Whether a cell of a table has no value: None, or NaN."""
    return value is None or (isinstance(value, float) and math.isnan(value))
