import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from types import NoneType

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from calstudy.engines.engine import write_inputs
from calstudy.engines.liggghts import insertion_seeds
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.completed import LEAST_REMOVED
from calstudy.models.fidelity import check_physics
from calstudy.models.heap import REFERENCE
from calstudy.plan_file import load_plan

FIDELITIES = ("full", "fast", "soft", "coarse", "tiny")
VARIANTS = ("ring", "wide")
FIXED = load_plan().fixed


def model_of(fidelity="coarse", variant="ring"):
    return load_model(FIXED, fidelity, variant)


COARSE = model_of()


@pytest.mark.parametrize(
    ("fidelity", "diameter", "softening", "share"),
    [
        ("full", 0.005, 1, 0.25),
        ("fast", 0.005, 10, 0.5),
        ("soft", 0.005, 80, 0.6),
        ("coarse", 0.0075, 80, 0.6),
        ("tiny", 0.010, 80, 0.6),
    ],
)
def test_fidelities_simulate_what_they_promise(fidelity, diameter, softening, share):
    model = model_of(fidelity)
    values = {name: float(text) for name, text in model.variables(REFERENCE, 1).items()}
    assert values["particle_diameter"] == 2 * values["particle_radius"] == diameter
    assert values["engine_youngs_modulus"] == values["wall_youngs_modulus"] == REFERENCE["YM"] / softening
    assert values["YM"] == REFERENCE["YM"]
    assert values["ring_height"] == pytest.approx(0.6 * diameter), "3 mm for 5 mm beads"
    # Eq. 1 of what is simulated, written out.
    shear = REFERENCE["YM"] / softening / (2 * (1 + 0.22))
    rayleigh = math.pi * diameter / 2 * math.sqrt(REFERENCE["DENS"] / shear) / (0.1631 * 0.22 + 0.8766)
    assert values["engine_time_step"] == pytest.approx(share * rayleigh, rel=1e-12)


def test_at_full_fidelity_the_time_step_is_a_quarter_of_the_costs():
    # 0.25 of the 2.98851e-5 s of Eq. 1; other fidelities simulate something else.
    assert model_of("full").engine_time_step(REFERENCE) == pytest.approx(7.471284e-6, rel=1e-6)
    assert model_of("soft").engine_time_step(REFERENCE) == pytest.approx(
        2.4 * math.sqrt(80) * 7.471284e-6, rel=1e-6
    )


def test_a_bead_weighs_density_times_volume():
    assert model_of("full").particle_mass(2500.0) == pytest.approx(1.636246e-4, rel=1e-6)
    values = model_of("full").variables(REFERENCE, 1)
    assert float(values["particle_mass"]) == model_of("full").particle_mass(2500.0)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_enough_beads_are_poured_to_reach_above_the_fill_height(fidelity):
    model = model_of(fidelity)
    bead_volume = math.pi / 6 * model.fidelity.particle_diameter**3
    # The largest solid fraction over the box was 0.619, measured with 5 mm beads.
    filled = 0.619 * model.fill_volume / bead_volume
    assert model.fidelity.poured_beads - filled > LEAST_REMOVED * model.fidelity.poured_beads


def test_variants_differ_in_the_plate_alone():
    ring, wide = (model_of("coarse", v).variables(REFERENCE, 1) for v in VARIANTS)
    assert {name for name in ring if ring[name] != wide[name]} == {"plate_radius"}
    assert float(ring["plate_radius"]) == 0.05 < float(wide["plate_radius"])


# ---- the script and its variables ----------------------------------------------------------------------


def whole_script(model):
    """The script that is run, with contact.in where it is included."""
    script, contact = (model.scripts[name] for name in ("in.angle_of_repose", "contact.in"))
    assert script.count("\ninclude contact.in\n") == 1
    return script.replace("\ninclude contact.in\n", f"\n{contact}\n")


def undefined(script, given_names):
    """Variables that a LIGGGHTS script uses before parameters.in or the script itself sets them."""
    known, missing = set(), []
    for line in script.splitlines():
        code = line.split("#")[0]
        if code.split() == ["include", "parameters.in"]:
            known |= set(given_names)
        used = re.findall(r"\$\{(\w+)\}|\$(\w)|\bv_(\w+)", code)
        missing += [name for names in used for name in names if name and name not in known]
        if words := re.match(r"\s*variable\s+(\w+)\s+(?:equal|index|loop|string|atom)\b", code):
            known.add(words[1])
    return missing


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_every_variable_of_the_script_is_set_before_it_is_used(fidelity, variant):
    model = model_of(fidelity, variant)
    assert undefined(whole_script(model), model.variables(REFERENCE, 1)) == []


@pytest.mark.parametrize("name", ["DENS", "MU_PW", "skin", "seed_insertion", "plate_radius", "rest_speed"])
def test_a_variable_that_is_not_set_is_noticed(name):
    model = model_of()
    given_names = set(model.variables(REFERENCE, 1)) - {name}
    assert set(undefined(whole_script(model), given_names)) == {name}


def test_a_variable_that_is_used_too_early_is_noticed():
    script = whole_script(model_of())
    names = model_of().variables(REFERENCE, 1)
    assert undefined(script.replace("include parameters.in", ""), names) != []
    assert undefined("run ${steps}\nvariable steps equal 7\n", []) == ["steps"]
    assert undefined("variable steps equal 7\nrun ${steps}\n", []) == []


def test_every_physical_input_reaches_the_script():
    model = model_of()
    used = set(re.findall(r"\$\{(\w+)\}", whole_script(model)))
    # YM enters softened; the nominal one is for the cost, which the script does not see.
    assert set(REFERENCE) - used == {"YM"}
    fixed = set(FIXED.__dataclass_fields__) - {"particle_radius"}
    assert fixed - used == set()
    assert set(model.schedule) - used == set()


# ---- parameters.in ------------------------------------------------------------------------------------


def parameters_in(folder):
    lines = (folder / "parameters.in").read_text().splitlines()
    words = [line.split() for line in lines]
    assert all(len(w) == 4 and (w[0], w[2]) == ("variable", "index") for w in words)
    return {w[1]: w[3] for w in words}


@given(st.fixed_dictionaries(dict.fromkeys(REFERENCE, st.floats(1e-9, 1e15)) | {"YM": st.floats(4e8, 1e15)}))
def test_all_digits_of_every_parameter_survive(parameters):
    text = COARSE.variables(parameters, 1)
    assert {name: float(text[name]) for name in parameters} == parameters


def test_parameters_in_holds_every_variable_as_it_was_meant(tmp_path):
    model = model_of()
    parameters = {**REFERENCE, "MU_PP": 0.1 + 0.2, "YM": 5.06e9 / 3}
    write_inputs(model.inputs(parameters, 11), tmp_path / "run")
    assert parameters_in(tmp_path / "run") == model.variables(parameters, 11)
    assert float(parameters_in(tmp_path / "run")["MU_PP"]) == 0.1 + 0.2


def test_a_stiffer_or_lighter_material_is_expected_to_take_longer():
    model = model_of()
    assert model.expected_seconds_at(REFERENCE) == model.expected_seconds
    steel = model.expected_seconds_at(REFERENCE | {"YM": 5.06e10})
    assert steel == pytest.approx(10 * model.expected_seconds)
    assert model.expected_seconds_at(REFERENCE | {"DENS": 625.0}) == pytest.approx(2 * model.expected_seconds)


def test_what_liggghts_refuses_is_refused_before():
    with pytest.raises(
        InputError, match=r"YM is 1e\+08 Pa, which coarse fidelity divides by 80; LIGGGHTS needs"
    ):
        model_of().inputs(REFERENCE | {"YM": 1e8}, 1)
    with pytest.raises(InputError, match=r"restitution_pw is 0.05; for LIGGGHTS it must lie in \(0.05; 1\]"):
        check_physics({}, replace(FIXED, restitution_pw=0.05))


def test_numpys_numbers_are_written_like_pythons():
    numpys = {name: np.float64(value) for name, value in REFERENCE.items()}
    assert model_of().variables(numpys, 1) == model_of().variables(REFERENCE, 1)


# ---- seeds --------------------------------------------------------------------------------------------


@given(st.integers(0, 2**63))
@example(0)
@example(2**31)
def test_insertion_seeds_are_different_primes_above_10000(seed):
    seeds = insertion_seeds(seed)
    assert len(set(seeds)) == 3
    for number in seeds:
        assert 10_000 < number < 2**31
        divisors = np.arange(2, math.isqrt(number) + 1)
        assert (number % divisors != 0).all()


def test_the_seed_decides_and_nothing_else():
    drawn = [insertion_seeds(seed) for seed in range(60)]
    assert drawn == [insertion_seeds(seed) for seed in range(60)]
    assert len(set(drawn)) == 60


def test_only_the_seeds_depend_on_the_seed():
    one, other = model_of().variables(REFERENCE, 1), model_of().variables(REFERENCE, 2)
    changed = {name for name in one if one[name] != other[name]}
    assert changed == {"seed_template", "seed_distribution", "seed_insertion"}


# ---- identity -----------------------------------------------------------------------------------------


OTHER = {
    str: lambda text: text + "x",
    int: lambda number: 2 * number + 1,
    float: lambda number: 2 * number + 1,
    NoneType: lambda _: 0.3,
    dict: lambda numbers: {**numbers, "pour_time": 7.0},
}


def changed_models(model):
    """Each number and text of a model changed on its own, by where it stands."""
    for part in ("fidelity", "variant", "fixed"):
        record = getattr(model, part)
        for name in record.__dataclass_fields__:
            value = getattr(record, name)
            other = OTHER[type(value)](value)
            yield f"{part}.{name}", replace(model, **{part: replace(record, **{name: other})})
    for part in ("geometry", "schedule"):
        for name, value in getattr(model, part).items():
            yield f"{part}.{name}", replace(model, **{part: {**getattr(model, part), name: 2 * value}})
    for name in ("deck", "skin_per_diameter", "pixels_per_mm", "sphere_diameter"):
        yield name, replace(model, **{name: getattr(model, name) + 1})
    for name, text in model.scripts.items():
        yield name, replace(model, scripts={**model.scripts, name: text + "#"})
    yield "name", replace(model, name="other")


NO_RESPONSE_DEPENDS_ON = {"fidelity.expected_seconds", "variant.relative_cost", "variant.meaning"}


def test_the_hash_changes_with_all_that_decides_a_response_and_with_nothing_else():
    model = model_of()
    same = {where for where, other in changed_models(model) if other.hash == model.hash}
    assert same == NO_RESPONSE_DEPENDS_ON


def test_each_change_gives_a_hash_of_its_own():
    hashes = [m.hash for where, m in changed_models(model_of()) if where not in NO_RESPONSE_DEPENDS_ON]
    assert len(hashes) > 25
    assert len(set(hashes)) == len(hashes)


def test_each_fidelity_and_variant_is_a_model_of_its_own():
    hashes = {model_of(f, v).hash for f in FIDELITIES for v in VARIANTS}
    assert len(hashes) == len(FIDELITIES) * len(VARIANTS)


def test_equal_content_gives_an_equal_hash_in_another_process():
    code = (
        "import json; from calstudy.models.angle_of_repose import load_model;"
        "from calstudy.plan_file import load_plan;"
        "fixed = load_plan().fixed;"
        f"print(json.dumps([load_model(fixed, f, v).hash for f in {FIDELITIES} for v in {VARIANTS}]))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONHASHSEED": "12345"},
    )
    here = [model_of(f, v).hash for f in FIDELITIES for v in VARIANTS]
    assert json.loads(answer.stdout) == here
    assert all(re.fullmatch("[0-9a-f]{64}", text) for text in here)


# ---- refusals -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REFERENCE)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -0.1])
def test_a_value_that_no_material_has_is_refused_by_name(name, value):
    with pytest.raises(InputError, match=f"^{name} is "):
        model_of().variables({**REFERENCE, name: value}, 1)


@pytest.mark.parametrize("name", ["DENS", "YM"])
def test_density_and_stiffness_cannot_be_zero(name):
    with pytest.raises(InputError, match=f"{name} is 0; it must be positive"):
        check_physics({**REFERENCE, name: 0.0}, FIXED)


def test_no_friction_is_physics():
    frictionless = {name: 0.0 for name in REFERENCE if name not in ("DENS", "YM")}
    check_physics({**REFERENCE, **frictionless}, FIXED)


@pytest.mark.parametrize("ratio", [0.5, 0.7, -0.1, math.nan])
def test_a_poissons_ratio_outside_0_to_one_half_is_refused(ratio):
    with pytest.raises(InputError, match="poissons_ratio"):
        check_physics(REFERENCE, replace(FIXED, poissons_ratio=ratio))


NOT_PHYSICAL = {
    "restitution_pp": (0.0, -0.5, 1.01, math.nan),
    "restitution_pw": (0.0, -0.5, 1.01, math.nan),
    "rolling_viscous_damping_pp": (-0.01, math.inf, math.nan),
    "rolling_viscous_damping_pw": (-0.01, math.inf, math.nan),
    "gravity": (0.0, -9.81, math.inf, math.nan),
    "particle_radius": (0.0, -0.0025, math.inf, math.nan),
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, values in NOT_PHYSICAL.items() for v in values])
def test_a_fixed_input_that_no_material_has_is_refused_by_name(name, value):
    with pytest.raises(InputError, match=f"^{name} is "):
        check_physics(REFERENCE, replace(FIXED, **{name: value}))


def test_perfect_rebound_and_no_rolling_damping_are_physics():
    perfect = {"restitution_pp": 1.0, "restitution_pw": 1.0}
    undamped = {"rolling_viscous_damping_pp": 0.0, "rolling_viscous_damping_pw": 0.0}
    check_physics(REFERENCE, replace(FIXED, **perfect, **undamped, poissons_ratio=0.0))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("wall_youngs_modulus", value) for value in (0.0, -1.0, math.inf, math.nan)),
        *(("wall_poissons_ratio", value) for value in (0.5, -0.1, math.nan)),
    ],
)
def test_elastic_constants_that_no_wall_has_are_refused_by_name(name, value):
    model = model_of()
    with pytest.raises(InputError, match=f"^{name} is "):
        replace(model, variant=replace(model.variant, **{name: value})).variables(REFERENCE, 1)


def test_a_refused_parameter_leaves_no_directory_behind(tmp_path):
    with pytest.raises(InputError):
        write_inputs(model_of().inputs({**REFERENCE, "MU_PP": -1.0}, 1), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_fidelity_or_variant_is_refused_with_what_there_is():
    with pytest.raises(InputError, match="fidelity 'huge' is unknown; choose one of full, fast, soft"):
        model_of("huge")
    with pytest.raises(InputError, match="variant 'round' is unknown; choose one of ring, plate_55"):
        model_of("full", "round")


def test_a_model_that_is_not_there_is_answered_with_those_that_are():
    with pytest.raises(InputError, match=r"no model no_such_test .*angle_of_repose"):
        load_model(load_plan().fixed, "full", name="no_such_test")


def test_a_folder_is_not_taken_for_a_model_with_variants():
    with pytest.raises(InputError, match="draw_down has no variants"):
        load_model(load_plan().fixed, "tiny", name="draw_down")
