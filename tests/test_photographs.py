"""Photographs are rendered from stored heaps by code of the tests; their truth is the exact outline."""

from __future__ import annotations

import json
import math
import struct
import zlib
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.cli.main import main
from calstudy.errors import MeasurementError, StoreError
from calstudy.models.photograph.flanks import bead_outline, fit_flanks, upper_outline
from calstudy.models.photograph.marked import read_marks
from calstudy.models.photograph.photograph import combined, measure_photograph
from calstudy.models.photograph.photographs import Reference, measure_photographs, read_photograph
from calstudy.models.photograph.scale import find_sphere
from calstudy.models.photograph.segmentation import cut_out, difference
from calstudy.models.silhouette import read_picture
from rendered_photographs import Scene, heaps, outline, photograph

DIAMETER = 0.005
PLAIN = Scene()
SCENES = {
    "plain": PLAIN,
    "from below the lamp": replace(PLAIN, light_deg=-55, light_gradient=0.5, exposure=0.6),
    "noisy and coarse": replace(PLAIN, noise=0.06, jpeg=25, blur=1.5),
    "turned": replace(PLAIN, roll_deg=8, azimuth_deg=120),
    "a hand, a ruler and a sphere": replace(
        PLAIN, hand=True, ruler=True, sphere=True, across=0.30, bead=(0.6, 0.6, 0.6), wall=(0.3, 0.28, 0.25)
    ),
}


@cache
def heap() -> np.ndarray:
    return heaps()[9]


def truth(scene: Scene) -> float:
    return fit_flanks(*outline(heap(), DIAMETER, scene)).mean_deg


def write(path: Path, scene: Scene) -> Path:
    cv2.imwrite(str(path), photograph(heap(), DIAMETER, scene))
    return path


def triangle(left_deg: float, right_deg: float, height: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """Outline of a triangle."""
    feet = -height / math.tan(math.radians(left_deg)), height / math.tan(math.radians(right_deg))
    x = np.linspace(*feet, 2001)
    return x, height * np.minimum(1 - x / feet[0], 1 - x / feet[1])


# ---- the flanks -------------------------------------------------------------------------------------


@given(left=st.floats(20, 40), steeper=st.floats(-8, 8))
def test_the_flanks_of_a_triangle_are_its_sides(left: float, steeper: float) -> None:
    right = left + steeper
    found = fit_flanks(*triangle(left, right))
    assert (found.left_deg, found.right_deg) == pytest.approx((left, right), abs=0.02)


def test_height_over_half_the_width_is_the_angle_of_a_triangle() -> None:
    found = fit_flanks(*triangle(25, 25))
    assert math.degrees(math.atan(2 * found.height / found.width)) == pytest.approx(25, abs=0.05)


def test_a_loose_particle_on_a_flank_does_not_turn_it() -> None:
    x, y = triangle(25, 25)
    lump = np.abs(x - 60) < 8
    assert fit_flanks(x, y + 15 * lump).mean_deg == pytest.approx(25, abs=0.3)
    alone = np.polyfit(x[x > 20], (y + 15 * lump)[x > 20], 1)[0]
    assert abs(math.degrees(math.atan(-alone)) - 25) > 0.5  # least squares would


def test_the_outline_of_beads_is_that_of_their_picture() -> None:
    x, y = bead_outline(np.array([[0.0, 0, 0.01], [0.02, 0, 0.01]]), np.array(0.01), 0.0, 1e-4)
    assert y.max() == pytest.approx(0.02, abs=1e-5)
    assert x[0] == pytest.approx(-0.01, abs=1e-4) and x[-1] == pytest.approx(0.03, abs=1e-4)
    mask = np.zeros((10, 4), bool)
    mask[7:, 1:3] = True
    assert upper_outline(mask)[1].tolist() == [0, 3, 3, 0]


# ---- photographs ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_a_photograph_gives_the_angle_of_its_exact_outline(name: str) -> None:
    found = measure_photograph(photograph(heap(), DIAMETER, SCENES[name]))
    assert found.angle_deg == pytest.approx(truth(SCENES[name]), abs=0.5)
    assert found.view.roll_deg == pytest.approx(SCENES[name].roll_deg, abs=0.7)


@pytest.mark.slow
def test_what_is_drawn_lies_on_the_heap() -> None:
    scene = replace(PLAIN, roll_deg=6)
    picture = photograph(heap(), DIAMETER, scene)
    cut = cut_out(picture, difference(picture), 1000)
    without = photograph(heap(), DIAMETER, replace(scene, bead=(0.75, 0.45, 0.25)))
    rows, columns = np.nonzero(cut.heap)
    at = (np.column_stack([rows, columns]) * cut.scale + cut.corner[::-1]).astype(int)
    differs = np.abs(picture.astype(int) - without)[at[:, 0], at[:, 1]].max(axis=1) > 30
    assert differs.mean() > 0.9
    everywhere = (np.abs(picture.astype(int) - without).max(axis=2) > 30).sum()
    assert differs.sum() / cut.scale**-2 == pytest.approx(everywhere, rel=0.1)


@pytest.mark.slow
def test_a_disc_below_the_heap_is_not_part_of_it() -> None:
    scene = replace(PLAIN, disc=(0.45, 0.53, 0.5), pitch_deg=1.5)
    assert measure_photograph(photograph(heap(), DIAMETER, scene)).angle_deg == pytest.approx(
        truth(scene), abs=0.5
    )


REFUSED = {
    "no heap": (replace(PLAIN, across=20.0, distance=30.0), "no object looks like a heap"),
    "cut by the border": (
        replace(PLAIN, across=0.095, distance=0.5),
        ".",
    ),
    "of the background's colour": (
        replace(PLAIN, bead=(0.7, 0.7, 0.7), table=(0.7, 0.7, 0.7), wall=(0.7, 0.7, 0.7), blur=4, noise=0.1),
        "hardly differs from its background",
    ),
    "from far away": (replace(PLAIN, across=0.40), "pixels wide, less than 320"),
    "from high above": (replace(PLAIN, pitch_deg=25), "the camera looks down by 2"),
    "turned on its side": (replace(PLAIN, roll_deg=30), "no object looks like a heap"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", REFUSED)
def test_a_photograph_that_cannot_be_measured_is_refused(name: str) -> None:
    scene, why = REFUSED[name]
    with pytest.raises(MeasurementError, match=why) as refused:
        measure_photograph(photograph(heap(), DIAMETER, scene))
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_the_sphere_beside_the_heap_gives_the_scale() -> None:
    scene = replace(PLAIN, sphere=True, across=0.30, wall=(0.4, 0.4, 0.4))
    picture = photograph(heap(), DIAMETER, scene)
    sphere = find_sphere(picture, (400, 300, 800, 500))
    assert 50 / sphere.diameter == pytest.approx(1e3 * scene.across / scene.width, rel=0.02)
    with pytest.raises(MeasurementError, match="no sphere is found"):
        find_sphere(photograph(heap(), DIAMETER, replace(scene, sphere=False)), (400, 300, 800, 500))


@pytest.mark.slow
def test_repeats_narrow_the_deviation(tmp_path: Path) -> None:
    paths = [write(tmp_path / f"{a}.jpg", replace(PLAIN, azimuth_deg=a)) for a in (0, 90, 180)]
    one, three = (measure_photographs(paths[:n], Reference(scale=2e-4)) for n in (1, 3))
    assert three.flank_sd_deg < one.flank_sd_deg
    assert three.height == pytest.approx((heap()[:, 2].max() + 0.0025), abs=0.002)
    angles = [found.found.angle_deg for found in three.each]
    assert three.flank_deg == pytest.approx(np.mean(angles))
    assert combined([found.found for found in three.each], 3.0)[1] > 3.0


# ---- files and the command --------------------------------------------------------------------------


def huge_png(path: Path) -> Path:
    """A PNG of 30000 x 30000 white pixels in a few kilobytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    squeeze = zlib.compressobj()
    rows = b"".join(squeeze.compress(b"\0" + b"\xff" * 3750) for _ in range(30000)) + squeeze.flush()
    head = struct.pack(">IIBBBBB", 30000, 30000, 1, 0, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    return path


@pytest.mark.parametrize("read", [read_picture, read_photograph])
def test_a_picture_that_is_too_large_is_refused_by_its_header(
    read: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("was decoded"))
    with pytest.raises(MeasurementError, match="more than 100 million pixels; make it smaller"):
        read(huge_png(tmp_path / "huge.png"))  # type: ignore[operator]


@pytest.mark.slow
def test_measure_prints_what_a_calibration_takes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = replace(PLAIN, pitch_deg=1)
    path = write(tmp_path / "heap.jpg", scene)
    assert main(["measure", "--photo", str(path), "--out", str(tmp_path / "out")]) == 0
    text = capsys.readouterr().out
    value = float(text.split("angle_of_repose_flank_deg = { value = ")[1].split(",")[0])
    assert value == pytest.approx(truth(scene), abs=0.5)
    drawn = cv2.imread(str(tmp_path / "out" / "heap-measured.png"))
    red = (drawn == (40, 40, 230)).all(axis=2)
    assert 500 < red.sum() < 20000


@pytest.mark.slow
def test_a_scale_by_two_points_gives_lengths(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "heap.jpg", PLAIN)
    per_pixel = 1e3 * PLAIN.across / PLAIN.width
    scale = f"100,700,600,700,{500 * per_pixel}"
    out = ["--out", str(tmp_path), "--json"]
    assert main(["measure", "--photo", str(path), "--scale", scale, *out]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["heap_radius"] == pytest.approx(0.049, abs=0.002)
    assert main(["measure", "--photo", str(path), "--region", "150,250,900,350", *out]) == 0
    part = json.loads(capsys.readouterr().out)
    key = "angle_of_repose_flank_deg"
    assert part[key] == pytest.approx(found[key], abs=0.3)


@pytest.mark.parametrize(
    ("words", "code", "what"),
    [
        ((), 2, "name photographs with --photo"),
        (("top.png",), 2, "name photographs with --photo"),
        (("top.png", "side.png", "--scale", "0.2"), 2, "--scale is for photographs"),
        (("top.png", "side.png", "--photo", "a.jpg"), 2, "not both at once"),
        (("--photo", "a.jpg", "--scale", "0.2", "--sphere-diameter-mm", "50"), 2, "both give the scale"),
        (("--photo", "a.jpg", "--scale", "1,2,3"), 2, "not 3"),
        (("--photo", "a.jpg", "--scale", "1,2,1,2,50"), 2, "both points are the same"),
        (("--photo", "a.jpg", "--scale", "-1"), 2, "is not positive"),
        (("--photo", "a.jpg", "--region", "0,0,0,5"), 2, "1 or more"),
        (("--photo", "a.jpg"), 5, "a.jpg: no such file"),
        (("top.png", "side.png"), 5, "photographs are measured with --photo"),
    ],
)
def test_what_measure_cannot_take_is_told_in_one_line(
    words: tuple[str, ...], code: int, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        found = main(["measure", *words])
    except SystemExit as ended:
        found = ended.code  # type: ignore[assignment]
    message = capsys.readouterr().err
    assert (found, message.count("\n")) == (code, 1)
    assert what in message


@pytest.mark.slow
def test_a_photograph_from_above_gives_appendix_a(tmp_path: Path) -> None:
    side = write(tmp_path / "side.jpg", PLAIN)
    mm = 1e3 * PLAIN.across / PLAIN.width
    top = np.full((900, 900, 3), 200, np.uint8)
    cv2.circle(top, (450, 450), 240, (60, 110, 190), -1)  # 48 mm at 0.2 mm a pixel
    cv2.imwrite(str(tmp_path / "top.png"), top)
    found = measure_photographs(
        [side],
        Reference(scale=1e-3 * mm),
        top=(tmp_path / "top.png", Reference(scale=2e-4)),
        particle_diameter=DIAMETER,
    )
    assert found.height is not None and found.appendix_a_deg is not None
    assert math.tan(math.radians(found.appendix_a_deg)) == pytest.approx(
        (found.height - DIAMETER) / 0.048, rel=0.02
    )


def test_marks_are_read_back_and_damaged_ones_are_refused_in_one_line(tmp_path: Path) -> None:
    path, outline_and_scale = tmp_path / "photographs.json", [[0, 0], [1, 2], [3, 0], [0, 4.5], [3, 4.5]]
    good = {"points": outline_and_scale, "by_hand": True, "mm": 20}
    path.write_text(json.dumps({"a.png": good}))
    assert read_marks(path) == {"a.png": good}
    assert read_marks(tmp_path / "none.json") == {}
    damaged = [
        {"points": 3},
        {"points": [[0, 0]]},
        {"points": [[0, math.nan]] * 5},
        {"mm": -1},
        {"by_hand": 1},
    ]
    for text in ("{", "[]", '{"a.png": 3}', *(json.dumps({"a.png": good | bad}) for bad in damaged)):
        path.write_text(text)
        with pytest.raises(StoreError, match=r"photographs\.json is damaged; delete it") as refused:
            read_marks(path)
        assert "\n" not in str(refused.value)
