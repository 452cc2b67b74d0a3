"""Error of the angle of repose on photographs, rendered from stored heaps, whose truth is known.

    python benchmarks/photographs.py                 (some ten minutes)
    python benchmarks/photographs.py --each 3 --only noise,hand

Each group disturbs one thing over its range, and the last one everything at once. The truth is the rule of
the flanks on the exact outline of the same beads as the camera sees them. A photograph of a heap from above
its foot shows other beads at the outline than a level view from far away: the last column compares with that
one. Printed are the share that was refused with its 95 % interval (Clopper & Pearson), and of the others the
errors.

No threshold of the measurement was set on the scenes of the table, which is series 2. Take another series to
look for what should be refused.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from calstudy.errors import InputError, MeasurementError
from calstudy.models.measurement import one_thread
from calstudy.models.photograph.flanks import fit_flanks
from calstudy.models.photograph.photograph import measure_photograph
from calstudy.written import choice

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from rendered_photographs import DIAMETER, Scene, heaps, outline, photograph

EACH, SERIES = 16, 2
BEADS, EVERYTHING = "beads", "everything"
LIMIT = 0.5
"""Largest error in degrees that is allowed where a photograph is not refused."""
FAR = Scene(pitch_deg=0.0, distance=50.0, across=0.12)
"""The level view from far away."""

Draw = Callable[[Scene, np.random.Generator], Scene]


def colour(rng: np.random.Generator) -> tuple[float, float, float]:
    """Any colour, not far from grey."""
    blue, green, red = np.clip(rng.uniform(0.1, 0.9) + 0.08 * rng.standard_normal(3), 0.02, 0.98)
    return float(blue), float(green), float(red)


GROUPS: Mapping[str, Draw] = {
    "nothing": lambda s, _: s,
    "light": lambda s, rng: replace(
        s,
        light_deg=rng.uniform(-60, 60),
        light_gradient=rng.uniform(0, 0.6),
        exposure=rng.uniform(0.4, 1.5),
        gloss=rng.uniform(0, 0.7),
    ),
    "noise": lambda s, rng: replace(s, noise=rng.uniform(0.02, 0.10)),
    "blur": lambda s, rng: replace(s, blur=rng.uniform(1, 5)),
    "JPEG": lambda s, rng: replace(s, jpeg=int(rng.integers(8, 60))),
    "roll": lambda s, rng: replace(s, roll_deg=rng.uniform(-10, 10)),
    "pitch": lambda s, rng: replace(s, pitch_deg=rng.uniform(0, 8)),
    "texture": lambda s, rng: replace(s, texture=rng.uniform(0.03, 0.15)),
    "shadow": lambda s, rng: replace(
        s, shadow=rng.uniform(0.4, 0.9), light_deg=rng.uniform(-65, 65), pitch_deg=rng.uniform(0, 3)
    ),
    "distance": lambda s, rng: replace(s, across=rng.uniform(0.13, 0.5), distance=rng.uniform(0.4, 1.5)),
    "colours": lambda s, rng: replace(s, bead=colour(rng), table=colour(rng), wall=colour(rng)),
    "graph paper": lambda s, rng: replace(s, lines=rng.uniform(0.1, 0.7)),
    "disc": lambda s, rng: replace(
        s, disc=colour(rng), disc_diameter=rng.uniform(0.11, 0.25), pitch_deg=rng.uniform(0, 3.5)
    ),
    BEADS: lambda s, _: s,
    "things": lambda s, rng: replace(
        s, sphere=rng.uniform() < 0.6, hand=rng.uniform() < 0.6, ruler=rng.uniform() < 0.6, across=0.30
    ),
}
"""What is disturbed, by name."""
SIZES: Mapping[str, tuple[str, ...]] = {
    BEADS: ("3 mm", "coarse", "tiny"),
    EVERYTHING: ("soft", "coarse"),
}
"""Fidelities whose beads are photographed, in turn; `soft` in the other groups."""
OF_EVERYTHING = {
    "pitch_deg": (0.0, 3.5),
    "roll_deg": (-5.0, 5.0),
    "light_deg": (-60.0, 60.0),
    "light_gradient": (0.0, 0.5),
    "exposure": (0.6, 1.2),
    "texture": (0.0, 0.06),
    "shadow": (0.1, 0.6),
    "noise": (0.0, 0.04),
    "blur": (0.0, 2.5),
    "across": (0.16, 0.32),
    "gloss": (0.0, 0.5),
    "distance": (0.5, 1.2),
}


def everything(scene: Scene, rng: np.random.Generator) -> Scene:
    """All disturbances at once, each over a part of its range."""
    mixed = replace(scene, bead=colour(rng), table=colour(rng), wall=colour(rng))
    mixed = replace(mixed, **{name: rng.uniform(*ends) for name, ends in OF_EVERYTHING.items()})
    return replace(
        mixed,
        jpeg=int(rng.integers(30, 95)),
        sphere=rng.uniform() < 0.3,
        hand=rng.uniform() < 0.2,
        ruler=rng.uniform() < 0.2,
        lines=rng.uniform(0, 0.5) if rng.uniform() < 0.2 else 0.0,
        disc=colour(rng) if rng.uniform() < 0.3 else None,
    )


def cases(group: str, each: int, series: int) -> list[tuple[Scene, np.ndarray, float, int]]:
    """Scene, beads with their diameter in m, and seed of each photograph of a group."""
    draw, sizes = {**GROUPS, EVERYTHING: everything}[group], SIZES.get(group, ("soft",))
    kept = {size: heaps(size) for size in sizes}
    rng = np.random.default_rng([series, *group.encode()])
    found = []
    for seed in range(each):
        scene = Scene(azimuth_deg=rng.uniform(0, 360), pitch_deg=rng.uniform(0, 2))
        size = sizes[seed % len(sizes)]
        beads = kept[size][int(rng.integers(len(kept[size])))]
        found.append((draw(scene, rng), beads, DIAMETER[size], 1000 * series + seed))
    return found


def line(group: str, each: int, series: int) -> tuple[list[str], list[float], Counter[str]]:
    """Cells of the table, the errors in degrees, and why photographs were refused."""
    errors, level, refusals = [], [], Counter[str]()
    for scene, beads, diameter, seed in cases(group, each, series):
        true = fit_flanks(*outline(beads, diameter, scene)).mean_deg
        far = fit_flanks(*outline(beads, diameter, replace(FAR, azimuth_deg=scene.azimuth_deg))).mean_deg
        try:
            found = measure_photograph(photograph(beads, diameter, scene, seed)).angle_deg
        except MeasurementError as error:
            refusals[str(error).partition(":")[0].partition(";")[0]] += 1
            continue
        errors.append(found - true)
        level.append(found - far)
    cells = [group, str(each), share(each - len(errors), each), *summary(errors), summary(level)[1]]
    return cells, errors, refusals


def share(count: int, of: int) -> str:
    """A count with the 95 % interval of its share in per cent."""
    ends = stats.binomtest(count, of).proportion_ci()
    return f"{count} ({100 * ends.low:.0f} to {100 * ends.high:.0f} %)"


def summary(errors: list[float]) -> list[str]:
    """Mean, root mean square and largest of errors."""
    if not errors:
        return ["", "", ""]
    e = np.array(errors)
    return [f"{e.mean():+.2f}", f"{np.sqrt((e**2).mean()):.2f}", f"{np.abs(e).max():.2f}"]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--each", type=int, default=EACH, help=f"photographs of a group; default: {EACH}")
    parser.add_argument("--series", type=int, default=SERIES, help=f"of scenes; default: {SERIES}")
    parser.add_argument("--only", default=",".join([*GROUPS, EVERYTHING]), help="groups, with commas")
    a = parser.parse_args()
    print(
        "| disturbed | photographs | refused | mean error, deg | rms | largest | rms against the level view |"
    )
    print("|---|---|---|---|---|---|---|")
    errors: list[float] = []
    refusals: Counter[str] = Counter()
    total = 0
    with one_thread():
        for group in a.only.split(","):
            if group not in {*GROUPS, EVERYTHING}:
                raise InputError(f"there is no group {group!r}; {choice(group, [*GROUPS, EVERYTHING])}")
            cells, found, why = line(group, a.each, a.series)
            errors += found
            refusals += why
            total += a.each
            print(f"| {' | '.join(cells)} |", flush=True)
    cells = ["all", str(total), share(total - len(errors), total), *summary(errors), ""]
    print(f"| {' | '.join(cells)} |")
    beyond = sum(abs(error) > LIMIT for error in errors)
    print(f"\n{share(beyond, len(errors))} of {len(errors)} errors are larger than {LIMIT} deg. Refused:\n")
    for reason, count in refusals.most_common():
        print(f"* {count}: {reason}")


if __name__ == "__main__":
    main()
