"""Whether a material card holds: its optimum is run with fresh seeds, and its targets are tested.

The card says that the mean responses are within what is good enough of their targets. That is the hypothesis;
the level is shared out among the responses. A card holds where the test does not reject it and the means are
within; where they are not, but might be by chance, more seeds decide.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from calstudy.errors import InputError
from calstudy.parameters import Array
from calstudy.report.card.card import Card
from calstudy.study.definition.models import Chosen, chosen_models
from calstudy.tomlfile import Section

LEVEL = 0.05
"""Probability that a card that holds is rejected."""
POWER = 0.9
HASH = "hash"


class Holds(StrEnum):
    """Verdict on a response."""

    YES = "holds"
    NO = "does not hold"
    UNDECIDED = "cannot be decided"


@dataclass(frozen=True, slots=True)
class Verdict:
    """What fresh runs say of one response, in its unit."""

    response: str
    unit: str
    target: float
    good_enough: float
    mean: float
    standard_error: float
    p: float
    """Probability of a mean as far off or farther if the card holds, times the number of responses."""
    would_find: float
    """Deviation beyond what is good enough that the test finds with a probability of `POWER`."""
    verdict: Holds


def models_of(card: Card, folders: Sequence[Path], fidelity: str | None = None) -> tuple[Chosen, ...]:
    """Models of a card, with ``fidelity`` in place of their own; InputError where one is not there."""
    sections = [
        {key: value for key, value in section.items() if key != HASH}
        | ({"fidelity": fidelity} if fidelity is not None else {})
        for section in card.content["models"]
    ]
    asked = (*card.responses, *card.held_out)
    data: dict[str, Any] = {"models": sections, "targets": {name: {} for name in asked}}
    return chosen_models(Section(card.path, data, {}), folders, insist=True)


def changed(card: Card, models: Sequence[Chosen]) -> list[str]:
    """Models whose files, fidelity or fixed inputs are not those of the card."""
    hashes = [section[HASH] for section in card.content["models"]]
    return [chosen.label for chosen, was in zip(models, hashes, strict=True) if chosen.model.hash != was]


def verdicts(
    card: Card, found: Mapping[str, Array], noise: Mapping[str, float], level: float = LEVEL
) -> list[Verdict]:
    """Verdict on each claim of a card, by the values (n,) of its fresh runs.

    ``noise`` is the known standard deviation of a run; a response without one is tested by Student's
    distribution. InputError where there are too few values.
    """
    claims = card.claims
    return [
        _verdict(name, of, found[name], noise.get(name), level / len(claims), len(claims))
        for name, of in claims.items()
    ]


def _verdict(
    name: str, of: Mapping[str, Any], values: Array, noise: float | None, level: float, responses: int
) -> Verdict:
    n = len(values)
    if n < (1 if noise else 2):
        raise InputError(f"{name}: {n} run(s) gave it, which are too few; give more --seeds")
    error = (noise or float(np.std(values, ddof=1))) / math.sqrt(n)
    by = stats.norm if noise else stats.t(n - 1)
    mean, target, good = float(np.mean(values)), float(of["target"]), float(of["good_enough"])
    beyond = abs(mean - target) - good
    p = float(by.sf(beyond / error)) if error > 0 else float(beyond <= 0)
    would_find = float(by.isf(level) + by.isf(1 - POWER)) * error
    verdict = Holds.NO if p < level else Holds.YES if beyond <= 0 else Holds.UNDECIDED
    return Verdict(name, of["unit"], target, good, mean, error, min(1.0, p * responses), would_find, verdict)


def overall(found: Sequence[Verdict]) -> Holds:
    """Whether the whole card holds: the worst verdict."""
    each = {one.verdict for one in found}
    return next((one for one in (Holds.NO, Holds.UNDECIDED) if one in each), Holds.YES)
