"""Clumps of [models.material]: their volume, what is refused, and real runs of the tests that take them."""

import math
import threading

import numpy as np
import pytest
from pytest import approx

from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS, LOG, markers, read_dump, read_particles
from calstudy.errors import InputError, SetupError
from calstudy.models.angle_of_repose import shipped_model
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder
from calstudy.models.material.clump import clump
from calstudy.models.material.folder import of_material
from calstudy.models.material.heap import heap_of
from calstudy.models.material.material import Material
from calstudy.records import Outcome
from material_runs import defined

PAIR = clump([[0, 0, 0, 0.008], [0.003, 0, 0, 0.008]])
ROD = Material(clump=PAIR)
SMALL = {"cylinder_diameter": 0.1, "fill_height": 0.04, "drop_height": 0.05, "plate_diameter": 0.12}
"""A draw-down that takes some seconds."""


def lens(radius, apart):
    """Volume that two equal spheres share."""
    return math.pi * (4 * radius + apart) * (2 * radius - apart) ** 2 / 12


@pytest.mark.parametrize("apart", [0.1, 0.5, 0.9])
def test_two_spheres_have_their_volume_without_what_they_share(apart):
    pair = clump([[0, 0, 0, 2.0], [0, 2 * apart, 0, 2.0]])
    assert pair.volume == approx(8 / 3 * math.pi - lens(1, 2 * apart), rel=1e-3)
    assert pair.length == approx(2 + 2 * apart)
    assert pair.diameter == approx((6 / math.pi * pair.volume) ** (1 / 3))


def test_a_clump_that_grows_keeps_its_shape():
    grown = PAIR.grown(2.0)
    assert (grown.diameter, grown.length) == (approx(2 * PAIR.diameter), approx(2 * PAIR.length))


@pytest.mark.parametrize(
    ("spheres", "reason"),
    [
        ([[0, 0, 0, 1.0]], "2 to 16 spheres, not 1"),
        ([[0, 0, 0], [1, 0, 0, 1.0]], "four numbers"),
        ([[0, 0, 0, 1.0], [1, 0, 0, -1.0]], "no positive diameter"),
        ([[0, 0, 0, 1.0], [2, 0, 0, 1.0]], "do not hang together"),
        ([[0, 0, 0, 1.0], [0.9, 0, 0, 1.0], [5, 0, 0, 1.0], [5.9, 0, 0, 1.0]], "do not hang together"),
        ([[0, 0, 0, 1.0], [0.1, 0, 0, 0.2]], "within another one"),
        ([[0, 0, 0, 1.0], [0, 0, 0, 1.0]], "within another one"),
    ],
)
def test_spheres_that_are_no_clump_are_refused(spheres, reason):
    with pytest.raises(InputError, match=reason):
        clump(spheres)


def test_a_clump_of_a_file_is_refused_with_its_line(tmp_path):
    with pytest.raises(InputError, match="line 8: clump: the script of shear_cell holds single beads"):
        defined(tmp_path, "clump = [[0, 0, 0, 0.008], [0.003, 0, 0, 0.008]]")
    with pytest.raises(InputError, match=r"line 8: .*do not hang together"):
        defined(tmp_path, "clump = [[0, 0, 0, 0.008], [0.03, 0, 0, 0.008]]")
    with pytest.raises(InputError, match="line 8: clump and diameter both"):
        defined(tmp_path, "diameter = 0.01\nclump = [[0, 0, 0, 0.008], [0.003, 0, 0, 0.008]]")
    with pytest.raises(InputError, match=r"line 8: .*it looks like mm"):
        defined(tmp_path, "clump = [[0, 0, 0, 8], [3, 0, 0, 8]]")


def test_clumps_run_on_one_rank_alone():
    model = load_folder(SHIPPED / "draw_down", fidelity="tiny", ranks=2)
    with pytest.raises(InputError, match="one rank alone, not on 2"):
        of_material(model, ROD)


def test_a_run_of_clumps_costs_its_spheres():
    single = Material(diameter=PAIR.diameter)
    of = [heap_of(shipped_model("tiny"), material, {}).expected_seconds for material in (ROD, single)]
    assert of[0] == approx(2 * of[1] * PAIR.diameter / 0.008)


@pytest.fixture(scope="module")
def program():
    try:
        return LIGGGHTS.find()
    except SetupError as error:
        pytest.fail(f"these tests need the real LIGGGHTS: {error}", pytrace=False)


def clumps(positions, diameters):
    """Distance of both spheres of each clump, for clumps of two with consecutive ids."""
    assert len(positions) % 2 == 0
    return np.linalg.norm(positions[::2] - positions[1::2], axis=1)


@pytest.mark.liggghts
@pytest.mark.slow
def test_a_heap_of_clumps_has_whole_clumps_and_their_mass(program, tmp_path):
    model = heap_of(shipped_model("tiny"), ROD, {"fill_height": 0.02, "time_step_share": 0.6})
    run = ProgramEngine(model, program).run(model.reference, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.OK, run.reason
    for name in ("filled", "heap"):
        dump = read_dump(tmp_path / "run" / f"{name}.dump")
        dump = dump[np.argsort(dump[:, 0])]
        assert clumps(dump[:, 1:4], 0.008) == approx(np.full(len(dump) // 2, 0.003), rel=1e-4)
    filled = float(markers(tmp_path / "run" / LOG)["mass_filled"])
    assert filled == approx(run.beads.filled / 2 * 2500 * PAIR.volume, rel=3e-3)
    _, radii = read_particles(tmp_path / "run" / "radii.dump")
    assert set(np.round(radii, 6)) == {0.004}


@pytest.mark.liggghts
@pytest.mark.slow
def test_a_draw_down_of_clumps_weighs_them(program, tmp_path):
    model = of_material(load_folder(SHIPPED / "draw_down", insist=True, fidelity="tiny", changes=SMALL), ROD)
    run = ProgramEngine(model, program).run(model.reference, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.OK, run.reason
    assert all(math.isfinite(value) for value in run.responses.values())
    filling = (
        run.responses["bulk_density"] * math.pi / 4 * SMALL["cylinder_diameter"] ** 2 * SMALL["fill_height"]
    )
    assert run.responses["discharged_mass"] + run.responses["remaining_mass"] == approx(filling, rel=1e-6)
    whole = filling / (2500 * PAIR.volume)
    assert whole == approx(round(whole), rel=3e-3) and 0.5 < run.responses["bulk_density"] / 2500 < 0.7
