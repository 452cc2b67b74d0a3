"""``--engine emulator``: which emulator answers, and that it was asked for by name."""

from __future__ import annotations

from pathlib import Path

from calstudy.emulator import Emulator, read_emulator
from calstudy.errors import InputError

ENGINES = ("liggghts", "emulator")


def chosen_emulator(
    engine: str, directory: Path | None, scheduler: str | None, replicates: int | None = None
) -> Emulator | None:
    """Emulator of ``--engine`` and ``--emulator``; None for LIGGGHTS, which is never replaced unasked.

    InputError where the options do not fit together, or there is no emulator.
    """
    if engine not in ENGINES:
        raise InputError(f"--engine {engine}: unknown; choose {' or '.join(ENGINES)}")
    if engine != "emulator":
        if directory is not None:
            raise InputError("--emulator is for --engine emulator; give both, or neither")
        if replicates is not None:
            raise InputError(
                f"--replicates {replicates} is for --engine emulator, for each takes as many DEM runs as the "
                "study; give --engine emulator --emulator DIR, or leave --replicates out"
            )
        return None
    if scheduler is not None:
        raise InputError("--engine emulator answers on this machine; leave --scheduler out")
    if directory is None:
        raise InputError(
            "--engine emulator needs --emulator DIR; make one: calstudy emulator sample --out RUNS, "
            "then calstudy emulator fit RUNS --out DIR"
        )
    return read_emulator(directory)
