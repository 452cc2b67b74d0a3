"""The command ``calstudy``: the table of its commands, its parser, and its exit code."""

from __future__ import annotations

import errno
import io
import itertools
import os
import re
import sys
import threading
import traceback
from argparse import ArgumentParser, RawDescriptionHelpFormatter, _SubParsersAction
from collections.abc import Sequence
from importlib import import_module
from typing import Any

from calstudy import __version__
from calstudy.errors import EXIT_CODES, CalstudyError, SetupError
from calstudy.machine import refusal
from calstudy.written import choice, printable

GROUPS = {
    "plan": "the experimental plan, and running it",
    "emulator": "an emulator of the DEM model, made from its runs",
}
"""First words of several commands, with their help."""
COMMANDS = (
    ("plan show", "plan.show.plan_show", "Show rows, intervals, constants, fixed inputs and targets."),
    ("plan export", "plan.show.plan_export", "Write the plan's rows."),
    ("plan check", "plan.show.plan_check", "Check balance, word lengths and samples."),
    (
        "plan run",
        "plan.run.plan_run",
        "Calibrate rows of the plan; the same command continues where it stopped.",
    ),
    (
        "plan rerun",
        "plan.rerun.plan_rerun",
        "Run rows of a study again with its own settings, and compare each DEM run.",
    ),
    ("plan status", "plan.status.plan_status", "Show how far a study has got."),
    ("adopt", "trial.adopt_script", "Make a model folder of an input script, by the smallest change to it."),
    ("try", "trial.try_models", "Run your own models twice before any sample, and show what is read."),
    (
        "reread",
        "reread.reread_runs",
        "Read what the runs of your own models left anew, after a reader or a marker was corrected.",
    ),
    (
        "calibrate",
        "calibrate.calibrate",
        "Calibrate your own material, with your own DEM model if you have one; continues where it stopped.",
    ),
    ("ui", "page.ui.ui", "Calibrate in the browser: photograph, file, runs and result on one page."),
    (
        "advise",
        "advice.advise.advise",
        "Say what each material test would tell about your parameters, before it is made.",
    ),
    ("check", "check.check", "Run a material card again, and say whether it holds on this machine."),
    (
        "analyse",
        "analyse.analyse",
        "Regenerate the paper's tables and figures from a study, beside the published values.",
    ),
    ("simulate", "model.simulate", "Run the DEM model with one or more seeds."),
    ("twin", "model.twin", "Make a twin target: mean responses at known parameters."),
    (
        "sweep",
        "sweep.sweep",
        "Run the DEM model at listed points; the same command continues where it stopped.",
    ),
    (
        "emulator sample",
        "emulator.sample",
        "Run the design that an emulator is fitted to; the same command continues where it stopped.",
    ),
    (
        "emulator similarity",
        "emulator.similarity",
        "Check that the parameters of a model's ratio, such as YM/DENS, act through it alone.",
    ),
    ("emulator fit", "emulator.fit", "Fit an emulator to runs."),
    ("emulator validate", "emulator.validate", "Compare an emulator with runs that it was not fitted to."),
    (
        "benchmark",
        "benchmark.benchmark",
        "Compare calibrators, yours among them, on emulated DEM models; continues where it stopped.",
    ),
    (
        "measure",
        "measure.measure",
        "Measure a heap: on photographs from the side, or on two silhouettes (Appendix A).",
    ),
    (
        "doctor",
        "model.doctor",
        "Show which engines were found, and test the first DEM program for some seconds.",
    ),
)
"""The commands in the order of the help: words, ``module.function`` in calstudy.cli, and help."""


class Parser(ArgumentParser):
    """Reports a wrong command line in one line; options cannot be abbreviated."""

    verbs: _SubParsersAction[Parser] | None = None
    command: str = ""
    """``module.function`` in calstudy.cli; ``function_options`` in calstudy.cli.options.module declares
    its options."""

    def declare(self) -> None:
        """Declare the options of the command, once, without importing what it works with."""
        if self.command and self.get_default("command") is None:
            module, _, function = self.command.rpartition(".")
            room = import_module(f"calstudy.cli.options.{module}")
            getattr(room, f"{function}_options")(self)
            self.set_defaults(command=self.command)

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[no-untyped-def]
        """As argparse does, after unknown options and commands have been reported."""
        self.declare()
        words = list(sys.argv[1:] if args is None else args)
        verb = next((word for word in words if not word.startswith("-")), None) if self.verbs else None
        known = [name for name in self._option_string_actions if name.startswith("--")]
        for word in itertools.takewhile(lambda word: word not in ("--", verb), words):
            option = word.partition("=")[0]
            if re.fullmatch("--[a-z-]+", option) and option not in known:
                self.error(f"there is no option {option}; {choice(option, known, 'there are')}")
        if self.verbs and verb and verb not in self.verbs.choices:
            self.error(f"there is no command {verb!r}; {choice(verb, self.verbs.choices, 'there are')}")
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> None:  # type: ignore[override]
        """End with exit code 2 and one line."""
        self.exit(2, f"{self.prog}: {message} (see '{self.prog} --help')\n")


def command_line() -> Parser:
    """Parser of all commands. Each declares its options when it is used, or by ``declare``."""
    codes = "\n".join(f"  {code:>3}  {meaning}" for code, meaning in EXIT_CODES.items())
    common = Parser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser = Parser(
        prog="calstudy",
        description="Calibrate discrete element models, and study how to calibrate them.",
        epilog=f"exit codes:\n{codes}",
        formatter_class=RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"calstudy {__version__}")
    parser.verbs = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=Parser)
    groups = {"": parser.verbs}
    for words, command, text in COMMANDS:
        group, _, word = words.rpartition(" ")
        if group not in groups:
            to = parser.verbs.add_parser(group, help=GROUPS[group])
            groups[group] = to.verbs = to.add_subparsers(
                required=True, metavar="COMMAND", parser_class=Parser
            )
        verb = groups[group].add_parser(
            word, help=text, description=text, parents=[common], allow_abbrev=False
        )
        verb.command = command
    return parser


def program() -> int:
    """Run ``main``, and carry on if standard output or error cannot be written; returns the exit code."""
    output = open_streams()
    try:
        code = main()
    except SystemExit as end:  # --help, --version and a mistyped option
        code = int(end.code or 0)
    sys.stdout.flush()
    lost = output.lost
    code = code or (SetupError.exit_code if lost else 0)
    if any(not thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread()):
        from calstudy.cli.terminal import leave_in_the_end  # loads what the shortest answers do without

        leave_in_the_end(code)
    if lost is not None:
        why = lost.strerror
        print(
            f"calstudy: standard output: {why}; the work is done, but its output is lost",
            file=sys.stderr,
        )
    return code


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code (``calstudy --help`` lists them)."""
    parser = command_line()
    words = list(sys.argv[1:] if argv is None else argv)
    for word in words:
        if word != word.encode(errors="replace").decode():  # Arrow and JSON could not take it as a path
            parser.error(f"{printable(word)} is not UTF-8; rename the file or directory")
    debug = "--debug" in words  # parsing may fail before we have more
    try:
        if why := refusal():
            raise SetupError(why)
        arguments = parser.parse_args(words)
        module, _, function = arguments.command.rpartition(".")
        command = getattr(import_module(f"calstudy.cli.{module}"), function)
        return int(command(arguments) or 0)
    except CalstudyError as error:
        if debug:
            traceback.print_exc()
        print(f"calstudy: {printable(str(error))}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("calstudy: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        if debug:
            traceback.print_exc()
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            print("calstudy: the disk is full; free space and run the same command again", file=sys.stderr)
            return SetupError.exit_code
        if isinstance(error, MemoryError):
            print(
                "calstudy: memory is short; free some, or ask for fewer --workers, and run the same command "
                "again; what is finished is kept",
                file=sys.stderr,
            )
            return SetupError.exit_code
        place = f"{type(error).__name__}: {error}"
        print(f"calstudy: unexpected error: {place}; run again with --debug and report it", file=sys.stderr)
        return 1


class Stream(io.FileIO):
    """Standard output or error. After the first write that fails it leads to the null device.

    The reader may be gone (head, tee), or the disk full. Neither ends the work, and Python must not fail
    again on buffered output at exit. ``lost`` is the error, unless only the reader was gone.
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
    """Replace standard output and error by streams that can always be written; returns the first of them.

    Both are line-buffered, wherever they lead. A character that the encoding lacks is shown by its code.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:  # closed by our caller; the next file that is opened must not get its number
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
