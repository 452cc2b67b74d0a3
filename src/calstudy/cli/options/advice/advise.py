"""Options of ``advise``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import emulators_option, force_option, json_option, models_option


def advise_options(parser: ArgumentParser) -> None:
    """Declare the options of ``advise``."""
    parser.add_argument(
        "file",
        type=Path,
        nargs="?",
        metavar="FILE.toml",
        help="definition of the calibration; without it, the emulators' box with nothing measured",
    )
    parser.add_argument(
        "--tests", metavar="NAME,...", help="of these tests alone; default: all that there is an emulator of"
    )
    parser.add_argument(
        "--error",
        action="append",
        default=[],
        metavar="TEST.RESPONSE=SD",
        help="standard deviation of your laboratory's value, in the response's unit; default: a usual one",
    )
    emulators_option(parser, "made by 'calstudy emulator fit': in place of the shipped one of its test")
    parser.add_argument(
        "--study",
        type=Path,
        metavar="DIR",
        help="finished study of the file, whose solution space is what is known; default: studies/FILE, if "
        "it is there",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("advice"),
        metavar="DIR",
        help="page, tables and pictures (default: %(default)s)",
    )
    models_option(parser)
    force_option(parser)
    json_option(parser)
