"""The command ``benchmark``: calibrators on the same emulated problems."""

from __future__ import annotations

import os
import shlex
import sys
from argparse import Namespace
from pathlib import Path

from calstudy import __version__
from calstudy.cli.terminal import messages_console, print_json, results_console, stop_on_signals
from calstudy.emulator.benchmark.campaign import Piece, run
from calstudy.emulator.benchmark.challenges import CHALLENGES, challenge
from calstudy.emulator.benchmark.scores import score_table
from calstudy.engines.queue import cores
from calstudy.report.benchmark import print_scores, write_scores

BUDGETS = (16.0, 32.0, 64.0)


def benchmark(a: Namespace) -> None:
    """Let methods work on the challenges, and score them."""
    here = str(Path.cwd())
    sys.path.insert(0, here)  # a method's module is looked for where the command is run, as Python does
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    methods = list(dict.fromkeys(a.method.split(",")))
    challenges = [one.name for one in CHALLENGES] if a.challenge is None else a.challenge.split(",")
    seeds = tuple(range(1, a.seeds + 1))
    pieces = [
        Piece(method, challenge(name).name, seeds, BUDGETS) for name in challenges for method in methods
    ]
    console = messages_console()

    def say(done: int, of: int, piece: Piece) -> None:
        console.print(f"{done} of {of}: {piece.method} on {piece.challenge}", highlight=False, soft_wrap=True)

    with stop_on_signals(console) as stop:
        lines = run(pieces, a.out, a.workers or cores(), stop, say)
    scores = score_table(lines, methods[0])
    command = shlex.join(["calstudy", "benchmark", "--method", a.method, "--seeds", str(a.seeds)])
    written = write_scores(a.out, scores, f"calstudy {__version__}: {command}")
    if a.json:
        print_json({"scores": scores.to_dict("records"), "written": [str(path) for path in written]})
        return
    out = results_console()
    print_scores(out, scores)
    for path in written:
        out.print(f"  {path}", highlight=False, soft_wrap=True)
