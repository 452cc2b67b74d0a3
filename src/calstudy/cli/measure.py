"""``calstudy measure``: a heap on photographs, or on two silhouettes."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

import cv2

from calstudy.cli.terminal import print_json, results_console
from calstudy.disk.files import write_atomically
from calstudy.errors import InputError, MeasurementError, SetupError
from calstudy.models.measurement import measure as measure_pictures
from calstudy.models.measurement import measure_heap
from calstudy.models.photograph.drawing import drawn
from calstudy.models.photograph.photographs import (
    Measured,
    OneOf,
    Reference,
    measure_photographs,
    target_text,
)
from calstudy.models.photograph.rules import RULES, angles, read_beads

SPHERE_MM, PARTICLE_MM = 50.0, 5.0
"""The paper's reference sphere and particles, of silhouettes."""
FLANK = "angle_of_repose_flank_deg"
"""Response that the flanks of a photograph are compared with."""
APPENDIX_A = "angle_of_repose_deg"
SUFFIX = "-measured.png"


def measure(a: Namespace) -> None:
    """Measure photographs, or two silhouettes."""
    given = {
        "--scale": a.scale,
        "--top-photo": a.top_photo,
        "--top-scale": a.top_scale,
        "--region": a.region,
    }
    if a.beads is not None:
        if a.photo is not None or a.top is not None:
            raise InputError("--beads measures positions; leave the pictures out")
        _measure_beads(a.beads, 1e-3 * (a.particle_diameter_mm or PARTICLE_MM), a.json)
        return
    if a.photo is not None:
        if a.top is not None:
            raise InputError(f"{a.top} and --photo: silhouettes or photographs, not both at once")
        if a.scale is not None and a.sphere_diameter_mm is not None:
            raise InputError("--scale and --sphere-diameter-mm both give the scale; leave one out")
        _measure_photographs(a)
        return
    if a.side is None:
        raise InputError("name photographs with --photo, two silhouettes, TOP.png and SIDE.png, or --beads")
    if alone := [option for option, value in given.items() if value is not None]:
        raise InputError(f"{alone[0]} is for photographs; name them with --photo")
    _measure_silhouettes(a)


def _measure_beads(path: Path, diameter: float, as_json: bool) -> None:
    """Measure a heap by every rule, from the positions of its beads."""
    centres = read_beads(path)
    measured = measure_heap(centres, diameter)
    found = {APPENDIX_A: measured.angle_of_repose_deg}
    if measured.stands:
        found |= angles(tuple(RULES), centres, diameter, measured)
    if as_json:
        print_json(found | {"heap_radius": measured.radius, "heap_height": measured.height})
        return
    lines = [f"{name} {value:.2f}" for name, value in found.items()]
    lines.append(f"radius {1e3 * measured.radius:.2f} mm, height {1e3 * measured.height:.2f} mm")
    results_console().print("\n".join(lines), highlight=False)


def _measure_silhouettes(a: Namespace) -> None:
    try:
        found = measure_pictures(
            a.top,
            a.side,
            sphere_diameter=1e-3 * (a.sphere_diameter_mm or SPHERE_MM),
            particle_diameter=1e-3 * (a.particle_diameter_mm or PARTICLE_MM),
        )
    except MeasurementError as error:
        raise MeasurementError(f"{error} (photographs are measured with --photo)") from error
    if a.json:
        named = {"heap_radius": found.radius, "heap_height": found.height, "heap": found.stands}
        print_json({"angle_of_repose_deg": found.angle_of_repose_deg, **named})
        return
    heap = "" if found.stands else " (no heap: nothing stands above the first layer)"
    results_console().print(
        f"angle of repose {found.angle_of_repose_deg:.2f} deg, radius {1e3 * found.radius:.2f} mm, "
        f"height {1e3 * found.height:.2f} mm{heap}",
        highlight=False,
    )


def _measure_photographs(a: Namespace) -> None:
    sphere = None if a.sphere_diameter_mm is None else 1e-3 * a.sphere_diameter_mm
    top_sphere = None if a.top_scale is not None else sphere
    found = measure_photographs(
        a.photo,
        Reference(a.scale, sphere),
        region=a.region,
        top=None if a.top_photo is None else (a.top_photo, Reference(a.top_scale, top_sphere)),
        particle_diameter=1e-3 * (a.particle_diameter_mm or 0.0),
    )
    pictures = _write_pictures(found, a.out)
    if a.json:
        print_json(_numbers(found, pictures))
        return
    out = results_console()
    for one, picture in zip(found.each, pictures, strict=True):
        shown = one.found
        out.print(
            f"{one.path}: left {shown.left_deg:.2f}, right {shown.right_deg:.2f} deg; drawn in {picture}",
            highlight=False,
            soft_wrap=True,
            markup=False,
        )
    words = [f"by the flanks {found.flank_deg:.2f} deg (sd {found.flank_sd_deg:.2f})"]
    words.append(f"by height and radius {found.height_radius_deg:.2f} deg")
    if found.height is not None and found.radius is not None:
        words.append(f"height {1e3 * found.height:.1f} mm, radius {1e3 * found.radius:.1f} mm")
    if found.appendix_a_deg is not None:
        words.append(f"by Appendix A {found.appendix_a_deg:.2f} deg")
    lines = [f"angle of repose {', '.join(words)}", "", "[targets]", *_targets(found)]
    out.print("\n".join(lines), highlight=False, soft_wrap=True, markup=False)


def _targets(found: Measured) -> list[str]:
    """Lines for the calibration's file."""
    lines = [f"{FLANK} = {target_text(found.flank_deg, found.flank_sd_deg)}"]
    if found.appendix_a_deg is not None:
        lines.append(f"# or by Appendix A: {APPENDIX_A} = {{ value = {found.appendix_a_deg:.2f} }}")
    return lines


def _numbers(found: Measured, pictures: list[Path]) -> dict[str, Any]:
    return {
        FLANK: found.flank_deg,
        f"{FLANK}_sd": found.flank_sd_deg,
        "height_radius_deg": found.height_radius_deg,
        "appendix_a_deg": found.appendix_a_deg,
        "heap_height": found.height,
        "heap_radius": found.radius,
        "photographs": [
            {
                "photograph": str(one.path),
                "left_deg": one.found.left_deg,
                "right_deg": one.found.right_deg,
                "segmentation_sd_deg": one.found.doubt_deg,
                "roll_deg": one.found.view.roll_deg,
                "pitch_deg": one.found.view.pitch_deg,
                "metres_per_pixel": one.scale,
                "drawn": str(picture),
            }
            for one, picture in zip(found.each, pictures, strict=True)
        ],
        "targets": _targets(found),
    }


def _write_pictures(found: Measured, out: Path) -> list[Path]:
    """Draw what was measured over each photograph; returns the files."""
    paths = [out / f"{one.path.stem}{SUFFIX}" for one in found.each]
    if len({*paths}) < len(paths):
        paths = [out / f"{n}-{path.name}" for n, path in enumerate(paths, 1)]
    try:
        out.mkdir(parents=True, exist_ok=True)
        for one, path in zip(found.each, paths, strict=True):
            _, data = cv2.imencode(".png", drawn(one.photograph, one.found, one.sphere, _caption(one)))
            write_atomically(path, data.tobytes())
    except OSError as error:
        raise SetupError(f"{out}: cannot be written: {error.strerror}; choose another --out") from error
    return paths


def _caption(one: OneOf) -> str:
    shown = one.found
    return f"{shown.angle_deg:.1f} deg: left {shown.left_deg:.1f}, right {shown.right_deg:.1f}"
