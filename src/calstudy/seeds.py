"""Seeds by place, so that neither order nor parallelism nor an interruption changes a number."""

from __future__ import annotations

import numpy as np

from calstudy.records import Phase

_STREAM = {Phase.SAMPLING: 1, Phase.START: 2, Phase.JACOBIAN: 3, Phase.TRIAL: 4}
_DESIGN = 0


def design_generator(study_seed: int, row: int) -> np.random.Generator:
    """Generator of a row's Latin hypercube."""
    return np.random.default_rng(np.random.SeedSequence(study_seed, spawn_key=(row, _DESIGN)))


def run_seed(study_seed: int, row: int, phase: Phase, index: int) -> int:
    """Seed of one DEM run of its own, a positive 31-bit integer."""
    return _draw(np.random.SeedSequence(study_seed, spawn_key=(row, _STREAM[phase], index)))


def study_run_seed(study_seed: int) -> int:
    """The one seed of all DEM runs of a study, as in the authors' decks."""
    return _draw(np.random.SeedSequence(study_seed))


def _draw(sequence: np.random.SeedSequence) -> int:
    return int(sequence.generate_state(1, np.uint32)[0] >> 1) + 1
