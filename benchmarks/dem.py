"""The deck's cost and responses beside a fixed schedule's, on real LIGGGHTS.

    python benchmarks/dem.py pairs  --fidelity coarse --points 12 --seeds 4 --out pairs-coarse.parquet
    python benchmarks/dem.py replay --fidelity coarse --points 12
    python benchmarks/dem.py show pairs-coarse.parquet       (of several files, their pairs together)

`pairs` runs the deck and the reference (benchmarks/reference) with the same parameters and seeds, in turn on
the same core, stores each pair at once (the same command goes on where it was ended), and prints the ratio of
their processor times and the difference of their responses with a 90 % interval over the points. The two
pack the same beads in the same way; from the removal on they part, as two seeds do, so a difference of the
angle is told through its scatter. `replay` applies the deck's rule for ending the lift to frames of the
reference: there the difference is exact, pair by pair.

Points fill the whole box; they come from a fixed seed, as do the runs.
"""

from __future__ import annotations

import argparse
import math
import re
import tempfile
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from calstudy.calibration.sampling import maximin_optimised
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.models.angle_of_repose import AngleOfReposeModel, load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.models.measurement import measure_heap
from calstudy.parameters import Box
from calstudy.plan_file import load_plan
from calstudy.records import Run

REFERENCE_SCRIPT = Path(__file__).parent / "reference" / "in.fixed_schedule"
REFERENCE_SKIN = 0.001
"""m; that of the trial deck whose schedule the reference has."""
DESIGN_SEED = 20170101
FIRST_SEED = 5001
CONFIDENCE = 0.90
PHASES = ("pour", "settle", "lift")


def reference_of(model: AngleOfReposeModel, frames: bool) -> AngleOfReposeModel:
    """The model on the fixed schedule."""
    scripts = {**model.scripts, "in.angle_of_repose": REFERENCE_SCRIPT.read_text()}
    skin = REFERENCE_SKIN / model.fidelity.particle_diameter
    schedule = {**model.schedule, "frames": int(frames)}
    return replace(model, scripts=scripts, schedule=schedule, skin_per_diameter=skin)


def points(count: int) -> list[dict[str, float]]:
    """Space-filling parameter sets over the whole box."""
    box = Box.of(load_plan().parameters)
    design = maximin_optimised(count, len(box.names), np.random.default_rng(DESIGN_SEED))
    lower, upper = np.array(box.lower), np.array(box.upper)
    return [dict(zip(box.names, map(float, lower + u * (upper - lower)), strict=True)) for u in design]


def run(model: AngleOfReposeModel, parameters: dict[str, float], seed: int, folder: Path) -> Run:
    """One DEM run; its folder stays until the caller has read it."""
    done = ProgramEngine(model, LIGGGHTS.find()).run(parameters, seed, folder, threading.Event())
    if not done.usable:
        raise SystemExit(f"{folder.name}: {done.reason}")
    return done


def seconds_by_part(log: Path) -> dict[str, float]:
    """LIGGGHTS's own timing of a run: seconds by what was computed."""
    text = log.read_text()
    parts = {"pair": "Pair", "neighbour": "Neigh", "other": "Other"}
    return {
        f"{name}_seconds": sum(map(float, re.findall(rf"^{word}\s+time \(%\) = (\S+)", text, re.MULTILINE)))
        for name, word in parts.items()
    }


def pairs(a: argparse.Namespace) -> None:
    """Run the pairs that the table lacks, store a line for each."""
    model = load_model(load_plan().fixed, a.fidelity, a.variant)
    about = {"fidelity": a.fidelity, "variant": a.variant, "deck": model.deck, "model_hash": model.hash}
    lines: list[Mapping[Any, Any]] = []
    if a.out.exists():
        lines += pd.read_parquet(a.out).to_dict("records")
    if any(line[name] != value for line in lines for name, value in about.items()):
        raise SystemExit(f"{a.out}: has pairs of another model; give another file")
    there = {(line["point"], line["seed"]) for line in lines}
    seeds = range(a.first_seed, a.first_seed + a.seeds)
    design = [
        (k, p, seed) for seed in seeds for k, p in enumerate(points(a.points)) if (k, seed) not in there
    ]

    def pair(job: tuple[int, dict[str, float], int]) -> dict[str, float | str]:
        point, parameters, seed = job
        line: dict[str, float | str] = {"point": point, "seed": seed, **parameters, **about}
        with tempfile.TemporaryDirectory(prefix="calstudy-") as scratch:
            for name, which in (("deck", model), ("reference", reference_of(model, frames=False))):
                folder = Path(scratch) / name
                done = run(which, parameters, seed, folder)
                measured = {r: done.responses[r] for r in (ANGLE_OF_REPOSE, BULK_DENSITY)}
                measured |= {"beads_heap": done.beads.on_plate if done.beads else math.nan}
                measured |= {"cpu_time": done.cpu_time, "simulated_time": done.simulated_time}
                measured |= seconds_by_part(folder / "log.liggghts")
                line |= {f"{name}_{key}": value for key, value in measured.items()}
        print(
            f"point {point} seed {seed}: {line['deck_cpu_time']:.1f} of {line['reference_cpu_time']:.1f} s, "
            f"{line['deck_angle_of_repose_deg']:.2f} and {line['reference_angle_of_repose_deg']:.2f} deg",
            flush=True,
        )
        return line

    with ThreadPoolExecutor(a.workers) as pool:
        for done in as_completed([pool.submit(pair, job) for job in design]):
            lines.append(done.result())
            part = a.out.with_suffix(".part")
            pd.DataFrame(lines).sort_values(["seed", "point"]).to_parquet(part, index=False)
            part.replace(a.out)
    print("", *report(pd.read_parquet(a.out)), sep="\n")


def interval(differences: pd.Series) -> tuple[float, float]:
    """Mean and half-width of its 90 % interval (Student's t)."""
    n = len(differences)
    quantile = stats.t.ppf(0.5 + CONFIDENCE / 2, n - 1)
    return float(differences.mean()), float(quantile * differences.std(ddof=1) / math.sqrt(n))


def report(table: pd.DataFrame) -> list[str]:
    """Lines that say ratios, differences, and where the time goes."""
    first = table.iloc[0]
    deck, reference = table["deck_cpu_time"], table["reference_cpu_time"]
    ratio = deck / reference
    lines = [
        f"{first['fidelity']}, {first['variant']}, deck {first['deck']}: {len(table)} pairs",
        f"  processor time, deck / reference: {deck.sum():.0f} s / {reference.sum():.0f} s = "
        f"{deck.sum() / reference.sum():.3f} "
        f"(pairs: median {ratio.median():.3f}, {ratio.min():.3f} to {ratio.max():.3f})",
    ]
    angle = table[f"deck_{ANGLE_OF_REPOSE}"] - table[f"reference_{ANGLE_OF_REPOSE}"]
    density = 100 * (table[f"deck_{BULK_DENSITY}"] / table[f"reference_{BULK_DENSITY}"] - 1)
    for name, differences, unit in (("angle of repose", angle, "deg"), ("bulk density", density, "%")):
        there = differences.dropna()
        mean, half = interval(there)
        lines.append(
            f"  {name}: deck - reference = {mean:+.3f} {unit}, "
            f"90 % interval {mean - half:+.3f} to {mean + half:+.3f} ({len(there)} pairs)"
        )
    lines.append("  where the time goes (LIGGGHTS's own clock), share of the reference's total:")
    total = sum(table[f"reference_{part}_seconds"].sum() for part in ("pair", "neighbour", "other"))
    for name in ("reference", "deck"):
        shares = {p: table[f"{name}_{p}_seconds"].sum() / total for p in ("pair", "neighbour", "other")}
        words = ", ".join(f"{part} {share:.2f}" for part, share in shares.items())
        lines.append(f"    {name:>9}: {words}; simulated {table[f'{name}_simulated_time'].mean():.2f} s")
    return lines


def frames(path: Path) -> Iterator[np.ndarray]:
    """Frames (n, 7) of a dump, one after the other."""
    with path.open() as handle:
        while handle.readline():
            head = [handle.readline() for _ in range(8)]
            count = int(head[2])
            yield np.array([handle.readline().split() for _ in range(count)], float).reshape(-1, 7)


def replay(a: argparse.Namespace) -> None:
    """Apply the rule for ending the lift to frames of the reference."""
    model = load_model(load_plan().fixed, a.fidelity, a.variant)
    print(f"{a.fidelity}, {a.variant}: the lift ended by the deck's rule, and after 4.2 s of the same run")

    def one(job: tuple[int, dict[str, float]]) -> float:
        point, parameters = job
        with tempfile.TemporaryDirectory(prefix="calstudy-") as scratch:
            folder = Path(scratch) / "run"
            run(reference_of(model, frames=True), parameters, FIRST_SEED, folder)
            seen = list(frames(folder / "frames.dump"))[1:]
        ended = rule(model, seen)
        early, late = (angle(model, frame) for frame in (seen[ended], seen[-1]))
        time = (ended + 1) * model.schedule["lift_interval"]
        print(f"point {point:>2}: after {time:.2f} s {early:.3f} deg, after 4.2 s {late:.3f} deg", flush=True)
        return early - late

    with ThreadPoolExecutor(a.workers) as pool:
        differences = np.array(list(pool.map(one, enumerate(points(a.points)))))
    print(f"largest difference: {np.abs(differences).max():.4f} deg")


def rule(model: AngleOfReposeModel, seen: list[np.ndarray]) -> int:
    """Index of the frame at which the deck would have ended the lift (see the end of its script)."""
    schedule, ring = model.schedule, model.fidelity.ring_height
    calm = 0
    for k, frame in enumerate(seen):
        edge = ring + schedule["lift_speed"] * (k + 1) * schedule["lift_interval"]
        clear = edge > frame[:, 3].max() + model.particle_radius
        at_rest = (frame[:, 4:7] ** 2).sum() < schedule["rest_speed"] ** 2
        calm = (calm + 1) if clear and at_rest else 0
        if calm >= 2:
            return k
    return len(seen) - 1


def angle(model: AngleOfReposeModel, frame: np.ndarray) -> float:
    """Angle of repose in deg of the beads that are on the plate."""
    on_plate = frame[np.hypot(frame[:, 1], frame[:, 2]) <= model.variant.plate_radius, 1:4]
    return measure_heap(
        on_plate,
        model.fidelity.particle_diameter,
        pixels_per_mm=model.pixels_per_mm,
        sphere_diameter=model.sphere_diameter,
    ).angle_of_repose_deg


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(required=True)
    for name, work in (("pairs", pairs), ("replay", replay)):
        verb = verbs.add_parser(name)
        verb.add_argument("--fidelity", default="coarse")
        verb.add_argument("--variant", default="ring")
        verb.add_argument("--points", type=int, default=12)
        verb.add_argument("--workers", type=int, default=1)
        verb.set_defaults(work=work)
        if name == "pairs":
            verb.add_argument(
                "--seeds", type=int, default=1, help="runs with seeds of their own at each point"
            )
            verb.add_argument("--first-seed", type=int, default=FIRST_SEED)
            verb.add_argument("--out", type=Path, required=True, help="Parquet of the pairs")
    show = verbs.add_parser("show")
    show.add_argument("files", type=Path, nargs="+")
    show.set_defaults(work=lambda a: print(*report(pd.concat(map(pd.read_parquet, a.files))), sep="\n"))
    a = parser.parse_args()
    a.work(a)


if __name__ == "__main__":
    main()
