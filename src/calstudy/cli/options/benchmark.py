"""Options of ``benchmark``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import json_option, positive


def benchmark_options(parser: ArgumentParser) -> None:
    """Declare the options of ``benchmark``."""
    parser.add_argument(
        "--method",
        metavar="NAMES",
        default="robust,paper,sobol,random",
        help="of robust, robust_together, robust_two, paper, sobol and random, or module:function of "
        "your own, such as robust,my_module:calibrator; the others are compared with the first (default: "
        "%(default)s)",
    )
    parser.add_argument(
        "--challenge", metavar="NAMES", help="some of the challenges, such as six,row; default: all"
    )
    parser.add_argument(
        "--seeds", type=positive, metavar="N", default=20, help="problems of each challenge (default: 20)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        default=Path("benchmark"),
        help="scores, page and picture; the same command goes on where it stopped (default: %(default)s)",
    )
    parser.add_argument("--workers", type=positive, metavar="N", help="processes; default: one a core")
    json_option(parser)
