"""Options of ``calibrate``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import (
    emulators_option,
    force_option,
    json_option,
    liggghts_option,
    models_option,
    running_options,
)


def calibrate_options(parser: ArgumentParser) -> None:
    """Declare the options of ``calibrate``."""
    parser.add_argument(
        "file", type=Path, nargs="?", metavar="FILE.toml", help="definition of the calibration; see --init"
    )
    parser.add_argument(
        "--init",
        action="store_true",
        help="write a commented FILE.toml (default: calibration.toml) for glass beads that runs as it is",
    )
    parser.add_argument(
        "--tests",
        metavar="NAME,...",
        help="with --init: for these shipped material tests, such as angle_of_repose,shear_cell",
    )
    models_option(parser)
    emulators_option(
        parser, "made by 'calstudy emulator fit': answers in place of the DEM program; one of each model"
    )
    parser.add_argument(
        "--until",
        type=float,
        metavar="P",
        help="confirm until all responses are within tolerance with this probability, or it is out of reach",
    )
    parser.add_argument("--study", type=Path, metavar="DIR", help="default: studies/FILE")
    running_options(parser)
    parser.add_argument(
        "--retry-failed",
        action="store_true",
        help="start a failed calibration again, with its failed and timed-out DEM runs",
    )
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
