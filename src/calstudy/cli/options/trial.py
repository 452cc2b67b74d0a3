"""Options of ``try``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import force_option, json_option, liggghts_option


def try_models_options(parser: ArgumentParser) -> None:
    """Declare the options of ``try``."""
    parser.add_argument("file", type=Path, metavar="FILE.toml", help="definition of the calibration")
    parser.add_argument(
        "--models",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="directory of model folders, searched before those beside FILE.toml and the shipped ones",
    )
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
