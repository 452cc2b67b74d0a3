"""LIGGGHTS: its seeds, and how its log and dumps are read."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np

from calstudy.engines.process import output_text
from calstudy.engines.profiles import LIGGGHTS
from calstudy.errors import RunError
from calstudy.parameters import Array

MARKER = "calstudy: "
LOG = LIGGGHTS.log


def markers(log: Path) -> dict[str, str]:
    """Values that the script printed into its log behind the marker, by name.

    A name alone (``finished``) has the value ''. Raises RunError when the log cannot be read.
    """
    lines = output_text(log).splitlines()
    marked = (line.removeprefix(MARKER).strip() for line in lines if line.startswith(MARKER))
    return {name: value for name, _, value in (text.partition(" ") for text in marked)}


def insertion_seeds(seed: int) -> tuple[int, int, int]:
    """Three different primes above 10000 drawn from ``seed``: LIGGGHTS accepts only such seeds."""
    candidates = np.random.default_rng(np.random.SeedSequence([seed, 0x5EED]))
    primes: list[int] = []
    while len(primes) < 3:
        number = int(candidates.integers(10_001, 50_000_000))
        if _is_prime(number) and number not in primes:
            primes.append(number)
    return primes[0], primes[1], primes[2]


def _is_prime(number: int) -> bool:
    if number < 2 or number % 2 == 0:
        return number == 2
    return all(number % divisor for divisor in range(3, math.isqrt(number) + 1, 2))


COLUMNS = ("id", "x", "y", "z", "vx", "vy", "vz")


def read_dump(path: Path) -> Array:
    """Beads of the only frame of a custom dump, shape (n, 7): id, position in m, velocity in m/s.

    Sorted by id, so that the order does not depend on how LIGGGHTS sorted its atoms. RunError: the
    file is missing or cut short, has other columns, or holds a value that is not a finite number.
    """
    text = output_text(path, errors="strict")
    head, _, body = text.partition("ITEM: ATOMS")
    lines = head.splitlines()
    columns, _, rows = body.partition("\n")
    if tuple(columns.split()) != COLUMNS or "ITEM: NUMBER OF ATOMS" not in lines[:-1]:
        raise RunError(f"{path.name}: not a dump of {' '.join(COLUMNS)}")
    try:
        announced = int(lines[lines.index("ITEM: NUMBER OF ATOMS") + 1])
        beads = np.empty((0, len(COLUMNS)))
        if rows.strip():
            beads = np.loadtxt(io.StringIO(rows), ndmin=2, comments=None)
    except ValueError as error:
        raise RunError(f"{path.name}: cut short or garbled") from error
    # A file that was cut within its last line may still hold a number there, only a shorter one.
    if beads.shape != (announced, len(COLUMNS)) or not text.endswith("\n"):
        raise RunError(f"{path.name}: {len(beads)} of {announced} beads are there; it was cut short")
    if not np.isfinite(beads).all():
        raise RunError(f"{path.name}: a position or velocity is not finite; the simulation exploded")
    return beads[np.argsort(beads[:, 0])]


def read_positions(path: Path) -> Array:
    """Particle centres (n, 3) in m in the last frame of a custom dump that has the columns x, y and z.

    Sorted by id if the dump has ids. RunError: the file is missing or cut short, or lacks these columns.
    """
    return _last_frame(path, ("x", "y", "z"))[0]


def read_particles(path: Path) -> tuple[Array, Array | None]:
    """The same with the particles' radii (n,) in m; None where the dump has no column ``radius``."""
    beads, names = _last_frame(path, ("x", "y", "z"), optional="radius")
    return beads[:, :3], beads[:, 3] if "radius" in names else None


def _last_frame(path: Path, columns: tuple[str, ...], optional: str = "") -> tuple[Array, tuple[str, ...]]:
    """Columns of the last frame of a custom dump, sorted by id, and their names."""
    text = output_text(path, errors="strict")
    frame = text.rpartition("ITEM: TIMESTEP")[2]
    head, found, body = frame.partition("ITEM: ATOMS")
    first, _, rows = body.partition("\n")
    names, lines = first.split(), head.splitlines()
    if not found or not set(columns) <= set(names) or "ITEM: NUMBER OF ATOMS" not in lines[:-1]:
        raise RunError(f"{path.name}: not a dump with the columns x, y and z")
    columns += (optional,) if optional in names else ()
    try:
        announced = int(lines[lines.index("ITEM: NUMBER OF ATOMS") + 1])
        cells = [line.split() for line in rows.splitlines()]
        wanted = [names.index(name) for name in (("id",) if "id" in names else ()) + columns]
        beads = np.array([[float(cell[k]) for k in wanted] for cell in cells]).reshape(-1, len(wanted))
    except (ValueError, IndexError) as error:
        raise RunError(f"{path.name}: cut short or garbled") from error
    if len(beads) != announced or not text.endswith("\n") or not np.isfinite(beads).all():
        raise RunError(f"{path.name}: {len(beads)} of {announced} beads are there; it was cut short")
    if "id" in names:
        beads = beads[np.argsort(beads[:, 0], kind="stable"), 1:]
    return beads, columns
