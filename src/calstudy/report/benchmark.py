"""The benchmark's scores for people: tables on the terminal, a page with the learning curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from rich.console import Console

from calstudy.analysis.exhibit import Column, Picture, Table, render, to_csv
from calstudy.disk.files import write_atomically
from calstudy.emulator.benchmark.challenges import challenge
from calstudy.errors import SetupError
from calstudy.report.page import page
from calstudy.report.terminal import Column as TerminalColumn
from calstudy.report.terminal import fitted

PANELS = 3
"""Panels beside each other."""
MARKERS = "osD^v<>Pp*X"
COLOURS = (*(f"C{k}" for k in range(10)), "black", "gold")
COLUMNS = (
    Column("method", "method"),
    Column("n", "problems", "d"),
    Column("paid", "runs", ".1f"),
    Column("excess", "excess", ".2g", "excess_low", "excess_high"),
    Column("worse_by", "beside the first", "+.1g", "worse_low", "worse_high"),
    Column("within", "within", ".0%"),
    Column("said_falsely", "falsely said", ".0%"),
    Column("surprise", "surprise", ".1f"),
    Column("rounds", "rounds", ".0f"),
    Column("cpu_time", "CPU s", ".2g"),
    Column("failures", "failures", "d"),
)
LOSSES = (Column("challenge", "challenge"), Column("budget", "budget", ".0f"), *COLUMNS[:6])
"""Columns of the lines of methods that beat the first one."""
NOTES = (
    "runs: what the answer had cost, in runs of the fidelity that counts. excess: noise-free cost of "
    "the answer above the least of the box (mean, 95 % interval). beside the first: difference of the "
    "excess to that of the first method on the same problems. within: share of problems whose responses "
    "are all truly within tolerance. falsely said: share of the answers said to be within tolerance "
    "that are not. surprise: root mean square of what the answers deviate from what the method expected, in "
    "its own standard deviations; 1 is honest. rounds: batches of at most eight runs at once that the "
    "answer had cost. failures: "
    "problems without an answer, or in which the method raised an error.",
)


def score_tables(scores: pd.DataFrame) -> list[Table]:
    """A table for each challenge and budget."""
    tables = []
    for (name, budget), group in scores.groupby(["challenge", "budget"], sort=False):
        title = f"{name}, {budget:g} runs: {challenge(str(name)).meaning}"
        tables.append(Table(f"{name}-{budget:g}", title, group.reset_index(drop=True), COLUMNS))
    return tables


def learning_curves(scores: pd.DataFrame) -> Figure:
    """Excess over the budget, a panel for each challenge, with the intervals of the means.

    Where some challenges have several methods, those that have one are left out.
    """
    rivals = scores.groupby("challenge", sort=False)["method"].nunique()
    challenges = list(rivals.index[rivals > 1] if (rivals > 1).any() else rivals.index)
    methods = list(dict.fromkeys(scores["method"]))
    lines = -(-len(challenges) // PANELS)
    figure = Figure(figsize=(4.0 * PANELS, 3.0 * lines + 0.8), layout="constrained")
    panels = np.ravel(figure.subplots(lines, PANELS, squeeze=False))
    for axes, name in zip(panels, challenges, strict=False):
        of = scores[scores["challenge"] == name]
        for k, method in enumerate(methods):
            one = of[of["method"] == method].sort_values("budget")
            x = one["budget"].to_numpy() * (1.0 + 0.02 * (k - len(methods) / 2))  # side by side
            reach = one[["excess_low", "excess_high"]].clip(lower=1e-7).to_numpy().T
            style = {
                "marker": MARKERS[k % len(MARKERS)],
                "color": COLOURS[k % len(COLOURS)],
                "lw": 2.0 if k == 0 else 1.0,
            }
            axes.plot(x, one["excess"].clip(lower=1e-7), label=method, ms=4, **style)
            axes.vlines(x, *reach, color=style["color"], lw=0.8)
        axes.set(xscale="log", yscale="log", title=name, xlabel="budget in runs", ylabel="excess")
        axes.set_xticks(sorted(set(of["budget"])), [f"{b:g}" for b in sorted(set(of["budget"]))])
        axes.minorticks_off()
    for axes in panels[len(challenges) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(methods), 5), frameon=False)
    return figure


def print_scores(console: Console, scores: pd.DataFrame) -> None:
    """Print the tables on the terminal."""
    for table in score_tables(scores):
        columns = [
            TerminalColumn(column.heading, list(cells), right=bool(column.form))
            for column, cells in zip(table.columns, zip(*table.cells(), strict=True), strict=True)
        ]
        for shown in fitted(columns, console.width, table.title):
            console.print(shown)
    console.print(NOTES[0], highlight=False)


def write_scores(directory: Path, scores: pd.DataFrame, made_by: str) -> list[Path]:
    """Write ``scores.csv``, ``curves.png`` and ``report.html``; SetupError where that cannot be done."""
    tables = score_tables(scores)
    notes = ("Mean noise-free cost above the least of the box, with its 95 % interval.",)
    curves = Picture("curves", "Learning curves", render(learning_curves(scores), ("svg", "png")), notes)
    lead = "Every method on the same problems: what it reached for the runs that it paid."
    methods = ", ".join(dict.fromkeys(scores["method"]))
    html = page("Benchmark of calibrators", lead, {"methods": methods, "made by": made_by}, [curves, *tables])
    whole = Table("scores", "Scores", scores, COLUMNS)
    contents = {
        "scores.csv": to_csv(whole).encode(),
        "curves.png": curves.files["png"],
        "report.html": html.encode(),
    }
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_atomically(directory / name, content, directory)
    except OSError as error:
        raise SetupError(f"{directory}: cannot be written: {error.strerror}; choose another --out") from error
    return [directory / name for name in contents]
