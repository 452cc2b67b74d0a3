"""Every peer on the open benchmark: the one command behind reports/benchmark.

    python compare.py --out runs --report ../../reports/benchmark --workers 2
    python compare.py --out quick --quick
    python compare.py --out ../../reports/benchmark --lines ../../reports/benchmark/lines.parquet

Runs what is not in ``--out`` yet, scores all of it against `robust`, and writes ``lines.parquet`` (a line for
each problem and budget), ``tables.md`` and ``curves.png``. ``--quick`` takes two problems of two challenges
and 16 runs: enough to see that every peer works. ``--only`` takes some of the methods.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from calstudy.analysis.exhibit import Table, render
from calstudy.emulator.benchmark.campaign import Piece, run
from calstudy.emulator.benchmark.challenges import CHALLENGES
from calstudy.emulator.benchmark.scores import losses, score_table
from calstudy.report.benchmark import LOSSES, NOTES, learning_curves, score_tables

HERE = Path(__file__).parent
ALL = tuple(one.name for one in CHALLENGES)


@dataclass(frozen=True)
class Group:
    """Methods that work on the same challenges."""

    methods: tuple[str, ...]
    challenges: tuple[str, ...] = ALL
    seeds: int = 20
    budgets: tuple[float, ...] = (16.0, 32.0, 64.0)


INFORMED = ("informed:sobol", "informed:cma_es", "informed:optuna_tpe", "informed:dfo_ls")
GROUPS = (
    Group(("robust", "paper", "sobol", "random")),
    Group(("peers:cma_es", "peers:optuna_tpe", "peers:dfo_ls", "peers:least_squares")),
    Group(("robust_two",), ("two_fidelities",)),
    Group(INFORMED, ("six", "six_weighted", "row", "beyond", "noisy")),
    Group(("peers:grainlearning",), ("six", "six_weighted", "row")),
    Group(("peers:optuna_gp", "informed:optuna_gp"), ("six",), 8, (16.0, 32.0)),
    Group(("peers:skopt_gp", "peers:botorch_scalar"), ("six",), 8, (16.0, 32.0)),
    Group(("peers:botorch_composite", "peers:botorch_batch"), ("six",), 8, (16.0, 32.0)),
)
"""Gaussian processes take up to half a minute a problem with 32 runs, and all others a second or two. So they
have the main challenge alone, and eight problems."""
QUICK = Group(tuple(method for group in GROUPS for method in group.methods), ("six", "failing"), 2, (16.0,))


def pieces_of(groups: Sequence[Group], only: Sequence[str]) -> list[Piece]:
    """The pieces of groups, of some methods or of all."""
    return [
        Piece(method, challenge, tuple(range(1, group.seeds + 1)), group.budgets)
        for group in groups
        for challenge in group.challenges
        for method in group.methods
        if not only or method in only
    ]


def markdown(table: Table) -> str:
    """A table in Markdown, under its title."""
    head = [column.heading for column in table.columns]
    rows = [head, ["---"] * len(head), *table.cells()]
    return "\n".join([f"## {table.title}", "", *(f"| {' | '.join(row)} |" for row in rows), ""])


def tables(scores: pd.DataFrame) -> str:
    """The page of all scores, in Markdown."""
    beaten = Table("losses", "Where a method beats the first one", losses(scores), LOSSES)
    parts = [
        "# The open benchmark in numbers",
        "",
        "Made by `compare.py`; [the page](README.md) says more.",
        "",
    ]
    parts += [*NOTES, "", *map(markdown, [beaten, *score_tables(scores)])]
    return "\n".join(parts)


def write(lines: pd.DataFrame, report: Path) -> None:
    """Write the lines, their scores and the picture."""
    report.mkdir(parents=True, exist_ok=True)
    scores = score_table(lines)
    lines.to_parquet(report / "lines.parquet", index=False)
    (report / "tables.md").write_text(tables(scores))
    (report / "curves.png").write_bytes(render(learning_curves(scores), ("png",))["png"])


def main() -> None:
    """Run, score, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="what has been run is kept here")
    parser.add_argument("--report", type=Path, help="where tables and picture go (default: --out)")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", type=lambda text: text.split(","), default=[], metavar="METHODS")
    parser.add_argument("--quick", action="store_true", help="at most five minutes")
    parser.add_argument("--lines", type=Path, help="run nothing, score this file of lines")
    a = parser.parse_args()
    sys.path.insert(0, str(HERE))  # for peers, here and in the processes
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(HERE), os.environ.get("PYTHONPATH"))))
    pieces = pieces_of((QUICK,) if a.quick else GROUPS, a.only)
    lines = pd.read_parquet(a.lines) if a.lines else run(pieces, a.out, a.workers, threading.Event(), said)
    write(lines, a.report or a.out)
    spent = lines.groupby(["method", "challenge", "seed"])["cpu_time"].first().sum()
    print(f"{len(lines)} lines; the methods took {spent / 60:.1f} minutes of processor time")


def said(done: int, of: int, piece: Piece) -> None:
    """Say which piece has ended."""
    print(f"{done} of {of}: {piece.method} on {piece.challenge}", flush=True)


if __name__ == "__main__":
    main()
