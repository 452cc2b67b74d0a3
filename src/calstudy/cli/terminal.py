"""Printing to the terminal, and stopping on signals, for all commands."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console
from rich.text import Text

from calstudy.engines.guardian import ending
from calstudy.written import printable

LAST_SECONDS = 9.0
"""Seconds from a signal to the end of the program, at most."""
UNLIMITED = 100_000
"""Characters in a line of a file or a pipe."""


@contextmanager
def stop_on_signals(console: Console) -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set. A second one ends the program at once, and so does time.

    What has finished is on disk at any moment. So a computation that does not end is not waited for. Where
    Python itself cannot act any more, its guardian ends it by SIGKILL.
    """
    stop, over = threading.Event(), threading.Event()
    signals = itertools.count()  # the event alone does not tell: work that ends by itself sets it, too

    def handle(number: int, _: object) -> None:
        if next(signals):
            os._exit(130)
        stop.set()
        threading.Thread(target=end_late, name="end", daemon=True).start()
        console.print("stopping; what is finished is kept (again: stop at once)", highlight=False)

    def end_late() -> None:
        if not over.wait(LAST_SECONDS):
            leave(130, "something did not stop, and is not waited for; what is finished is kept")

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, handle) for number in numbers}
    try:
        with ending():
            yield stop
    finally:
        over.set()
        for number, handler in before.items():
            signal.signal(number, handler)


def leave(code: int, why: str) -> NoReturn:
    """End the program at once, whatever its threads do."""
    with suppress(Exception):
        print(f"calstudy: {why}", file=sys.stderr, flush=True)
        sys.stdout.flush()
    os._exit(code)


def leave_in_the_end(code: int) -> None:
    """End the program with its exit code, should a thread still compute when Python waits for all threads."""

    def wait() -> None:
        time.sleep(LAST_SECONDS / 3)
        leave(code, "a computation did not end, and was not waited for; what is finished is kept")

    threading.Thread(target=wait, name="end", daemon=True).start()


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
