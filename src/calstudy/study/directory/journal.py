"""A line of the journal of a study: one evaluation, with a checksum."""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calstudy.disk.files import open_to_read
from calstudy.records import Beads, Evaluation, Outcome, Phase, Request, Run
from calstudy.study.schema import BEAD_COUNTS

RUN_NUMBERS = ("wall_time", "cpu_time", "radius", "height", "engine_time_step", "simulated_time")
"""Numbers of a run that may be NaN, which is null in a line."""
LARGEST_HEAP = 240e6
"""Bytes of a heap: twenty million beads."""
MOST_EXPANSION, SMALLEST_HEAP = 50, 1_000_000
"""A heap is at most so many times larger than what it is packed to, and so many bytes."""
LONGEST_LINE = 400_000_000
"""Bytes of a line; the rest of a longer one counts as damaged lines."""
_UNKNOWN = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError, zlib.error)
RUN_TEXTS = ("reason", "host", "finished_at")


def encode(evaluation: Evaluation, study: str = "") -> bytes:
    """Line of an evaluation: CRC-32 in hexadecimal, a space, JSON, newline. ``study`` is its study's id."""
    owner = {"study": study} if study else {}
    text = json.dumps({**owner, **_to_json(evaluation)}, separators=(",", ":")).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def decode(line: bytes) -> Evaluation | None:
    """Evaluation of a line without its newline; None if the line is damaged, or what it says is not known."""
    owned = _decoded(line)
    return None if owned is None else owned[1]


def _decoded(line: bytes, heaps: bool = True) -> tuple[str, Evaluation] | None:
    """Id of the study that a line names, "" where it names none, and its evaluation."""
    checksum, _, text = line.partition(b" ")
    if checksum != b"%08x" % zlib.crc32(text):
        return None
    try:
        data = json.loads(text)
        return data.get("study", ""), _from_json(data, heaps)
    except _UNKNOWN:
        return None


@dataclass(frozen=True, slots=True)
class Kept:
    """What a journal holds."""

    evaluations: tuple[Evaluation, ...] = ()
    damaged: int = 0
    """Lines that are damaged, or not known to this version of calstudy."""
    foreign: int = 0
    """Lines that name another study."""


def read_journal(path: Path, study: str = "", heaps: bool = True) -> Kept:
    """What a journal holds, line by line; nothing if there is none. ``study`` is the id of its study.

    Without ``heaps`` the evaluations have none, which saves time and memory.
    """
    evaluations: list[Evaluation] = []
    damaged = foreign = 0
    try:
        file = open_to_read(path)
    except FileNotFoundError:
        return Kept()
    with file:
        while line := file.readline(LONGEST_LINE):
            if line == b"\n":
                continue
            found = _decoded(line.removesuffix(b"\n"), heaps)
            if found is None:
                damaged += 1
            elif study and found[0] not in ("", study):
                foreign += 1
            else:
                evaluations.append(found[1])
    return Kept(tuple(evaluations), damaged, foreign)


def _to_json(evaluation: Evaluation) -> dict[str, Any]:
    request, run = evaluation.request, evaluation.run
    return {
        "request": {**asdict(request), "phase": str(request.phase)},
        "run_id": evaluation.run_id,
        **({"model_hash": evaluation.model_hash} if evaluation.model_hash else {}),
        "run": {
            "outcome": str(run.outcome),
            "responses": {k: _or_none(v) for k, v in run.responses.items()},
            **{k: _or_none(getattr(run, k)) for k in RUN_NUMBERS},
            **{k: getattr(run, k) for k in RUN_TEXTS},
            "beads": {k: getattr(run.beads, n) for k, n in BEAD_COUNTS.items()} if run.beads else None,
            # Of a sample too: the second optimisation may start there, and shares the run.
            "heap": None if run.positions is None else _pack(run.positions),
        },
    }


def _from_json(data: Mapping[str, Any], heaps: bool) -> Evaluation:
    request, run = dict(data["request"]), dict(data["run"])
    for name in RUN_NUMBERS:
        run[name] = math.nan if run[name] is None else run[name]
    run["responses"] = {k: math.nan if v is None else v for k, v in run["responses"].items()}
    counts = run["beads"]
    run["beads"] = Beads(**{n: counts[k] for k, n in BEAD_COUNTS.items()}) if counts else None
    packed = run.pop("heap")
    run["positions"] = _unpack(packed) if packed and heaps else None
    return Evaluation(
        Request(**{**request, "phase": Phase(request["phase"])}),
        data["run_id"],
        Run(**{**run, "outcome": Outcome(run["outcome"])}),
        data.get("model_hash", ""),
    )


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value


def _pack(positions: Any) -> str:
    return base64.b64encode(zlib.compress(np.ascontiguousarray(positions, np.float32).tobytes())).decode()


def _unpack(text: str) -> Any:
    packed = base64.b64decode(text)
    most = min(LARGEST_HEAP, MOST_EXPANSION * len(packed) + SMALLEST_HEAP)
    unpacking = zlib.decompressobj()
    content = unpacking.decompress(packed, int(most))
    if not unpacking.eof:
        raise ValueError("a heap is larger than any that is stored")
    return np.frombuffer(content, np.float32).reshape(-1, 3)
