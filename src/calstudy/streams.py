"""Standard output and error that end neither the work nor its exit code when they cannot be written."""

from __future__ import annotations

import errno
import io
import os
import sys
from typing import Any


class Stream(io.FileIO):
    """Standard output or error; from the first write that fails on, it leads to the null device.

    A reader may have gone (head, tee), the disk behind a file may be full. Neither ends the work, and Python
    must not fail once more on what is still buffered while it exits. ``lost`` is the error, unless a reader
    had seen enough.
    """

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self.lost: OSError | None = None

    def write(self, data: Any) -> int:
        """Write, or drop what cannot be written; returns the number of bytes."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno != errno.EPIPE:
                self.lost = error
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return memoryview(data).nbytes


def open_streams() -> Stream:
    """Standard output and error that the program can always write to; returns what is below standard output.

    Both are line by line, to wherever they lead, and show a character that the encoding lacks by its code.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:  # closed by who started us; the next file that is opened must not take its place
            os.open(os.devnull, os.O_RDWR)
    output, errors = (Stream(descriptor) for descriptor in (1, 2))
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(
            io.BufferedWriter(raw),
            encoding=getattr(before, "encoding", None),
            errors="backslashreplace",
            line_buffering=True,
        )
        for raw, before in ((output, sys.stdout), (errors, sys.stderr))
    )
    return output
