"""simulate, twin and sweep on the model of a calibration's file; warnings where runs are too fast or too
soft."""

import json

import pandas as pd
import pytest
from pytest import approx

from calstudy.cli.main import main
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import shipped_model
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder
from calstudy.models.material.regime import LARGEST_INERTIA, cautions, inertial_number, overlap
from calstudy.study.definition import example, example_of, model_of, read_definition
from calstudy.study.definition.advice import advice
from fake_liggghts import COMMAND

HEAP_NAME = "angle_of_repose"
FOLDERS = ("draw_down", "rotating_drum", "uniaxial_compression", "shear_cell")
HEAP = """
[[models]]
name = "angle_of_repose"
fidelity = "tiny"
[models.fixed]
cylinder_diameter = 0.2
[models.material]
diameter = 0.012
"""
CELL = """
[[models]]
name = "shear_cell"
label = "cell"
fidelity = "coarse"
[models.material]
cohesion = "sjkr2"
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    (tmp_path / "powder.toml").write_text(HEAP)
    return tmp_path / "powder.toml"


def test_the_model_of_a_file_is_the_one_that_its_calibration_runs(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(example() + '\n[models.material]\nrolling = "cdt"\n')
    (chosen,) = read_definition(path).models
    assert model_of(path).hash == chosen.model.hash != shipped_model("soft").hash


def test_of_several_models_one_is_named(file):
    file.write_text(HEAP + CELL)
    with pytest.raises(InputError, match=r"which of its models.*--model"):
        model_of(file)
    assert model_of(file, "cell").hash == model_of(file, "shear_cell").hash
    assert "CED_PP" in model_of(file, "cell").parameters
    with pytest.raises(InputError, match="did you mean cell"):
        model_of(file, "cel")


def test_simulate_takes_the_model_of_a_file(file, capsys):
    assert main(["simulate", "--calibration", "powder.toml", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["model_hash"] == model_of(file).hash
    assert main(["simulate", "--calibration", "powder.toml", "--fidelity", "coarse"]) == 2
    assert "--fidelity coarse: powder.toml says it" in capsys.readouterr().err


def test_sweep_and_twin_take_the_model_of_a_file(file, capsys):
    (file.parent / "design.csv").write_text(
        "label,seed,DENS,MU_PP,MU_PW,RF_PP,RF_PW,YM\na,1,2500,0.2,0.2,0.05,0.01,5e8\n"
    )
    assert main(["sweep", "design.csv", "--calibration", "powder.toml", "--out", "runs"]) == 0
    table = pd.read_parquet("runs/runs.parquet")
    assert list(table["model_hash"]) == [model_of(file).hash] and table["bulk_density"][0] > 0
    assert main(["twin", "--calibration", "powder.toml", "--seeds", "2", "--out", "twins.csv"]) == 0
    assert "--calibration powder.toml" in (file.parent / "twins.csv").read_text()


# ---- regime -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FOLDERS)
@pytest.mark.parametrize("fidelity", ["coarse", "tiny"])
def test_no_shipped_test_is_too_fast_or_too_soft(name, fidelity):
    model = load_folder(SHIPPED / name, fidelity=fidelity)
    for parameters in (model.reference, dict(model.reference) | {"DENS": 3000.0, "YM": 4.175e8}):
        assert list(cautions(model, [parameters])) == []


@pytest.mark.parametrize("name", FOLDERS)
def test_density_scaling_is_warned_of(name):
    model = load_folder(SHIPPED / name, fidelity="tiny")
    (line,) = cautions(model, [dict(model.reference) | {"DENS": 2500.0 * 100}])
    number = {"shear_cell": "inertial number", "uniaxial_compression": "weight of the bed"}.get(
        name, "overlap"
    )
    assert line.startswith(name) and number in line and "lower DENS" in line


def test_the_inertial_number_is_that_of_its_definition():
    model = load_folder(SHIPPED / "shear_cell", fidelity="tiny")
    number = inertial_number(model, model.reference)
    assert number == approx(0.02 / 0.075 * 0.010 * (2500 / 1500) ** 0.5) and number < LARGEST_INERTIA
    assert inertial_number(model, dict(model.reference) | {"DENS": 1e4}) == approx(2 * number)
    assert inertial_number(shipped_model("tiny"), model.reference) is None


def test_weight_and_softness_together_make_the_overlap():
    """Of a heap with twice the DENS and twice the YM it is the same; eight times the softening makes it
    four."""
    model, point = shipped_model("tiny"), dict(shipped_model("tiny").reference)
    assert overlap(model, point | {"DENS": 5000.0, "YM": 2 * point["YM"]}) == approx(overlap(model, point))
    assert overlap(model, point | {"YM": point["YM"] / 8}) == approx(4 * overlap(model, point))


def test_a_calibration_says_that_its_densities_are_scaled(tmp_path):
    path = tmp_path / "mine.toml"
    text = example_of(["shear_cell"])
    assert text.count("DENS = [") == 1
    path.write_text(text.replace("DENS = [", "DENS = [2400.0, 4.0e5] # ["))
    line, *_ = advice(read_definition(path, insist=True))
    assert line.startswith("shear_cell: the inertial number is up to 0.03")
    path.write_text(example_of([HEAP_NAME, *FOLDERS]))
    assert not [line for line in advice(read_definition(path)) if "lower DENS" in line]
