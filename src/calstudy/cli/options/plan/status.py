"""Options of ``plan status``."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import json_option


def plan_status_options(parser: ArgumentParser) -> None:
    """Declare the options of ``plan status``."""
    parser.add_argument("--study", type=Path, required=True, metavar="DIR")
    json_option(parser)
