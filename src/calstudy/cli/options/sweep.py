"""Options of ``sweep``."""

from __future__ import annotations

from argparse import SUPPRESS, ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import (
    Renamed,
    calibration_option,
    force_option,
    json_option,
    liggghts_option,
    model_option,
    workers_option,
)


def sweep_options(parser: ArgumentParser) -> None:
    """Declare the options of ``sweep``."""
    parser.add_argument(
        "design",
        type=Path,
        metavar="DESIGN.csv",
        help="label,fidelity,variant,seed and the six parameters; of a model of one's own, or with "
        "--calibration, label,seed and its parameters",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="runs.parquet is written there"
    )
    parser.add_argument(
        "--keep-beads", action="store_true", help="keep the beads' positions at the end, as heaps.parquet"
    )
    parser.add_argument("--keep-heaps", dest="keep_beads", nargs=0, const=True, action=Renamed, help=SUPPRESS)
    model_option(parser)
    parser.add_argument(
        "--fidelity",
        metavar="F",
        help="of a model's folder; designs of the angle-of-repose model have a column",
    )
    calibration_option(parser)
    workers_option(parser)
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
