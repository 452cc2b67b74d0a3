"""The rotating drum: the slope that a camera sees, and what a real run obeys."""

import math

import numpy as np
import pytest

from material_runs import measures, tiny_run

DRUM = measures("rotating_drum")
DIAMETER, RADIUS = 0.004, 0.075


def bed(slope):
    """Beads of a bed in a drum whose surface falls with x by a slope in deg, in rows that touch."""
    grid = np.mgrid[-18:19, -2:3, -18:19].reshape(3, -1).T * DIAMETER
    turned = math.radians(slope)
    x = grid[:, 0] * math.cos(turned) + grid[:, 2] * math.sin(turned)
    z = -grid[:, 0] * math.sin(turned) + grid[:, 2] * math.cos(turned)
    there = (grid[:, 2] <= 0) & (np.hypot(x, z) < RADIUS)
    return np.column_stack([x, grid[:, 1], z])[there]


@pytest.mark.parametrize("slope", [-20.0, 0.0, 33.0])
def test_the_slope_of_a_tilted_bed_is_found(slope):
    assert DRUM.surface_angle_deg(bed(slope), DIAMETER, RADIUS) == pytest.approx(slope, abs=0.6)


def test_beads_that_fly_are_not_of_the_surface():
    points = bed(25.0)
    flying = np.array([[-0.02, 0.0, 0.05], [0.01, 0.004, 0.06], [0.03, -0.004, 0.03]])
    assert DRUM.surface_angle_deg(np.concatenate([points, flying]), DIAMETER, RADIUS) == pytest.approx(
        DRUM.surface_angle_deg(points, DIAMETER, RADIUS), abs=1e-9
    )
    assert len(DRUM.bed(np.concatenate([points, flying]), DIAMETER)) <= len(points)


def test_the_silhouette_of_a_bead_is_its_upper_half():
    columns = np.array([-0.003, 0.0, 0.001, 0.003])
    top = DRUM.silhouette(np.array([0.0]), np.array([0.01]), 0.002, columns)
    assert np.isnan(top[[0, 3]]).all()
    assert top[1:3] == pytest.approx([0.012, 0.01 + math.sqrt(3) * 0.001])


def test_an_empty_middle_has_no_slope():
    with pytest.raises(ValueError, match="too few beads"):
        DRUM.surface_angle_deg(bed(0.0) * [0.2, 1, 1] + [0.06, 0, 0], DIAMETER, RADIUS)


@pytest.mark.liggghts
def test_the_drum_keeps_its_beads_and_cascades_at_a_larger_angle():
    run, marks, _ = tiny_run("rotating_drum")
    assert marks["beads_end"] == marks["beads_filled"]
    assert int(marks["beads_filled"]) >= 0.97 * int(marks["beads_wanted"])
    assert 10 < run.responses["slow_angle_deg"] < run.responses["fast_angle_deg"] < 60
