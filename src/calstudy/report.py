"""Results for people: tables for the terminal, from a study's tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from calstudy.plan import PARAMETERS, Plan
from calstudy.records import (
    ANGLE_OF_REPOSE,
    BULK_DENSITY,
    MEASURED,
    RAYLEIGH_TIME_STEP,
    RESPONSES,
    STOPPED,
    UNITS,
    Phase,
)
from calstudy.schema import PARAMETER_UNITS
from calstudy.store import StudySettings


def calibration_table(line: Mapping[str, Any], plan: Plan, settings: StudySettings) -> Table:
    """One row's result: intervals, target or twin's truth, Kriging optimum, DEM optimum; 80 columns wide."""
    twin = settings.target.truth
    runs = ", ".join(f"{line[f'runs_{phase}']} {phase}" for phase in Phase)
    table = Table(
        title=f"Row {line['row']}: WRL {line['WRL']:g}, SPP {line['SPP']}, {line['fidelity']} fidelity, "
        f"{line['variant']}, {line['mode']} mode",
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
    for name in PARAMETERS:
        free = line[f"calibrated_{name}"]
        interval = _interval(by_name[name].lower, by_name[name].upper) if free else "constant"
        truth = _short(twin[name]) if twin else ""
        values = [_short(line[f"{prefix}{name}"]) for prefix in ("kriging_", "dem_")]
        table.add_row(name, interval, truth, *values, PARAMETER_UNITS[name], style=None if free else "dim")
    table.add_row()
    table.add_row("", "sampled", "target", style="bold")
    for name in RESPONSES:
        is_measured = name in MEASURED
        target = _short(settings.target.values[name], 5) if is_measured else ""
        ends = (line[f"sampled_{name}_min"], line[f"sampled_{name}_max"]) if is_measured else ()
        values = [_short(line[f"{prefix}{name}"], 5) for prefix in ("kriging_", "dem_")]
        table.add_row(name, _interval(*ends) if ends else "", target, *values, UNITS[name])
    sums = [_short(line[f"{prefix}sum_of_squares"], 3) for prefix in ("kriging_", "dem_")]
    table.add_row("sum of squares", "", "", *sums, "-")
    return table


def _interval(low: float, high: float) -> str:
    return f"[{_short(low)}; {_short(high)}]"


def _short(value: float, digits: int = 4) -> str:
    """A number without the signs and zeros that widen its exponent: 4.175e8, 2.988e-5."""
    return f"{value:.{digits}g}".replace("e+0", "e").replace("e-0", "e-")


def _level(value: float | None) -> str:
    """A factor's level; a calibration of one's own has no SPP."""
    return "" if value is None or math.isnan(value) else f"{value:g}"


def study_table(lines: Sequence[Mapping[str, Any]], settings: StudySettings) -> Table:
    """One line a row."""
    table = Table(caption=f"Target: {settings.target.origin}", title_justify="left", caption_justify="left")
    quantities = settings.quantities
    responses = [*quantities.targeted, RAYLEIGH_TIME_STEP]
    short = {ANGLE_OF_REPOSE: "angle", BULK_DENSITY: "bulk", RAYLEIGH_TIME_STEP: "Rayleigh"}
    values = [f"{short.get(name, name)} {quantities.units[name]}" for name in responses]
    headings = ("row", "WRL", "SPP", "calibrated", *values, "squares", "runs", "")
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("calibrated", "") else "right")
    for line in lines:
        free = " ".join(p for p, _ in quantities.parameters if line[f"calibrated_{p}"])
        cells = [str(line["row"]), *(_level(line[name]) for name in ("WRL", "SPP")), free]
        if line["outcome"] == "ok":
            digits = [5 if name == BULK_DENSITY else 4 for name in responses]
            cells += [f"{line[f'dem_{name}']:.{d}g}" for name, d in zip(responses, digits, strict=True)]
            cells += [f"{line['dem_sum_of_squares']:.2g}", str(line["runs_total"]), ""]
            outside = [n for n in quantities.targeted if not line[f"reachable_{n}"]]
            cells[-1] = "outside: " + ", ".join(outside) if outside else ""
        else:
            cells += [*("" for _ in responses), "", str(line["runs_total"]), f"failed: {line['reason']}"]
        table.add_row(*cells)
    return table


def print_results(
    console: Console,
    lines: Sequence[Mapping[str, Any]],
    plan: Plan,
    settings: StudySettings,
    detailed_up_to: int = 3,
) -> None:
    """Print a table for each of a few rows, or one line a row for many; warnings follow."""
    if len(lines) <= detailed_up_to:
        for line in lines:
            if line["outcome"] == "ok":
                console.print(calibration_table(line, plan, settings))
            else:
                console.print(
                    f"Row {line['row']} failed: {line['reason']}", style="bold red", highlight=False
                )
    else:
        console.print(study_table(lines, settings))
    for warning in warnings(lines):
        console.print(f"WARNING {warning}", style="bold yellow", highlight=False, soft_wrap=True)


def warnings(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """What a reader of the results must not miss, one line each."""
    found = []
    for line in lines:
        if line["outcome"] != "ok":
            continue
        found += [unreachable(line, name) for name in MEASURED if not line[f"reachable_{name}"]]
    return found


def unreachable(line: Mapping[str, Any], name: str) -> str:
    """Warning of a line of the table of calibrations whose target lies outside what was sampled."""
    low, high = line[f"sampled_{name}_min"], line[f"sampled_{name}_max"]
    return (
        f"row {line['row']}: the target {name} = {line[f'target_{name}']:.5g} lies OUTSIDE the "
        f"sampled responses [{low:.5g}; {high:.5g}]: this row's parameters may not reach it"
    )
