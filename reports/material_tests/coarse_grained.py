"""A cohesive powder coarse-grained and not: whole tests whose simulated beads are 1.5 real ones wide, and
one.

    python reports/material_tests/coarse_grained.py

writes reports/material_tests/coarse_grained.csv: test, coarse-graining factor, seed, outcome, responses,
processor time. Real beads have 6.7 mm, simulated ones 10 mm or 6.7 mm. Runs that are there already are not
repeated.
"""

from __future__ import annotations

import csv
import tempfile
import threading
from pathlib import Path

from calstudy.engines.choose import profile_of
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Model
from calstudy.models.angle_of_repose import shipped_model
from calstudy.models.find import DEFAULT_MODEL, SHIPPED
from calstudy.models.folder import load_folder
from calstudy.models.material.folder import of_material
from calstudy.models.material.heap import heap_of
from calstudy.models.material.material import Material

TABLE = Path(__file__).parent / "coarse_grained.csv"
DIAMETER, FACTORS, SEEDS = 0.00667, (1.5, 1.0), (1,)
TESTS = {
    "shear_cell": ({"speed": 0.04}, 3e5),
    "uniaxial_compression": ({"lid_speed": 0.02}, 3e5),
    "angle_of_repose": ({}, 3e5),
}
"""Test, its apparatus (faster than shipped, to the cost of no response) and CED_PP in J/m3."""
COLUMNS = ("test", "coarse_graining", "seed", "outcome", "response", "value", "cpu_time")


def model(name: str, factor: float) -> Model:
    """A test at its tiny fidelity with the powder."""
    material = Material(diameter=DIAMETER, coarse_graining=factor, cohesion="sjkr2")
    if name == DEFAULT_MODEL:
        return heap_of(shipped_model("tiny"), material, {})
    return of_material(load_folder(SHIPPED / name, fidelity="tiny", changes=TESTS[name][0]), material)


def main() -> None:
    """Run what is not in the table yet."""
    lines = list(csv.DictReader(TABLE.open())) if TABLE.exists() else []
    done = {(line["test"], line["coarse_graining"], line["seed"]) for line in lines}
    for seed in SEEDS:
        for name, (_, ced) in TESTS.items():
            for factor in FACTORS:
                if (name, f"{factor:g}", str(seed)) in done:
                    continue
                one = model(name, factor)
                point = dict(one.reference) | {"CED_PP": ced, "CED_PW": 0.0}
                with tempfile.TemporaryDirectory() as scratch:
                    engine = ProgramEngine(one, profile_of().find(None))
                    run = engine.run(point, seed, Path(scratch) / "run", threading.Event())
                for response, value in run.responses.items():
                    if response != "rayleigh_time_step":
                        cells = (
                            name,
                            f"{factor:g}",
                            seed,
                            run.outcome,
                            response,
                            f"{value:.6g}",
                            f"{run.cpu_time:.1f}",
                        )
                        lines.append(dict(zip(COLUMNS, map(str, cells), strict=True)))
                print(name, factor, seed, run.outcome, run.reason, f"{run.cpu_time:.1f} s", flush=True)
                with TABLE.open("w", newline="") as file:
                    writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
                    writer.writeheader()
                    writer.writerows(lines)


if __name__ == "__main__":
    main()
