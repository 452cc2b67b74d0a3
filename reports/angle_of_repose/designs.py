"""Writes the designs of the model's measurements, each as DIR/design.csv for `calstudy sweep`.

    python reports/angle_of_repose/designs.py
    calstudy sweep reports/angle_of_repose/noise/design.csv --out reports/angle_of_repose/noise

Seeds are the same at every point and for every fidelity and variant, so that comparisons are paired.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calstudy.calibration.sampling import maximin_optimised
from calstudy.models.heap import REFERENCE
from calstudy.parameters import Box
from calstudy.plan_file import load_plan
from calstudy.study.sweep import DESIGN_COLUMNS

HERE = Path(__file__).parent
PARAMETERS = load_plan().parameters
LOWER = {p.name: p.lower for p in PARAMETERS}
UPPER = {p.name: p.upper for p in PARAMETERS}

# The four corners are a half fraction of those of MU_PP, RF_PP and the particle-wall frictions; density
# and stiffness, which the responses hardly feel, go along so that each takes both its ends.
CORNERS = {
    "reference": REFERENCE,
    "low": {**LOWER, "DENS": UPPER["DENS"]},
    "sliding": {**LOWER, "MU_PP": UPPER["MU_PP"], "MU_PW": UPPER["MU_PW"], "YM": UPPER["YM"]},
    "rolling": {**LOWER, "RF_PP": UPPER["RF_PP"], "RF_PW": UPPER["RF_PW"], "YM": UPPER["YM"]},
    "high": {**UPPER, "YM": LOWER["YM"]},
}
# Seeds at each point, by fidelity; the expensive ones at fewer.
NOISE_SEEDS = {"tiny": 8, "coarse": 8, "soft": 8, "full": 4, "fast": 4}

# Each against `ring` at the reference point.
CHOICES = ("ring", "steel_walls", "slow_pour", "fast_pour", "more_beads", "edge", "steady_lift")
CHOICE_SEEDS = 8

PLATES = ("ring", "plate_55", "plate_60", "plate_75", "wide")
PLATE_POINTS = 30


def noise() -> Iterator[tuple[object, ...]]:
    """Seed-to-seed scatter and bias of the fidelities at the reference point and four corners."""
    for fidelity, seeds in NOISE_SEEDS.items():
        for seed in range(1, seeds + 1):
            for label, parameters in CORNERS.items():
                if label == "reference" or fidelity != "full":
                    yield label, fidelity, "ring", seed, *parameters.values()


def choices() -> Iterator[tuple[object, ...]]:
    """What the paper leaves open, one at a time, at the reference point."""
    for seed in range(11, 11 + CHOICE_SEEDS):
        for variant in CHOICES:
            yield "reference", "soft", variant, seed, *REFERENCE.values()


def plate() -> Iterator[tuple[object, ...]]:
    """The whole box, on each plate."""
    box = Box.of(PARAMETERS)
    design = maximin_optimised(PLATE_POINTS, len(box.names), np.random.default_rng(2017))
    lower, upper = np.array(box.lower), np.array(box.upper)
    for k, u in enumerate(design):
        for variant in PLATES:
            yield f"point-{k:02d}", "soft", variant, 101 + k, *map(float, lower + u * (upper - lower))


if __name__ == "__main__":
    for name, lines in (("noise", noise), ("choices", choices), ("plate", plate)):
        (HERE / name).mkdir(exist_ok=True)
        with (HERE / name / "design.csv").open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(DESIGN_COLUMNS)
            writer.writerows(lines())
