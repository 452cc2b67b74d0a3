"""The command ``calstudy``: parses, calls one function, prints, returns an exit code."""

from __future__ import annotations

import errno
import io
import os
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from calstudy.cli.options import command_line
from calstudy.errors import CalstudyError, SetupError
from calstudy.written import printable


def program() -> int:
    """The program: ``main``, whose work goes on where standard output or error cannot be written."""
    output = open_streams()
    try:
        code = main()
    except SystemExit as end:  # --help, --version and a mistyped option
        code = int(end.code or 0)
    sys.stdout.flush()
    if output.lost is not None:
        why = output.lost.strerror
        print(
            f"calstudy: standard output: {why}; the work is done, but what it shows is lost",
            file=sys.stderr,
        )
    return code or (SetupError.exit_code if output.lost else 0)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code (``calstudy --help`` lists them)."""
    parser = command_line()
    for word in sys.argv[1:] if argv is None else argv:
        if word != word.encode(errors="replace").decode():  # Arrow and JSON could not take it as a path
            parser.error(f"{printable(word)} is not UTF-8; rename the file or directory")
    arguments = parser.parse_args(argv)
    try:
        module, _, function = arguments.command.partition(".")
        # Imported here, so that --help and a mistyped option do not wait for scipy and matplotlib.
        command = getattr(import_module(f"calstudy.cli.{module}"), function)
        return int(command(arguments) or 0)
    except CalstudyError as error:
        if arguments.debug:
            traceback.print_exc()
        print(f"calstudy: {printable(str(error))}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("calstudy: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        if arguments.debug:
            traceback.print_exc()
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            print("calstudy: the disk is full; free space and run the same command again", file=sys.stderr)
            return SetupError.exit_code
        place = f"{type(error).__name__}: {error}"
        print(f"calstudy: unforeseen error: {place}; run again with --debug and report it", file=sys.stderr)
        return 1


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
