"""Every method on every challenge, seed by seed, in processes; what is finished is kept and never done twice.

    DIR/METHOD/CHALLENGE.parquet    a line for each seed and budget

A method works on a problem once, with the largest budget. Its answer to a smaller one is what it had named,
or run, when it had paid that much.
"""

from __future__ import annotations

import os
import re
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from threadpoolctl import threadpool_limits

from calstudy.disk.files import cannot_write, write_atomically
from calstudy.disk.parquet import open_parquet
from calstudy.emulator.benchmark.challenges import Posed, challenge
from calstudy.emulator.benchmark.methods import method_of
from calstudy.emulator.benchmark.problem import Method, Problem, solve
from calstudy.errors import InputError, SetupError, Stopped, StoreError

LOOK_SECONDS = 0.25
KEPT = 64
"""Problems that a process keeps: the least cost of a box takes a second to find."""
COLUMNS = {
    "method": "string",
    "challenge": "string",
    "seed": "int64",
    "budget": "float64",
    "paid": "float64",
    "excess": "float64",
    "is_within": "bool",
    "said_within": "boolean",
    "surprise": "float64",
    "rounds": "int64",
    "cpu_time": "float64",
    "failure": "string",
}
"""Columns of the lines, with their types. ``paid`` and ``rounds`` are what the answer had cost, in runs of
the fidelity that counts, and in rounds. ``excess``: noise-free cost of the answer less the least of the box;
NaN without an answer. ``said_within`` is missing where nothing was said; ``surprise`` is that of `Named`.
``cpu_time`` (s) is that of the whole work on the problem."""


@dataclass(frozen=True, slots=True)
class Piece:
    """One method on one challenge, with all seeds."""

    method: str
    challenge: str
    seeds: tuple[int, ...]
    budgets: tuple[float, ...]

    def path(self, directory: Path) -> Path:
        """Where its lines are kept."""
        return directory / re.sub(r"[^\w.-]", "-", self.method) / f"{self.challenge}.parquet"


def lines_of(piece: Piece) -> pd.DataFrame:
    """Let a piece's method work on its problems; returns a line for each seed and budget."""
    method = method_of(piece.method)
    lines: list[dict[str, Any]] = []
    for seed in piece.seeds:
        posed = posed_problem(piece.challenge, seed)
        problem = posed.problem(max(piece.budgets))
        started = time.process_time()
        failure = worked(method, problem)
        used = time.process_time() - started
        for budget in piece.budgets:
            answer = problem.answer(budget)
            line = {"method": piece.method, "challenge": piece.challenge, "seed": seed, "budget": budget}
            line |= {"cpu_time": used, "failure": failure}
            line |= {"paid": problem.paid, "rounds": problem.rounds, "excess": np.nan, "surprise": np.nan}
            line |= {"is_within": False, "said_within": pd.NA}
            if answer is not None:
                responses, costs = posed.exact(answer.point[None])
                said = pd.NA if answer.within is None else answer.within
                line |= {"paid": answer.paid, "rounds": answer.rounds, "said_within": said}
                line |= {"excess": float(costs[0]) - posed.least, "surprise": answer.surprise(responses[0])}
                line |= {"is_within": problem.is_within(responses[0])}
            lines.append(line)
    return pd.DataFrame(lines).astype(COLUMNS)[list(COLUMNS)]


@lru_cache(maxsize=KEPT)
def posed_problem(name: str, seed: int) -> Posed:
    """The problem that a seed makes of a challenge, kept for the next method."""
    return challenge(name).pose(seed)


def worked(method: Method, problem: Problem) -> str:
    """Let a method work on a problem; returns the line of an error that it raised, or nothing.

    A method that fails answers with what it had by then: what anybody would do.
    """
    try:
        with threadpool_limits(1):
            solve(method, problem)
    except Exception as error:  # anything: the method is anybody's
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    return ""


def run(
    pieces: Sequence[Piece],
    directory: Path,
    workers: int,
    stop: threading.Event,
    say: Callable[[int, int, Piece], None],
) -> pd.DataFrame:
    """Run the pieces that are not there yet; returns the lines of all.

    Raises Stopped once ``stop`` is set, and InputError for lines of other seeds or budgets.
    """
    missing = [piece for piece in pieces if kept(piece, directory) is None]
    for name in dict.fromkeys(piece.method for piece in missing):
        method_of(name)  # a mistyped name is found before any work
    context = get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin)
    try:
        pending: dict[Future[pd.DataFrame], Piece] = {pool.submit(lines_of, p): p for p in missing}
        while pending:
            ended, _ = wait(pending, timeout=LOOK_SECONDS, return_when=FIRST_COMPLETED)
            for future in ended:
                piece = pending.pop(future)
                keep(future.result(), piece.path(directory))
                say(len(missing) - len(pending), len(missing), piece)
            if stop.is_set():
                raise Stopped("interrupted")
    except BrokenProcessPool as error:
        raise SetupError(
            "a process of the benchmark was ended from outside, for want of memory perhaps; run the same "
            "command again, with fewer --workers"
        ) from error
    finally:
        processes = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes if stop.is_set() else ():
            process.kill()  # a method may take minutes for a step, and what it has is not kept anyway
    return read(pieces, directory)


def _begin() -> None:
    """Begin a process: Ctrl-C is for the first one to hear, and it ends with that one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    while parent is not None and parent.is_alive():
        time.sleep(LOOK_SECONDS)
    os._exit(1)


def keep(lines: pd.DataFrame, path: Path) -> None:
    """Write the lines of a piece, as a whole or not at all; SetupError where that cannot be done."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, lines.to_parquet(index=False))
    except OSError as error:
        raise cannot_write(path, error) from error


def kept(piece: Piece, directory: Path) -> pd.DataFrame | None:
    """Lines of a piece that was run before; InputError for one of other seeds or budgets."""
    path = piece.path(directory)
    if not path.exists():
        return None
    try:
        with open_parquet(path) as file:
            lines = file.read().to_pandas().astype(COLUMNS)
    except (OSError, TypeError, ValueError, KeyError) as error:
        raise StoreError(f"{path} is damaged ({error}); delete it, and run the same command again") from error
    if set(lines["seed"]) != set(piece.seeds) or set(lines["budget"]) != set(piece.budgets):
        raise InputError(f"{path} has other seeds or budgets; choose another --out, or delete it")
    return lines


def read(pieces: Iterable[Piece], directory: Path) -> pd.DataFrame:
    """Lines of pieces that have been run."""
    found = [lines for piece in pieces if (lines := kept(piece, directory)) is not None]
    return pd.concat(found, ignore_index=True)
