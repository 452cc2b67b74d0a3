"""The commands around the emulator: each builds the parts, calls one function, prints what comes back."""

from __future__ import annotations

import io
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import rc_context
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from calstudy.cli.model import own_model
from calstudy.cli.sweep import run_design
from calstudy.cli.terminal import print_json, results_console
from calstudy.disk.files import write_atomically
from calstudy.disk.parquet import open_parquet
from calstudy.emulator.design import Choice, emulator_design, fresh_design
from calstudy.emulator.emulator import Emulator, fit_emulator, read_emulator, write_emulator
from calstudy.emulator.similarity import Similarity, similarity_design, similarity_table
from calstudy.emulator.validation import (
    Trust,
    Unexplained,
    coverage,
    cross_validated,
    fresh_points,
    fresh_summary,
    left_out,
    unexplained,
)
from calstudy.emulator.validation_figure import validation_figure
from calstudy.engines.interface import Model
from calstudy.engines.queue import cores
from calstudy.errors import NOT_DECIDED, NOT_HOLDING, InputError, SetupError, StoreError
from calstudy.models.angle_of_repose import DEFAULT_VARIANT, load_model, shipped_model
from calstudy.models.find import DEFAULT_MODEL, declaration
from calstudy.parameters import Parameter
from calstudy.plan_file import load_plan
from calstudy.records import Phase
from calstudy.study.directory.session import duration
from calstudy.study.reading import read_study
from calstudy.study.schema import Quantities, sweep_columns
from calstudy.study.settings import SETTINGS_FILE
from calstudy.study.sweep import RUNS, Line, read_design, write_design
from calstudy.written import choice as options_of
from calstudy.written import number_in

DESIGN = "design.csv"
CODES = {Trust.NO: NOT_HOLDING, Trust.UNDECIDED: NOT_DECIDED, Trust.YES: 0}
"""Exit code by the least trust in a response; the worst comes first."""


def sample(a: Namespace) -> None:
    """Run the design that an emulator is fitted to, or fresh points that it is judged by."""
    of_shipped = {"fidelity": a.fidelity, "reference": a.reference, "variant": a.variant}
    own = own_model(a.model, of_shipped, ranks=a.ranks)
    if own is None:
        choice = Choice(a.fidelity or "fast", a.reference or "full", a.variant or DEFAULT_VARIANT, a.seed)
    else:
        at = own.labels["fidelity"]
        choice = Choice(at, at, "", a.seed)
    parameters = _intervals(a.interval, own)
    similar = Similarity.of(own or declaration(DEFAULT_MODEL), parameters)
    if a.fresh is None:
        design = emulator_design(parameters, choice, a.points, similar)
    else:
        design = fresh_design(parameters, choice, a.fresh, similar)
    if own is not None:
        for line in design:
            own.check(line.parameters)
    table = _run(a, design, own)
    if table is not None:
        _print_runs(a, table)


def _intervals(given: Sequence[str], own: Model | None) -> Sequence[Parameter]:
    """Parameters with the intervals of ``--interval``, or the plan's where there are none of the heap's.

    InputError where one is missing or wrong.
    """
    if own is None and not given:
        return load_plan().parameters
    own = own or shipped_model()
    found: dict[str, tuple[float, float]] = {}
    for text in given:
        name, equals, ends = (part.strip() for part in text.partition("="))
        if name not in own.parameters or not equals:
            remedy = options_of(name, own.parameters, "NAME is one of")
            raise InputError(
                f"--interval {text}: use NAME=LOW:HIGH, or NAME=VALUE for one that stays constant; {remedy}"
            )
        low, colon, high = ends.partition(":")
        try:
            found[name] = number_in(low), number_in(high if colon else low)
        except InputError as error:
            raise InputError(f"--interval {text}: {error}") from error
        if colon and not found[name][0] < found[name][1]:
            raise InputError(f"--interval {text}: write the smaller end first, then the larger one")
    if missing := [name for name in own.parameters if name not in found]:
        raise InputError(f"give the interval of {', '.join(missing)} with --interval NAME=LOW:HIGH")
    return _as_parameters(found, own)


def _range_of(runs: pd.DataFrame, own: Model) -> list[Parameter]:
    """Parameters with the intervals that the runs fill; one that is the same in all runs is a constant."""
    return _as_parameters({n: (float(runs[n].min()), float(runs[n].max())) for n in own.parameters}, own)


def _as_parameters(ends: Mapping[str, tuple[float, float]], own: Model) -> list[Parameter]:
    """Parameters with these intervals; InputError where none varies, or the model cannot have an end."""
    if all(low == high for low, high in ends.values()):
        raise InputError(f"no parameter of {own.name} varies, so there is nothing to emulate; vary one")
    for name, values in ends.items():
        for value in values:
            own.check({name: value})
    return [
        Parameter(name, unit, *ends[name], ends[name][0] if ends[name][0] == ends[name][1] else None)
        for name, unit in own.parameters.items()
    ]


def similarity(a: Namespace) -> None:
    """Check that the two parameters of a model's ratio act through their quotient alone."""
    own = own_model(a.model, {"fidelity": a.fidelity, "variant": a.variant}, ranks=a.ranks)
    labels = ("", "") if own else (a.fidelity or "tiny", a.variant or DEFAULT_VARIANT)
    parameters = _intervals(a.interval, own)
    similar = Similarity.of(own or declaration(DEFAULT_MODEL), parameters)
    design = similarity_design(parameters, similar, a.seed, a.seeds, *labels)
    runs = _run(a, design, own)
    if runs is None:
        return
    found = similarity_table(runs, similar)
    above, below = similar.ratio or ("", "")
    if a.json:
        print_json(found.to_dict("records"))
        return
    table = Table(
        "response",
        "doubled: largest change",
        f"upper less lower end of {below}",
        "noise of a run",
        title=f"{below} and {above} at equal {above}/{below} and other parameters",
    )
    for line in found.itertuples():
        table.add_row(
            str(line.response),
            f"{line.doubled:.3g} ({line.doubled_pairs} pairs)",
            f"{line.difference:.2g} ± {line.half_width:.2g} (90 %, {line.points} points)",
            f"{line.noise:.2g}",
        )
    results_console().print(table)


def fit(a: Namespace) -> int:
    """Fit an emulator to runs, and say whether its intervals can be trusted."""
    own = own_model(
        a.model, {"fidelity": a.fidelity, "variant": a.variant, "reference": a.reference}, ranks=a.ranks
    )
    declared = own or declaration(DEFAULT_MODEL)
    runs = pd.concat([_read_runs(path, Quantities.of(declared)) for path in a.data], ignore_index=True)
    if own is not None and set(runs["model_hash"]) != {own.hash}:
        raise InputError(f"the runs are not of this version of {own.name}; run their design again with it")
    runs = runs.drop_duplicates("run_id", ignore_index=True)
    for option, given in (("fidelity", a.fidelity), ("variant", a.variant)):
        if given is not None:
            wanted, there = given.split(","), sorted(runs[option].unique())
            if missing := [name for name in wanted if name not in there]:
                has = ", ".join(there) or "none"
                raise InputError(f"--{option} {given}: no run has {missing[0]}; there is {has}")
            runs = runs[runs[option].isin(wanted)].reset_index(drop=True)
    with threadpool_limits(1):  # matrices this small gain nothing from more
        parameters = _range_of(runs, own) if own and not a.interval else _intervals(a.interval, own)
        emulator = fit_emulator(runs, parameters, Similarity.of(declared, parameters), a.reference)
        found = unexplained(emulator)
    write_emulator(a.out, emulator)
    if a.json:
        print_json(_described(emulator) | {"unexplained": [asdict(one) for one in found]})
        return _code(found)
    out = results_console()
    _print_emulator(out, emulator, found)
    if dropped := len(runs) - len(emulator.runs):
        out.print(f"{dropped} run(s) that broke were left out", highlight=False)
    out.print(f"Written to {a.out}", highlight=False, soft_wrap=True)
    return _code(found)


def _code(found: Sequence[Unexplained]) -> int:
    least = {one.trust for one in found}
    return next(code for trust, code in CODES.items() if trust in least)


def validate(a: Namespace) -> int:
    """Hold an emulator against runs that it was not fitted to."""
    if a.out is not None and a.out.suffix not in (".png", ".svg"):
        raise InputError(f"--out {a.out}: the figure is written as .png or .svg")
    emulator = read_emulator(a.emulator)
    with threadpool_limits(1):
        # What may be refused comes first: the fits take minutes.
        fresh = (
            None
            if a.fresh is None
            else fresh_points(emulator, _read_runs(a.fresh, emulator.similarity.quantities))
        )
        summary = [] if fresh is None else fresh_summary(fresh)
        singles, found = left_out(emulator), unexplained(emulator)
        folded = cross_validated(emulator, a.folds)
    tables = {"left_out": coverage(singles), "cross_validated": coverage(folded)}
    if a.out is not None:
        _write_figure(a.out, emulator, singles, fresh)
    if a.json:
        lists: dict[str, object] = {name: table.to_dict("records") for name, table in tables.items()}
        lists |= {"fresh": [asdict(of) for of in summary], "unexplained": [asdict(one) for one in found]}
        print_json(lists | {"version": emulator.version})
        return _code(found)
    out = results_console()
    _print_emulator(out, emulator, found)
    titles = {
        "left_out": "Runs predicted without their point",
        "cross_validated": f"Runs predicted by new fits, {a.folds} folds",
    }
    for name, coverages in tables.items():
        table = Table("response", "fidelity", "runs", "inside 95 %", "rms error", title=titles[name])
        for line in coverages.itertuples():
            inside = f"{line.inside} ({line.share:.1%})"
            table.add_row(str(line.response), str(line.fidelity), str(line.runs), inside, f"{line.error:.3g}")
        out.print(table)
    if summary:
        columns = ("response", "points", "inside 95 %", "rms error", "noise taken off", "noise of a run")
        table = Table(*columns, title="Means at fresh points")
        for of in summary:
            numbers = (f"{value:.3g}" for value in (of.rms_error, of.error, of.noise))
            table.add_row(of.response, str(of.points), str(of.inside), *numbers)
        out.print(table)
    return _code(found)
    if a.out is not None:
        out.print(f"Figure: {a.out}", highlight=False, soft_wrap=True)


def _run(a: Namespace, design: Sequence[Line], own: Model | None = None) -> pd.DataFrame | None:
    """Write a design into ``--out`` and run it; None where ``--dry-run`` only asks what that would cost."""
    fixed = load_plan().fixed
    costs = {
        key: (own or load_model(fixed, *key)).expected_seconds
        for key in {(x.fidelity, x.variant) for x in design}
    }
    path = a.out / DESIGN
    there = read_design(path, own=own) if path.exists() else []
    if left := set(map(_key, there)) - set(map(_key, design)):
        raise InputError(
            f"{path} is another design: it holds {_in_words(there)}, asked for are {_in_words(design)}, "
            f"without {len(left)} of its runs; choose another --out, or ask for what it holds and more"
        )
    if a.dry_run:
        seconds = sum(costs[x.fidelity, x.variant] for x in design)
        counts = {f: sum(x.fidelity == f for x in design) for f, _ in sorted(costs)}
        if a.json:
            print_json({"runs": counts, "core_hours_expected": round(seconds / 3600, 2)})
        else:
            said = ", ".join(f"{count} at {name or 'one fidelity'}" for name, count in counts.items())
            wait = duration(seconds / (a.workers or cores()))
            results_console().print(
                f"{len(design)} DEM runs ({said}): about {seconds / 3600:.1f} core-hours, {wait} with "
                f"{a.workers or cores()} worker(s). Nothing was run.",
                highlight=False,
                soft_wrap=True,
            )
        return None
    write_design(path, design, own)
    return run_design(design, a.out, a.liggghts, a.workers, own=own)


def _in_words(design: Sequence[Line]) -> str:
    """Number of runs, fidelities, variants and first seed of a design."""
    at = " and ".join(sorted({f"{line.fidelity}, {line.variant}" for line in design}))
    return f"{len(design)} runs ({at}; first seed {design[0].seed})"


def _key(line: Line) -> tuple[object, ...]:
    return line.label, line.fidelity, line.variant, line.seed, *line.parameters.items()


def _print_runs(a: Namespace, table: pd.DataFrame) -> None:
    failed = int((table["outcome"] != "ok").sum())
    if a.json:
        print_json({"runs": len(table), "failed": failed, "table": str(a.out / RUNS)})
    else:
        said = f"{len(table)} runs, {failed} not ok: {a.out / RUNS}"
        results_console().print(said, highlight=False, soft_wrap=True)


def _read_runs(path: Path, quantities: Quantities) -> pd.DataFrame:
    """Runs of a sweep's directory or table, or a study's samples; InputError for anything else."""
    if (path / SETTINGS_FILE).is_file():
        return _samples(path, quantities)
    file = path / RUNS if path.is_dir() else path
    try:
        with open_parquet(file) as opened:
            table = opened.read()
    except FileNotFoundError as error:
        raise InputError(f"{path} holds no runs; make them: calstudy emulator sample --out {path}") from error
    except (OSError, ValueError) as error:
        raise StoreError(f"{file} is damaged; restore it, or run its design again") from error
    if missing := sorted({column.name for column in sweep_columns(quantities)} - set(table.schema.names)):
        raise InputError(f"{file} is no table of a sweep: {missing[0]} is missing; name another")
    return table.to_pandas()


def _samples(study: Path, quantities: Quantities) -> pd.DataFrame:
    """A study's samples as runs of a sweep; InputError for a study of another model.

    The later runs are left out: an optimiser chose them by what the earlier ones had answered.
    """
    runs = read_study(study).evaluations
    runs = runs[runs["phase"] == Phase.SAMPLING].copy()
    runs["label"] = [f"row {row}, sample {k}" for row, k in zip(runs["row"], runs["index"], strict=True)]
    names = [column.name for column in sweep_columns(quantities)]
    if missing := sorted(set(names) - set(runs)):
        raise InputError(f"{study} is a study of another model: {missing[0]} is missing; name another")
    return runs[names]


def _described(emulator: Emulator) -> dict[str, object]:
    """An emulator for machines."""
    return {
        "version": emulator.version,
        **asdict(emulator.origin),
        "runs": emulator.runs["fidelity"].value_counts().to_dict(),
        "responses": {
            r.name: {
                "members": [asdict(member.settings) for member in r.process.members],
                "off": list(r.off),
                "jumps": r.region is not None,
            }
            for r in emulator.responses
        },
    }


def _print_emulator(out: Console, emulator: Emulator, found: Sequence[Unexplained]) -> None:
    """Say what an emulator is, what it found, and where it says nothing."""
    origin = emulator.origin
    counts = emulator.runs["fidelity"].value_counts()
    said = ", ".join(f"{counts[name]} at {name}" if name else f"{counts[name]} runs" for name in counts.index)
    which = origin.model
    if origin.fidelity:
        which += f" (deck {origin.deck}, {origin.variant}) at {origin.fidelity} fidelity"
    say = out.print
    say(
        f"emulator {emulator.version}: {which}, from {said}, {origin.engine}",
        highlight=False,
        soft_wrap=True,
    )
    units = {r.name: r.unit for r in emulator.similarity.responses}
    centre = np.full((1, emulator.box.dimension), 0.5)
    for response in emulator.responses:
        mean, sd = response.process.mean_and_sd(centre)
        noise = response.process.noise_sd(centre)
        unit = units.get(response.name, "-")
        say(
            f"  {response.name}: {mean[0]:.4g} {unit} (sd {sd[0]:.2g}) at the centre of the box; "
            f"noise of a run {noise[0]:.2g} {unit}",
            highlight=False,
        )
        if response.region is not None:
            say(
                f"  {response.name} JUMPS: {len(response.off)} run(s) left the branch that most lie on; "
                "near them nothing is emulated",
                highlight=False,
            )
        elif response.off:
            strays = emulator.runs[emulator.runs["run_id"].isin(response.off)]["label"]
            say(
                f"  {response.name}: {', '.join(strays)} lie off the branch, too few to say where it ends",
                highlight=False,
            )
    for words in filter(None, (one.in_words for one in found)):
        say(f"  {words}", highlight=False, soft_wrap=True, markup=False)


def _write_figure(
    path: Path, emulator: Emulator, predicted: pd.DataFrame, fresh: pd.DataFrame | None
) -> None:
    kind = path.suffix.removeprefix(".")
    sink = io.BytesIO()
    with rc_context({"svg.hashsalt": "calstudy"}):
        metadata = {"Date": None} if kind == "svg" else {}
        validation_figure(emulator, predicted, fresh).savefig(sink, format=kind, dpi=150, metadata=metadata)
    try:
        write_atomically(path, sink.getvalue())
    except OSError as error:
        raise SetupError(f"{path}: cannot be written: {error.strerror}; choose another --out") from error
