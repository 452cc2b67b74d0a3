"""A line of the journal of a study: one evaluation, with a checksum."""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from calstudy.records import Beads, Evaluation, Outcome, Phase, Request, Run
from calstudy.study.schema import BEAD_COUNTS

RUN_NUMBERS = ("wall_time", "cpu_time", "radius", "height", "engine_time_step", "simulated_time")
"""Numbers of a run that may be NaN, which is null in a line."""
RUN_TEXTS = ("reason", "host", "finished_at")


def encode(evaluation: Evaluation) -> bytes:
    """Line of an evaluation: CRC-32 in hexadecimal, a space, JSON, newline."""
    text = json.dumps(_to_json(evaluation), separators=(",", ":")).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def decode(line: bytes) -> Evaluation | None:
    """Evaluation of a line without its newline; None if the line is damaged."""
    checksum, _, text = line.partition(b" ")
    if checksum != b"%08x" % zlib.crc32(text):
        return None
    return _from_json(json.loads(text))


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


def _from_json(data: Mapping[str, Any]) -> Evaluation:
    request, run = dict(data["request"]), dict(data["run"])
    for name in RUN_NUMBERS:
        run[name] = math.nan if run[name] is None else run[name]
    run["responses"] = {k: math.nan if v is None else v for k, v in run["responses"].items()}
    counts = run["beads"]
    run["beads"] = Beads(**{n: counts[k] for k, n in BEAD_COUNTS.items()}) if counts else None
    packed = run.pop("heap")
    run["positions"] = _unpack(packed) if packed else None
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
    return np.frombuffer(zlib.decompress(base64.b64decode(text)), np.float32).reshape(-1, 3)
