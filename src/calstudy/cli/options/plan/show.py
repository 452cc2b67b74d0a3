"""Options of the commands around the plan."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import json_option, plan_option


def plan_show_options(parser: ArgumentParser) -> None:
    """Declare the options of ``plan show``."""
    plan_option(parser)
    json_option(parser)


def plan_check_options(parser: ArgumentParser) -> None:
    """Declare the options of ``plan check``."""
    plan_option(parser)
    json_option(parser)


def plan_export_options(parser: ArgumentParser) -> None:
    """Declare the options of ``plan export``."""
    parser.add_argument("--format", default="csv", metavar="FORMAT", help="csv (default), json or parquet")
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: standard output")
    plan_option(parser)
