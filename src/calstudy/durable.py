"""Files that outlive a power cut: whole or not there, and lines that are appended once and for all."""

from __future__ import annotations

import os
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
    """Append a line that ends with a newline; on disk when this returns. The file is made if need be."""
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


def force_names(directory: Path) -> None:
    """Make the names of new and moved files in a directory outlive a power cut."""
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
