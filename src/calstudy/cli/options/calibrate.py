"""Options of ``calibrate``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import force_option, json_option, liggghts_option, running_options


def calibrate_options(parser: ArgumentParser) -> None:
    """Declare the options of ``calibrate``."""
    parser.add_argument(
        "file", type=Path, nargs="?", metavar="FILE.toml", help="what is calibrated to what; see --init"
    )
    parser.add_argument(
        "--init",
        action="store_true",
        help="write a commented FILE.toml (default: calibration.toml) for glass beads, which runs as it is",
    )
    parser.add_argument(
        "--models",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="directory that holds model folders; also looked for beside FILE.toml and among the shipped",
    )
    parser.add_argument("--study", type=Path, metavar="DIR", help="default: studies/FILE")
    running_options(parser)
    parser.add_argument(
        "--retry-failed",
        action="store_true",
        help="start a calibration that failed anew, with its failed and timed-out DEM runs",
    )
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
