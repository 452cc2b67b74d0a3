"""An outline by hand has the angles of what is drawn, and those that were found where nothing was changed."""

from pathlib import Path

import numpy as np
import pytest

from calstudy.errors import MeasurementError
from calstudy.models.photograph.outline import HANDLES, measure_outline, outline_of
from calstudy.models.photograph.photograph import measure_photograph
from calstudy.models.photograph.photographs import read_photograph

IMAGES = Path(__file__).parent.parent / "docs" / "images"


def triangle(left, right, turn=0.0):
    """Outline of a triangle with flanks at two angles in degrees, of a picture that is turned."""
    a, b = np.tan(np.radians([left, right]))
    apex = 1000 * b / (a + b)
    x = np.linspace(0, 1000, HANDLES + 2)
    y = np.minimum(a * x, b * (1000 - x))
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    assert 0 < apex < 1000
    return np.column_stack([500 + c * x + s * y, 800 + s * x - c * y])


@pytest.mark.parametrize("turn", [0.0, 5.0, -8.0])
def test_the_angles_are_those_of_the_triangle_however_the_camera_is_turned(turn):
    found = measure_outline(triangle(20.0, 30.0, turn))
    assert np.allclose([found.left_deg, found.right_deg], [20.0, 30.0], atol=0.3)
    assert np.isclose(found.width, 1000)
    first, last = found.flanks[0]
    slope = np.degrees(np.arctan2(first[1] - last[1], last[0] - first[0]))
    assert abs(slope + turn - 20.0) < 0.3


def test_one_point_that_is_dragged_off_hardly_turns_the_angle_and_raises_its_doubt():
    points = triangle(25.0, 25.0)
    before = measure_outline(points)
    points[4, 1] -= 40
    after = measure_outline(points)
    assert abs(after.left_deg - before.left_deg) < 2.0
    assert after.doubt_deg > before.doubt_deg


def test_feet_the_wrong_way_round_are_refused():
    with pytest.raises(MeasurementError, match="foot"):
        measure_outline(triangle(20.0, 30.0)[::-1])


@pytest.mark.slow
def test_an_outline_that_nobody_changed_has_the_angles_that_were_found():
    found = measure_photograph(read_photograph(IMAGES / "photograph1.jpg"))
    points = outline_of(found)
    again = measure_outline(points)
    assert points.shape == (HANDLES + 2, 2)
    assert abs(again.angle_deg - found.angle_deg) < 0.8
    assert abs(again.width / found.width - 1) < 0.03
    assert abs(again.height / found.height - 1) < 0.1
