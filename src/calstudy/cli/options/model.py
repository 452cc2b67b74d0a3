"""Options of the commands around the DEM model."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import (
    any_model_options,
    calibration_option,
    force_option,
    json_option,
    liggghts_option,
    natural,
    parameters_option,
    seeds_option,
    workers_option,
)

DEFAULT_FIDELITY = "coarse"
"""Fidelity of `simulate` and `twin` where none is named."""


def simulate_options(parser: ArgumentParser) -> None:
    """Declare the options of ``simulate``."""
    any_model_options(parser, fidelity=DEFAULT_FIDELITY)
    calibration_option(parser)
    parameters_option(parser)
    parser.add_argument("--seed", type=natural, default=1, metavar="S", help="default: 1")
    seeds_option(parser, 1, "number of DEM runs, with seeds S, S+1, ...")
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep deck, log, pictures and beads here")
    workers_option(parser)
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)


def twin_options(parser: ArgumentParser) -> None:
    """Declare the options of ``twin``."""
    any_model_options(parser, fidelity=DEFAULT_FIDELITY)
    calibration_option(parser)
    parameters_option(parser)
    parser.add_argument("--seed", type=natural, default=1001, metavar="N", help="first seed; default: 1001")
    seeds_option(parser, 8, "number of DEM runs, with seeds N, N+1, ...")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="table of twins to write or add to"
    )
    workers_option(parser)
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)


def doctor_options(parser: ArgumentParser) -> None:
    """Declare the options of ``doctor``."""
    liggghts_option(parser)
    json_option(parser)
