"""The command line's words: commands, options and their help, each command with the function it calls."""

from __future__ import annotations

import argparse
import itertools
import re
import sys
from pathlib import Path

from calstudy import __version__
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.errors import EXIT_CODES, InputError
from calstudy.plausible import INSIST
from calstudy.written import choice, number_in, shortened, whole_number_in

FIDELITY_HELP = "full (the paper's model), fast, soft, coarse (7.5 mm beads) or tiny (10 mm, for smoke tests)"

LARGEST = 2**63
"""Whole numbers of options, seeds among them, stay below it: a table holds them."""


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with the command line in one line; abbreviations of options are not taken."""

    verbs: argparse._SubParsersAction[_Parser] | None = None

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[no-untyped-def]
        """As argparse does, once every word that it would not know has been looked at."""
        words = list(sys.argv[1:] if args is None else args)
        verb = next((word for word in words if not word.startswith("-")), None) if self.verbs else None
        known = [name for name in self._option_string_actions if name.startswith("--")]
        for word in itertools.takewhile(lambda word: word not in ("--", verb), words):
            option = word.partition("=")[0]
            if re.fullmatch("--[a-z-]+", option) and option not in known:
                self.error(f"there is no option {option}; {choice(option, known, 'there are')}")
        if self.verbs and verb and verb not in self.verbs.choices:
            self.error(f"there is no command {verb!r}; {choice(verb, self.verbs.choices, 'there are')}")
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> None:  # type: ignore[override]
        self.exit(2, f"{self.prog}: {message}; see '{self.prog} --help'\n")


def command_line() -> argparse.ArgumentParser:
    """Parser of all commands; ``command`` is ``module.function`` of the one that was asked for."""
    codes = "\n".join(f"  {code:>3}  {meaning}" for code, meaning in EXIT_CODES.items())
    common = _Parser(add_help=False)
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser = _Parser(
        prog="calstudy",
        description="Calibrate discrete element models, and study how to calibrate them.",
        epilog=f"exit codes:\n{codes}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"calstudy {__version__}")
    verbs = parser.verbs = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)

    plan = verbs.add_parser("plan", help="the experimental plan, and running it")
    plan_verbs = plan.verbs = plan.add_subparsers(required=True, metavar="COMMAND", parser_class=_Parser)

    def add(
        to: argparse._SubParsersAction[_Parser], name: str, function: str, text: str
    ) -> argparse.ArgumentParser:
        verb = to.add_parser(name, help=text, description=text, parents=[common], allow_abbrev=False)
        verb.set_defaults(command=function)
        return verb

    show = add(
        plan_verbs,
        "show",
        "plan.plan_show",
        "Show rows, intervals, constants, fixed inputs and targets.",
    )
    _plan_file(show)
    _json(show)

    export = add(plan_verbs, "export", "plan.plan_export", "Write the plan's rows.")
    export.add_argument("--format", default="csv", metavar="FORMAT", help="csv (default), json or parquet")
    export.add_argument("--out", type=Path, metavar="FILE", help="default: standard output")
    _plan_file(export)

    check = add(plan_verbs, "check", "plan.plan_check", "Check balance, word lengths and samples.")
    _plan_file(check)
    _json(check)

    run = add(
        plan_verbs,
        "run",
        "plan_run.plan_run",
        "Calibrate rows of the plan; the same command goes on where it stopped.",
    )
    run.add_argument("--rows", metavar="ROWS", help="such as 1,4,10-12; default: all")
    _model(run, fidelity=None, otherwise="soft; of an emulator its own, of a shipped one full")
    run.add_argument(
        "--engine",
        default="liggghts",
        metavar="E",
        help="liggghts, or emulator: answers from an emulator of earlier DEM runs; default: liggghts",
    )
    run.add_argument(
        "--emulator",
        type=Path,
        metavar="DIR",
        help="made by 'calstudy emulator fit'; default: the one shipped of the fidelity and variant",
    )
    run.add_argument(
        "--replicates",
        type=_positive,
        metavar="N",
        help="on an emulator: then repeat the study N times, each with samples, noise and a draw of the "
        "emulator of its own; 'calstudy analyse' shows their bands",
    )
    run.add_argument("--mode", default="paper", metavar="MODE", help="paper or robust; default: paper")
    run.add_argument(
        "--budget",
        type=_positive,
        metavar="N",
        help="most DEM runs of a row's second optimisation; default: the mode's",
    )
    run.add_argument(
        "--target",
        default="paper",
        metavar="TARGET",
        help="paper (22 deg, 1500 kg/m3), twin (this fidelity's own responses at known parameters), "
        "twin:FILE, or angle_of_repose_deg=...,bulk_density=...; default: paper",
    )
    run.add_argument(
        "--study",
        type=Path,
        metavar="DIR",
        help="default: studies/FIDELITY-VARIANT-MODE-SEED; of an emulator, emulator-VERSION is FIDELITY",
    )
    run.add_argument("--seed", type=_natural, default=1, metavar="S", help="seed of the study; default: 1")
    _running(run)
    run.add_argument(
        "--share-samples",
        action="store_true",
        help="rows that differ in WRL alone use the same samples: a third fewer sampling runs",
    )
    run.add_argument(
        "--retry-failed",
        action="store_true",
        help="start the rows whose calibration failed anew, with their failed and timed-out DEM runs",
    )
    _plan_file(run)
    _force(run)
    _liggghts(run)
    _json(run)

    rerun = add(
        plan_verbs,
        "rerun",
        "plan_run.plan_rerun",
        "Run rows of a study again, by its own settings, and compare DEM run by DEM run.",
    )
    rerun.add_argument("study", type=Path, metavar="STUDY", help="a study on LIGGGHTS, such as a shipped one")
    rerun.add_argument("--rows", required=True, metavar="ROWS", help="such as 1,4,10-12; finished ones")
    rerun.add_argument("--out", type=Path, metavar="DIR", help="its study; default: studies/rerun-ID")
    _running(rerun)
    rerun.set_defaults(replicates=None, retry_failed=False)
    _plan_file(rerun)
    _liggghts(rerun)
    _json(rerun)

    status = add(plan_verbs, "status", "status.plan_status", "Say how far a study is.")
    status.add_argument("--study", type=Path, required=True, metavar="DIR")
    _json(status)

    calibrate = add(
        verbs,
        "calibrate",
        "calibrate.calibrate",
        "Calibrate one's own material, with one's own LIGGGHTS model if need be; goes on where it stopped.",
    )
    calibrate.add_argument(
        "file", type=Path, nargs="?", metavar="FILE.toml", help="what is calibrated to what; see --init"
    )
    calibrate.add_argument(
        "--init",
        action="store_true",
        help="write a commented FILE.toml (default: calibration.toml) for glass beads, which runs as it is",
    )
    calibrate.add_argument(
        "--models",
        type=Path,
        action="append",
        default=[],
        metavar="DIR",
        help="directory that holds model folders; also looked for beside FILE.toml and among the shipped",
    )
    calibrate.add_argument("--study", type=Path, metavar="DIR", help="default: studies/FILE")
    _running(calibrate)
    calibrate.add_argument(
        "--retry-failed",
        action="store_true",
        help="start a calibration that failed anew, with its failed and timed-out DEM runs",
    )
    _force(calibrate)
    _liggghts(calibrate)
    _json(calibrate)

    analyse = add(
        verbs,
        "analyse",
        "analyse.analyse",
        "Regenerate the paper's tables and figures from a study, beside the published values.",
    )
    analyse.add_argument(
        "study", type=Path, metavar="STUDY", help="a study directory; it may be running still"
    )
    analyse.add_argument("--out", type=Path, metavar="DIR", help="default: STUDY/analysis")
    analyse.add_argument(
        "--beside",
        type=Path,
        metavar="STUDY",
        help="another study, with replicates: bands_beside compares the bands of both; numbers_beside and "
        "rows_beside compare this one, on the DEM model, with those replicates; or a directory where analyse "
        "wrote the numbers of all replicates (not for rows_beside)",
    )
    analyse.add_argument(
        "--format", metavar="FORMATS", help="of html,csv,tex,png,svg, such as html,csv; default: all"
    )
    analyse.add_argument(
        "--only",
        metavar="NAMES",
        help="such as table5,figure7; of table1 to table6, table_b1, figure1 to figure9, effects, "
        "second_phase, claims; of replicates also bands, bands_claims, bands_figure, half_fraction, "
        "bands_beside; of a DEM model's rows beside an emulator's replicates numbers_beside, "
        "numbers_beside_figure, rows_beside, rows_beside_figure",
    )
    _plan_file(analyse)
    _json(analyse)

    simulate = add(verbs, "simulate", "model.simulate", "Run the DEM model with a seed or several.")
    _model(simulate, fidelity="coarse")
    _parameters(simulate)
    simulate.add_argument("--seed", type=_natural, default=1, metavar="S", help="default: 1")
    simulate.add_argument(
        "--replicates",
        type=_positive,
        default=1,
        metavar="N",
        help="number of runs, with seeds S, S+1, ...; default: 1",
    )
    simulate.add_argument("--out", type=Path, metavar="DIR", help="keep deck, log, pictures and beads here")
    _workers(simulate)
    _force(simulate)
    _liggghts(simulate)
    _json(simulate)

    twin = add(
        verbs,
        "twin",
        "model.twin",
        "Make a twin target: mean responses at known parameters.",
    )
    _model(twin, fidelity="coarse")
    _parameters(twin)
    twin.add_argument("--seed", type=_natural, default=1001, metavar="N", help="first seed; default: 1001")
    twin.add_argument("--replicates", type=_positive, default=8, metavar="N", help="default: 8")
    twin.add_argument(
        "--out", type=Path, required=True, metavar="FILE", help="table of twins to write or add to"
    )
    _workers(twin)
    _force(twin)
    _liggghts(twin)
    _json(twin)

    sweep = add(
        verbs,
        "sweep",
        "sweep.sweep",
        "Run the DEM model at listed points; the same command goes on where it stopped.",
    )
    sweep.add_argument(
        "design", type=Path, metavar="DESIGN.csv", help="label,fidelity,variant,seed and the six parameters"
    )
    sweep.add_argument("--out", type=Path, required=True, metavar="DIR", help="runs.parquet is written there")
    sweep.add_argument("--keep-heaps", action="store_true", help="keep the heaps' beads as heaps.parquet")
    _workers(sweep)
    _force(sweep)
    _liggghts(sweep)
    _json(sweep)

    emulator = verbs.add_parser("emulator", help="an emulator of the DEM model, made from its runs")
    emulator_verbs = emulator.verbs = emulator.add_subparsers(
        required=True, metavar="COMMAND", parser_class=_Parser
    )

    sample = add(
        emulator_verbs,
        "sample",
        "emulator.sample",
        "Run the design that an emulator is fitted to; the same command goes on where it stopped.",
    )
    sample.add_argument(
        "--points", type=_positive, default=128, metavar="N", help="of the cheap fidelity; default: 128"
    )
    sample.add_argument(
        "--fresh",
        type=_positive,
        metavar="N",
        help="instead, N random points at the reference fidelity to judge by, half of them with three seeds",
    )
    sample.add_argument("--fidelity", default="fast", metavar="F", help="cheap fidelity; default: fast")
    sample.add_argument(
        "--reference",
        default="full",
        metavar="F",
        help="fidelity to emulate, run at a sixth of the points; default: full",
    )
    _design(sample)

    similarity = add(
        emulator_verbs,
        "similarity",
        "emulator.similarity",
        "Check that DENS and YM act through YM/DENS alone.",
    )
    similarity.add_argument("--fidelity", default="tiny", metavar="F", help=f"{FIDELITY_HELP}; default: tiny")
    similarity.add_argument("--replicates", type=_positive, default=4, metavar="N", help="seeds; default: 4")
    _design(similarity)

    fit = add(emulator_verbs, "fit", "emulator.fit", "Fit an emulator to runs.")
    fit.add_argument("data", type=Path, nargs="+", metavar="RUNS", help="directory of a sweep, or its table")
    fit.add_argument("--out", type=Path, required=True, metavar="DIR", help="the emulator is written there")
    fit.add_argument(
        "--fidelity", metavar="F", help="take the runs of this fidelity alone, or of two such as fast,full"
    )
    fit.add_argument("--variant", metavar="V", help="take the runs of this variant alone")
    fit.add_argument("--reference", metavar="F", help="fidelity to emulate; default: the dearest of the runs")
    _json(fit)

    validate = add(
        emulator_verbs,
        "validate",
        "emulator.validate",
        "Hold an emulator against runs that it was not fitted to.",
    )
    validate.add_argument("emulator", type=Path, metavar="EMULATOR", help="directory of the emulator")
    validate.add_argument("--folds", type=_positive, default=10, metavar="K", help="default: 10")
    validate.add_argument(
        "--fresh", type=Path, metavar="RUNS", help="runs made with 'emulator sample --fresh'"
    )
    validate.add_argument("--out", type=Path, metavar="FILE", help="write the figure, as .png or .svg")
    _json(validate)

    measure = add(
        verbs,
        "measure",
        "model.measure",
        "Measure a heap on two pictures (Appendix A).",
    )
    measure.add_argument("top", type=Path, metavar="TOP.png")
    measure.add_argument("side", type=Path, metavar="SIDE.png")
    measure.add_argument(
        "--sphere-diameter-mm", type=_millimetres, default=50.0, metavar="D", help="default: 50"
    )
    measure.add_argument(
        "--particle-diameter-mm", type=_millimetres, default=5.0, metavar="D", help="default: 5"
    )
    _json(measure)

    doctor = add(verbs, "doctor", "model.doctor", "Say which LIGGGHTS is found, and test it for two seconds.")
    _liggghts(doctor)
    _json(doctor)
    return parser


def _json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print the result as JSON")


def _plan_file(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plan",
        type=Path,
        metavar="FILE",
        help="rows as CSV, or full-factorial: the paper's and "
        "the other half, rows 73 to 144; default: the paper's plan",
    )


def _design(parser: argparse.ArgumentParser) -> None:
    """Add what the commands share that make a design and run it."""
    _variant(parser)
    parser.add_argument(
        "--seed", type=_natural, default=1, metavar="S", help="seed of the design; default: 1"
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="runs.parquet is written there"
    )
    parser.add_argument("--dry-run", action="store_true", help="say what it would cost, and run nothing")
    _workers(parser)
    _liggghts(parser)
    _json(parser)


def _model(parser: argparse.ArgumentParser, fidelity: str | None, otherwise: str = "") -> None:
    default = fidelity or otherwise
    parser.add_argument(
        "--fidelity", default=fidelity, metavar="F", help=f"{FIDELITY_HELP}; default: {default}"
    )
    _variant(parser)


def _variant(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--variant",
        default="ring",
        metavar="V",
        help="ring (the plate ends at the ring), wide, or one of the model's other variants; default: ring",
    )


def _parameters(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a parameter in SI units; those not set have the reference point's values",
    )


def _workers(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--workers", type=_positive, metavar="N", help="DEM runs at once; default: one a core"
    )


def _running(parser: argparse.ArgumentParser) -> None:
    _workers(parser)
    parser.add_argument(
        "--scratch", type=Path, metavar="DIR", help="where DEM runs work; default: STUDY/runs"
    )
    parser.add_argument(
        "--keep-runs", action="store_true", help="keep every DEM run's directory in the scratch"
    )
    parser.add_argument(
        "--time-limit",
        type=_duration,
        metavar="TIME",
        help="such as 3h30m: start no DEM run that might not end by then (exit code 9); default: none",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="run on the Dask cluster of this scheduler, such as tcp://node1:8786 (pip install "
        "'calstudy[cluster]'); DEM runs at once are then all threads of its workers, or --workers; LIGGGHTS "
        "and --scratch are looked for there",
    )
    parser.add_argument("--dry-run", action="store_true", help="say what it would cost, and run nothing")


def _force(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        INSIST, action="store_true", help="take values outside their plausible ranges, which are refused"
    )


def _liggghts(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--liggghts", metavar="COMMAND", help=f"program, with arguments if need be; also {LIGGGHTS.variable}"
    )


def _natural(text: str) -> int:
    return _whole(text, 0, "a whole number that is not negative")


def _positive(text: str) -> int:
    return _whole(text, 1, "a positive whole number")


def _whole(text: str, least: int, what: str) -> int:
    try:
        number = whole_number_in(text)
    except InputError:
        number = least - 1
    if not least <= number < LARGEST:
        raise argparse.ArgumentTypeError(f"{shortened(text)} is not {what}")
    return number


def _millimetres(text: str) -> float:
    try:
        number = number_in(text)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    if number <= 0:
        raise argparse.ArgumentTypeError(f"{shortened(text)} is not positive; give a length in mm")
    return number


def _duration(text: str) -> float:
    """Seconds of a time such as 3h30m, 90m or 45s."""
    parts = re.fullmatch(r"(?:([0-9]+)d)?(?:([0-9]+)h)?(?:([0-9]+)m)?(?:([0-9]+)s)?", text)
    wrong = argparse.ArgumentTypeError(f"{shortened(text)} is not a time such as 3h30m, 90m or 45s")
    if parts is None:
        raise wrong
    seconds = sum(int(n or 0) * unit for n, unit in zip(parts.groups(), (86400, 3600, 60, 1), strict=True))
    if not seconds:
        raise wrong
    return float(seconds)
