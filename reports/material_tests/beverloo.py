"""Beverloo's law over a wide range of openings: the discharge of the draw-down in cylinders of one shape.

    python reports/material_tests/beverloo.py

writes reports/material_tests/draw_down/beverloo.csv: opening in m, seed, bulk density in kg/m3, rate in
kg/s in each tenth of the filling between 0.1 and 0.4 of it, processor time. Beads of 10 mm; cylinder and
filling grow with the opening, and YM in proportion, so that the overlaps stay what they are. Runs that are
there already are not repeated; then the law is fitted with the exponents 2, 5/2 and 3, and with the exponent
free.
"""

from __future__ import annotations

import csv
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from calstudy.engines.choose import profile_of
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LOG, markers
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder

TABLE = Path(__file__).parent / "draw_down" / "beverloo.csv"
OPENINGS = ((0.05, 3), (0.065, 2), (0.085, 1), (0.11, 1), (0.15, 1))
"""Diameters in m with the number of seeds; wide ones scatter less, for more beads pass."""
CYLINDER, FILLING = 2.5, 1.5
"""Diameter of the cylinder and fill height over the opening."""
TENTHS = (0.1, 0.2, 0.3, 0.4)
"""Shares of the filling that have passed, between which the rates are taken."""
END = "variable over equal (${calm}>=4)*${slow}\n"
SOON = "variable over equal ${now}<(0.58*${filled})\n"
BEAD, GRAVITY = 0.01, 9.81
LONGEST = 120.0
"""Processor time in s that a run is expected to take at most."""


def run(opening: float, seed: int) -> dict[str, str]:
    """One line of the table; the run ends when 0.42 of the filling has passed."""
    model = load_folder(
        SHIPPED / "draw_down",
        insist=True,
        fidelity="tiny",
        changes={
            "opening_diameter": opening,
            "cylinder_diameter": CYLINDER * opening,
            "fill_height": FILLING * opening,
            "plate_diameter": 0.02,  # all beads fall past it
        },
    )
    script = model.files[model.script].decode()
    if END not in script:
        raise SystemExit("the script ends its discharge in another way than before")
    files = {**model.files, model.script: script.replace(END, SOON).encode()}
    model = replace(model, files=files, expected_seconds=LONGEST)
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch) / "run"
        engine = ProgramEngine(model, profile_of().find(None))
        stiff = dict(model.reference) | {"YM": model.reference["YM"] * opening / OPENINGS[0][0]}
        done = engine.run(stiff, seed, directory, threading.Event())
        of = markers(directory / LOG)
        time, mass = np.loadtxt(directory / "discharge.txt").T
    filling = float(of["bulk_density"]) * np.pi / 4 * (CYLINDER * opening) ** 2 * FILLING * opening
    passed = np.interp(np.array(TENTHS) * filling, mass, time)
    rates = np.diff(np.array(TENTHS) * filling) / np.diff(passed)
    return {
        "opening": f"{opening:g}",
        "seed": str(seed),
        "bulk_density": of["bulk_density"],
        **{f"rate_{low:g}": f"{rate:.5g}" for low, rate in zip(TENTHS, rates, strict=False)},
        "rate": f"{(TENTHS[-1] - TENTHS[0]) * filling / (passed[-1] - passed[0]):.5g}",
        "cpu_time": f"{done.cpu_time:.1f}",
    }


def fit(lines: list[dict[str, str]], exponent: float | None) -> tuple[float, float, float, float]:
    """C, k, exponent n and the relative residual of W = C rho sqrt(g) d^(5/2) (D/d - k)^n; None for a free
    n."""
    wide = np.array([float(line["opening"]) for line in lines]) / BEAD
    density = np.array([float(line["bulk_density"]) for line in lines])
    rate = np.log(np.array([float(line["rate"]) for line in lines]) / (density * GRAVITY**0.5 * BEAD**2.5))

    def off(x: np.ndarray) -> np.ndarray:
        return x[0] + (exponent or x[2]) * np.log(wide - x[1]) - rate

    start = [-0.5, 1.0] + ([] if exponent else [2.5])
    found = least_squares(off, start, bounds=([-9, -20, 0][: len(start)], [9, 4.9, 9][: len(start)]))
    spread = float(np.sqrt(np.sum(found.fun**2) / (len(rate) - len(start))))
    return float(np.exp(found.x[0])), float(found.x[1]), float(exponent or found.x[2]), spread


def main() -> None:
    """Run what is not in the table yet, and fit."""
    lines = list(csv.DictReader(TABLE.open())) if TABLE.exists() else []
    done = {(line["opening"], line["seed"]) for line in lines}
    for opening, seeds in OPENINGS:
        for seed in range(1, seeds + 1):
            if (f"{opening:g}", str(seed)) in done:
                continue
            lines.append(run(opening, seed))
            print(*lines[-1].values(), flush=True)
            with TABLE.open("w", newline="") as file:
                writer = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
                writer.writeheader()
                writer.writerows(lines)
    for exponent in (2.0, 2.5, 3.0, None):
        print("C {:.3g}, k {:.3g}, exponent {:.3g}: residual {:.2%}".format(*fit(lines, exponent)))


if __name__ == "__main__":
    main()
