"""Heaps of clumps: pairs of spheres of one volume, from a sphere to a rod, without rolling friction.

    python reports/material_tests/clumps.py

writes reports/material_tests/clumps.csv: length of the pair over the diameter of its spheres, seed,
outcome, angle of repose in deg, bulk density in kg/m3, processor time. Particles have the volume of a
sphere of 8.5 mm; with RF_PP and RF_PW 0 it is their shape alone that keeps them from rolling. Runs that are
there already are not repeated.
"""

from __future__ import annotations

import csv
import tempfile
import threading
from pathlib import Path

from calstudy.engines.choose import profile_of
from calstudy.engines.engine import ProgramEngine
from calstudy.models.angle_of_repose import shipped_model
from calstudy.models.material.clump import Clump, clump
from calstudy.models.material.heap import heap_of
from calstudy.models.material.material import Material

TABLE = Path(__file__).parent / "clumps.csv"
DIAMETER, ASPECTS, SEEDS = 0.0085, (1.0, 1.3, 1.6), (1,)


def pair(aspect: float) -> Clump:
    """Two spheres whose length is ``aspect`` times their diameter, with the volume of a sphere of
    DIAMETER."""
    unit = clump([[0, 0, 0, 1.0], [aspect - 1, 0, 0, 1.0]])
    return unit.grown(DIAMETER / unit.diameter)


def main() -> None:
    """Run what is not in the table yet."""
    lines = list(csv.DictReader(TABLE.open())) if TABLE.exists() else []
    done = {(line["aspect"], line["seed"]) for line in lines}
    for seed in SEEDS:
        for aspect in ASPECTS:
            if (f"{aspect:g}", str(seed)) in done:
                continue
            material = Material(diameter=DIAMETER) if aspect == 1 else Material(clump=pair(aspect))
            model = heap_of(shipped_model("tiny"), material, {})
            point = dict(model.reference) | {"RF_PP": 0.0, "RF_PW": 0.0}
            with tempfile.TemporaryDirectory() as scratch:
                engine = ProgramEngine(model, profile_of().find(None))
                run = engine.run(point, seed, Path(scratch) / "run", threading.Event())
            lines.append(
                {
                    "aspect": f"{aspect:g}",
                    "seed": str(seed),
                    "outcome": str(run.outcome),
                    "angle_of_repose_deg": f"{run.responses['angle_of_repose_deg']:.4g}",
                    "bulk_density": f"{run.responses['bulk_density']:.5g}",
                    "cpu_time": f"{run.cpu_time:.1f}",
                }
            )
            print(*lines[-1].values(), flush=True)
            with TABLE.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
                writer.writeheader()
                writer.writerows(lines)


if __name__ == "__main__":
    main()
