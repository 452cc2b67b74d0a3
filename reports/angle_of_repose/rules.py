"""What the rules of the measurement do to the responses, by measuring kept positions again.

    python reports/angle_of_repose/rules.py pour      (pours eight fillings, writes poured.parquet)
    python reports/angle_of_repose/rules.py           (prints the tables)

The picture's resolution and its connectivity: on the heaps of noise/heaps.parquet. Which bead is above the
fill height: on fillings as they were poured, before anything was removed. The deck is run up to there, which
takes a quarter of a run.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from calstudy.engines.engine import write_inputs
from calstudy.engines.liggghts import LIGGGHTS, read_dump
from calstudy.models.angle_of_repose import AngleOfReposeModel, load_model
from calstudy.models.heap import REFERENCE
from calstudy.models.measurement import MID_GREY, measure, measure_heap
from calstudy.models.silhouette import Picture, side_view, top_view
from calstudy.parameters import Array
from calstudy.plan_file import load_plan

HERE = Path(__file__).parent
POURED = HERE / "poured.parquet"
SCRIPT = "in.angle_of_repose"
SEEDS = 8
FIDELITY = "soft"
AXES = ["x", "y", "z"]
FINEST = 24.0
RESOLUTIONS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)


def model() -> AngleOfReposeModel:
    """The model whose positions were kept."""
    return load_model(load_plan().fixed, FIDELITY)


def heaps() -> list[Array]:
    """Bead centres (n, 3) in m of every kept heap of the fidelity."""
    runs = pd.read_parquet(HERE / "noise" / "runs.parquet")
    wanted = runs.loc[runs["fidelity"] == FIDELITY, "run_id"]
    kept = pd.read_parquet(HERE / "noise" / "heaps.parquet")
    return [
        heap[AXES].to_numpy(float)
        for _, heap in kept[kept["run_id"].isin(wanted)].groupby("run_id", sort=False)
    ]


def angles(kept: list[Array], pixels_per_mm: float) -> Array:
    """Angles of repose in deg of the heaps at a resolution."""
    m = model()
    return np.array(
        [
            measure_heap(
                heap,
                m.fidelity.particle_diameter,
                pixels_per_mm=pixels_per_mm,
                sphere_diameter=m.sphere_diameter,
            ).angle_of_repose_deg
            for heap in kept
        ]
    )


def edges_joined(picture: Picture) -> Picture:
    """The picture with what hangs on to its two largest objects by a corner of a pixel wiped away."""
    black = (picture < MID_GREY).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(black, connectivity=4)
    largest = 1 + np.argsort(stats[1:, cv2.CC_STAT_AREA])[-2:]
    return np.where(np.isin(labels, largest), picture, np.uint8(255))


def resolution(kept: list[Array]) -> list[list[str]]:
    """Resolution, and what it does to the angle against the finest: mean, scatter, largest."""
    finest = angles(kept, FINEST)
    rows = []
    for pixels_per_mm in RESOLUTIONS:
        d = angles(kept, pixels_per_mm) - finest
        rows.append(
            [f"{pixels_per_mm:g}", f"{d.mean():+.3f}", f"{d.std(ddof=1):.3f}", f"{np.abs(d).max():.3f}"]
        )
    return rows


def connectivity(kept: list[Array]) -> float:
    """Largest change of the angle in deg when pixels must share an edge, not a corner, to be one object."""
    m = model()
    diameter, pixels, sphere = m.fidelity.particle_diameter, m.pixels_per_mm, m.sphere_diameter
    changes = []
    for heap, angle in zip(kept, angles(kept, pixels), strict=True):
        views = [
            edges_joined(view(heap, diameter / 2, pixels_per_mm=pixels, sphere_diameter=sphere))
            for view in (top_view, side_view)
        ]
        found = measure(*views, sphere_diameter=sphere, particle_diameter=diameter)
        changes.append(abs(found.angle_of_repose_deg - angle))
    return max(changes)


def part_below(height: Array, radius: float) -> Array:
    """Share of a sphere that lies below a plane ``height`` (n,) above its centre."""
    u = np.clip(height / radius, -1.0, 1.0)
    return (2.0 + 3.0 * u - u**3) / 4.0


RULES: Mapping[str, Callable[[Array, float], Array]] = {
    "its centre is (the deck's rule)": lambda height, _: (height >= 0).astype(float),
    "any part of it is": lambda height, radius: (height >= radius).astype(float),
    "all of it is": lambda height, radius: (height > -radius).astype(float),
    "cut at the fill height: the volume below it": part_below,
}
"""Share of each bead that counts, from how far the fill height lies above its centre, by rule."""


def bead_count(poured: list[Array]) -> list[list[str]]:
    """Which bead is above the fill height, and what that does to the bulk density."""
    m = model()
    radius, fill = m.particle_radius, m.geometry["fill_height"]
    counts = {
        name: np.array([rule(fill - z, radius).sum() for *_, z in (beads.T for beads in poured)])
        for name, rule in RULES.items()
    }
    default = next(iter(counts.values()))
    rows = []
    for name, count in counts.items():
        change = 100 * (count / default - 1)
        scatter = 100 * count.std(ddof=1) / count.mean()
        rows.append([name, f"{count.mean():.0f}", f"{change.mean():+.2f}", f"{scatter:.2f}"])
    return rows


def read_poured() -> list[Array]:
    """Bead centres (n, 3) in m of every kept filling."""
    return [beads[AXES].to_numpy(float) for _, beads in pd.read_parquet(POURED).groupby("seed")]


def pour() -> None:
    """Run the deck at the reference point until the beads are poured, and keep them."""
    whole = model()
    script = whole.scripts[SCRIPT]
    poured, end, _ = script.partition("undump poured\n")
    if not end:
        raise SystemExit(f"{SCRIPT}: does not dump the poured beads any more; mend this script")
    cut = replace(whole, scripts={**whole.scripts, SCRIPT: poured})
    parts = []
    for seed in range(1, SEEDS + 1):
        with tempfile.TemporaryDirectory(prefix="calstudy-") as scratch:
            folder = Path(scratch) / "run"
            inputs = cut.inputs(REFERENCE, seed)
            write_inputs(inputs, folder)
            subprocess.run(
                LIGGGHTS.find().command(inputs.script, inputs.arguments),
                cwd=folder,
                check=True,
                stdout=subprocess.DEVNULL,
            )
            beads = read_dump(folder / "poured.dump")[:, 1:4].astype(np.float32)
        parts.append(pd.DataFrame(beads, columns=AXES).assign(seed=seed))
        print(f"seed {seed}: {len(beads)} beads", flush=True)
    pd.concat(parts).to_parquet(POURED, index=False, compression="zstd")


def markdown() -> list[str]:
    """The tables that the summary prints."""
    kept = heaps()
    columns = ["pixels a mm", f"angle against {FINEST:g} pixels a mm, deg", "sd", "largest"]
    lines = [columns, ["---"] * len(columns), *resolution(kept)]
    parts = [f"| {' | '.join(line)} |" for line in lines]
    parts += [
        "",
        f"{len(kept)} heaps at `{FIDELITY}`. Joined by edges alone, not by corners of pixels, the "
        f"largest change of an angle is {connectivity(kept):.3f} deg.",
    ]
    if POURED.exists():
        poured = read_poured()
        columns = ["a bead is above 50 mm when", "beads left", "bulk density, %", "sd from seed to seed, %"]
        lines = [columns, ["---"] * len(columns), *bead_count(poured)]
        parts += ["", *(f"| {' | '.join(line)} |" for line in lines)]
        parts += ["", f"{len(poured)} fillings at `{FIDELITY}` and the reference point."]
    return parts


def main() -> None:
    """Pour, or print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("work", nargs="?", choices=("pour",))
    if parser.parse_args().work:
        pour()
    else:
        print("\n".join(markdown()))


if __name__ == "__main__":
    main()
