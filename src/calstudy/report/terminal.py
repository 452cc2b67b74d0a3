"""Results on the terminal, as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.table import Table

from calstudy.disk.ours import kept
from calstudy.plan import PARAMETERS, Plan
from calstudy.records import RAYLEIGH_TIME_STEP, STOPPED
from calstudy.study.directory.session import LOG_FILE
from calstudy.study.settings import StudySettings
from calstudy.study.status import Failure
from calstudy.written import is_missing

IN_SHORT: tuple[Mapping[str, str], Mapping[str, str]] = (
    {
        "response": "",
        "target": "target",
        "tolerance": "tolerance",
        "optimum": "optimum",
        "again": "run again",
        "again_error": "+-",
        "probability": "P(within)",
        "noise": "noise",
        "unit": "unit",
        "verdict": "",
    },
    {
        "parameter": "",
        "interval": "interval",
        "optimum": "optimum",
        "solutions_low": "others\nfrom",
        "solutions_high": "\nto",
        "unit": "unit",
        "remark": "",
    },
)
"""Columns of the tables of responses and parameters of a calibration that tell the most, with their
headings."""


def calibration_table(line: Mapping[str, Any], plan: Plan, settings: StudySettings) -> Table:
    """One row's result, 80 columns wide: intervals, target or truth, Kriging optimum, DEM optimum."""
    twin = settings.target.truth
    runs = ", ".join(f"{line[f'runs_{phase}']} {phase}" for phase in settings.phases)
    table = Table(
        title=f"Row {line['row']}: WRL {line['WRL']:g}, SPP {line['SPP']}, {settings.at}, "
        f"{settings.mode} mode",
        caption=f"Target: {line['target_origin']}\n"
        f"DEM runs: {line['runs_total']} ({runs})\n"
        f"ended on the surrogates: {STOPPED[line['kriging_stop']]}\n"
        f"ended on the DEM model: {STOPPED[line['dem_stop']]}",
        title_justify="left",
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column("", no_wrap=True)
    for heading in ("interval", "twin's\ntruth" if twin else "target", "Kriging\noptimum", "DEM\noptimum"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    by_name = {p.name: p for p in plan.parameters}
    units = settings.quantities.units
    for name in PARAMETERS:
        free = line[f"calibrated_{name}"]
        interval = _interval(by_name[name].lower, by_name[name].upper) if free else "constant"
        truth = _short(twin[name]) if twin else ""
        values = [_short(line[f"{prefix}{name}"]) for prefix in ("kriging_", "dem_")]
        table.add_row(name, interval, truth, *values, units[name], style=None if free else "dim")
    table.add_row()
    table.add_row("", "sampled", "target", style="bold")
    for name in settings.quantities.given:
        if is_missing(line.get(f"dem_{name}")):
            continue  # a response that is no target has no surrogate
        is_measured = name in settings.quantities.targets
        target = _short(settings.target.values[name], 5) if is_measured else ""
        ends = (line[f"sampled_{name}_min"], line[f"sampled_{name}_max"]) if is_measured else ()
        values = [_short(line[f"{prefix}{name}"], 5) for prefix in ("kriging_", "dem_")]
        table.add_row(name, _interval(*ends) if ends else "", target, *values, units[name])
    sums = [_short(line[f"{prefix}sum_of_squares"], 3) for prefix in ("kriging_", "dem_")]
    table.add_row("sum of squares", "", "", *sums, "-")
    return table


def _interval(low: float, high: float) -> str:
    return f"[{_short(low)}; {_short(high)}]"


def _short(value: float, digits: int = 4) -> str:
    """A number with a short exponent: 4.175e8, 2.988e-5."""
    return f"{value:.{digits}g}".replace("e+0", "e").replace("e-0", "e-")


def _digits(value: float) -> int:
    """Digits of a response in a narrow table: four, or five above a thousand, so that a decimal is shown."""
    return 5 if abs(value) >= 1000 else 4


def _level(value: float | None) -> str:
    """A factor's level; empty without one, as for SPP outside a plan."""
    return "" if value is None or value != value else f"{value:g}"


@dataclass(frozen=True, slots=True)
class Column:
    """A column on the terminal."""

    heading: str
    cells: Sequence[str]
    right: bool = True
    folds: bool = False
    """Whether it may be folded between words on a narrow terminal. Numbers and names never are."""

    @property
    def least(self) -> int:
        """Smallest width in characters."""
        texts = [*self.heading.splitlines(), *self.cells]
        return max(
            (cell_len(w) for text in texts for w in (text.split() if self.folds else [text])), default=0
        )


def fitted(columns: Sequence[Column], width: int, title: str = "") -> list[Table]:
    """The columns as a table, or as several below each other if they are wider than the terminal.

    Each table begins with the first column, which identifies the line. Columns without text are left out.
    """
    first, *others = columns
    parts = [[first]]
    for column in others:
        if not any(column.cells):
            continue
        if 1 + sum(c.least + 2 for c in (*parts[-1], column)) > width and len(parts[-1]) > 1:
            parts.append([first])
        parts[-1].append(column)
    tables = []
    for k, part in enumerate(parts):
        table = Table(
            title=title if title and not k else None,
            title_justify="left",
            box=box.SIMPLE_HEAD,
            pad_edge=False,
            padding=(0, 1, 0, 0),
        )
        for c in part:
            table.add_column(c.heading, justify="right" if c.right else "left", no_wrap=not c.folds)
        for cells in zip(*(c.cells for c in part), strict=True):
            table.add_row(*cells)
        tables.append(table)
    return tables


def print_study(console: Console, lines: Sequence[Mapping[str, Any]], settings: StudySettings) -> None:
    """Print a line for each row, why rows failed, and the target."""
    quantities = settings.quantities
    found = [line["outcome"] == "ok" for line in lines]

    def column(name: str, heading: str, digits: int | None = None) -> Column:
        cells = [
            "" if not ok or is_missing(line[name]) else _short(line[name], digits or _digits(line[name]))
            for line, ok in zip(lines, found, strict=True)
        ]
        return Column(heading, cells)

    def remark(line: Mapping[str, Any]) -> str:
        if line["outcome"] != "ok":
            return "failed"
        names = [quantities.short[name] for name in missed(line, settings)]
        return "missed: " + ", ".join(names) if names else ""

    free = [" ".join(p for p, _ in quantities.parameters if line[f"calibrated_{p}"]) for line in lines]
    columns = [
        Column("row", [str(line["row"]) for line in lines]),
        Column("WRL", [f"{line['WRL']:g}" for line in lines]),
        Column("SPP", [_level(line["SPP"]) for line in lines]),
        Column("calibrated", free, right=False, folds=True),
        *(
            column(f"dem_{n}", f"{quantities.short[n]}\n{quantities.units[n]}")
            for n in (*quantities.targeted, RAYLEIGH_TIME_STEP)
        ),
        column("dem_sum_of_squares", "squares", 2),
        Column("runs", [str(line["runs_total"]) for line in lines]),
        Column("", [remark(line) for line in lines], right=False, folds=True),
    ]
    for table in fitted(columns, console.width):
        console.print(table)
    for line in lines:
        _print_failure(console, line)
    console.print(f"Target: {settings.target.origin}", highlight=False, soft_wrap=True)


def _print_failure(console: Console, line: Mapping[str, Any]) -> None:
    """Print why a row failed, if it did."""
    if line["outcome"] != "ok":
        told = f"Row {line['row']} failed: {line['reason']}"
        console.print(told, style="bold red", highlight=False, soft_wrap=True)


def print_results(
    console: Console,
    lines: Sequence[Mapping[str, Any]],
    plan: Plan,
    settings: StudySettings,
    detailed_up_to: int = 3,
) -> None:
    """Print a table for each of a few rows, or a line for each of many; then warnings."""
    if len(lines) <= detailed_up_to:
        for line in lines:
            if line["outcome"] == "ok":
                console.print(calibration_table(line, plan, settings))
            else:
                _print_failure(console, line)
    else:
        print_study(console, lines, settings)
    for line in lines:
        for name in missed(line, settings):
            told = f"WARNING {missed_in_words(line, name)}"
            console.print(told, style="bold yellow", highlight=False, soft_wrap=True)


def missed(line: Mapping[str, Any], settings: StudySettings) -> list[str]:
    """Responses of a row that miss a target out of its reach; empty for a row that failed.

    The Kriging models of the samples do not reach such a target (``solutions.reach``), and it is further from
    the DEM optimum than twice the noise of a run: the noise measured for the model, or else that estimated by
    the row's Kriging models.
    """
    if line["outcome"] != "ok":
        return []
    outside = [name for name in settings.aims(line) if not line[f"reachable_{name}"]]
    if not outside:
        return []
    # Both load scipy, which takes time and is not needed if all targets are within reach.
    from calstudy.calibration.solutions import NOISE_FACTOR
    from calstudy.models.noise import known_noise

    known = known_noise(settings.model, settings.model_hash) or {}
    return [
        name
        for name in outside
        if not abs(line[f"dem_{name}"] - line[f"target_{name}"])
        <= NOISE_FACTOR * known.get(name, line[f"kriging_noise_{name}"])  # which may be NaN
    ]


def missed_in_words(line: Mapping[str, Any], name: str) -> str:
    """A missed target in words, from a row's line of the table of calibrations."""
    low, high = line[f"sampled_{name}_min"], line[f"sampled_{name}_max"]
    return (
        f"row {line['row']}: the target {name} = {line[f'target_{name}']:.5g} is OUT OF REACH (samples: "
        f"{low:.5g} to {high:.5g}, noise included), and the DEM optimum, {line[f'dem_{name}']:.5g}, misses it"
    )


def print_failures(out: Console, directory: Path, found: Sequence[Failure], scratch: Path) -> None:
    """Print which DEM runs gave no responses, and where to look."""
    for f in found:
        out.print(
            f"{f.runs} DEM run(s) {f.outcome.replace('_', ' ')}; the last, of row {f.row}: {f.reason}\n"
            f"  deck and log: {kept(scratch, f.run_id)} on {f.host}; all: {directory / LOG_FILE}",
            style="yellow",
            highlight=False,
            soft_wrap=True,
        )
