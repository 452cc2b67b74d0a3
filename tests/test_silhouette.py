import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calstudy.errors import InputError, MeasurementError
from calstudy.models.silhouette import read_picture, side_view, top_view, write_picture

BEAD = 0.0025
VIEWS = {"top": (top_view, (0, 1)), "side": (side_view, (0, 2))}
view = pytest.mark.parametrize("name", VIEWS)


def trimmed(black):
    rows, columns = np.flatnonzero(black.any(axis=1)), np.flatnonzero(black.any(axis=0))
    return black[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def parted(picture, pixels_per_mm, sphere_diameter=0.050):
    """Black pixels left of the white gap, and those right of it, which must be the sphere's."""
    black = picture == 0
    last = np.flatnonzero(black.any(axis=0))[-1]
    cut = last - int(1e3 * sphere_diameter * pixels_per_mm) - 2
    return black[:, :cut], black[:, cut:]


def brute_force(u, v, radii, pixels_per_mm):
    """Every pixel against every disc, on the grid whose lines are whole multiples of the pixel; v up."""
    u, v, r = (1e3 * pixels_per_mm * np.asarray(q) for q in (u, v, radii))
    x = np.arange(np.floor((u - r).min()) - 1, np.ceil((u + r).max()) + 1) + 0.5
    y = np.arange(np.ceil((v + r).max()) + 1, np.floor((v - r).min()) - 1, -1) - 0.5
    black = np.zeros((len(y), len(x)), bool)
    for a, b, c in zip(u, v, r, strict=True):
        black |= (x - a) ** 2 + (y[:, None] - b) ** 2 <= c**2
    return black


@view
@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 60),
    pixels_per_mm=st.sampled_from([0.5, 1.0, 3.3, 4.0, 7.0]),
)
def test_a_pixel_is_black_when_its_centre_is_in_a_disc(name, seed, n, pixels_per_mm):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(-0.02, 0.02, (n, 3)) + rng.uniform(-0.1, 0.1, 3)
    radii = rng.uniform(0.0015, 0.006, n)
    draw, (u, v) = VIEWS[name]
    heap, _ = parted(draw(centres, radii, pixels_per_mm=pixels_per_mm), pixels_per_mm)
    expected = brute_force(centres[:, u], centres[:, v], radii, pixels_per_mm)
    np.testing.assert_array_equal(trimmed(heap), trimmed(expected))


def test_a_pixel_whose_centre_lies_on_the_edge_is_black():
    # 512 pixels a metre and a centre in the middle of a pixel: nothing is rounded. 81 points of the square
    # lattice have x2 + y2 <= 25, twelve of them on the circle.
    picture = top_view([[0.5 / 512, 0.5 / 512, 0.0]], 5 / 512, pixels_per_mm=0.512)
    heap, _ = parted(picture, 0.512)
    assert heap.sum() == 81


def test_one_radius_for_all_beads_is_the_same_as_one_each():
    centres = np.random.default_rng(3).uniform(0, 0.05, (20, 3))
    np.testing.assert_array_equal(top_view(centres, BEAD), top_view(centres, np.full(20, BEAD)))


@view
def test_pictures_are_black_on_white(name):
    picture = VIEWS[name][0]([[0, 0, BEAD]], BEAD)
    assert picture.dtype == np.uint8 and picture.ndim == 2
    assert set(np.unique(picture)) == {0, 255}
    assert (picture[[0, -1]] == 255).all() and (picture[:, [0, -1]] == 255).all()


@view
def test_the_order_of_the_beads_changes_nothing(name):
    centres = np.random.default_rng(5).uniform(0, 0.05, (50, 3))
    draw = VIEWS[name][0]
    np.testing.assert_array_equal(draw(centres, BEAD), draw(centres[::-1], BEAD))


@view
def test_a_shift_by_whole_pixels_changes_nothing(name):
    centres = np.random.default_rng(5).uniform(0, 0.05, (50, 3)) * [1, 1, 0] + np.array([0, 0, 0.01])
    shifted = centres + np.array([0.0125, -0.0335, 0])
    draw = VIEWS[name][0]
    np.testing.assert_array_equal(draw(centres, BEAD), draw(shifted, BEAD))


@view
@pytest.mark.parametrize("pixels_per_mm", [0.2, 0.5, 1, 4, 10])
def test_the_sphere_touches_nothing(name, pixels_per_mm):
    rng = np.random.default_rng(7)
    centres = rng.uniform([-0.05, -0.05, BEAD], [0.05, 0.05, 0.08], (300, 3))  # higher than the sphere
    picture = VIEWS[name][0](centres, BEAD, pixels_per_mm=pixels_per_mm)
    columns = (picture == 0).any(axis=0)
    heap, sphere = parted(picture, pixels_per_mm)
    assert heap.any() and sphere.any()
    edges = np.flatnonzero(np.diff(columns))
    gap = edges[-2] - edges[-3]  # white columns before the last run of black ones
    assert gap >= max(2, 9 * pixels_per_mm)


@view
def test_the_sphere_covers_the_same_pixels_whatever_the_heap(name):
    rng = np.random.default_rng(8)
    draw = VIEWS[name][0]
    alone = trimmed(draw(np.empty((0, 3)), BEAD) == 0)
    for _ in range(5):
        centres = rng.uniform(-0.05, 0.05, (40, 3)) + rng.uniform(-1, 1, 3) * [1, 1, 0]
        np.testing.assert_array_equal(trimmed(parted(draw(centres, BEAD), 4.0)[1]), alone)


def test_without_beads_only_the_sphere_is_drawn():
    for draw in (top_view, side_view):
        for none in ([], np.empty((0, 3))):
            black = draw(none, BEAD) == 0
            assert trimmed(black).shape == (200, 200)
            assert black.sum() == pytest.approx(np.pi * 100**2, rel=1e-3)


def test_the_sphere_rests_on_the_plate():
    heap, sphere = parted(side_view([[0, 0, BEAD]], BEAD), 4.0)
    assert np.flatnonzero(heap.any(axis=1))[-1] == np.flatnonzero(sphere.any(axis=1))[-1]


def test_the_first_row_of_the_side_view_is_the_top():
    heap, _ = parted(side_view([[0, 0, BEAD], [0, 0, 0.05], [0.02, 0, 0.05]], BEAD), 4.0)
    rows = np.flatnonzero(heap.any(axis=1))
    assert heap[rows[0] : rows[0] + 20].sum() == pytest.approx(2 * heap[rows[-1] - 19 : rows[-1] + 1].sum())


def test_the_first_row_of_the_top_view_is_the_greatest_y():
    heap, _ = parted(top_view([[0, 0.03, 0], [0.02, 0.03, 0], [0, -0.03, 0]], BEAD), 4.0)
    rows = np.flatnonzero(heap.any(axis=1))
    assert heap[rows[0] : rows[0] + 20].sum() == pytest.approx(2 * heap[rows[-1] - 19 : rows[-1] + 1].sum())


@view
@pytest.mark.parametrize(
    ("centres", "radii", "options", "complaint"),
    [
        ([[0, 0]], BEAD, {}, "shape"),
        ([0, 0, 0], BEAD, {}, "shape"),
        ([[0, 0, np.nan]], BEAD, {}, "finite"),
        ([[0, 0, 0]], 0.0, {}, "radii"),
        ([[0, 0, 0]], np.nan, {}, "radii"),
        ([[0, 0, 0]], [BEAD, BEAD], {}, "radii"),
        ([[0, 0, 0]], BEAD, {"pixels_per_mm": 0}, "pixels per mm"),
        ([[0, 0, 0]], BEAD, {"sphere_diameter": np.inf}, "sphere diameter"),
    ],
)
def test_what_cannot_be_drawn_is_refused(name, centres, radii, options, complaint):
    with pytest.raises(InputError, match=complaint):
        VIEWS[name][0](centres, radii, **options)


@view
def test_a_bead_thrown_far_away_is_told_and_does_not_fill_the_memory(name):
    with pytest.raises(MeasurementError, match="too far for a picture"):
        VIEWS[name][0]([[0, 0, 0], [1e4, 0, 1e4], [0, 1e4, 0]], BEAD)


@pytest.fixture
def picture():
    return top_view([[0, 0, BEAD]], BEAD)


def test_a_written_picture_is_read_back(picture, tmp_path):
    write_picture(tmp_path / "top.png", picture)
    np.testing.assert_array_equal(read_picture(tmp_path / "top.png"), picture)
    np.testing.assert_array_equal(read_picture(str(tmp_path / "top.png")), picture)


def test_other_kinds_of_picture_are_read_as_grey(picture, tmp_path):
    transparent = np.dstack([np.zeros_like(picture)] * 3 + [255 - picture])  # black on nothing at all
    for file, array in {
        "colour.png": np.dstack([picture] * 3),
        "deep.png": picture.astype(np.uint16) * 257,
        "transparent.png": transparent,
        "bitmap.bmp": picture,
    }.items():
        assert cv2.imwrite(str(tmp_path / file), array)
        np.testing.assert_array_equal(read_picture(tmp_path / file), picture, err_msg=file)


@pytest.mark.parametrize("kind", [".png", ".jpg"])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_picture_is_told_in_one_line(picture, tmp_path, capfd, kind, share):
    content = cv2.imencode(kind, picture)[1].tobytes()
    (tmp_path / "cut").write_bytes(content[: int(share * len(content))])
    with pytest.raises(MeasurementError, match="not a picture"):
        read_picture(tmp_path / "cut")
    assert capfd.readouterr().err == ""


def test_a_turned_picture_with_transparency_is_told(picture, tmp_path):
    from PIL import Image

    grey = np.dstack([picture] * 3 + [np.full_like(picture, 255)])
    image = Image.fromarray(grey[:, : grey.shape[1] // 2])
    exif = image.getexif()
    exif[0x0112] = 6
    image.save(tmp_path / "turned.png", exif=exif)
    with pytest.raises(MeasurementError, match=r"turned.png: is stored turned; save it upright"):
        read_picture(tmp_path / "turned.png")


def test_files_that_are_no_pictures_are_told(tmp_path, capfd):
    (tmp_path / "text.png").write_text("a heap")
    for file, complaint in (
        ("text.png", "not a picture"),
        ("none.png", "no such file"),
        (".", "cannot be read"),
    ):
        with pytest.raises(MeasurementError, match=complaint) as caught:
            read_picture(tmp_path / file)
        assert str(tmp_path) in str(caught.value) and "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


def test_a_picture_that_cannot_be_written_is_told(picture, tmp_path):
    with pytest.raises(MeasurementError, match="cannot be written"):
        write_picture(tmp_path / "none" / "top.png", picture)
    with pytest.raises(MeasurementError, match="not a picture but float64"):
        write_picture(tmp_path / "top.png", picture.astype(float))
