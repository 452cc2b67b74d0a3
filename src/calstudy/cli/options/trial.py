"""Options of ``adopt`` and ``try``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import force_option, json_option, liggghts_option, models_option


def adopt_script_options(parser: ArgumentParser) -> None:
    """Declare the options of ``adopt``."""
    parser.add_argument("script", type=Path, metavar="SCRIPT", help="an input script of LIGGGHTS or LAMMPS")
    parser.add_argument(
        "--out", type=Path, metavar="FOLDER", help="folder to write; default: liggghts_models/SCRIPT"
    )


def try_models_options(parser: ArgumentParser) -> None:
    """Declare the options of ``try``."""
    parser.add_argument("file", type=Path, metavar="FILE.toml", help="definition of the calibration")
    models_option(parser)
    parser.add_argument(
        "--study",
        type=Path,
        metavar="DIR",
        help="study to come, beside which the runs are kept; default: studies/FILE",
    )
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
