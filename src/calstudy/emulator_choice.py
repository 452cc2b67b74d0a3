"""``--engine emulator``: which emulator answers, and that it was asked for by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from calstudy.emulator import Emulator, read_emulator
from calstudy.errors import InputError
from calstudy.model import DEFAULT_MODEL
from calstudy.written import choice

ENGINES = ("liggghts", "emulator")
SHIPPED = Path(str(resources.files("calstudy.liggghts_models"))) / DEFAULT_MODEL / "emulators"
"""One folder for each fidelity and variant that an emulator is shipped of."""
REFERENCE = "full"
"""Fidelity that is meant when none is named."""


def chosen_emulator(
    engine: str,
    directory: Path | None,
    fidelity: str | None,
    variant: str,
    scheduler: str | None = None,
    replicates: int | None = None,
) -> Emulator | None:
    """Emulator of ``--engine`` and ``--emulator``; None for LIGGGHTS, which is never replaced unasked.

    Without a directory it is the one that is shipped of the fidelity and variant. InputError where the
    options do not fit together, or there is no emulator.
    """
    if engine not in ENGINES:
        raise InputError(f"--engine {engine}: unknown; {choice(engine, ENGINES)}")
    if engine != "emulator":
        if directory is not None:
            raise InputError("--emulator is for --engine emulator; give both, or neither")
        if replicates is not None:
            raise InputError(
                f"--replicates {replicates} is for --engine emulator, for each takes as many DEM runs as the "
                "study; give --engine emulator, or leave --replicates out"
            )
        return None
    if scheduler is not None:
        raise InputError("--engine emulator answers on this machine; leave --scheduler out")
    return read_emulator(directory or shipped_emulator(fidelity or REFERENCE, variant))


def shipped_emulator(fidelity: str, variant: str) -> Path:
    """Directory of a shipped emulator; InputError names those that there are."""
    directory = SHIPPED / f"{fidelity}-{variant}"
    if not directory.is_dir():
        there = ", ".join(path.name for path in sorted(SHIPPED.iterdir()))
        raise InputError(
            f"no emulator of {fidelity} fidelity, {variant}, is shipped ({there} are); choose with "
            "--fidelity and --variant, or name your own with --emulator DIR, made by 'calstudy emulator fit'"
        )
    return directory
