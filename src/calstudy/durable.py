"""Files that outlive a power cut: whole or not there, and lines that are appended once and for all."""

from __future__ import annotations

import os
import threading
from concurrent.futures import Future
from pathlib import Path


def write_atomically(path: Path, content: bytes) -> None:
    """Write beside the name, force it to disk, move it there; a dot keeps the part out of a table."""
    beside = path.with_name(f".{path.name}.part")
    try:
        with beside.open("wb") as handle:
            handle.write(content)
            handle.flush()
            os.fsync(handle.fileno())
        beside.replace(path)
    finally:
        beside.unlink(missing_ok=True)
    force_names(path.parent)


def append_line(path: Path, line: bytes) -> None:
    """Append a line, or several, each ending with a newline; on disk when this returns.

    The file is made if need be.
    """
    with path.open("a+b") as file:
        is_new = not file.tell()
        if not is_new:
            file.seek(-1, os.SEEK_END)
            # A line that a crash or a full disk cut short must not swallow this one.
            if file.read(1) != b"\n":
                line = b"\n" + line
        file.write(line)
        file.flush()
        os.fsync(file.fileno())
    if is_new:
        force_names(path.parent)


class Journal:
    """A file to which many threads append lines, each durable when its `append` returns.

    Forcing a file to disk takes milliseconds, however much was written. Lines that come meanwhile wait, and
    the next thread whose turn it is writes them all and forces them to disk once.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._guard = threading.Lock()
        self._waiting: list[tuple[bytes, Future[None]]] = []
        self._turn = threading.Lock()

    def append(self, line: bytes) -> None:
        """Append a line that ends with a newline; OSError where it, or one written with it, cannot be."""
        written: Future[None] = Future()
        with self._guard:
            self._waiting.append((line, written))
        with self._turn:
            with self._guard:
                together, self._waiting = self._waiting, []
            if together:  # else another thread has written this line, too
                _settle(self.path, together)
        written.result()


def _settle(path: Path, together: list[tuple[bytes, Future[None]]]) -> None:
    """Append lines at once, and tell whoever waits for each how it went."""
    try:
        append_line(path, b"".join(line for line, _ in together))
    except BaseException as error:
        for _, written in together:
            written.set_exception(error)
    else:
        for _, written in together:
            written.set_result(None)


def force_names(directory: Path) -> None:
    """Make the names of new and moved files in a directory outlive a power cut."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
