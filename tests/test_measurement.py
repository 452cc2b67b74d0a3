"""The truth here is Appendix A on the exact union of discs, computed without calstudy and OpenCV.

Which discs hang together comes from their distances, heights from their extremes, areas from chords: in
each of many thousand rows the union of discs is a few intervals, whose ends are known exactly.
"""

import math
from dataclasses import astuple, replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from calstudy.errors import InputError, MeasurementError
from calstudy.models import measurement
from calstudy.models.measurement import HeapMeasurement, measure, measure_heap, write_picture
from calstudy.models.silhouette import side_view, top_view

BEAD = 0.005
NO_HEAP = HeapMeasurement(0.0, math.nan, 0.0, stands=False)


@cache
def cone(radius=0.046, height=0.030, turn=0.3, x=0.0012, y=-0.0007):
    """Layers of a hexagonal grid; beads overlap by a tenth, so that no contact is a matter of pixels."""
    i, j = np.meshgrid(np.arange(-30, 31), np.arange(-30, 31))
    grid = 0.9 * BEAD * np.column_stack([(i + 0.5 * j).ravel(), (math.sqrt(0.75) * j).ravel()])
    layers = []
    for n in range(int((height - BEAD) / (0.8 * BEAD)) + 1):
        z = 0.5 * BEAD + 0.8 * BEAD * n
        layer = grid + 0.52 * BEAD * np.array([math.cos(n), math.sin(n)]) * (n % 3 > 0)
        layer = layer[np.hypot(*layer.T) <= radius * (1 - (z - 0.5 * BEAD) / height) - 0.5 * BEAD]
        layers.append(np.column_stack([layer, np.full(len(layer), z)]))
    beads = np.vstack(layers)
    c, s = math.cos(turn), math.sin(turn)
    beads[:, :2] = beads[:, :2] @ np.array([[c, s], [-s, c]]) + [x, y]
    return beads


@cache
def cone_with_arms():
    """Rows of single beads that hang on to the cone: the loose outer area of Figure 9a, exaggerated."""
    out = np.arange(9, 21) * 0.9 * BEAD
    arms = [np.column_stack([out * math.cos(a), out * math.sin(a)]) for a in (0.3, 1.3, 3.5)]
    flat = np.vstack(arms) + np.array([0.0012, -0.0007])
    return np.vstack([cone(), np.column_stack([flat, np.full(len(flat), 0.5 * BEAD)])])


@cache
def lopsided_cone():
    """A cone of which one side has slid away, so that its apex is far from its centroid, and that stands
    off the middle of the plate.
    """
    beads = cone()
    return beads[beads[:, 0] < 0.018] + np.array([0.0093, -0.0142, 0.0])


def largest_group(flat):
    tree = cKDTree(flat)
    _, group = connected_components(tree.sparse_distance_matrix(tree, BEAD), directed=False)
    return group == np.bincount(group).argmax()


def chords(flat, rows_per_mm=200):
    """The union of discs as intervals of x: y, first, last, each (n,), and the rows' distance, in m."""
    r, found = 0.5 * BEAD, []
    low, high = flat[:, 1].min() - r, flat[:, 1].max() + r
    rows = round(1e3 * rows_per_mm * (high - low))
    step = (high - low) / rows
    for y in low + step * (np.arange(rows) + 0.5):
        away = flat[:, 1] - y
        x, half = flat[np.abs(away) < r, 0], np.sqrt(r**2 - away[np.abs(away) < r] ** 2)
        order = np.argsort(x - half)
        first, last = (x - half)[order], np.maximum.accumulate((x + half)[order])
        begins = np.append(True, first[1:] > last[:-1])  # a gap before it
        found.append([np.full(begins.sum(), y), first[begins], last[np.append(begins[1:], True)]])
    return *np.hstack(found), step


@cache
def true_radii(heap, rounds=3):
    """Equal-area radius in m of a heap before any dropping, after dropping once, twice, ..."""
    beads = heap()
    y, first, last, step = chords(beads[largest_group(beads[:, :2]), :2])
    radii = []
    for _ in range(rounds):
        area = step * (last - first).sum()
        radii.append(math.sqrt(area / math.pi))
        x0, y0 = step * (last**2 - first**2).sum() / 2 / area, step * (y * (last - first)).sum() / area
        half = np.sqrt(np.maximum(radii[-1] ** 2 - (y - y0) ** 2, 0.0))
        first, last = np.maximum(first, x0 - half), np.minimum(last, x0 + half)
        last = np.maximum(first, last)
    return radii


def true_height(beads):
    return np.ptp(beads[largest_group(beads[:, ::2]), 2])


@pytest.fixture(scope="module")
def truth():
    radius, height = true_radii(cone)[1], true_height(cone())
    return HeapMeasurement(math.degrees(math.atan(height / radius)), radius, height, stands=True)


def is_about(expected, pixels_per_mm=4.0, share=0.1):
    """Compare with the truth within a share of a pixel.

    A pixel is half in at the heap's outline; over hundreds of outline pixels the halves average out to far
    less than a tenth of a pixel of radius. Rows are counted, and a rounded length is off by half a pixel
    at most, but by nothing for these heaps, whose height is a whole number of pixels.
    """
    return pytest.approx(expected, abs=share * 1e-3 / pixels_per_mm)


def test_the_angle_is_that_of_height_over_radius(truth):
    found = measure_heap(cone(), BEAD)
    assert found.stands
    assert found.radius == is_about(truth.radius)
    assert found.height == is_about(truth.height)
    assert found.angle_of_repose_deg == math.degrees(math.atan(found.height / found.radius))
    assert found.angle_of_repose_deg == pytest.approx(truth.angle_of_repose_deg, abs=0.05)


def test_the_error_shrinks_with_the_pixels(truth):
    rng = np.random.default_rng(11)
    shifts = rng.uniform(-0.01, 0.01, (6, 3)) * [1, 1, 0]
    mean_errors = []
    for pixels_per_mm in (2, 4, 8):
        found = [measure_heap(cone() + shift, BEAD, pixels_per_mm=pixels_per_mm) for shift in shifts]
        for one in found:
            assert one.radius == is_about(truth.radius, pixels_per_mm)
            assert one.height == is_about(truth.height, pixels_per_mm)
        mean_errors.append(np.mean([abs(one.radius - truth.radius) for one in found]))
    assert mean_errors[0] > 1.5 * mean_errors[1] > 2.25 * mean_errors[2]


def test_the_height_is_unbiased_whatever_part_of_a_pixel_it_ends_on():
    rng = np.random.default_rng(12)
    base = cone(radius=0.02, height=0.012)
    tops = 0.008 + rng.uniform(0, 0.002, 60)
    errors = [
        measure_heap(np.vstack([base, [0, 0, top]]), BEAD, pixels_per_mm=2).height - (top - 0.5 * BEAD)
        for top in tops
    ]
    pixel = 0.5e-3
    assert np.abs(errors).max() < 0.55 * pixel
    # A uniform rounding error has a standard deviation of 0.29 pixels, the mean of 60 one of 0.037; the
    # bare difference of the row numbers would be off by a whole pixel.
    assert abs(np.mean(errors)) < 0.12 * pixel


@pytest.mark.parametrize("shift", [(0.0111, -0.0077), (-0.3003, 0.2), (0.00013, 0.00009)])
def test_shifting_the_heap_changes_nothing(truth, shift):
    found = measure_heap(cone() + np.array([*shift, 0.0]), BEAD)
    assert found.radius == is_about(truth.radius)
    assert found.height == is_about(truth.height)


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.1, 2.0])
def test_turning_the_heap_changes_nothing(truth, turn):
    found = measure_heap(cone(turn=turn), BEAD)
    assert found.radius == is_about(truth.radius)
    assert found.height == is_about(truth.height)


def test_stray_beads_change_nothing():
    rng = np.random.default_rng(13)
    direction = rng.uniform(0, 2 * math.pi, 30)
    distance = rng.uniform(0.06, 0.15, 30)
    stray = np.column_stack([distance * np.cos(direction), distance * np.sin(direction), np.full(30, 0.0025)])
    assert measure_heap(np.vstack([cone(), stray]), BEAD) == measure_heap(cone(), BEAD)


def test_the_truth_of_a_single_bead_and_of_a_pair_is_known():
    single = np.array([[0.3, -0.2, 0.5 * BEAD]])
    pair = np.array([[0.0, 0.0, 0.5 * BEAD], [0.0, 0.9 * BEAD, 0.5 * BEAD]])
    assert true_radii(lambda: single) == pytest.approx([0.5 * BEAD] * 3, rel=1e-5)
    r = 0.5 * BEAD
    lens = 2 * r**2 * math.acos(0.9) - 0.9 * BEAD / 2 * math.sqrt(4 * r**2 - (0.9 * BEAD) ** 2)
    none, once, _ = true_radii(lambda: pair)
    assert none == pytest.approx(math.sqrt((2 * math.pi * r**2 - lens) / math.pi), rel=1e-5)
    assert once < 0.95 * none


@pytest.mark.slow
@pytest.mark.parametrize("turn", [0.0, 0.7, 2.1])
def test_a_heap_whose_apex_is_off_its_middle_is_measured_about_its_centroid(turn):
    none, once, _ = true_radii(lopsided_cone)
    assert none - once > 0.5e-3, "a circle about the apex, or one round, gives another answer"
    c, s = math.cos(turn), math.sin(turn)
    turned = lopsided_cone() @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    found = measure_heap(turned, BEAD)
    assert found.radius == is_about(once)
    assert found.height == is_about(true_height(lopsided_cone()))


def test_two_rounds_are_what_the_radius_is_taken_from():
    none, once, twice = true_radii(cone_with_arms)
    assert none - once > 1e-3 and once - twice > 0.2e-3  # each other number of rounds gives another answer
    assert measure_heap(cone_with_arms(), BEAD).radius == is_about(once)


def pictures(beads=None, **options):
    beads = cone() if beads is None else beads
    return {"top": top_view(beads, 0.5 * BEAD, **options), "side": side_view(beads, 0.5 * BEAD, **options)}


@pytest.mark.parametrize("sphere_diameter", [0.020, 0.035, 0.0443, 0.050, 0.0895, 0.120])
def test_the_sphere_may_be_smaller_larger_or_as_large_as_the_heap(truth, sphere_diameter):
    # 0.0443 m and 0.0895 m are as large as the heap's side and top view; at 0.020 m the sphere is 80 pixels
    # across and its own rounding reaches a thousandth.
    found = measure_heap(cone(), BEAD, sphere_diameter=sphere_diameter)
    assert found.radius == is_about(truth.radius, share=0.2)
    assert found.height == is_about(truth.height, share=0.2)
    assert measure(**pictures(sphere_diameter=sphere_diameter), sphere_diameter=sphere_diameter) == found


@pytest.mark.parametrize("name", ["top", "side"])
@pytest.mark.parametrize("share", [0.98, 0.995, 1.0, 1.005, 1.02])
def test_a_sphere_of_nearly_the_area_of_the_heap_is_told_from_it(truth, name, share):
    area = (pictures()[name][:, : sphere_columns(pictures()[name])[0]] == 0).sum() / 4000**2
    sphere_diameter = 2 * math.sqrt(share * area / math.pi)
    picture = pictures(sphere_diameter=sphere_diameter)[name]
    cut = sphere_columns(picture)[0]
    heap, sphere = (int((part == 0).sum()) for part in (picture[:, :cut], picture[:, cut:]))
    assert sphere / heap == pytest.approx(share, abs=1e-3)
    found = measure_heap(cone(), BEAD, sphere_diameter=sphere_diameter)
    assert found.radius == is_about(truth.radius, share=0.2)
    assert found.height == is_about(truth.height, share=0.2)


@pytest.mark.parametrize("rank", [0, 1])
def test_telling_the_sphere_by_its_size_would_fail(truth, monkeypatch, rank):
    monkeypatch.setattr(measurement, "_sphere", lambda objects, *_: objects[rank])
    assert measure_heap(cone(), BEAD).angle_of_repose_deg != pytest.approx(truth.angle_of_repose_deg, abs=2)


@pytest.mark.parametrize("size", [60, 100, 150])
def test_of_two_round_objects_the_rounder_one_is_the_sphere(size):
    top = np.full((400, 800), 255, np.uint8)
    cv2.circle(top, (650, 200), 100, 0, cv2.FILLED)
    cv2.ellipse(top, (200, 200), (size, round(0.97 * size)), 0, 0, 360, 0, cv2.FILLED)
    radius = measure(top, pictures()["side"]).radius
    assert radius == pytest.approx(0.025 * size / 100, rel=0.03)


def test_a_heap_in_two_pieces_that_are_larger_than_the_sphere_is_measured_on_the_largest():
    far = cone(radius=0.04, x=0.1)
    found = measure_heap(np.vstack([cone(), far]), BEAD)
    assert found.radius == measure_heap(cone(), BEAD).radius


def test_files_and_arrays_give_what_the_positions_give(tmp_path):
    drawn = pictures()
    for name, picture in drawn.items():
        write_picture(tmp_path / f"{name}.png", picture)
    expected = measure_heap(cone(), BEAD)
    assert measure(drawn["top"], drawn["side"]) == expected
    assert measure(tmp_path / "top.png", str(tmp_path / "side.png")) == expected


def test_the_views_may_have_different_scales(truth):
    found = measure(pictures(pixels_per_mm=4.0)["top"], pictures(pixels_per_mm=8.0)["side"])
    assert found.radius == is_about(truth.radius)
    assert found.height == is_about(truth.height)


def test_lengths_scale_with_the_sphere_and_the_particle_comes_off_the_height():
    drawn = pictures()
    one = measure(**drawn, particle_diameter=0.005)
    assert measure(**drawn, particle_diameter=0.007).height == pytest.approx(one.height - 0.002)
    twice = measure(**drawn, sphere_diameter=0.100, particle_diameter=0.010)
    assert astuple(twice)[:3] == pytest.approx((one.angle_of_repose_deg, 2 * one.radius, 2 * one.height))


def test_grey_counts_as_black_below_the_middle():
    grey = {name: np.where(picture == 0, 127, 128).astype(np.uint8) for name, picture in pictures().items()}
    assert measure(**grey) == measure(**pictures())


def test_what_touches_by_a_corner_is_one_object():
    side = np.full((300, 500), 255, np.uint8)
    cv2.circle(side, (400, 150), 30, 0, cv2.FILLED)
    side[100:150, 50:150] = 0
    side[150:200, 150:250] = 0
    top = pictures()["top"]
    both = measure(top, side).height
    side[150, 150] = 255  # now nothing but white between the two
    assert both > 1.5 * measure(top, side).height


@pytest.mark.parametrize(
    ("views", "says"),
    [
        (
            lambda d: (d["side"], d["top"]),
            "top picture: the heap is .* no heap is from above; give the top view",
        ),
        (lambda d: (d["side"], d["side"]), "top picture: the heap is"),
        (
            lambda d: (d["top"], np.rot90(d["side"]).copy()),
            "side picture: the heap is .* both views of one heap",
        ),
        (lambda d: (stray(d["top"]), d["side"]), "top picture: beside the largest round object is nothing"),
        (lambda d: (stray(d["top"], 13), d["side"]), "top picture: beside the largest round object"),
    ],
    ids=["swapped", "side twice", "turned", "no sphere", "no sphere but a speck"],
)
def test_views_that_are_not_of_one_heap_are_refused(views, says):
    with pytest.raises(MeasurementError, match=says):
        measure(*views(pictures()))


@pytest.mark.parametrize("radius", [70, 130])
def test_a_heap_as_round_as_the_sphere_is_told_by_the_side_view(radius):
    top, side = (np.full((400, 800), 255, np.uint8) for _ in range(2))
    for picture in (top, side):
        cv2.circle(picture, (150, 200), 100, 0, cv2.FILLED)
    cv2.circle(top, (500, 200), radius, 0, cv2.FILLED)
    cv2.fillPoly(side, [np.array([(500 - radius, 300), (500 + radius, 300), (500, 300 - radius // 2)])], 0)
    found = measure(top, side)
    assert found.radius == pytest.approx(0.025 * radius / 100, rel=0.01)
    assert found.height == pytest.approx(0.025 * (radius // 2) / 100 - BEAD, abs=3e-4)


def stray(like, size=1):
    """A round heap without a sphere, and a black speck."""
    picture = np.full_like(like, 255)
    cv2.circle(picture, (picture.shape[1] // 2, picture.shape[0] // 2), 150, 0, cv2.FILLED)
    picture[5 : 5 + size, 5 : 5 + size] = 0
    return picture


def test_objects_cut_by_the_border_do_not_matter_unless_measured():
    drawn = pictures()
    expected = measure(**drawn)
    for picture in drawn.values():
        cv2.circle(picture, (3, 30), 10, 0, cv2.FILLED)
    assert measure(**drawn) == expected


@pytest.mark.parametrize("name", ["top", "side"])
@pytest.mark.parametrize("side", ["left", "above", "below"])
def test_a_heap_whose_bead_touches_the_border_is_refused_and_one_a_pixel_away_is_not(name, side):
    drawn = pictures()
    expected = measure(**drawn)
    quarter = {"left": 0, "above": 1, "below": 3}[side]
    upright = np.rot90(drawn[name], -quarter)  # the border in question is the left one now
    first = np.flatnonzero((upright == 0).any(axis=0))[0]
    for margin, refused in ((1, False), (0, True)):
        cut = np.ascontiguousarray(np.rot90(upright[:, first - margin :], quarter))
        if refused:
            with pytest.raises(MeasurementError, match=f"{name} picture: the (heap|sphere) is cut"):
                measure(**{**drawn, name: cut})
        else:
            assert measure(**{**drawn, name: cut}) == expected


def test_the_callers_threads_are_left_as_they_were():
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        measure_heap(cone(), BEAD)
        with pytest.raises(MeasurementError):
            measure(np.zeros((9, 9), np.uint8), np.zeros((9, 9), np.uint8))
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


@pytest.mark.parametrize("pixels_per_mm", [0.5, 1.0, 4.0])
def test_no_heap_is_an_outcome(pixels_per_mm):
    def outcome(beads):
        return measure_heap(beads, BEAD, pixels_per_mm=pixels_per_mm)

    z = 0.5 * BEAD
    assert repr(outcome([])) == repr(NO_HEAP)  # NaN is not equal to itself
    single = [[0.0, 0.0, z]]
    scattered = [[0.0, 0.0, z], [0.031, 0.013, z], [-0.024, 0.03, z]]
    carpet = cone() * [1, 1, 0] + np.array([0, 0, z])
    for beads in (single, scattered, carpet):
        found = outcome(beads)
        assert replace(found, radius=math.nan).__repr__() == repr(NO_HEAP)
        assert found.radius > 0
    assert outcome(single).radius == pytest.approx(0.0025, rel=0.2)
    assert outcome(np.vstack([carpet, [0, 0, 0.8 * BEAD + z]])).stands  # one bead on top


@pytest.mark.parametrize("pixels_per_mm", [6.0, 8.0])
def test_a_single_bead_is_no_sphere_though_it_is_as_round_as_one(pixels_per_mm):
    found = measure_heap([[0.0, 0.0, 0.5 * BEAD]], BEAD, pixels_per_mm=pixels_per_mm)
    assert found.radius == pytest.approx(0.5 * BEAD, rel=0.05) and not found.stands


def test_beads_from_10_mm_to_2_mm_and_wide_heaps_are_measured(truth):
    for factor in (2.0, 0.4):
        found = measure_heap(factor * cone(), factor * BEAD, pixels_per_mm=4 / factor)
        assert found.angle_of_repose_deg == pytest.approx(truth.angle_of_repose_deg, abs=0.1)
    wide = 2 * cone(radius=0.06)  # 10 mm beads on 0.24 m: beside it the sphere is as small as a large bead
    assert measure_heap(wide, 2 * BEAD).stands


# --- what is refused ------------------------------------------------------------------------------------


def sphere_columns(picture):
    """First and last column of the sphere, the last run of columns with black."""
    edges = np.flatnonzero(np.diff((picture == 0).any(axis=0)))
    return edges[-2] + 1, edges[-1]


def without_sphere(picture):
    first, _ = sphere_columns(picture)
    return np.where(np.arange(picture.shape[1]) >= first, 255, picture).astype(np.uint8)


def without_heap(picture):
    return picture[:, sphere_columns(picture)[0] - 5 :]


def merged(picture):
    """Join sphere and heap by a bar."""
    first, _ = sphere_columns(picture)
    row = int(np.flatnonzero((picture[:, first:] == 0).any(axis=1)).mean())
    row = max(row, int(np.flatnonzero((picture[:, : first - 30] == 0).any(axis=1)).mean()))
    joined = picture.copy()
    joined[row - 3 : row + 4, picture.shape[1] // 3 : first + 60] = 0
    return joined


def with_loose_beads(picture, n):
    wider = np.pad(picture, ((0, 0), (0, 40 * n + 40)), constant_values=255)
    for k in range(n):
        cv2.circle(wider, (picture.shape[1] + 40 * k + 20, picture.shape[0] // 2), 10, 0, cv2.FILLED)
    return wider


def square_sphere(picture):
    first, last = sphere_columns(picture)
    changed = without_sphere(picture)
    changed[20 : 20 + last - first, first:last] = 0
    return changed


def two_spheres(picture):
    return np.hstack([without_heap(picture)] * 2)


REFUSED = {
    "white": (lambda p: np.full_like(p, 255), "blank"),
    "black": (np.zeros_like, "blank"),
    "empty": (lambda p: p[:0], "blank"),
    "no sphere": (without_sphere, "one object instead of two"),
    "no heap": (without_heap, "one object instead of two"),
    "touching": (merged, "one object instead of two"),
    "touching, with a loose bead": (lambda p: with_loose_beads(merged(p), 1), "as a loose particle"),
    "touching, with loose beads": (lambda p: with_loose_beads(merged(p), 3), "as a loose particle"),
    "no sphere, but a loose bead": (
        lambda p: with_loose_beads(without_sphere(p), 1),
        "as a loose particle|times smaller",
    ),
    "not round": (square_sphere, "no object is round"),
    "squeezed": (lambda p: np.repeat(p, 2, axis=1), "no object is round"),
    "inverted": (lambda p: 255 - p, "invert"),
    "heap cut": (lambda p: p[:, 100:], "the heap is cut"),
    "sphere cut": (lambda p: p[:, : sphere_columns(p)[1] - 2], "the sphere is cut"),
    "two spheres": (two_spheres, "equally round"),
    "few pixels": (
        lambda p: cv2.resize(p, None, fx=0.05, fy=0.05, interpolation=cv2.INTER_AREA),
        "less than 20 pixels",
    ),
    "nothing": (lambda p: None, "not a picture"),
    "a list": (lambda p: p.tolist(), "not a picture"),
    "floats": (lambda p: p.astype(float), "not a picture"),
    "colour": (lambda p: np.dstack([p] * 3), "not a picture"),
    "no file": (lambda p: "no/such/file.png", "no such file"),
    "no picture file": (lambda p: __file__, "not a picture"),
}


@pytest.mark.parametrize("name", ["top", "side"])
@pytest.mark.parametrize("case", REFUSED)
def test_a_picture_that_cannot_be_measured_is_told_in_one_line(name, case):
    spoil, complaint = REFUSED[case]
    drawn = pictures()
    drawn[name] = spoil(drawn[name])
    with pytest.raises(MeasurementError, match=complaint) as caught:
        measure(**drawn)
    assert str(caught.value).startswith(f"{name} picture")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250


@pytest.mark.parametrize(
    "diameters",
    [
        {"sphere_diameter": 0.0},
        {"particle_diameter": -1.0},
        {"sphere_diameter": math.nan},
        {"sphere_diameter": 0.005},
    ],
)
def test_diameters_that_are_none_are_refused(diameters):
    with pytest.raises(InputError, match=r"diameter|larger"):
        measure(**pictures(), **diameters)


@pytest.mark.parametrize("pixels_per_mm", [0.3, 0.0, math.nan])
def test_too_low_a_resolution_is_refused(pixels_per_mm):
    with pytest.raises(InputError, match="too few"):
        measure_heap(cone(), BEAD, pixels_per_mm=pixels_per_mm)
