"""Contacts of a bead in the bed of the uniaxial compression, under the largest stress.

    python reports/material_tests/contacts.py

writes reports/material_tests/uniaxial_compression/contacts.csv: seed, largest stress in Pa, mean number of
contacts of the beads that are a bead and more off the walls, solid fraction, moduli in Pa, processor time. At
tiny fidelity, no friction at the wall, the lid at 20 mm/s. Runs that are there already are not repeated.
"""

from __future__ import annotations

import csv
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from calstudy.engines.choose import profile_of
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import read_positions
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder

TABLE = Path(__file__).parent / "uniaxial_compression" / "contacts.csv"
STRESSES, SEEDS = (2.5e4, 5e4, 1e5, 2e5), (1, 2)
DUMP = """label loaded
dump loaded all custom 1 loaded.dump id x y z
dump_modify loaded format "%d %.12g %.12g %.12g"
run 0
undump loaded
"""
OFF = 1.2
"""Bead diameters that a bead which is counted keeps from walls, base and lid."""


def contacts(points: np.ndarray, diameter: float, cell_radius: float) -> float:
    """Mean number of contacts of the inner beads among ``points`` (n, 3), in m."""
    pairs = cKDTree(points).query_pairs(diameter, output_type="ndarray")
    count = np.bincount(pairs.ravel(), minlength=len(points))
    radius, height = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
    margin = OFF * diameter
    inner = (radius < cell_radius - margin) & (height > margin) & (height < height.max() - margin)
    return float(count[inner].mean())


def run(stress: float, seed: int) -> dict[str, str]:
    """One line of the table."""
    model = load_folder(
        SHIPPED / "uniaxial_compression",
        fidelity="tiny",
        changes={"lid_speed": 0.02, "largest_stress": stress},
    )
    script = model.files[model.script].decode().replace("label loaded\n", DUMP)
    model = replace(model, files={**model.files, model.script: script.encode()})
    diameter, cell = model.fixed["bead_diameter"], model.fixed["cell_diameter"] / 2
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch) / "run"
        engine = ProgramEngine(model, profile_of().find(None))
        done = engine.run(dict(model.reference) | {"MU_PW": 0.0}, seed, directory, threading.Event())
        points = read_positions(directory / "loaded.dump")
    height = points[:, 2].max() + diameter / 2
    fraction = len(points) * np.pi / 6 * diameter**3 / (np.pi * cell**2 * height)
    return {
        "seed": str(seed),
        "largest_stress": f"{stress:g}",
        "contacts": f"{contacts(points, diameter, cell):.4g}",
        "solid_fraction": f"{fraction:.4g}",
        "loading_modulus": f"{done.responses['loading_modulus']:.4g}",
        "unloading_modulus": f"{done.responses['unloading_modulus']:.4g}",
        "cpu_time": f"{done.cpu_time:.1f}",
    }


def main() -> None:
    """Run what is not in the table yet."""
    lines = list(csv.DictReader(TABLE.open())) if TABLE.exists() else []
    done = {(line["seed"], line["largest_stress"]) for line in lines}
    for seed in SEEDS:
        for stress in STRESSES:
            if (str(seed), f"{stress:g}") in done:
                continue
            lines.append(run(stress, seed))
            print(*lines[-1].values(), flush=True)
            with TABLE.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
                writer.writeheader()
                writer.writerows(lines)


if __name__ == "__main__":
    main()
