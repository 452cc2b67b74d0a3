"""Printing to the terminal, and stopping on signals, for all commands."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from calstudy.written import printable

UNLIMITED = 100_000
"""Characters in a line of a file or a pipe."""


@contextmanager
def stop_on_signals(console: Console) -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set; a second one ends the program at once."""
    stop = threading.Event()
    signals = itertools.count()  # the event alone does not tell: work that ends by itself sets it, too

    def handle(number: int, _: object) -> None:
        if next(signals):
            os._exit(130)
        stop.set()
        console.print("stopping; what is finished is kept (again: stop at once)", highlight=False)

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def messages_console() -> Console:
    """Standard error: what is going on."""
    return _console(sys.stderr.isatty(), stderr=True)


def say(console: Console, message: str) -> None:
    """Print a message on one line, however long; warnings stand out."""
    style = "bold yellow" if message.startswith("WARNING") else None
    console.print(message, style=style, highlight=False, soft_wrap=True)


def print_paths(out: Console, heading: str, paths: Sequence[Path | str]) -> None:
    """Print paths, or a command, under a heading; nothing if there are none."""
    for line in [heading, *(f"  {path}" for path in paths)] if paths else []:
        out.print(line, highlight=False, soft_wrap=True)


def results_console() -> Console:
    """Standard output; where it is not a terminal, lines and tables are as wide as they are."""
    return _console(sys.stdout.isatty()) if sys.stdout.isatty() else _console(False, width=UNLIMITED)


def _console(is_terminal: bool, **settings: Any) -> Console:
    """Brackets and colons are what they are, paths among them; a file or a pipe gets no colours."""
    return _Console(force_terminal=is_terminal, markup=False, emoji=False, **settings)


class _Console(Console):
    """What is printed comes from files and programs, too: their control characters are shown, not obeyed."""

    def render_str(self, text: str, **settings: Any) -> Text:
        return super().render_str(printable(text), **settings)


def print_json(value: Any) -> None:
    """Print a result as JSON; what is not finite is null."""
    print(json.dumps(_plain(value), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    """JSON's types: NaN is null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if hasattr(value, "item"):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
