"""Options of ``plan rerun``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import json_option, liggghts_option, plan_option, running_options


def plan_rerun_options(parser: ArgumentParser) -> None:
    """Declare the options of ``plan rerun``."""
    parser.add_argument(
        "study", type=Path, metavar="STUDY", help="study made with a DEM program, such as a shipped one"
    )
    parser.add_argument("--rows", required=True, metavar="ROWS", help="finished rows, such as 1,4,10-12")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="study of the new runs; default: studies/rerun-ID"
    )
    running_options(parser)
    parser.set_defaults(replicates=None, retry_failed=False)
    plan_option(parser)
    liggghts_option(parser)
    json_option(parser)
