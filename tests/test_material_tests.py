"""The shipped material tests beside the angle of repose: what holds for every one of them."""

import pytest

from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder
from calstudy.models.heap import PARAMETER_UNITS, REFERENCE

TESTS = ("draw_down", "rotating_drum", "uniaxial_compression", "shear_cell")


@pytest.mark.parametrize("name", TESTS)
def test_every_material_test_takes_the_paper_s_parameters_and_has_its_fidelities(name):
    model = load_folder(SHIPPED / name)
    assert dict(model.parameters) == PARAMETER_UNITS and model.reference == REFERENCE
    assert model.fixed["bead_diameter"] > 0
    for fidelity in ("tiny", "coarse"):
        assert load_folder(SHIPPED / name, fidelity=fidelity).fidelity == fidelity
    assert model.expected_seconds <= 60


@pytest.mark.parametrize("name", TESTS)
def test_a_script_s_own_numbers_are_those_that_its_model_holds_fixed(name):
    """So that LIGGGHTS alone, started on the script, runs what calstudy runs at coarse fidelity."""
    model = load_folder(SHIPPED / name, fidelity="coarse")
    lines = (SHIPPED / name / model.script).read_text().splitlines()
    words = [line.split() for line in lines if line.startswith("variable") and " index " in line]
    said = {word[1]: float(word[3]) for word in words if word[1] not in model.seeds}
    assert said == model.reference | dict(model.fixed)
