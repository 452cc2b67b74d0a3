"""Files that outlive a power cut: whole or not there, and lines that are appended once and for all."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from calstudy.errors import SetupError


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

    Forcing a file to disk takes milliseconds, however much was written. Lines that come meanwhile wait; then
    the first of their threads writes them all and forces them to disk once.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._guard = threading.Lock()
        self._busy = False
        self._waiting: list[tuple[bytes, Future[bool]]] = []
        """Lines, each with an answer: False when it is written, True where its thread is to write all."""

    def append(self, line: bytes) -> None:
        """Append a line that ends with a newline; OSError where it, or one written with it, cannot be."""
        mine: Future[bool] = Future()
        with self._guard:
            self._waiting.append((line, mine))
            writes, self._busy = not self._busy, True
        if writes or mine.result():
            self._write(mine)

    def _write(self, mine: Future[bool]) -> None:
        """Write all lines that wait, tell their threads, and leave the next ones to the first of theirs."""
        with self._guard:
            together, self._waiting = self._waiting, []
        others = [answer for _, answer in together if answer is not mine]
        try:
            append_line(self.path, b"".join(line for line, _ in together))
        except BaseException as error:
            for answer in others:
                answer.set_exception(error)
            raise
        else:
            for answer in others:
                answer.set_result(False)
        finally:
            with self._guard:
                following = self._waiting[0][1] if self._waiting else None
                self._busy = following is not None
            if following is not None:
                following.set_result(True)


def force_names(directory: Path) -> None:
    """Make the names of new and moved files in a directory outlive a power cut."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def content_hash(content: Mapping[str, Any]) -> str:
    """Hexadecimal SHA-256 of a mapping of strings, numbers, lists and mappings.

    Numbers must already have their declared type: 1 and 1.0 are different content.
    """
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def cannot_write(path: Path, error: OSError) -> SetupError:
    """Error of a file that cannot be written."""
    return SetupError(f"{path}: cannot be written: {error.strerror}; free space and run it again")


def cannot_use(directory: Path, option: str, error: OSError) -> SetupError:
    """Error of a directory that cannot be worked in; ``option`` names another."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    remedy = "free space and run it again" if full else f"choose another {option} directory"
    return SetupError(f"{directory}: {error.strerror}; {remedy}")
