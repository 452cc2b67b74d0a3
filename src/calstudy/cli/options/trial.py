"""Options of ``try``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import force_option, json_option, liggghts_option


def try_models_options(parser: ArgumentParser) -> None:
    """Declare the options of ``try``."""
    parser.add_argument("file", type=Path, metavar="FILE.toml", help="what is to be calibrated to what")
    parser.add_argument(
        "--models",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="directory that holds model folders; also looked for beside FILE.toml and among the shipped",
    )
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
