"""The shear cell: stresses and densities of made-up curves, and what real runs obey."""

import math

import numpy as np
import pytest

from material_runs import measures, tiny_run

CELL = measures("shear_cell")


def test_the_friction_angle_is_that_of_the_steady_part():
    normal = np.full(100, 2000.0)
    shear = np.r_[np.full(50, 1900.0), np.full(50, 1000.0)]
    assert CELL.angle_deg(normal, shear) == pytest.approx(math.degrees(math.atan(0.5)))


def test_a_peak_is_not_one_window_s():
    shear = np.full(40, 500.0)
    shear[20] = 1500.0
    assert CELL.peak(shear) == pytest.approx(700.0)
    shear[18:23] = 900.0
    assert CELL.peak(shear) == pytest.approx(900.0)
    with pytest.raises(ValueError, match="too short"):
        CELL.peak(shear[:4])


def test_the_yield_locus_is_the_line_through_both_peaks():
    angle, cohesion = CELL.locus((3000.0, 1500.0), (100 + 0.4 * 3000, 100 + 0.4 * 1500))
    assert angle == pytest.approx(math.degrees(math.atan(0.4)))
    assert cohesion == pytest.approx(100.0)


def test_spheres_cut_by_a_slab_count_by_their_volume_in_it():
    z = np.array([0.0, 0.5, 1.0, 3.0])  # of diameter 1: half in, all in, half in, out
    volume = 2 * math.pi / 6
    assert CELL.slab_fraction(z, 1.0, 0.0, 1.0, 4.0) == pytest.approx(volume / 4)
    layers = np.repeat(np.arange(20.0), 100) + 0.5
    assert CELL.slab_fraction(layers, 1.0, 3.3, 15.8, 100.0) == pytest.approx(math.pi / 6, rel=0.02)


@pytest.mark.liggghts
def test_the_lid_bears_the_load_that_it_is_given():
    _, marks, directory = tiny_run("shear_cell")
    assert marks["beads_end"] == marks["beads_filled"]
    for stage, stress in ((0, "preshear_stress"), (1, "shear_stress_1"), (3, "shear_stress_2")):
        normal, _ = CELL._stage(directory, stage)
        assert normal[len(normal) // 2 :].mean() == pytest.approx(float(marks[stress]), rel=0.03)
    assert 0.5 < CELL.solid_fraction(directory) < 0.65


@pytest.mark.liggghts
def test_a_smooth_wall_holds_no_more_than_its_friction_and_not_much_less():
    """At most atan(MU_PW), within the scatter of a run; beads that roll take a part of it."""
    run, _, _ = tiny_run("shear_cell")
    most = math.degrees(math.atan(0.2))
    assert 0.75 * most < run.responses["wall_friction_angle_deg"] < most + 0.5
