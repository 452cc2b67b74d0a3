"""[models.material]: sizes, cohesion, rolling model, walls and coarse-graining of every shipped test."""

import math
import threading
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx
from scipy import integrate, stats

from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS, read_particles
from calstudy.errors import InputError, SetupError
from calstudy.models.angle_of_repose import load_model, shipped_model
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder
from calstudy.models.material.folder import of_material
from calstudy.models.material.heap import heap_of
from calstudy.models.material.material import AS_SHIPPED, COHESION_MODELS, ROLLING_MODELS, Material
from calstudy.models.material.scaling import cost_ratio
from calstudy.models.material.sizes import Sizes, discrete, log_normal
from calstudy.records import Outcome
from contact_scripts import FIXED, PARAMETERS, Bead, Bench
from material_runs import defined

HEAP = "angle_of_repose"
FOLDERS = ("draw_down", "rotating_drum", "uniaxial_compression", "shear_cell")
LARGER = discrete([0.014, 0.016], [0.5, 0.5], "mass")
POWDER = Material(
    sizes=discrete([0.010, 0.012], [0.5, 0.5], "mass"),
    cohesion="sjkr2",
    rolling="cdt",
    wall_youngs_modulus=2.1e11,
    wall_poissons_ratio=0.3,
)


def with_material(name, material, fidelity="tiny"):
    if name == HEAP:
        return heap_of(shipped_model(fidelity), material, {})
    return of_material(load_folder(SHIPPED / name, fidelity=fidelity), material)


def text_of(model):
    return "".join(
        content if isinstance(content, str) else content.decode()
        for name, content in model.files.items()
        if not name.endswith((".stl", ".py"))
    )


# ---- sizes ------------------------------------------------------------------------------------------------


def test_mass_shares_are_number_shares_times_volume():
    by_mass = discrete([0.002, 0.001], [0.8, 0.2], "mass")
    assert by_mass.diameters == (0.001, 0.002)
    assert by_mass.shares == approx([0.2 / (0.2 + 0.1), 0.1 / (0.2 + 0.1)])
    assert discrete([0.001, 0.002], [2, 1], "number").shares == approx(by_mass.shares)


def test_the_diameter_of_several_sizes_is_that_of_mean_volume():
    sizes = discrete([0.001, 0.003], [3, 1], "number")
    assert sizes.diameter**3 == approx((3 * 0.001**3 + 0.003**3) / 4)


@pytest.mark.parametrize("weighting", ["number", "mass"])
def test_the_classes_of_a_log_normal_have_its_number_and_its_mass(weighting):
    """Mean volume by number, from the classes and by integrating the truncated distribution."""
    median, deviation, smallest, largest = 0.004, 1.3, 0.003, 0.006
    found = log_normal(median, deviation, smallest, largest, weighting)
    density = stats.lognorm(math.log(deviation), scale=median).pdf

    def moment(power):
        return integrate.quad(lambda d: d**power * density(d), smallest, largest)[0]

    mean = moment(3) / moment(0) if weighting == "number" else moment(0) / moment(-3)
    assert found.diameter**3 == approx(mean, rel=1e-6)
    assert smallest < found.diameters[0] and found.diameters[-1] < largest
    assert sum(found.shares) == approx(1)


def test_a_log_normal_by_mass_and_by_number_is_one_distribution():
    """Hatch and Choate: the median by number is that by mass times exp(-3 ln^2 deviation)."""
    spread = math.log(1.2)
    by_mass = log_normal(0.004, 1.2, 0.001, 0.0099, "mass")
    by_number = log_normal(0.004 * math.exp(-3 * spread**2), 1.2, 0.001, 0.0099, "number")
    assert by_mass.diameter == approx(by_number.diameter, rel=1e-3)


def test_a_log_normal_that_is_hardly_cut_is_taken_whole():
    whole = log_normal(0.004, 1.1, 1e-9, 1.0, "number")
    assert whole.diameter**3 == approx(0.004**3 * math.exp(4.5 * math.log(1.1) ** 2), rel=1e-9)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (([0.001, 0.002], [1.0], "mass"), "2 diameters have 1 shares"),
        (([0.001, 0.001], [1.0, 1.0], "mass"), "stands twice"),
        (([0.001, -0.002], [1.0, 1.0], "mass"), "must be positive"),
        (([0.001, 0.02], [1.0, 1.0], "mass"), "cut the sizes at a ratio of 10"),
    ],
)
def test_sizes_that_no_beads_have_are_refused(arguments, reason):
    with pytest.raises(InputError, match=reason):
        discrete(*arguments)


# ---- decks ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [HEAP, *FOLDERS])
def test_a_material_that_differs_in_nothing_is_the_shipped_model(name):
    model = with_material(name, AS_SHIPPED)
    shipped = shipped_model("tiny") if name == HEAP else load_folder(SHIPPED / name, fidelity="tiny")
    assert model.hash == shipped.hash and dict(model.parameters) == dict(shipped.parameters)


@pytest.mark.parametrize("name", [HEAP, *FOLDERS])
def test_every_shipped_script_takes_every_material(name):
    plain = with_material(name, AS_SHIPPED)
    for cohesion in COHESION_MODELS:
        for rolling in ROLLING_MODELS:
            model = with_material(name, replace(POWDER, cohesion=cohesion, rolling=rolling))
            said = f"rolling_friction {rolling}"
            assert said in text_of(model) and "1 bead 1.0" not in text_of(model)
            assert ("cohesionEnergyDensity" in text_of(model)) == (cohesion != "none")
            assert ("CED_PP" in model.parameters) == (cohesion != "none")
            assert model.hash != plain.hash
            assert model.particles.radius == approx(0.005)


@pytest.mark.parametrize("name", [HEAP, *FOLDERS])
def test_a_coarse_bead_is_a_bead_of_that_size(name):
    """All scaling of a Hertzian contact with SJKR is in the diameter: the decks differ in nothing else."""
    coarse = with_material(name, Material(diameter=0.005, coarse_graining=2.0, cohesion="sjkr2"))
    large = with_material(name, Material(diameter=0.010, cohesion="sjkr2"))
    assert coarse.hash == large.hash


def test_a_run_costs_beads_times_time_steps():
    assert cost_ratio(Sizes((0.005,), (1.0,)), 0.010) == approx(16)
    mixed = Sizes((0.0025, 0.005), (0.5, 0.5))
    assert cost_ratio(mixed, 0.010) == approx(4 * (0.010 / mixed.diameter) ** 3)
    model = with_material("shear_cell", Material(diameter=0.005))
    assert model.expected_seconds == approx(16 * with_material("shear_cell", AS_SHIPPED).expected_seconds)


def test_the_time_step_is_that_of_the_smallest_bead():
    model = with_material(HEAP, POWDER)
    single = with_material(HEAP, replace(POWDER, sizes=Sizes((0.010,), (1.0,))))
    point = dict(model.reference)
    assert model.engine_time_step(point) == approx(single.engine_time_step(point))
    for name in FOLDERS:
        assert "*PI*0.005*sqrt(" in text_of(with_material(name, POWDER))


def test_an_apparatus_of_other_dimensions_scales_what_belongs_to_it():
    model = heap_of(shipped_model("tiny"), AS_SHIPPED, {"cylinder_diameter": 0.2, "fill_height": 0.1})
    assert model.variant.plate_radius == approx(0.1) and model.geometry["ring_diameter"] == approx(0.2)
    assert model.schedule["pour_bottom"] == approx(0.140)
    assert model.poured_beads == approx(8 * shipped_model("tiny").poured_beads, rel=0.1)
    assert model.schedule["lift_intervals"] == 2 * shipped_model("tiny").schedule["lift_intervals"]
    stiffer = heap_of(shipped_model("tiny"), AS_SHIPPED, {"softening": 20.0, "time_step_share": 0.15})
    point = dict(stiffer.reference)
    assert stiffer.engine_time_step(point) == approx(shipped_model("tiny").engine_time_step(point) / 8)
    assert stiffer.poured_beads == shipped_model("tiny").poured_beads
    assert stiffer.expected_seconds == approx(8 * shipped_model("tiny").expected_seconds)
    with pytest.raises(InputError, match="too narrow for simulated beads"):
        heap_of(shipped_model("tiny"), AS_SHIPPED, {"cylinder_diameter": 0.05})


# ---- the calibration's file -------------------------------------------------------------------------

COHESIVE = "CED_PP = [0.0, 5e4]\nCED_PW = 0.0"


def test_a_cohesive_material_has_its_cohesion_among_the_parameters(tmp_path):
    found = defined(tmp_path, 'cohesion = "sjkr2"\ndiameter = 0.006', COHESIVE)
    assert found.task.space.calibrated == ("MU_PP", "CED_PP")
    (chosen,) = found.models
    assert chosen.model.fixed["bead_diameter"] == 0.006
    with pytest.raises(InputError, match="lacks CED_PP"):
        defined(tmp_path, 'cohesion = "sjkr2"')
    with pytest.raises(InputError, match="CED_PP is unknown"):
        defined(tmp_path, "diameter = 0.006", COHESIVE)


@pytest.mark.parametrize(
    ("material", "reason"),
    [
        ('cohesion = "jkr"', "line 8: cohesion 'jkr' is unknown; did you mean sjkr"),
        ('rolling = "epsd9"', "line 8: rolling 'epsd9' is unknown"),
        ("diameter = 6", "line 8: half a diameter is 3 m.* it looks like mm: write 0.003"),
        ("diameter = -1.0", "line 8: diameter is -1"),
        ("coarse_graining = 0.5", "line 8: coarse_graining is 0.5; it must be 1 or more"),
        ("wall_poissons_ratio = 0.6", "line 8: wall_poissons_ratio is 0.6"),
        ("diameters = 0.006", "line 8: key diameters is unknown; did you mean diameter"),
        ("diameter = 0.01\nsizes = { diameters = [0.01], shares = [1] }", "line 8: sizes and diameter both"),
        ('sizes = { diameters = [0.01, 0.02], weighting = "mass" }', r"lacks shares"),
        ("sizes = { median = 0.01 }", "lacks weighting"),
        (
            'sizes = { median = 0.01, deviation = 0.2, smallest = 0.01, largest = 0.02, weighting = "mass" }',
            "line 8: .*standard deviation above 1, such as 1.2",
        ),
        ('sizes = { diameters = [0.01], shares = [1], weighting = "volume" }', "weighting 'volume'"),
    ],
)
def test_a_material_that_cannot_be_is_refused_with_its_line(tmp_path, material, reason):
    with pytest.raises(InputError, match=reason):
        defined(tmp_path, material)


def test_a_model_of_one_s_own_states_its_material_itself(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / "in.mine").write_text('variable MU_PP index 0.2\nvariable x equal ${MU_PP}\nprint "aor ${x}"\n')
    (folder / "model.toml").write_text(
        'script = "in.mine"\nexpected_seconds = 1\n[parameters]\nMU_PP = "-"\n'
        '[responses.aor]\nunit = "deg"\nlog = "aor"\n'
    )
    with pytest.raises(InputError, match=r"mine takes no \[models.material\]"):
        of_material(load_folder(folder), Material(rolling="cdt"))


# ---- LIGGGHTS -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def program():
    try:
        return LIGGGHTS.find()
    except SetupError as error:
        pytest.fail(f"these tests need the real LIGGGHTS: {error}", pytrace=False)


def push(program, directory, overlap, *, softening=1.0, coarse_graining=1.0, cohesion=3e6):
    """Force in N with which two cohesive beads of 4 mm, or coarser, push each other at an overlap (m)."""
    model = load_model(FIXED, "tiny")
    model = replace(model, fidelity=replace(model.fidelity, softening=softening))
    material = Material(diameter=0.004, cohesion="sjkr2", coarse_graining=coarse_graining)
    bench = Bench(program, directory, heap_of(model, material, {}))
    apart = bench.model.particle_diameter - overlap
    beads = [Bead((sign * apart / 2, 0.0, 0.1)) for sign in (-1, 1)]
    seen = bench.run(
        beads,
        1e-3,
        "unfix gravity",
        "group one id 1",
        "fix hold all setforce 0 0 0",
        "fix held one setforce 0 0 0",
        "unfix hold",
        "group two id 2",
        "fix held_too two setforce 0 0 0",
        "variable push equal f_held[1]",
        after=['print "calstudy: push ${push}"'],
        parameters={"CED_PP": cohesion, "CED_PW": 0.0},
        frames=1,
    )
    return -float(seen.marks["push"])


@pytest.mark.liggghts
@pytest.mark.parametrize("overlap", [2e-6, 2e-5])
def test_cohesion_is_energy_density_times_contact_area(program, tmp_path, overlap):
    """F = 4/3 E* sqrt(R/2) overlap^1.5 - CED 2 pi overlap R: at 2 um the beads hold each other."""
    radius, ced = 0.002, 3e6
    modulus = PARAMETERS["YM"] / (2 * (1 - FIXED.poissons_ratio**2))
    expected = 4 / 3 * modulus * math.sqrt(radius / 2) * overlap**1.5 - ced * 2 * math.pi * overlap * radius
    assert push(program, tmp_path, overlap) == approx(expected, rel=1e-6)
    assert (expected < 0) == (overlap < 1e-5)


@pytest.mark.liggghts
@pytest.mark.parametrize("overlap", [2e-6, 2e-5])
def test_a_softened_contact_has_the_force_of_the_stiff_one(program, tmp_path, overlap):
    """At s^(2/3) times the overlap, whether it pushes or pulls."""
    stiff = push(program, tmp_path / "stiff", overlap)
    soft = push(program, tmp_path / "soft", overlap * 80 ** (2 / 3), softening=80.0)
    assert soft == approx(stiff, rel=1e-6)


@pytest.mark.liggghts
@pytest.mark.parametrize("overlap", [2e-6, 2e-5])
def test_a_coarse_contact_has_the_stress_of_the_fine_one(program, tmp_path, overlap):
    """At k times the overlap and k^2 times the force, whether it pushes or pulls."""
    fine = push(program, tmp_path / "fine", overlap)
    coarse = push(program, tmp_path / "coarse", 2.5 * overlap, coarse_graining=2.5)
    assert coarse == approx(2.5**2 * fine, rel=1e-6)


@pytest.mark.liggghts
@pytest.mark.slow
@pytest.mark.parametrize("name", [HEAP, *FOLDERS])
def test_every_test_runs_with_a_cohesive_powder_of_two_sizes(program, tmp_path, name):
    # The boxes of the other tests hold enough beads that are half as large again.
    model = with_material(name, POWDER if name == HEAP else replace(POWDER, sizes=LARGER))
    point = dict(model.reference) | {"CED_PP": 2e4, "CED_PW": 1e4}
    run = ProgramEngine(model, program).run(point, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.OK, run.reason
    assert all(math.isfinite(value) for value in run.responses.values())
    if name == HEAP:
        _, radii = read_particles(tmp_path / "run" / "radii.dump")
        assert set(np.round(radii, 6)) == {0.005, 0.006}
