"""Writes the designs of the comparison of DEM programs, and says how they were run.

    python reports/cross_code/designs.py
    calstudy sweep reports/cross_code/lammps/design.csv --out reports/cross_code/lammps \\
        --model angle_of_repose_lammps --fidelity coarse
    calstudy sweep reports/cross_code/yade/design.csv --out reports/cross_code/yade \\
        --model angle_of_repose_yade --fidelity tiny
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from calstudy.calibration.sampling import maximin_optimised
from calstudy.models.find import NOISE_FILE, model_folder
from calstudy.models.folder import load_folder
from calstudy.models.heap import REFERENCE
from calstudy.parameters import Box
from calstudy.plan_file import load_plan
from calstudy.study.sweep import Line, write_design

HERE = Path(__file__).parent
POINTS, REFERENCE_SEEDS, CORNER_SEEDS = 30, 8, 3


def line(label: str, fidelity: str, seed: int, parameters: Mapping[str, float]) -> Line:
    """One run; these models have no variants."""
    return Line(label, fidelity, "", seed, {name: float(value) for name, value in parameters.items()})


def over_the_box() -> list[Line]:
    """The reference point with its seeds, and points that fill the plan's box."""
    box = Box.of(load_plan().parameters)
    filling = maximin_optimised(POINTS, box.dimension, np.random.default_rng(np.random.SeedSequence(2017)))
    points = [dict(zip(box.names, box.from_unit(u), strict=True)) for u in filling]
    seeds = range(1, REFERENCE_SEEDS + 1)
    return [line("reference", "coarse", seed, REFERENCE) for seed in seeds] + [
        line(f"box-{k:02d}", "coarse", 1, point) for k, point in enumerate(points)
    ]


def corners() -> list[Line]:
    """The points of the shipped heap's noise.csv at tiny."""
    with (model_folder("angle_of_repose") / NOISE_FILE).open() as file:
        points = [point for point in csv.DictReader(file) if point["fidelity"] == "tiny"]
    return [
        line(point["label"], "tiny", seed, {name: float(point[name]) for name in REFERENCE})
        for seed in range(1, CORNER_SEEDS + 1)
        for point in points
    ]


if __name__ == "__main__":
    for code, design in (("lammps", over_the_box()), ("yade", corners())):
        own = load_folder(model_folder(f"angle_of_repose_{code}"), fidelity=design[0].fidelity)
        write_design(HERE / code / "design.csv", design, own)
