"""Why a calibration cannot go on with the study in its directory: what changed, and what a new one costs."""

from __future__ import annotations

import difflib
import itertools
import json
import shlex
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from calstudy.disk.files import content_of
from calstudy.disk.ours import temporary
from calstudy.engines.interface import Engine
from calstudy.errors import StoreError
from calstudy.study.definition import Definition
from calstudy.study.directory.begun import difference, free_name, going_on
from calstudy.study.directory.session import duration
from calstudy.study.directory.store import finished_rows, read_lines
from calstudy.study.reread import keeping, reread
from calstudy.study.run.estimate import estimate
from calstudy.study.run.taking import definition_work, take_over
from calstudy.study.run.work import MODELS_FILE, Work
from calstudy.study.settings import LARGEST, MODEL_CHANGED

SHOWN = 40
"""Characters of a line that are shown."""


def refusal(
    definition: Definition, engines: Sequence[Engine], work: Work, slots: int, any_version: bool = False
) -> StoreError | None:
    """Error if the directory holds another study; None where it holds none, or this one.

    It says what changed down to the lines of a model's files, and what a new study would cost beside it.
    ``slots`` is the number of DEM runs at once; ``any_version`` as in ``difference``.
    """
    directory = work.directory
    changed = difference(directory, work.settings, any_version)
    if not changed:
        return None
    there, now = _models_there(directory), definition.told
    of_models = [
        f"{label}: {told}" for label in now if label in there for told in _changes(there[label], now[label])
    ]
    if of_models:
        changed = [*(told for told in changed if told != MODEL_CHANGED), *of_models]
    free = free_name(directory)
    with temporary() as scratch:
        kept = [keeping(engine, directory.parent) for engine in engines]
        again = reread(kept, directory.parent, (), scratch, threading.Event())
    taken, stored = take_over(definition, engines, free, again)
    middle = definition.task.space.complete(definition.task.space.box.centre)
    seconds = [model.expected_seconds_at(middle) for model, _ in definition.programs]
    new = definition_work(taken, engines, free, stored)
    cost = estimate(new, seconds[: len(definition.models)], slots)
    return StoreError(
        f"{directory} holds a study with other settings: {'; '.join(changed)}. Its {_runs(directory)} "
        f"stay there. To calibrate beside it, add {work.option} {shlex.quote(str(free))}: "
        f"{len(stored.known)} stored run(s) serve, {cost.runs_sampling} sampling run(s) and about "
        f"{cost.runs_optimisation:.0f} of the second optimisation are new, about "
        f"{duration(cost.elapsed_seconds)}. To go on with it, {going_on(directory, work.settings)}"
    )


def _models_there(directory: Path) -> dict[str, Any]:
    """The models with which a study was begun; empty where it does not say."""
    try:
        told: dict[str, Any] = json.loads(content_of(directory / MODELS_FILE, LARGEST))
        return told
    except (OSError, RecursionError, ValueError):
        return {}


def _runs(directory: Path) -> str:
    rows = "result and " if finished_rows(directory) else ""
    try:
        ids = {line["run_id"] for line in read_lines(directory, "evaluations", columns=["run_id"])}
    except StoreError:
        ids = set()
    return f"{rows}{len(ids)} run(s)" if ids else "runs"


def _changes(was: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    """What differs between two descriptions of a model: its files with their lines, then its model.toml."""
    before, after = was["files"], now["files"]
    for name in sorted({*before, *after}):
        if name not in after:
            yield f"{name} is gone"
        elif name not in before:
            yield f"{name} is new"
        elif before[name] != after[name]:
            yield f"{name}, {_lines(before[name], after[name])}"
    flat, flat_now = _flat(was["says"]), _flat(now["says"])
    for name in dict.fromkeys([*flat, *flat_now]):
        old, new = flat.get(name), flat_now.get(name)
        if old != new and not name.endswith(".source"):  # the reader's file was told
            yield f"{name.replace('.', ' ')}: {_shown(old)} → {_shown(new)}"


def _lines(was: str, now: str) -> str:
    """The first group of lines that differs, and how many more there are."""
    before, after = was.splitlines(), now.splitlines()
    matcher = difflib.SequenceMatcher(None, before, after, autojunk=False)
    groups = [group for group in matcher.get_opcodes() if group[0] != "equal"]
    if was.startswith("sha256 ") or now.startswith("sha256 ") or not groups:
        return "changed"
    _, i, i_end, j, j_end = groups[0]
    place = f"line {j + 1}" if j_end - j <= 1 else f"lines {j + 1} to {j_end}"
    old, new = " ".join(before[i:i_end][:1]), " ".join(after[j:j_end][:1])
    more = f" and {len(groups) - 1} more place(s)" if len(groups) > 1 else ""
    same = sum(1 for _ in itertools.takewhile(lambda pair: pair[0] == pair[1], zip(old, new, strict=False)))
    begin = max(same - SHOWN // 2, 0) if max(len(old), len(new)) > SHOWN else 0
    return f"{place}: {_shown(old[begin:] or None)} → {_shown(new[begin:] or None)}{more}"


def _shown(value: Any) -> str:
    if value is None:
        return "none"
    text = value if isinstance(value, str) else json.dumps(value)
    text = " ".join(text.split())
    return f"'{text}'" if len(text) <= SHOWN else f"'{text[:SHOWN]} ...'"


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in content.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat
