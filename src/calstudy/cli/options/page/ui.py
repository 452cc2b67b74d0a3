"""Options of ``ui``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import (
    emulators_option,
    force_option,
    liggghts_option,
    models_option,
    natural,
    workers_option,
)


def ui_options(parser: ArgumentParser) -> None:
    """Declare the options of ``ui``."""
    parser.add_argument(
        "project",
        type=Path,
        nargs="?",
        default=Path(),
        metavar="DIRECTORY",
        help="directory of the calibration, or its FILE.toml; default: this directory and calibration.toml",
    )
    parser.add_argument("--study", type=Path, metavar="DIR", help="default: DIRECTORY/studies/FILE")
    parser.add_argument(
        "--port", type=natural, default=0, metavar="N", help="of this machine; default: a free one"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address, and open no browser")
    models_option(parser)
    emulators_option(parser, "answers in place of the DEM program, as of 'calstudy calibrate'")
    workers_option(parser)
    force_option(parser)
    liggghts_option(parser)
