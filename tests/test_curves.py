"""Curves as targets: read where they were measured, modelled by components, weighed as one response."""

import json
import sys

import numpy as np
import pytest
from pytest import approx

from calstudy.calibration.kriging.components import principal
from calstudy.calibration.kriging.surrogates import Kriging, Surrogates
from calstudy.calibration.posterior import chi_square
from calstudy.calibration.solutions import errors_of
from calstudy.cli.main import main
from calstudy.errors import InputError, RunError
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder
from calstudy.models.folder.curves import Columns, Curve, PointOfCurve
from calstudy.parameters import Parameter, Space
from calstudy.study.definition import read_definition
from calstudy.study.definition.curves import read_curve
from calstudy.study.directory.store import read_lines
from calstudy.study.settings import read_settings

STRESS = Curve("Pa", "strain", "-", Columns("out.txt", 1, 2))

# ---- what a run left ----------------------------------------------------------------------------------


def test_a_curve_is_read_where_its_abscissa_first_gets(tmp_path):
    (tmp_path / "out.txt").write_text("# x y\n0 1\n1 2\n0.5 9\n2 4\n")
    assert PointOfCurve(Columns("out.txt", 1, 2), 0.5).read(tmp_path) == approx(1.5)
    assert PointOfCurve(Columns("out.txt", 1, 2), 1.5).read(tmp_path) == approx(3.0)


def test_a_height_is_read_as_strain_and_a_stage_alone(tmp_path):
    (tmp_path / "out.txt").write_text("1 0.10 5\n0 0.10 10\n0 0.09 20\n0 0.08 30\n1 0.01 40\n")
    columns = Columns("out.txt", 3, 2, where=(1, 0), strain="y")
    assert PointOfCurve(columns, 25).read(tmp_path) == approx(0.15)


def test_a_curve_that_ends_too_early_says_where(tmp_path):
    (tmp_path / "out.txt").write_text("0 1\n1 2\n")
    assert PointOfCurve(STRESS.columns, 1.005).read(tmp_path) == 2.0  # the last step ended short of it
    with pytest.raises(RunError, match=r"goes from 0 to 1 and has no value at 1.5"):
        PointOfCurve(STRESS.columns, 1.5).read(tmp_path)
    (tmp_path / "out.txt").write_text("nothing\n")
    with pytest.raises(RunError, match="have not the columns"):
        PointOfCurve(STRESS.columns, 0.5).read(tmp_path)


@pytest.mark.parametrize(
    ("name", "curves"),
    [
        ("uniaxial_compression", {"loading"}),
        ("shear_cell", {"preshear", "wall"}),
        ("draw_down", {"discharge"}),
        ("rotating_drum", set()),
    ],
)
def test_a_shipped_test_is_another_model_only_where_a_curve_is_asked_for(name, curves):
    model = load_folder(SHIPPED / name)
    assert set(model.curves) == curves
    for curve in curves:
        compared = model.measured_at({curve: (0.1, 0.2, 0.3)})
        assert compared.hash != model.hash
        assert [r.name for r in compared.responses][-3:] == [f"{curve}_0{k}" for k in (1, 2, 3)]


# ---- what was measured --------------------------------------------------------------------------------


def test_a_laboratory_s_units_are_turned_into_the_model_s(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("strain [%]; stress [kPa]; sd\n2; 20; 1\n1; 8; 0.5\n\n3; 40; 2\n")
    x, y, sd = read_curve(path, STRESS)
    assert (
        x == approx([0.01, 0.02, 0.03]) and y == approx([8e3, 20e3, 40e3]) and sd == approx([500, 1e3, 2e3])
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("strain, stress\n1,2\n", r"m.csv, line 1: its first line names the columns and their units"),
        ("strain [-], stress [bar]\n1,2\n2,3\n3,4\n", r"line 1: a column is in \[bar\].* Pa or kPa"),
        ("strain [-], stress [Pa]\n1,2\n2,3\n", "has 2 points; give 3 to 50"),
        ("strain [-], stress [Pa]\n1,2\n1,3\n3,4\n", "an abscissa stands twice"),
        ("strain [-], stress [Pa]\n1,2\nx,3\n3,4\n", "m.csv, line 3: .*x.* is not a finite number"),
        ("strain [-], stress [Pa]\n1,2\n2\n3,4\n", "m.csv, line 3: 1 cells"),
        ("strain [-], stress [Pa], sd\n1,2,1\n2,3,0\n3,4,1\n", "m.csv, line 3: an sd must be positive"),
        ("strain [-], stress [Pa], error\n1,2,1\n", "the third column is 'error'; it can only be sd"),
        ("", "m.csv, line 1"),
    ],
)
def test_a_file_that_is_no_curve_is_refused_with_its_line(tmp_path, text, reason):
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(InputError, match=reason):
        read_curve(tmp_path / "m.csv", STRESS)


# ---- principal components -----------------------------------------------------------------------------


def test_components_explain_the_curves_and_leave_the_noise():
    rng = np.random.default_rng(1)
    x = np.linspace(0, 1, 12)
    exact = rng.normal(size=(9, 1)) * x + rng.normal(size=(9, 1)) * x**2
    found = principal(exact + 1e-3 * rng.normal(size=exact.shape))
    assert len(found.vectors) <= 2
    assert found.vectors @ found.vectors.T == approx(np.eye(len(found.vectors)), abs=1e-12)
    rest = exact - found.mean - found.scores @ found.vectors
    assert np.mean(rest**2) <= 0.0011 * np.mean((exact - exact.mean(axis=0)) ** 2)
    assert found.left == approx(np.sqrt(np.mean(rest**2, axis=0)), abs=2e-3)
    assert (found.vectors[np.arange(len(found.vectors)), np.abs(found.vectors).argmax(axis=1)] > 0).all()


def test_curves_that_are_all_the_same_have_a_component_all_the_same():
    found = principal(np.ones((5, 4)))
    assert found.mean + found.scores @ found.vectors == approx(np.ones((5, 4)))


def space():
    ends = (Parameter("A", "-", 0.0, 1.0, None), Parameter("B", "-", 0.0, 1.0, None))
    return Space(ends, ("A", "B"))


def curve_of(points, x):
    a, b = np.asarray(points).T
    return (1 + a)[:, None] * x + b[:, None] * x**2


def test_kriging_of_scores_predicts_curves_between_the_samples():
    rng = np.random.default_rng(2)
    x = np.linspace(0.1, 1, 10)
    points = rng.random((10, 2))
    names = ("angle", *(f"c_{k:02d}" for k in range(1, 11)))
    responses = np.column_stack([30 + 5 * points[:, 0], curve_of(points, x)])
    settings = Kriging("robust", "constant", {}, curves=(names[1:],))
    model = Surrogates.fit(settings, space(), names, points, responses)
    assert len(model.models) <= 1 + 2 and set(model.diagnostics) == set(names)
    at = rng.random((20, 2)) * 0.6 + 0.2
    means, deviations = model.predict_with_deviations(at)
    assert means[:, 1:] == approx(curve_of(at, x), abs=0.06)
    assert means == approx(model.predict(at))
    assert deviations.shape == means.shape and (deviations >= 0).all()
    # The response of its own is modelled as it is without any curve.
    alone = Surrogates.fit(Kriging("robust", "constant", {}), space(), names[:1], points, responses[:, :1])
    assert means[:, 0] == approx(alone.predict(at)[:, 0])


# ---- a whole calibration ------------------------------------------------------------------------------

PROGRAM = """
import sys  # the arguments are A, B and SEED
a, b, seed = map(float, sys.argv[1:])
with open("out.txt", "w") as file:
    for k in range(41):
        x = k / 40
        print(x, 1e3 * ((1 + a) * x + b * x**2), file=file)
print("done")
"""
MODEL = """
command = [{python}, "press.py", "{{A}}", "{{B}}", "{{SEED}}"]
script = "press.py"
seeds = ["SEED"]
finished = "done"
expected_seconds = 1

[parameters]
A = "-"
B = "-"

[responses.last]
unit = "Pa"
file = "out.txt"

[curves.stress]
unit = "Pa"
abscissa = "strain"
abscissa_unit = "-"
file = "out.txt"
x = 1
y = 2
"""
FILE = """
mode = "robust"
seed = 1
WRL = 0

[[models]]
name = "press"

[parameters]
A = [0.0, 1.0]
B = [0.0, 1.0]

[targets]
{targets}
"""
TRUTH = (0.3, 0.6)
TARGETS = 'stress = { curve = "measured.csv", tolerance = 20.0 }'


def folder_with(tmp_path, targets=TARGETS, sd=False):
    model = tmp_path / "press"
    model.mkdir()
    (model / "press.py").write_text(PROGRAM)
    (model / "model.toml").write_text(MODEL.format(python=json.dumps(sys.executable)))
    x = np.linspace(0.1, 1, 7)
    y = curve_of([TRUTH], x)[0]
    lines = [
        f"{100 * a!r}, {b!r}{', 0.05' if sd else ''}" for a, b in zip(x.tolist(), y.tolist(), strict=True)
    ]
    head = "strain [%], stress [kPa]" + (", sd" if sd else "")
    (tmp_path / "measured.csv").write_text("\n".join([head, *lines]))
    (tmp_path / "mine.toml").write_text(FILE.format(targets=targets))
    return tmp_path / "mine.toml"


@pytest.mark.parametrize("sd", [False, True])
def test_a_curve_weighs_as_one_response(tmp_path, sd):
    """Its sum of squares is the mean square of the deviations, in errors or over the curve's size."""
    definition = read_definition(folder_with(tmp_path, sd=sd))
    cost = definition.task.cost
    assert cost.responses == tuple(f"stress_0{k}" for k in range(1, 8))
    off = cost.desired + 80.0
    squares = float(np.sum(cost.residuals(np.array([0.5, 0.5]), off) ** 2))
    size = 50.0 if sd else np.sqrt(np.mean(cost.desired**2))
    assert squares == approx((80.0 / size) ** 2)


def test_all_points_of_a_curve_say_as_much_as_one_response(tmp_path):
    """A curve that is off by one error everywhere is as improbable as one response that is."""
    task = read_definition(folder_with(tmp_path, sd=True)).task
    errors = np.array([*errors_of(task, {}).values()])
    off = np.full((1, 7), 50.0)  # the sd of each point
    assert float(chi_square(off, np.zeros((1, 7)), errors)[0]) == approx(1.0)


@pytest.mark.parametrize(
    ("targets", "reason"),
    [
        ('stres = { curve = "measured.csv" }', "no model gives a curve stres; did you mean stress"),
        ('stress = { curve = "nowhere.csv" }', "nowhere.csv: cannot be read"),
        ("stress = 3.0", "stress is a curve of Pa over strain; write stress = "),
        ('stress = { curve = "measured.csv", sd = 1.0 }', "have their own errors: a column sd"),
        ('stress = { curve = "measured.csv", weight = 0 }', "the weight of stress is 0"),
        ('last = { curve = "measured.csv" }', "no model gives a curve last"),
    ],
)
def test_a_curve_that_cannot_be_a_target_is_refused(tmp_path, targets, reason):
    with pytest.raises(InputError, match=reason):
        read_definition(folder_with(tmp_path, targets))


@pytest.mark.slow
def test_a_calibration_finds_the_parameters_of_a_curve(tmp_path, monkeypatch, coarse_profiles):
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", str(folder_with(tmp_path)), "--study", "found", "--workers", "1"]) == 0
    settings = read_settings(tmp_path / "found")
    (line,) = read_lines(tmp_path / "found", "calibrations", settings.quantities)
    assert [line[f"dem_{name}"] for name in "AB"] == approx(TRUTH, abs=0.1)
    page = (tmp_path / "found" / "report" / "report.html").read_text()
    assert "Measured curves" in page and "measured.csv" in page
