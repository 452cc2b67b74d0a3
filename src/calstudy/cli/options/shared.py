"""Options that several commands share, and the values they take."""

from __future__ import annotations

import contextlib
import re
import sys
from argparse import SUPPRESS, Action, ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from calstudy.engines.profiles import LIGGGHTS
from calstudy.errors import InputError
from calstudy.plausible import INSIST
from calstudy.written import shortened, whole_number_in

FIDELITY_HELP = "full (the paper's model), fast, soft, coarse (7.5 mm beads) or tiny (10 mm, for smoke tests)"

LARGEST = 2**63
"""Limit of whole numbers such as seeds, which tables store in 64 bits."""


def json_option(parser: ArgumentParser) -> None:
    """``--json``."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def plan_option(parser: ArgumentParser) -> None:
    """``--plan``: the file of the plan's rows."""
    parser.add_argument(
        "--plan",
        type=Path,
        metavar="FILE",
        help="CSV file of rows; or full-factorial: the paper's rows and the other half as rows 73 to 144; or "
        "material-tests: 36 rows of one to four tests; default: the paper's plan",
    )


def model_options(parser: ArgumentParser, fidelity: str | None, otherwise: str = "") -> None:
    """``--fidelity``, with a default or a description of it, and ``--variant``."""
    default = fidelity or otherwise
    parser.add_argument(
        "--fidelity", default=fidelity, metavar="F", help=f"{FIDELITY_HELP}; default: {default}"
    )
    variant_option(parser)


def any_model_options(parser: ArgumentParser, fidelity: str) -> None:
    """``--model`` for any model, with ``--fidelity`` and ``--variant``."""
    model_option(parser)
    model_options(parser, None, fidelity)
    parser.set_defaults(variant=None)


def calibration_option(parser: ArgumentParser) -> None:
    """``--calibration FILE.toml``: a model as a calibration's file has it."""
    parser.add_argument(
        "--calibration",
        type=Path,
        metavar="FILE.toml",
        help="take the model as this file's [[models]] has it, with fidelity, apparatus and material; the "
        "rest of the file may be missing; --model says which, where there are several",
    )


def model_option(parser: ArgumentParser) -> None:
    """``--model``: a shipped model, or a folder of your own."""
    parser.add_argument(
        "--model",
        metavar="NAME|FOLDER",
        help="a shipped model, or the folder of one's own, which has no --variant and the fidelities that "
        "its model.toml gives; default: angle_of_repose",
    )
    ranks_option(parser)


def ranks_option(parser: ArgumentParser) -> None:
    """``--ranks``: MPI ranks of a run."""
    parser.add_argument(
        "--ranks",
        type=positive,
        metavar="N",
        help="MPI ranks of a run of a model's folder, in place of its model.toml's",
    )


def variant_option(parser: ArgumentParser) -> None:
    """``--variant``."""
    parser.add_argument(
        "--variant",
        default="ring",
        metavar="V",
        help="ring (the plate ends at the ring), wide, or one of the model's other variants; default: ring",
    )


def parameters_option(parser: ArgumentParser) -> None:
    """``--set NAME=VALUE``, as often as wanted."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a parameter in SI units; those not set have the reference point's values, which "
        "a model of one's own does not have: set all",
    )


class Renamed(Action):
    """An option by the name that it had before: it still works, and says how it is called now."""

    def __call__(
        self,
        parser: ArgumentParser,
        namespace: Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        """Say the new name on standard error, and take the value."""
        name = self.dest.replace("_", "-")
        print(f"calstudy: {option_string} is now called --{name}; use that", file=sys.stderr)
        setattr(namespace, self.dest, self.const if self.nargs == 0 else values)


def seeds_option(parser: ArgumentParser, default: int, meaning: str) -> None:
    """``--seeds N``: runs of the same parameters with other seeds. Version 0.1 called it ``--replicates``."""
    parser.add_argument(
        "--seeds", type=positive, default=default, metavar="N", help=f"{meaning}; default: {default}"
    )
    parser.add_argument("--replicates", type=positive, dest="seeds", action=Renamed, help=SUPPRESS)


def models_option(parser: ArgumentParser) -> None:
    """``--models DIR``, as often as wanted."""
    parser.add_argument(
        "--models",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="directory of model folders, searched before those beside FILE.toml and the shipped ones",
    )
    ranks_option(parser)


def workers_option(parser: ArgumentParser) -> None:
    """``--workers``: DEM runs at once."""
    parser.add_argument("--workers", type=positive, metavar="N", help="DEM runs at once; default: one a core")


def running_options(parser: ArgumentParser) -> None:
    """How DEM runs are run, which does not change results, and ``--dry-run``."""
    workers_option(parser)
    parser.add_argument(
        "--scratch", type=Path, metavar="DIR", help="working directory of DEM runs; default: STUDY/runs"
    )
    parser.add_argument("--keep-runs", action="store_true", help="keep the directory of every DEM run")
    parser.add_argument(
        "--time-limit",
        type=duration,
        metavar="TIME",
        help="such as 3h30m: start no DEM run that might end later (exit code 9); default: none",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run on the Dask cluster of this scheduler, such as tcp://node1:8786 (pip install "
        "'calstudy[cluster]'); --workers is then all threads of its workers by default; LIGGGHTS and "
        "--scratch must be there",
    )
    parser.add_argument(
        "--wait-workers",
        type=duration,
        metavar="TIME",
        help="with --scheduler: give up (exit code 3) when the cluster has had no worker for that long; "
        "default: 1d",
    )
    parser.add_argument("--dry-run", action="store_true", help="show the expected cost, and run nothing")


def force_option(parser: ArgumentParser) -> None:
    """``--force``: accept implausible values."""
    parser.add_argument(INSIST, action="store_true", help="accept values outside their plausible ranges")


def liggghts_option(parser: ArgumentParser) -> None:
    """``--liggghts``: the command that runs it."""
    parser.add_argument(
        "--liggghts",
        metavar="COMMAND",
        help=f"command that runs LIGGGHTS; default: {LIGGGHTS.variable}, or liggghts on the search path",
    )


def natural(text: str) -> int:
    """Value of an option: a whole number from 0 on."""
    return _whole(text, 0, "a whole number that is not negative")


def positive(text: str) -> int:
    """Value of an option: a whole number from 1 on."""
    return _whole(text, 1, "a positive whole number")


def _whole(text: str, least: int, what: str) -> int:
    try:
        number = whole_number_in(text)
    except InputError:
        number = least - 1
    if not least <= number < LARGEST:
        raise ArgumentTypeError(f"{shortened(text)} is not {what}")
    return number


def emulators_option(parser: ArgumentParser, what: str) -> None:
    """Declare ``--emulator``, once for each emulator."""
    parser.add_argument("--emulator", type=Path, action="append", default=[], metavar="DIR", help=what)


def share(text: str) -> tuple[int, int]:
    """K and N of a share such as 3/8."""
    number, _, of = text.partition("/")
    with contextlib.suppress(ArgumentTypeError):
        if (one := positive(number)) <= (all_of_them := positive(of)):
            return one, all_of_them
    raise ArgumentTypeError(f"{shortened(text)} is not a share such as 3/8, with K from 1 to N")


def duration(text: str) -> float:
    """Seconds of a time such as 3h30m, 90m or 45s."""
    parts = re.fullmatch(r"(?:([0-9]+)d)?(?:([0-9]+)h)?(?:([0-9]+)m)?(?:([0-9]+)s)?", text)
    wrong = ArgumentTypeError(f"{shortened(text)} is not a time such as 3h30m, 90m or 45s")
    if parts is None:
        raise wrong
    seconds = sum(int(n or 0) * unit for n, unit in zip(parts.groups(), (86400, 3600, 60, 1), strict=True))
    if not seconds:
        raise wrong
    return float(seconds)
