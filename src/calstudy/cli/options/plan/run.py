"""Options of the commands that calibrate rows of the plan."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path

from calstudy.cli.options.shared import (
    any_model_options,
    force_option,
    json_option,
    liggghts_option,
    natural,
    plan_option,
    positive,
    running_options,
    share,
)
from calstudy.engines.choose import ENGINES


def plan_run_options(parser: ArgumentParser) -> None:
    """Declare the options of ``plan run``."""
    parser.add_argument("--rows", metavar="ROWS", help="such as 1,4,10-12; default: all")
    any_model_options(parser, "soft; with an emulator its own, full of the shipped ones")
    parser.add_argument(
        "--engine",
        metavar="E",
        help=f"{', '.join(ENGINES)}, or one of your own as package.module:name; emulator answers from "
        "earlier DEM runs; default: the program that the model is written for",
    )
    parser.add_argument(
        "--emulator",
        type=Path,
        metavar="DIR",
        help="made by 'calstudy emulator fit'; default: the shipped one of the fidelity and variant",
    )
    parser.add_argument(
        "--replicates",
        type=positive,
        metavar="N",
        help="with an emulator: then repeat the study N times, each with its own samples, noise and draw of "
        "the emulator; 'calstudy analyse' shows their bands",
    )
    parser.add_argument("--mode", default="paper", metavar="MODE", help="paper or robust; default: paper")
    parser.add_argument(
        "--budget",
        type=positive,
        metavar="N",
        help="most DEM runs of a row's second optimisation; default: the mode's",
    )
    parser.add_argument(
        "--cheap",
        metavar="FIDELITY",
        help="sample at this cheap fidelity, and run few at --fidelity; for mode robust",
    )
    parser.add_argument(
        "--confirm",
        type=natural,
        default=0,
        metavar="N",
        help="run each optimum again with N fresh seeds; default: 0, as the paper",
    )
    parser.add_argument(
        "--target",
        metavar="TARGET",
        help="paper (22 deg, 1500 kg/m3), twin (this fidelity's own responses at known parameters), "
        "twin:FILE, or angle_of_repose_deg=...,bulk_density=...; default: paper, of material-tests twin",
    )
    parser.add_argument(
        "--study",
        type=Path,
        metavar="DIR",
        help="default: studies/FIDELITY-VARIANT-MODE-SEED, with emulator-VERSION for FIDELITY if an emulator "
        "answers; of another model studies/MODEL-FIDELITY-MODE-SEED",
    )
    parser.add_argument("--seed", type=natural, default=1, metavar="S", help="seed of the study; default: 1")
    running_options(parser)
    parser.add_argument(
        "--array",
        type=share,
        metavar="K/N",
        help="be process K of N that work on the same rows of one study at once, such as "
        "$SLURM_ARRAY_TASK_ID/8; all else must be the same for each",
    )
    parser.add_argument(
        "--share-samples",
        action="store_true",
        help="rows that differ only in WRL share their samples, which saves sampling runs",
    )
    parser.add_argument(
        "--retry-failed",
        action="store_true",
        help="start failed rows again, with their failed and timed-out DEM runs",
    )
    plan_option(parser)
    force_option(parser)
    liggghts_option(parser)
    json_option(parser)
