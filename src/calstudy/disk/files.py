"""Files that survive a power cut: a file is there whole or not at all, and appended lines stay."""

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
    """Write a file beside ``path``, force it to disk, and rename it. Its leading dot hides it until then."""
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
    """Append lines that end with a newline. They are on disk when this returns.

    The file is created if it does not exist.
    """
    with path.open("a+b") as file:
        is_new = not file.tell()
        if not is_new:
            file.seek(-1, os.SEEK_END)
            # A line that a crash or a full disk cut short must not run into this one.
            if file.read(1) != b"\n":
                line = b"\n" + line
        file.write(line)
        file.flush()
        os.fsync(file.fileno())
    if is_new:
        force_names(path.parent)


class Journal:
    """A file to which many threads append lines. A line is on disk when its `append` returns.

    Forcing a file to disk takes milliseconds, however much was written. Lines that arrive meanwhile wait.
    Then the thread of the first one writes them all and forces them to disk once.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._guard = threading.Lock()
        self._busy = False
        self._waiting: list[tuple[bytes, Future[bool]]] = []
        """Lines, each with an answer: False once it is written, True if its thread must write all of them."""

    def append(self, line: bytes) -> None:
        """Append a line that ends with a newline. OSError: a line cannot be written."""
        mine: Future[bool] = Future()
        with self._guard:
            self._waiting.append((line, mine))
            writes, self._busy = not self._busy, True
        if writes or mine.result():
            self._write(mine)

    def _write(self, mine: Future[bool]) -> None:
        """Write all waiting lines, tell their threads, and leave the next lines to one of their threads."""
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
    """Make the names of new and renamed files in a directory survive a power cut."""
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
    """Error for a file that cannot be written."""
    return SetupError(f"{path}: cannot be written: {error.strerror}; free space and run it again")


def cannot_use(directory: Path, option: str, error: OSError) -> SetupError:
    """Error for a directory that cannot be used; ``option`` chooses another."""
    full = error.errno in (errno.ENOSPC, errno.EDQUOT)
    remedy = "free space and run it again" if full else f"choose another {option} directory"
    return SetupError(f"{directory}: {error.strerror}; {remedy}")
