"""Options of ``calstudy check``."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError
from pathlib import Path

from calstudy.cli.options.shared import (
    json_option,
    liggghts_option,
    models_option,
    natural,
    seeds_option,
    workers_option,
)
from calstudy.errors import InputError
from calstudy.written import number_in, shortened


def check_options(parser: ArgumentParser) -> None:
    """Declare the options of ``check``."""
    parser.add_argument("card", type=Path, metavar="material.json")
    parser.add_argument("--fidelity", metavar="NAME", help="another fidelity of the card's models")
    parser.add_argument("--seed", type=natural, default=1, metavar="S", help="first seed; default: 1")
    seeds_option(parser, 8, "number of DEM runs of each model, with seeds S, S+1, ...")
    parser.add_argument(
        "--level",
        type=_level,
        default=0.05,
        metavar="P",
        help="probability that a card that holds is rejected; default: 0.05",
    )
    models_option(parser)
    workers_option(parser)
    liggghts_option(parser)
    json_option(parser)


def _level(text: str) -> float:
    try:
        number = number_in(text)
    except InputError as error:
        raise ArgumentTypeError(str(error)) from error
    if not 0 < number < 1:
        raise ArgumentTypeError(f"{shortened(text)} is not between 0 and 1")
    return number
