"""Options of ``analyse``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.analysis.contents import names_in_words
from calstudy.cli.options.shared import json_option, plan_option


def analyse_options(parser: ArgumentParser) -> None:
    """Declare the options of ``analyse``."""
    parser.add_argument(
        "study", type=Path, metavar="STUDY", help="a study directory; the study may still be running"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: STUDY/analysis")
    parser.add_argument(
        "--beside",
        type=Path,
        metavar="STUDY",
        help="another study, with replicates: bands_beside compares the bands of both; numbers_beside and "
        "rows_beside compare this one, on the DEM model, with those replicates; or a directory where analyse "
        "wrote the numbers of all replicates (not for rows_beside)",
    )
    parser.add_argument(
        "--format", metavar="FORMATS", help="of html,csv,tex,png,svg, such as html,csv; default: all"
    )
    parser.add_argument(
        "--only",
        metavar="NAMES",
        help=f"such as table5,figure7; {names_in_words()}",
    )
    plan_option(parser)
    json_option(parser)
