"""Files that survive a power cut: a file is there whole or not at all, and appended lines stay."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import stat
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, BinaryIO

from calstudy.disk.ours import opened, refuse_link
from calstudy.errors import SetupError, StoreError

_NEW = os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC
_APPEND = os.O_CREAT | os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC


def write_atomically(path: Path, content: bytes, below: Path | None = None) -> None:
    """Write a file beside ``path``, force it to disk, and rename it. Its leading dot hides it until then.

    ``below`` as in ``ours.opened``. Without it the user named the file: a link leads to what is written, and
    a device or a pipe is written as it is. StoreError: there is a link where none is followed.
    """
    if below is None:
        if path.exists() and not path.is_file() and not path.is_dir():
            path.write_bytes(content)
            return
        path = Path(os.path.realpath(path))
    with opened(path.parent, below) as place:
        refuse_link(path, place)
        part = f".{path.name}.part"
        try:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(part, dir_fd=place)  # of a killed process
            with os.fdopen(os.open(part, _NEW, 0o666, dir_fd=place), "wb") as handle:
                handle.write(content)
                handle.flush()
                os.fsync(handle.fileno())
            os.rename(part, path.name, src_dir_fd=place, dst_dir_fd=place)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(part, dir_fd=place)
            raise
        os.fsync(place)  # so that the name survives a power cut


def write_new(path: Path, content: bytes, below: Path | None = None) -> None:
    """Write a file that does not exist yet, and force it to disk; FileExistsError if it does."""
    with opened(path.parent, below) as place:
        with os.fdopen(os.open(path.name, _NEW, 0o666, dir_fd=place), "wb") as file:
            try:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                os.unlink(path.name, dir_fd=place)
                raise
        os.fsync(place)


def require_writable(path: Path) -> None:
    """Raise OSError where a file that the user named cannot be written; nothing is changed."""
    if path.exists():
        path.open("ab").close()
        return
    with opened(path.parent) as place:
        probe = f".{path.name}.part"
        os.close(os.open(probe, os.O_CREAT | os.O_WRONLY | os.O_NOFOLLOW, 0o666, dir_fd=place))
        os.unlink(probe, dir_fd=place)


def open_to_append(path: Path, below: Path | None = None) -> BinaryIO:
    """Open a file to append to it, and to read; it is created if need be. StoreError: it is a link."""
    with opened(path.parent, below) as place:
        refuse_link(path, place)
        handle = os.open(path.name, _APPEND, 0o666, dir_fd=place)
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            os.close(handle)
            raise StoreError(f"{path} is not a regular file; remove it")
        return os.fdopen(handle, "a+b")


def append_line(path: Path, line: bytes, below: Path | None = None) -> None:
    """Append lines that end with a newline. They are on disk when this returns.

    The file is created if it does not exist.
    """
    with open_to_append(path, below) as file:
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

    def __init__(self, path: Path, below: Path | None = None) -> None:
        self.path, self.below = path, below
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
            append_line(self.path, b"".join(line for line, _ in together), self.below)
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


def open_to_read(path: Path) -> BinaryIO:
    """Open a regular file. StoreError: it is another kind of file, which might never end."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe would be waited for
    kind = os.fstat(handle).st_mode
    if stat.S_ISREG(kind):
        return os.fdopen(handle, "rb")
    os.close(handle)
    if stat.S_ISDIR(kind):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise StoreError(f"{path} is not a regular file; remove it, or restore it")


def content_of(path: Path, most: float) -> bytes:
    """Content of a regular file. StoreError: it is another kind of file, or larger than ``most`` bytes."""
    with open_to_read(path) as file:
        if os.fstat(file.fileno()).st_size > most:
            raise StoreError(f"{path} is larger than {most / 1e6:g} MB; restore it")
        return file.read()


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
