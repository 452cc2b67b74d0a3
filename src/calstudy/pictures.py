"""The pictures that a study gets of each finished row: its DEM runs, and its heap."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from matplotlib.figure import Figure

from calstudy.analysis import convergence, figure9
from calstudy.durable import write_atomically
from calstudy.errors import SetupError
from calstudy.study import Study


def draw_runs(study: Study, row: int) -> Figure:
    """A row's DEM runs, phase by phase."""
    runs = study.evaluations[study.evaluations["row"] == row]
    result = study.calibrations[study.calibrations["row"] == row].to_dict("records")[0]
    title = f"Row {row}: {len(runs)} DEM runs at {result['fidelity']} fidelity"
    return convergence(runs, cast(dict[str, Any], result), study.settings.quantities.targeted, title)


def draw_row(directory: Path, study: Study, row: int) -> list[Path]:
    """Draw a finished row's pictures into the study, unless they are there; returns their paths."""
    if row not in set(study.ok["row"]):
        return []
    pictures = directory / "pictures"
    try:
        pictures.mkdir(exist_ok=True)
    except OSError as error:
        raise SetupError(f"{pictures}: cannot be made: {error.strerror}") from error
    drawings: dict[str, Callable[[], Figure]] = {"runs": lambda: draw_runs(study, row)}
    if row in set(study.heaps["row"]):  # an emulator leaves no beads
        drawings = {"heap": lambda: figure9(study, row), **drawings}
    paths = {name: pictures / f"row-{row:02d}-{name}.png" for name in drawings}
    for name, path in paths.items():
        if not path.exists():
            drawn = io.BytesIO()
            # Little compression: it takes as long as the drawing, and the pictures are small.
            drawings[name]().savefig(drawn, dpi=130, pil_kwargs={"compress_level": 2})
            try:
                write_atomically(path, drawn.getvalue())
            except OSError as error:
                raise SetupError(
                    f"{path}: cannot be written: {error.strerror}; free space, run again"
                ) from error
    return list(paths.values())
