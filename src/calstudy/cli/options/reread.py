"""Options of ``reread``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import force_option, json_option, liggghts_option, models_option


def reread_runs_options(parser: ArgumentParser) -> None:
    """Declare the options of ``reread``."""
    parser.add_argument("file", type=Path, metavar="FILE.toml", help="definition of the calibration")
    models_option(parser)
    parser.add_argument(
        "--study", type=Path, metavar="DIR", help="study beside which runs are kept; default: studies/FILE"
    )
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
