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

import numpy as np
import pandas as pd

from calstudy.analysis.exhibit import Column, Table, render
from calstudy.emulator.benchmark.campaign import Piece, run
from calstudy.emulator.benchmark.challenges import CHALLENGES
from calstudy.emulator.benchmark.scores import interval, losses, score_table
from calstudy.report.benchmark import COLUMNS, LOSSES, NOTES, learning_curves, score_tables

HERE = Path(__file__).parent
ALL = tuple(one.name for one in CHALLENGES)


@dataclass(frozen=True)
class Group:
    """Methods that work on the same challenges."""

    methods: tuple[str, ...]
    challenges: tuple[str, ...] = ALL
    seeds: int = 20
    budgets: tuple[float, ...] = (16.0, 32.0, 64.0)


RING = ("six_weighted", "row", "corner", "beyond", "noisy", "quiet")
"""Challenges of the heap at `full` on the ring, beside the main one."""
INFORMED = ("informed:sobol", "informed:cma_es", "informed:optuna_tpe", "informed:dfo_ls")
GROUPS = (
    Group(("robust", "robust_together", "paper", "sobol", "random")),
    Group(("peers:cma_es", "peers:optuna_tpe", "peers:dfo_ls", "peers:least_squares")),
    Group(("robust_two",), ("two_fidelities",)),
    Group(INFORMED, ("six", *RING)),
    Group(("peers:grainlearning",), ("six", "six_weighted", "row")),
    Group(("peers:optuna_gp", "informed:optuna_gp"), ("six",), 8, (16.0, 32.0)),
    Group(("peers:skopt_gp", "peers:botorch_scalar"), ("six",), 8, (16.0, 32.0)),
    Group(("peers:botorch_composite", "peers:botorch_batch"), ("six",), 8, (16.0, 32.0)),
    Group(("peers:botorch_composite",), RING, 8, (16.0,)),
)
"""Gaussian processes take up to half a minute a problem with 32 runs, and all others a second or two. So they
have eight problems, and but for the best of them the main challenge alone."""
MAIN = ("six", "six_weighted", "row", "corner")
"""Challenges whose claims are counted together: targets in reach and at the edge, and the paper's."""
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


def last(lines: pd.DataFrame) -> pd.DataFrame:
    """Lines of the largest budget that a method had on a challenge."""
    return lines[lines["budget"] == lines.groupby(["method", "challenge"])["budget"].transform("max")]


def few_against_all(lines: pd.DataFrame, reference: str = "robust") -> pd.DataFrame:
    """Scores of the reference with its smallest budget, and of all others with their largest."""
    few = lines[(lines["method"] == reference) & (lines["budget"] == lines["budget"].min())]
    both = pd.concat([few, last(lines[lines["method"] != reference])])
    return score_table(both.assign(budget=0.0), reference)  # scored together, whatever their budgets


def claims(lines: pd.DataFrame) -> pd.DataFrame:
    """How often a method said "within tolerance" on the main challenges, and how often that was false.

    ``surprise``, ``low`` and ``high``: root mean square of its surprises on all challenges, with the
    interval.
    """
    table = []
    for method, group in last(lines).groupby("method", sort=False):
        main = group[group["challenge"].isin(MAIN)]
        said = main["said_within"].fillna(False).astype(bool)
        false, squares = said & ~main["is_within"], group["surprise"].dropna().to_numpy() ** 2
        line = {"method": method, "n": len(main), "within": int(main["is_within"].sum())}
        line |= {"said": int(said.sum()), "false": int(false.sum()), "surprises": len(squares)}
        line["share"] = false.sum() / said.sum() if said.any() else np.nan
        line["surprise"] = np.sqrt(squares.mean()) if len(squares) else np.nan
        line["low"], line["high"] = np.sqrt(interval(squares))
        table.append(line)
    return pd.DataFrame(table)


FEW = (Column("challenge", "challenge"), *COLUMNS[:7])
CLAIMS = (
    *(Column("method", "method"), Column("n", "answers", "d"), Column("within", "truly within", "d")),
    *(Column("said", "said within", "d"), Column("false", "falsely", "d"), Column("share", "share", ".0%")),
    *(Column("surprises", "doubts told", "d"), Column("surprise", "surprise", ".2f", "low", "high")),
)


def tables(lines: pd.DataFrame, scores: pd.DataFrame) -> str:
    """The page of all scores, in Markdown."""
    pairs = scores[scores["worse_by"].notna()]
    beaten = Table("losses", "Where a method beats the first one", losses(scores), LOSSES)
    few = Table("few", "16 runs of robust beside all runs of the others", few_against_all(lines), FEW)
    said = Table("claims", f"What was said on {', '.join(MAIN)}, and all doubts", claims(lines), CLAIMS)
    parts = [
        "# The open benchmark in numbers",
        "",
        "Made by `compare.py`; [the page](README.md) says more.",
        "",
    ]
    count = f"{len(pairs.groupby(['method', 'challenge']))} pairs of a method and a challenge"
    parts += [*NOTES, "", f"Beside the first on the same problems: {count}.", ""]
    parts += map(markdown, [beaten, few, said, *score_tables(scores)])
    return "\n".join(parts)


def write(lines: pd.DataFrame, report: Path) -> None:
    """Write the lines, their scores and the picture."""
    report.mkdir(parents=True, exist_ok=True)
    scores = score_table(lines)
    lines.to_parquet(report / "lines.parquet", index=False)
    (report / "tables.md").write_text(tables(lines, scores))
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
