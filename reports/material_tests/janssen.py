"""Janssen's law in a tall column: the cell of the uniaxial compression, filled seven times as high as wide.

    python reports/material_tests/janssen.py

The wall is drawn upwards slowly, so that friction is mobilised everywhere in one direction. The forces of the
wall and the base are averaged over the second half of its way; over the first the column dilates. Writes
reports/material_tests/uniaxial_compression/janssen.csv: a line for each slice with MU_PW, seed, depth of its
middle in m, vertical stress there, normal and shear stress on the wall (Pa); and for each run one with depth
"base", whose normal stress is that on the base and whose vertical stress is the weight over the area. Runs
that are there already are not repeated.
"""

from __future__ import annotations

import csv
import math
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

TABLE = Path(__file__).parent / "uniaxial_compression" / "janssen.csv"
DIAMETER, HEIGHT, YM, GRAVITY = 0.05, 0.35, 5e6, 9.81
"""Of the cell in m; a soft bead in Pa, for the stresses are below 2 kPa."""
POINTS = ((0.2, 1), (0.0, 1), (0.1, 1), (0.4, 1), (0.2, 2))
"""MU_PW and seeds."""
SLICES, SPEED, WAY, FRAMES = 14, 0.01, 0.03, 60
LID = "# ---- the lid comes down"
COLUMN = f"""
unfix cell
unfix base
fix cell all wall/gran model ${{contact}} primitive type 2 zcylinder ${{R}} 0. 0. &
    shear z {SPEED} store_force yes
fix base all wall/gran model ${{contact}} primitive type 2 zplane 0.0 store_force yes
variable way equal ceil({WAY}/{SPEED}/${{dt}})
variable each equal floor(${{way}}/{FRAMES})
dump wall all custom ${{each}} wall.dump id x y z &
    f_force_cell[1] f_force_cell[2] f_force_cell[3] f_force_base[3]
run ${{way}}
undump wall
print "calstudy: column_mass ${{bead_mass}}"
print "calstudy: finished"
"""


def run(mu_pw: float, seed: int, diameter: float = DIAMETER, height: float = HEIGHT) -> list[dict[str, str]]:
    """The lines of one run; the column's dimensions in m."""
    model = load_folder(
        SHIPPED / "uniaxial_compression",
        insist=True,
        fidelity="tiny",
        changes={"cell_diameter": diameter, "fill_height": height},
    )
    script = model.files[model.script].decode().partition(LID)[0] + COLUMN
    model = replace(model, files={**model.files, model.script: script.encode()})
    parameters = dict(model.reference) | {"MU_PW": mu_pw, "YM": YM}
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch) / "run"
        engine = ProgramEngine(model, profile_of().find(None))
        done = engine.run(parameters, seed, directory, threading.Event())
        mass = float(markers(directory / LOG)["column_mass"])
        frames = [
            np.array(text.partition("ITEM: ATOMS")[2].partition("\n")[2].split(), float).reshape(-1, 8)[:, 1:]
            for text in (directory / "wall.dump").read_text().split("ITEM: TIMESTEP")[1:]
        ]
    print(f"MU_PW {mu_pw:g}, seed {seed}: {len(frames[-1])} beads, {done.cpu_time:.1f} s", flush=True)
    found = profile(frames[len(frames) // 2 :], mass, diameter)
    return [{"MU_PW": f"{mu_pw:g}", "seed": str(seed), **line} for line in found]


def profile(frames: list[np.ndarray], mass: float, diameter: float) -> list[dict[str, str]]:
    """Stresses over the depth, from frames of x, y, z, the wall's force on each bead, the base's on it.

    The vertical stress at a depth is the weight above it less what the wall carries of it, over the area.
    """
    area = math.pi / 4 * diameter**2
    top = float(np.mean([frame[:, 2].max() for frame in frames]))
    edges = np.linspace(0, top, SLICES + 1)
    sums = np.zeros((3, SLICES))
    base = 0.0
    for frame in frames:
        depth = top - frame[:, 2]
        outward = -(frame[:, 0] * frame[:, 3] + frame[:, 1] * frame[:, 4]) / np.hypot(
            frame[:, 0], frame[:, 1]
        )
        for k, weight in enumerate((np.full(len(frame), mass * GRAVITY), outward, frame[:, 5])):
            sums[k] += np.histogram(depth, edges, weights=weight)[0] / len(frames)
        base += frame[:, 6].sum() / len(frames)
    weight, normal, up = sums
    at_edge = np.concatenate([[0.0], np.cumsum(weight - up)]) / area
    ring = math.pi * diameter * np.diff(edges)
    lines = [
        (f"{edges[k : k + 2].mean():.5g}", at_edge[k : k + 2].mean(), normal[k] / ring[k], up[k] / ring[k])
        for k in range(SLICES)
    ]
    lines.append(("base", weight.sum() / area, base / area, up.sum() / area))
    return [
        {
            "depth": depth,
            "vertical": f"{vertical:.5g}",
            "normal": f"{on_wall:.5g}",
            "shear": f"{along:.5g}",
        }
        for depth, vertical, on_wall, along in lines
    ]


def fit(depth: np.ndarray, vertical: np.ndarray) -> tuple[float, float]:
    """Stress (Pa) at great depth and the length (m) in which it is reached, by least squares."""

    def off(x: np.ndarray) -> np.ndarray:
        return x[0] * (1 - np.exp(-depth / x[1])) - vertical

    found = least_squares(off, [vertical.max(), DIAMETER], x_scale=[vertical.max(), DIAMETER])
    return float(found.x[0]), float(found.x[1])


def summary(lines: list[dict[str, str]], diameter: float) -> dict[str, float]:
    """What a run says of Janssen's law.

    ``base``: share of the weight that the base bears; ``K``: stress on the wall over the vertical stress;
    ``mobilised``: shear over normal stress on the wall. With these two, the law reaches ``law_stress`` (Pa)
    in a length of ``law_length`` (m), and the profile ``stress`` in ``length``. Not without friction.
    """
    *slices, base = lines
    inner = slices[1:-1]  # the surface and the base disturb a slice each
    depth, vertical, normal, shear = (
        np.array([float(line[key]) for line in inner]) for key in ("depth", "vertical", "normal", "shear")
    )
    ratio, mobilised = float(np.sum(normal) / np.sum(vertical)), float(np.sum(shear) / np.sum(normal))
    found = {"base": float(base["normal"]) / float(base["vertical"]), "K": ratio, "mobilised": mobilised}
    if mobilised <= 0:
        return found
    top = float(slices[-1]["depth"]) + float(slices[0]["depth"])
    length = diameter / (4 * mobilised * ratio)
    stress, reached = fit(depth, vertical)
    return found | {
        "law_stress": float(base["vertical"]) / top * length,
        "law_length": length,
        "stress": stress,
        "length": reached,
    }


def main() -> None:
    """Run what is not in the table yet, and fit each run."""
    lines = list(csv.DictReader(TABLE.open())) if TABLE.exists() else []
    done = {(line["MU_PW"], line["seed"]) for line in lines}
    for mu_pw, seed in POINTS:
        if (f"{mu_pw:g}", str(seed)) in done:
            continue
        lines += run(mu_pw, seed)
        with TABLE.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(lines)
    for mu_pw, seed in POINTS:
        of = [line for line in lines if (line["MU_PW"], line["seed"]) == (f"{mu_pw:g}", str(seed))]
        found = summary(of, DIAMETER)
        print(f"MU_PW {mu_pw:g}, seed {seed}: " + ", ".join(f"{k} {v:.4g}" for k, v in found.items()))


if __name__ == "__main__":
    main()
