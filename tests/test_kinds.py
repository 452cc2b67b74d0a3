"""Parameters of other kinds than an interval: logarithmic, listed, chosen by name, following from others."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

import calstudy as cs
from calstudy.calibration.cost import Cost
from calstudy.cli.main import main
from calstudy.errors import InputError
from calstudy.models.folder import load_folder
from calstudy.parameters import Grid, Parameter, Space
from calstudy.parameters.expression import Expression
from calstudy.rayleigh import Particles
from calstudy.records import Target
from calstudy.study.directory.store import read_table
from calstudy.study.settings import read_settings

LOG = Parameter("YM", "Pa", 2e5, 7e9, None, is_log=True)
LISTED = Parameter("N", "1", 1.0, 5.0, None, values=(1.0, 2.5, 5.0))
CHOSEN = Parameter("law", "-", 1.0, 2.0, None, values=(1.0, 2.0), texts=("hertz", "hooke"))
MU = Parameter("MU", "-", 0.1, 0.5, None)
TENTH = Parameter("RF", "-", math.nan, math.nan, None, formula=Expression("MU / 10"))
SPACE = Space((LOG, LISTED, CHOSEN, MU, TENTH), ("YM", "N", "law", "MU"))


@given(st.lists(st.floats(0, 1), min_size=4, max_size=4))
def test_a_point_of_the_grid_is_the_point_of_its_values(unit):
    grid = Grid(SPACE.box, 1_000_000, SPACE.whole)
    values = SPACE.complete(grid.nearest(SPACE.box.from_unit(np.array(unit))))
    assert SPACE.takes(values)
    assert SPACE.complete(SPACE.point(values)) == values
    for name, value in values.items():
        assert SPACE.values(name, SPACE.point(values)) == pytest.approx(value, rel=1e-11)


def test_the_ends_of_a_logarithmic_interval_are_exact_and_its_middle_the_geometric_mean():
    assert [LOG.value(end) for end in LOG.ends] == [2e5, 7e9]
    assert LOG.value(sum(LOG.ends) / 2) == pytest.approx(math.sqrt(2e5 * 7e9))


def test_each_listed_value_has_the_same_share_of_the_box():
    at = SPACE.box.from_unit(np.linspace(0.0005, 0.9995, 1000)[:, None] * np.ones(4))
    values, counts = np.unique(SPACE.values("N", at), return_counts=True)
    assert list(values) == [1.0, 2.5, 5.0]
    assert np.ptp(counts) < 15


@pytest.mark.parametrize(
    ("values", "is_taken"),
    [({}, True), ({"RF": 0.031}, False), ({"N": 2.0}, False), ({"YM": 1e5}, False), ({"law": 2.0}, True)],
)
def test_a_stored_run_is_taken_where_each_parameter_may_have_its_value(values, is_taken):
    assert SPACE.takes({"YM": 1e6, "N": 2.5, "law": 1.0, "MU": 0.3, "RF": 0.03} | values) is is_taken


@given(st.floats(0.1, 10), st.floats(0.1, 10))
def test_arithmetic_is_that_of_python(a, b):
    for text in ("a / b", "-a + 2 * b ** 2", "(a + b) / 3e-2", "max(a, b) - min(a, b)", "sqrt(a) * log10(b)"):
        known = {"a": a, "b": b, "sqrt": math.sqrt, "log10": math.log10, "max": max, "min": min}
        assert Expression(text).at({"a": a, "b": b}) == pytest.approx(eval(text, known), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "MU.real",
        "MU[0]",
        "'a' * 9",
        "MU if MU else 1",
        "lambda: 1",
        "MU @ MU",
        "open(MU)",
        "sqrt(MU, MU)",
        "True",
        "MU +",
        "[MU for MU in MU]",
        "",
        "(" * 300 + "MU" + ")" * 300,
    ],
)
def test_what_is_no_arithmetic_is_refused(text):
    with pytest.raises(InputError):
        Expression(text)


def test_a_name_that_has_no_value_of_its_own_is_refused():
    chain = Parameter("RF2", "-", math.nan, math.nan, None, formula=Expression("RF * 2"))
    with pytest.raises(InputError, match="follows from RF,"):
        Space((MU, TENTH, chain), ("MU",))


@pytest.mark.parametrize("mover", ["radius", "poissons_ratio", "density", "youngs_modulus", "followed"])
def test_whatever_moves_the_rayleigh_time_step_enters_the_cost(mover):
    bounds = {"radius": (1e-3, 2e-3), "poissons_ratio": (0.1, 0.4), "density": (2e3, 3e3)}
    x = Parameter("X", "-", *bounds.get(mover, (1e7, 1e9)), None)
    follows = Parameter("E", "Pa", math.nan, math.nan, None, formula=Expression("2 * X"))
    given = {"radius": 1e-3, "poissons_ratio": 0.3, "density": 2500.0, "youngs_modulus": 1e8}
    given |= {"youngs_modulus": "E"} if mover == "followed" else {mover: "X"}
    parameters = (x, follows) if mover == "followed" else (x,)
    cost = Cost(Space(parameters, ("X",)), Target({"a": 1.0}, "set", ""), 0.5, (Particles(**given),))
    ends = cost.residuals(np.array([[x.lower], [x.upper]]), np.array([[1.0], [1.0]]))[:, 1]
    assert sorted(ends) == pytest.approx([0.0, 0.5])


PROGRAM = """#!{python} -S
import json, sys
if "--version" in sys.argv:
    print("heap 1")
    sys.exit()
given = json.load(open("parameters.json"))
open("calls", "a").write("run\\n")
known = {{"hertz": 0.0, "hooke": 5.0}}
import math
print("angle =", 3 * math.log10(given["YM"]) + known[given["law"]] + 20 * given["MU"] + given["RF"]
      + given["SEED"] % 7 / 100)
"""
MODEL = """
command = ["{program}"]
version = ["--version"]
script = "heap.txt"
include = "parameters.json"
seeds = ["SEED"]
expected_seconds = 1

[parameters]
YM = "Pa"
MU = "-"
RF = "-"
N = "1"
law = {{ unit = "-", values = ["hertz", "hooke"] }}

[responses.angle]
unit = "deg"
log = "angle"
"""
FILE = """
mode = "robust"
seed = 1
WRL = 0.0
[[models]]
name = "heap"
[parameters]
YM = {YM}
MU = {MU}
RF = {RF}
N = {N}
law = {law}
[targets]
angle = {{ value = 30.0, tolerance = 0.5 }}
"""
DEFAULTS = {
    "YM": '{ interval = [1e6, 1e9], scale = "log" }',
    "MU": "[0.1, 0.5]",
    "RF": '"MU / 10"',
    "N": "{ values = [1, 2, 8] }",
    "law": '{ values = ["hertz", "hooke"] }',
}


@pytest.fixture
def project(monkeypatch, tmp_path, coarse_profiles):
    monkeypatch.chdir(tmp_path)
    program = tmp_path / "program"
    program.write_text(PROGRAM.format(python=sys.executable))
    program.chmod(0o755)
    Path("heap").mkdir()
    Path("heap/model.toml").write_text(MODEL.format(program=program))
    Path("heap/heap.txt").write_text("YM MU RF N law SEED\n")

    def write(**changes):
        Path("box.toml").write_text(FILE.format(**DEFAULTS | changes))

    write()
    return write


def test_a_calibration_of_all_kinds_runs_what_they_are_and_reports_it(project, capsys):
    assert main(["calibrate", "box.toml", "--json"]) in (0, 11)
    result = json.loads(capsys.readouterr().out)
    settings = read_settings(Path("studies/box"))
    runs = read_table(Path("studies/box"), "evaluations", settings.quantities)
    assert set(runs["law"]) == {1.0, 2.0}
    assert set(runs["N"]) == {1.0, 2.0, 8.0}
    assert runs["RF"].to_numpy() == pytest.approx(runs["MU"].to_numpy() / 10)
    expected = 3 * np.log10(runs["YM"]) + 5 * (runs["law"] - 1) + 20 * runs["MU"] + runs["RF"]
    assert runs["angle"].to_numpy() == pytest.approx(expected.to_numpy(), abs=0.07)
    samples = runs[runs["phase"] == "sampling"]
    assert (samples["YM"] < 1e7).sum() >= 3  # a third; of a plain interval a hundredth
    parameters = {line["parameter"]: line for line in result["parameters"]}
    assert parameters["YM"]["interval"] == "[1e+06; 1e+09] log"
    assert 1e6 <= parameters["YM"]["solutions_low"] <= parameters["YM"]["solutions_high"] <= 1e9
    assert parameters["RF"]["interval"] == "= MU / 10"
    assert 0.01 <= parameters["RF"]["solutions_low"] <= parameters["RF"]["solutions_high"] <= 0.05
    assert parameters["law"]["interval"] == "1 = hertz, 2 = hooke"
    assert parameters["law"]["remark"].startswith(("hertz", "hooke"))
    lines = Path("studies/box/report/parameters.in").read_text()
    assert "variable law index h" in lines and "variable RF equal 0.0" in lines
    card = json.loads(Path("studies/box/report/material.json").read_text())
    for name, (low, high) in {"YM": (1e6, 1e9), "N": (1, 8), "law": (1, 2), "MU": (0.1, 0.5)}.items():
        assert all(low <= value <= high for value in card["parameters"][name]["quantiles"].values())
        drawn = np.array(card["sample"]["values"])[:, card["sample"]["parameters"].index(name)]
        assert low <= drawn.min() <= drawn.max() <= high
    solutions = pd.read_parquet("studies/box/report/solutions.parquet")
    assert set(solutions["N"]) <= {1.0, 2.0, 8.0} and solutions["YM"].between(1e6, 1e9).all()
    again = runs[runs["phase"] == "confirmation"]
    assert card["responses"]["angle"]["confirmed"]["runs"] == len(again) > 1
    definition = settings.case.definition["parameters"]
    assert definition["RF"] == "MU / 10" and definition["YM"] == [1e6, 1e9, "log"]
    assert definition["N"] == ["values", 1.0, 2.0, 8.0]


def test_another_formula_is_another_study(project, capsys):
    assert main(["calibrate", "box.toml"]) in (0, 11)
    project(RF='"MU / 5"')
    assert main(["calibrate", "box.toml", "--dry-run"]) == 6
    assert "RF: MU / 10 → MU / 5" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"YM": '{ interval = [0, 1e9], scale = "log" }'}, "a logarithmic interval must be positive"),
        ({"YM": '{ interval = [1, 1e9], scale = "logg" }'}, "scale is 'logg'"),
        ({"YM": '{ interval = [1, 9], scale = "log", integer = true }'}, "go not together"),
        ({"RF": '"MU / x"'}, "x is no parameter with a value or interval of its own"),
        ({"RF": '"MU / law"'}, None),
        ({"RF": '"1 / (MU - 0.1)"'}, "RF has no finite value, at YM = 1e+06, MU = 0.1"),
        ({"RF": '"0,3"'}, "it has a decimal comma; write 0.3 without quotes"),
        ({"RF": '"MU.real"'}, "'MU.real' is no arithmetic of parameters"),
        ({"N": "{ values = [1] }"}, "give two or more different values"),
        ({"N": "{ values = [1, 1] }"}, "give two or more different values"),
        ({"law": '{ values = ["hertz", "hook"] }'}, "'hook' is none of the model's; did you mean hooke"),
        ({"law": "[1, 2]"}, "law is a choice; give one of hertz, hooke"),
        ({"law": '"hooke"'}, None),
    ],
)
def test_what_is_wrong_with_a_parameter_is_said_with_its_line(project, capsys, changes, says):
    project(**changes)
    assert main(["calibrate", "box.toml", "--dry-run"]) == (2 if says else 0)
    said = capsys.readouterr().err
    assert says is None or (says in said and "box.toml, line " in said)


@pytest.mark.parametrize("name", ["YM", "RF", "N", "law"])
def test_a_constraint_of_what_is_no_plain_interval_is_refused(project, capsys, name):
    text = Path("box.toml").read_text()
    Path("box.toml").write_text(f'constraints = ["MU <= 2 * {name}"]\n{text}')
    assert main(["calibrate", "box.toml", "--dry-run"]) == 2
    assert f"{name} is logarithmic, listed, or follows from others" in capsys.readouterr().err


def test_in_mode_paper_listed_values_are_refused(project, capsys):
    text = Path("box.toml").read_text().replace('"robust"', '"paper"\nsamples_per_parameter = 6')
    Path("box.toml").write_text(text)
    assert main(["calibrate", "box.toml", "--dry-run"]) == 2
    assert "take mode robust" in capsys.readouterr().err


def test_a_python_function_takes_the_same_kinds():
    def angle(YM, MU, RF):
        return 3 * math.log10(YM) + 20 * MU + RF

    parameters = {
        "YM": {"interval": (1e6, 1e9), "scale": "log"},
        "MU": {"values": (0.1, 0.2, 0.5)},
        "RF": "MU / 10",
    }
    result = cs.calibrate(angle, parameters, {"angle": 27.0}, tolerances={"angle": 0.3})
    assert result.evaluations["MU"].isin([0.1, 0.2, 0.5]).all()
    assert result.responses["angle"] == pytest.approx(27.0, abs=0.3)


def test_a_choice_is_set_by_its_word(project, capsys):
    words = ["simulate", "--model", "heap", "--set", "YM=1e6", "--set", "MU=0.1", "--set", "RF=0.01"]
    assert main([*words, "--set", "N=1", "--set", "law=hooke", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)
    assert main([*words, "--set", "N=1", "--set", "law=hook"]) == 2
    assert "did you mean hooke" in capsys.readouterr().err


@pytest.mark.parametrize("style", ["equal", "index"])
def test_a_chosen_word_reaches_a_script_as_a_text(tmp_path, style):
    folder = tmp_path / "heap"
    folder.mkdir()
    head = f'script = "in.heap"\ninclude = "params.in"\nstyle = "{style}"\nexpected_seconds = 1\n'
    law = '[parameters]\nlaw = { unit = "-", values = ["hertz", "hooke"] }\n'
    (folder / "model.toml").write_text(f'{head}{law}[responses.a]\nunit = "-"\nlog = "a"\n')
    (folder / "in.heap").write_text("include params.in\npair_style gran model ${law}\n")
    model = load_folder(folder)
    assert b"variable law index hooke\n" in model.inputs({"law": 2.0}, 1).files["params.in"]
    with pytest.raises(InputError, match="choose one of 1 = hertz, 2 = hooke"):
        model.check({"law": 3.0})
