"""The command ``calstudy``: parses, calls one function, prints, returns an exit code."""

from __future__ import annotations

import errno
import sys
import traceback
from collections.abc import Sequence
from importlib import import_module

from calstudy.arguments import command_line
from calstudy.errors import CalstudyError, SetupError
from calstudy.streams import open_streams
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
        command = getattr(import_module(f"calstudy.{module}"), function)
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
