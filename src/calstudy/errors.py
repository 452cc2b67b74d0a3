"""Errors, named by when they happen; each message says what, where and the remedy in one line."""

from __future__ import annotations


class CalstudyError(Exception):
    """Base of every error that calstudy raises on purpose."""

    exit_code = 1


class InputError(CalstudyError, ValueError):
    """An option, a plan, a target or a parameter value is wrong; found before any work is done."""

    exit_code = 2


class SetupError(CalstudyError, RuntimeError):
    """The machine lacks something: the DEM program, disk space, a directory that can be written."""

    exit_code = 3


class RunError(CalstudyError, RuntimeError):
    """One DEM run failed; the message ends with the last lines of its log."""

    exit_code = 4


class MeasurementError(CalstudyError, ValueError):
    """A picture does not show what Appendix A needs, so nothing can be measured on it."""

    exit_code = 5


class StoreError(CalstudyError, RuntimeError):
    """A study directory is damaged, locked, or not the study that was asked for."""

    exit_code = 6


class NumericsError(CalstudyError, ArithmeticError):
    """Data from which the surrogate or the optimiser cannot compute an answer."""

    exit_code = 7


class OutOfTime(CalstudyError, TimeoutError):
    """The time limit was reached; everything finished is on disk."""

    exit_code = 9


EXIT_CODES = {
    0: "done",
    1: "an error that calstudy did not foresee; please report it with --debug",
    2: "bad input: option, file, plan, target or parameter value; analyse: a plan that is not the study's",
    3: "set-up: LIGGGHTS missing or unusable, directory not writable, disk full",
    4: "a DEM run failed (simulate, twin, doctor)",
    5: "a picture cannot be measured",
    6: "a study directory is damaged, locked, none at all, or belongs to other settings",
    7: "numerics: the data do not allow an answer",
    8: "plan run or calibrate finished, but a calibration failed; the tables say which and why",
    9: "a --time-limit was reached; what is finished is kept, the same command goes on",
    10: "plan rerun: a row came out otherwise than in the study",
    11: "plan run or calibrate finished, but a target was missed: a row's that is out of its reach, which a "
    "warning names; calibrate: a response outside its tolerance, or beyond twice its noise",
    130: "interrupted; everything finished is on disk and the same command goes on",
}
"""Exit codes of the command ``calstudy``."""


class Stopped(CalstudyError):
    """The run was ended on request; it leaves no record."""

    exit_code = 130


FAILED_ROWS = 8
"""Exit code where a calibration failed."""
OTHERWISE = 10
"""Exit code where a row that was run again came out otherwise."""
MISSED = 11
"""Exit code where every calibration is finished, and a target was missed."""
