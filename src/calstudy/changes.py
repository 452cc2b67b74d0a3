"""What differs between two studies' settings, in words."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

SAID: tuple[tuple[str, str], ...] = (
    (r"target\.values\.(.+)", "the target of {}"),
    (r"case\.definition\.parameters\.(.+)", "{}"),
    (r"case\.definition\.tolerances\.(.+)", "the tolerance of {}"),
    (r"(?:case\.definition\.)?noise\.(.+)", "the noise of {}"),
    (r"case\.definition\.WRL", "WRL"),
    (r"case\.definition\.samples", "the number of samples"),
    (r"budget", "the budget of the second phase"),
    (r"mode", "the mode"),
    (r"seed", "the seed"),
    (r"fidelity", "the fidelity"),
    (r"variant", "the variant"),
    (r"plan", "the plan or file"),
    (r"model", "the model"),
    (r"deck", "the model's deck"),
    (r"engine", "the engine"),
    (r"calstudy", "the version of calstudy"),
    (r"grid", "the grid of the DEM model's parameters"),
    (r"share_samples", "whether rows share samples"),
)
"""Settings by their dotted names, and what they are called."""

IMPLIED: tuple[tuple[str, str], ...] = (
    (
        r"case\.definition\.models\..+|model_hash|case\.models\..+",
        "the model's files or fixed inputs are others",
    ),
    (r"plan_hash", "the plan's rows or definitions are others"),
    (r"target\..+", "the target comes from elsewhere"),
    (r"noise|case\.definition\.noise", "the known noise is another"),
    (r"case\.parameters\..+|case\.responses\..+", "units of parameters or responses are others"),
)
"""Settings that follow from others. They are told where nothing that they follow from has changed."""
CAUSES: Mapping[str, tuple[str, ...]] = {
    "the model's files or fixed inputs are others": (
        "the fidelity",
        "the variant",
        "the model:",
        "the model's deck",
    ),
    "the target comes from elsewhere": ("the target of", "the engine", "the fidelity", "the variant"),
    "the known noise is another": ("the fidelity", "the variant", "the model:", "the mode:", "the noise of"),
}


def changes(was: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Each setting that differs, as "the target of angle_of_repose_deg: 22 → 25"; empty for equal ones.

    ``was`` and ``now`` are settings as a study stores them.
    """
    before, after = _flat(was), _flat(now)
    differing = [name for name in before | after if before.get(name) != after.get(name)]
    told: list[str] = []
    implied: list[str] = []
    for name in differing:
        if subject := _called(name, SAID):
            told.append(_in_words(subject, before.get(name), after.get(name)))
        elif subject := _called(name, IMPLIED):
            implied.append(subject)
        else:
            told.append(_in_words(name, before.get(name), after.get(name)))
    if "case" in was and "case" in now:  # its hash follows from it
        implied = [subject for subject in implied if subject != "the plan's rows or definitions are others"]
    more = [s for s in dict.fromkeys(implied) if not any(t.startswith(CAUSES.get(s, ())) for t in told)]
    return [*told, *more]


def _called(name: str, table: tuple[tuple[str, str], ...]) -> str:
    for pattern, subject in table:
        if found := re.fullmatch(pattern, name):
            return subject.format(*found.groups())
    return ""


def _in_words(subject: str, was: Any, now: Any) -> str:
    if isinstance(was, list) and isinstance(now, list):
        subject = f"the interval of {subject}"
    shown, shown_now = _value(was), _value(now)
    if shown == shown_now:
        shown, shown_now = repr(was), repr(now)
    return f"{subject}: {shown} → {shown_now}"


def _value(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "none"}[value]
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _flat(content: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested content by dotted names."""
    flat: dict[str, Any] = {}
    for name, value in content.items():
        flat |= _flat(value, f"{prefix}{name}.") if isinstance(value, Mapping) else {prefix + name: value}
    return flat
