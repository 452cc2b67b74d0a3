import math
from collections import Counter

import numpy as np
import pytest

from calstudy.models.angle_of_repose import load_model
from calstudy.models.geometry import stl, tube
from calstudy.plan_file import load_plan

FIDELITIES = ("full", "fast", "soft", "coarse", "tiny")


def parse_stl(text):
    """Normals (n, 3) and triangles (n, 3, 3) of an ASCII STL."""
    words = [line.split() for line in text.splitlines()]
    normals = [list(map(float, line[2:])) for line in words if line[:2] == ["facet", "normal"]]
    corners = [list(map(float, line[1:])) for line in words if line[:1] == ["vertex"]]
    return np.array(normals), np.array(corners).reshape(-1, 3, 3)


def area_below(triangles, height):
    """Area that the corners at one height enclose."""
    flat = triangles.reshape(-1, 3)
    flat = flat[flat[:, 2] == height, :2]
    x, y = flat[np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))].T
    return 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def edges(triangles):
    """How many triangles have each edge; corners closer than 1e-12 m are the same."""
    keys = [[tuple(corner) for corner in np.round(t, 12) + 0.0] for t in triangles]
    return Counter(frozenset((t[k], t[k - 1])) for t in keys for k in range(3))


@pytest.mark.parametrize("facets", [3, 4, 24, 48, 1000])
def test_a_tube_encloses_the_circles_area(facets):
    triangles = tube(0.05, 0.003, 0.13, facets)
    assert triangles.shape == (2 * facets, 3, 3)
    for height in (0.003, 0.13):
        assert area_below(triangles, height) == pytest.approx(math.pi * 0.05**2, rel=1e-12)


def test_corners_on_the_circle_would_enclose_less():
    angles = 2 * np.pi * np.arange(24) / 24
    inscribed = np.column_stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), np.zeros(24)])
    assert area_below(inscribed[None], 0.0) < 0.99 * math.pi * 0.05**2


def test_the_wall_is_closed_and_open_only_at_both_ends():
    count = edges(tube(0.05, 0.0, 0.1, 24))
    rims = [edge for edge, n in count.items() if n == 1]
    assert set(count.values()) == {1, 2}
    assert len(rims) == 2 * 24
    for height in (0.0, 0.1):
        ends = Counter(corner for edge in rims for corner in edge if corner[2] == height)
        assert len(ends) == 24
        assert set(ends.values()) == {2}, "the rim is one closed ring"


def test_a_wall_with_a_missing_triangle_is_not_closed():
    count = edges(tube(0.05, 0.0, 0.1, 24)[1:])
    assert sum(n == 1 for n in count.values()) != 2 * 24


def test_stl_gives_back_the_same_numbers():
    triangles = tube(0.05, 0.003, 0.13, 24)
    _, parsed = parse_stl(stl("cylinder", triangles))
    np.testing.assert_allclose(parsed, triangles, rtol=1e-8, atol=1e-15)


def test_stl_is_framed_as_the_format_asks():
    text = stl("ring", tube(0.05, 0.0, 0.003, 24))
    lines = text.splitlines()
    assert lines[0] == "solid ring"
    assert lines[-1] == "endsolid ring"
    assert text.endswith("\n")
    count = Counter(line.split()[0] for line in lines)
    assert count["facet"] == count["endfacet"] == count["outer"] == count["endloop"] == 48
    assert count["vertex"] == 3 * 48
    assert "-0 " not in text
    assert "nan" not in text


def test_normals_are_unit_vectors_that_all_point_the_same_way():
    normals, triangles = parse_stl(stl("ring", tube(0.05, 0.0, 0.003, 24)))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-8)
    np.testing.assert_allclose(normals[:, 2], 0.0, atol=1e-12)
    outwards = np.einsum("ij,ij->i", normals, triangles.mean(axis=1))
    assert (outwards > 0).all() or (outwards < 0).all()


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_the_cylinder_begins_where_the_ring_ends(fidelity):
    model = load_model(load_plan().fixed, fidelity)
    _, ring = parse_stl(model.files["ring.stl"])
    _, cylinder = parse_stl(model.files["cylinder.stl"])
    assert ring[..., 2].min() == 0.0
    assert ring[..., 2].max() == cylinder[..., 2].min() == model.fidelity.ring_height
    assert cylinder[..., 2].max() > model.schedule["pour_top"]


@pytest.mark.parametrize("name", ["ring.stl", "cylinder.stl"])
def test_the_models_walls_enclose_the_circle_of_section_2_2(name):
    model = load_model(load_plan().fixed, "full")
    _, wall = parse_stl(model.files[name])
    assert area_below(wall, wall[..., 2].max()) == pytest.approx(math.pi / 4 * 0.1**2, rel=1e-7)
    assert model.fill_volume == pytest.approx(math.pi / 4 * 0.1**2 * 0.05, rel=1e-12)
