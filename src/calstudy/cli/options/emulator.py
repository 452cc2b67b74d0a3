"""Options of the commands around the emulator."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import (
    FIDELITY_HELP,
    json_option,
    liggghts_option,
    model_option,
    natural,
    positive,
    seeds_option,
    variant_option,
    workers_option,
)


def sample_options(parser: ArgumentParser) -> None:
    """Declare the options of ``emulator sample``."""
    parser.add_argument(
        "--points", type=positive, default=128, metavar="N", help="of the cheap fidelity; default: 128"
    )
    parser.add_argument(
        "--fresh",
        type=positive,
        metavar="N",
        help="instead, N random points at the reference fidelity to judge by, half of them with three seeds",
    )
    parser.add_argument("--fidelity", metavar="F", help="cheap fidelity; default: fast")
    parser.add_argument(
        "--reference",
        metavar="F",
        help="fidelity to emulate, run at a sixth of the points; default: full",
    )
    _design_options(parser)
    parser.set_defaults(variant=None)
    model_option(parser)
    interval_option(parser)


def interval_option(parser: ArgumentParser) -> None:
    """``--interval``, as often as wanted."""
    parser.add_argument(
        "--interval",
        action="append",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="of each parameter of a model of one's own, in SI units: what is emulated; NAME=VALUE for one "
        "that stays constant",
    )


def _design_options(parser: ArgumentParser) -> None:
    """Add what the commands share that make a design and run it."""
    variant_option(parser)
    parser.add_argument("--seed", type=natural, default=1, metavar="S", help="seed of the design; default: 1")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="runs.parquet is written there"
    )
    parser.add_argument("--dry-run", action="store_true", help="say what it would cost, and run nothing")
    workers_option(parser)
    liggghts_option(parser)
    json_option(parser)


def similarity_options(parser: ArgumentParser) -> None:
    """Declare the options of ``emulator similarity``."""
    parser.add_argument("--fidelity", metavar="F", help=f"{FIDELITY_HELP}; default: tiny")
    seeds_option(parser, 4, "number of DEM runs at each end, with seeds of their own")
    _design_options(parser)
    parser.set_defaults(variant=None)
    model_option(parser)
    interval_option(parser)


def fit_options(parser: ArgumentParser) -> None:
    """Declare the options of ``emulator fit``."""
    parser.add_argument(
        "data",
        type=Path,
        nargs="+",
        metavar="RUNS",
        help="directory of a sweep, or its table; or a study, of which the samples are taken",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="the emulator is written there"
    )
    parser.add_argument(
        "--fidelity",
        metavar="F",
        help="take the runs of this fidelity alone, or of several such as soft,fast,full",
    )
    parser.add_argument("--variant", metavar="V", help="take the runs of this variant alone")
    model_option(parser)
    interval_option(parser)
    parser.add_argument(
        "--reference", metavar="F", help="fidelity to emulate; default: the most expensive of the runs"
    )
    json_option(parser)


def validate_options(parser: ArgumentParser) -> None:
    """Declare the options of ``emulator validate``."""
    parser.add_argument("emulator", type=Path, metavar="EMULATOR", help="directory of the emulator")
    parser.add_argument("--folds", type=positive, default=10, metavar="K", help="default: 10")
    parser.add_argument("--fresh", type=Path, metavar="RUNS", help="runs made with 'emulator sample --fresh'")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the figure, as .png or .svg")
    json_option(parser)
