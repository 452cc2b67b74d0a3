"""Errors, named by when they happen. Each message is one line with what is wrong, where, and the remedy."""

from __future__ import annotations


class CalstudyError(Exception):
    """Base of every error that calstudy raises on purpose."""

    exit_code = 1


class InputError(CalstudyError, ValueError):
    """An option, a plan, a target or a parameter value is wrong. It is found before any work is done."""

    exit_code = 2
    keys: tuple[str | int, ...] = ()
    """Keys that lead to the value in its file; empty where it is no value of a file."""
    what: str = ""
    """What is wrong with it, without its place; empty where ``keys`` is."""


class SetupError(CalstudyError, RuntimeError):
    """The machine lacks something: the DEM program, disk space, a writable directory."""

    exit_code = 3


class RunError(CalstudyError, RuntimeError):
    """A DEM run failed. The message ends with the last lines of its log."""

    exit_code = 4


class MeasurementError(CalstudyError, ValueError):
    """A picture does not show what Appendix A needs, so nothing can be measured on it."""

    exit_code = 5


class StoreError(CalstudyError, RuntimeError):
    """A study directory is damaged, locked, or not the study that was asked for."""

    exit_code = 6


class NumericsError(CalstudyError, ArithmeticError):
    """The surrogate or the optimiser cannot compute an answer from the data."""

    exit_code = 7


class OutOfTime(CalstudyError, TimeoutError):
    """The time limit was reached. Everything finished is on disk."""

    exit_code = 9


EXIT_CODES = {
    0: "done",
    1: "an unexpected error; please run again with --debug and report it",
    2: "bad input: option, file, plan, target or parameter value; analyse: a plan that is not the study's",
    3: "set-up: the DEM program missing or unusable, directory not writable, disk full, Windows without WSL",
    4: "a DEM run failed (simulate, twin, doctor)",
    5: "a picture cannot be measured",
    6: "a study directory is damaged, locked, missing, or has other settings",
    7: "numerics: the data do not allow an answer",
    8: "plan run or calibrate finished, but a calibration failed; the tables say which and why",
    9: "a --time-limit was reached; finished work is kept, and the same command continues",
    10: "plan rerun: a row gave another result than in the study",
    11: "plan run or calibrate finished, but a target was missed: in a plan one that a row cannot reach, as "
    "a warning says; in a calibration by more than its tolerance, or twice its noise",
    12: "check: a material card does not hold here; emulator fit and validate: a response is too steep for "
    "the runs, and its intervals are too narrow",
    13: "check: these runs cannot decide whether a material card holds; emulator fit and validate: too few "
    "runs are repeated to tell noise from a response that is too steep",
    130: "interrupted; finished work is on disk, and the same command continues",
}
"""Exit codes of the command ``calstudy``."""


class Stopped(CalstudyError):
    """A run was ended on request. It leaves no record."""

    exit_code = 130


FAILED_ROWS = 8
"""Exit code if a calibration failed."""
OTHERWISE = 10
"""Exit code if a row that was run again gave another result."""
NOT_HOLDING, NOT_DECIDED = 12, 13
"""Exit codes if a material card, or an emulator's intervals, do not hold, and if it cannot be decided."""
MISSED = 11
"""Exit code if all calibrations finished and a target was missed."""
