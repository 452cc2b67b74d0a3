"""Runs by which the material tests are proven: each series changes one thing at the tiny fidelity.

    python reports/material_tests/proofs.py NAME [SERIES ...]

writes reports/material_tests/NAME/proofs.csv: series, what was changed, seed, outcome, responses, processor
time. Runs that are there already are not repeated. The model's NOTES.md says what each series shows.
"""

from __future__ import annotations

import csv
import sys
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

from calstudy.engines.choose import profile_of
from calstudy.engines.engine import ProgramEngine
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder
from calstudy.models.material.folder import of_material
from calstudy.models.material.material import Material

HERE = Path(__file__).parent
SMOOTH = {"MU_PP": 0.0, "MU_PW": 0.0, "RF_PP": 0.0, "RF_PW": 0.0}
Changes = dict[str, float]

DRAW_DOWN: dict[str, list[Changes]] = {
    "opening": [
        {"opening_diameter": x, "cylinder_diameter": 0.16, "fill_height": 0.1}
        for x in (0.050, 0.055, 0.060, 0.065, 0.070)
    ],
    "fill": [{"fill_height": x} for x in (0.07, 0.1)],
    "plate": [{"plate_diameter": x} for x in (0.1, 0.2)],
    "gravity": [{"gravity": x, "YM": 5.06e8 * x / 9.81} for x in (9.81, 39.24)],
    "density": [{"DENS": x, "YM": 5.06e8 * x / 2500} for x in (2500.0, 5000.0)],
    "friction": [{"MU_PP": x} for x in (0.1, 0.3, 0.5)],
}
ROTATING_DRUM: dict[str, list[Changes]] = {
    "froude": [
        {"slow_turns": 0.02, "fast_turns": 0.4, "fast_froude": x} for x in (0.0005, 0.002, 0.01, 0.04)
    ],
    "gravity": [{"gravity": x} for x in (9.81, 39.24)],
    "density": [{"DENS": 2500.0 * x} for x in (4.0, 16.0)],
    "time_step": [{"time_step_share": 0.25, "gravity": x} for x in (9.81, 39.24)],
    "scale": [
        {"bead_diameter": x * 0.01, "drum_diameter": x * 0.15, "drum_width": x * 0.05, "YM": x * 5.06e8}
        for x in (1.0, 2.0)
    ],
    "fill": [{"fill_fraction": x, "fast_turns": 0.02} for x in (0.3, 0.4, 0.5)],
    "friction": [{"MU_PP": x, "fast_turns": 0.02} for x in (0.1, 0.3, 0.5)],
    "smooth": [
        {**SMOOTH, "fast_turns": 0.001, "slow_turns": turns, "slow_froude": x}
        for x, turns in ((1e-2, 0.3), (1e-3, 0.3), (1e-4, 0.1), (1e-5, 0.05), (1e-6, 0.03))
    ],
    "reversed": [{"reversed": x} for x in (0.0, 1.0)],
}
COMPRESSION: dict[str, list[Changes]] = {
    "speed": [{"lid_speed": x} for x in (0.0025, 0.005, 0.01, 0.02)],
    "density": [{"DENS": 2500.0 * x} for x in (16.0, 256.0)],
    "stiffness": [{"YM": x} for x in (2.53e8, 5.06e8, 1.012e9, 2.024e9)],
    "scale": [
        {"YM": x * 5.06e8, "DENS": x * 2500, "largest_stress": x * 1e5, "seating_stress": x * 2e3}
        for x in (1.0, 2.0)
    ],
    "height": [{"fill_height": x} for x in (0.06, 0.09)],
    "stress": [{"largest_stress": x, "MU_PW": 0.0} for x in (2.5e4, 5e4, 1e5, 2e5)],
}
SHEAR_CELL: dict[str, list[Changes]] = {
    "friction": [{"MU_PP": x} for x in (0.1, 0.4, 0.8)],
    "smooth": [{**SMOOTH, "MU_PW": 0.2}],
    "smooth_speed": [{**SMOOTH, "MU_PW": 0.2, "speed": x} for x in (0.1, 0.5)],
    "wall": [{"MU_PW": x, "preshear_distance": 0.01} for x in (0.3,)],
    "speed": [{"speed": x} for x in (0.04, 0.01)],
    "density": [{"DENS": 2500.0 * x} for x in (16.0, 64.0, 256.0)],
    "size": [{"length": 0.12, "width": 0.08}],
    "reversed": [{"reversed": 1.0}],
    "time_step": [{"time_step_share": x} for x in (0.6,)],
    "cohesion": [{"CED_PP": 1e6, "speed": 0.04}],
}
SERIES = {
    "draw_down": DRAW_DOWN,
    "rotating_drum": ROTATING_DRUM,
    "uniaxial_compression": COMPRESSION,
    "shear_cell": SHEAR_CELL,
}
SEEDS = {"density": (1, 2), "cohesion": (1, 2)}
"""Of the series that have more than the seed 1."""
REVERSED = {
    "rotating_drum": [
        ("shear x ${", "shear x -${"),
        ("axis 0. 1. 0.", "axis 0. -1. 0."),
    ],
    "shear_cell": [
        ("linear -${speed}", "linear +${speed}"),
        ("linear ${speed}", "linear -${speed}"),
        ("linear +${speed}", "linear ${speed}"),
        ("equal f_push[1]", "equal -f_push[1]"),
        ("shear x ${speed}", "shear x -${speed}"),
    ],
}
"""Text of the scripts and what stands there when everything moves the other way."""


def run(name: str, changes: Changes, seed: int) -> dict[str, object]:
    """One run of a test at its tiny fidelity with changed parameters and fixed variables."""
    folder = SHIPPED / name
    is_reversed = bool(changes.get("reversed", 0.0))
    changes = {key: value for key, value in changes.items() if key != "reversed"}
    model = load_folder(folder, fidelity="tiny")
    fixed = {key: value for key, value in changes.items() if key in model.fixed}
    model = load_folder(folder, insist=True, fidelity="tiny", changes=fixed)
    if "CED_PP" in changes:
        model = of_material(model, Material(cohesion="sjkr2"))
    if is_reversed:
        script = model.files[model.script].decode()
        for old, new in REVERSED[name]:
            script = script.replace(old, new)
        model = replace(model, files={**model.files, model.script: script.encode()})
    parameters = dict(model.reference) | {k: v for k, v in changes.items() if k not in fixed}
    with tempfile.TemporaryDirectory() as scratch:
        engine = ProgramEngine(model, profile_of().find(None))
        done = engine.run(parameters, seed, Path(scratch) / "run", threading.Event())
    numbers = {name: f"{value:.6g}" for name, value in done.responses.items() if name != "rayleigh_time_step"}
    return {"outcome": str(done.outcome), **numbers, "cpu_time": f"{done.cpu_time:.2f}"}


def main(name: str, wanted: list[str]) -> None:
    """Run the series of a test that are asked for, or all."""
    path = HERE / name / "proofs.csv"
    there = list(csv.DictReader(path.open())) if path.exists() else []
    done = {(line["series"], line["changes"], line["seed"]) for line in there}
    for series, points in SERIES[name].items():
        for changes in points if not wanted or series in wanted else ():
            for seed in SEEDS.get(series, (1,)):
                said = " ".join(f"{key}={value:g}" for key, value in changes.items())
                if (series, said, str(seed)) in done:
                    continue
                line = {"series": series, "changes": said, "seed": str(seed)} | run(name, changes, seed)
                there.append({key: str(value) for key, value in line.items()})
                print(*there[-1].values(), flush=True)
                with path.open("w", newline="") as file:
                    writer = csv.DictWriter(file, list(there[0]), lineterminator="\n")
                    writer.writeheader()
                    writer.writerows(there)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
