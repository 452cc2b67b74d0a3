"""LIGGGHTS dump files to arrays."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from calstudy.errors import RunError
from calstudy.parameters import Array
from calstudy.process import output_text

COLUMNS = ("id", "x", "y", "z", "vx", "vy", "vz")


def read_dump(path: Path) -> Array:
    """Beads of the only frame of a custom dump, shape (n, 7): id, position in m, velocity in m/s.

    Sorted by id, so that the order does not depend on how LIGGGHTS sorted its atoms. Raises RunError
    for a file that is missing, cut short, of other columns, or that holds a value that is no number.
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

    Sorted by id where there is one. RunError for a file that is missing, cut short or without them.
    """
    text = output_text(path, errors="strict")
    frame = text.rpartition("ITEM: TIMESTEP")[2]
    head, found, body = frame.partition("ITEM: ATOMS")
    columns, _, rows = body.partition("\n")
    names, lines = columns.split(), head.splitlines()
    if not found or not {"x", "y", "z"} <= set(names) or "ITEM: NUMBER OF ATOMS" not in lines[:-1]:
        raise RunError(f"{path.name}: not a dump with the columns x, y and z")
    try:
        announced = int(lines[lines.index("ITEM: NUMBER OF ATOMS") + 1])
        cells = [line.split() for line in rows.splitlines()]
        wanted = [names.index(name) for name in (("id",) if "id" in names else ()) + ("x", "y", "z")]
        beads = np.array([[float(cell[k]) for k in wanted] for cell in cells]).reshape(-1, len(wanted))
    except (ValueError, IndexError) as error:
        raise RunError(f"{path.name}: cut short or garbled") from error
    if len(beads) != announced or not text.endswith("\n") or not np.isfinite(beads).all():
        raise RunError(f"{path.name}: {len(beads)} of {announced} beads are there; it was cut short")
    ordered: Array = beads[np.argsort(beads[:, 0], kind="stable"), -3:] if "id" in names else beads
    return ordered
