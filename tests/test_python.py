"""From Python: what the package offers, and that it does what the commands do."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calstudy as cs
from calstudy.analysis.exhibit import Column, Table
from calstudy.cli.main import main
from calstudy.errors import InputError, RunError
from calstudy.report.calibration import missed, responses_table
from calstudy.study.reading import Result
from calstudy.study.settings import read_settings
from calstudy.written import html_table

SPACE: dict[str, tuple[float, float] | float] = {"mu": (0.1, 0.6), "cohesion": (0.0, 50.0)}
TARGETS = {"shear_stress": 330.0, "wall_angle": 9.0}
calls: list[float] = []


def shear_cell(mu: float, cohesion: float) -> dict[str, float]:
    calls.append(mu)
    return {"shear_stress": 100 + 400 * mu + 3 * cohesion, "wall_angle": 2 + 20 * mu}


@pytest.fixture(scope="module")
def found() -> Result:
    return cs.calibrate(
        shear_cell, SPACE, TARGETS, units={"cohesion": "<Pa>"}, tolerances={"wall_angle": 0.1}
    )


def test_importing_the_package_does_not_load_numpy() -> None:
    program = "import sys, calstudy; print('numpy' in sys.modules, calstudy.UniversalKriging.__name__)"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stdout == "False UniversalKriging\n"


def test_each_name_that_is_offered_is_there() -> None:
    assert all(callable(getattr(cs, name)) for name in cs.__all__) and set(cs.__all__) <= set(dir(cs))
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = cs.no_such_name


def test_a_function_comes_to_its_targets(found: Result) -> None:
    assert found.optimum == pytest.approx({"mu": 0.35, "cohesion": 30.0}, rel=1e-3)
    assert found.responses == pytest.approx(TARGETS, rel=1e-3)
    assert found.line["runs_total"] == len(found.evaluations) <= 12
    assert 0 < found.solutions.share < 1 and len(found.profiles) == len(found.optimum)


def test_the_same_call_gives_the_same_digits(found: Result) -> None:
    again = cs.calibrate(shear_cell, SPACE, TARGETS, tolerances={"wall_angle": 0.1}, workers=2)
    assert again.optimum == found.optimum


def test_a_finished_study_calls_the_function_no_more(tmp_path: Path) -> None:
    first = cs.calibrate(shear_cell, SPACE, TARGETS, path=tmp_path / "mine")
    calls.clear()
    assert cs.calibrate(shear_cell, SPACE, TARGETS, path=tmp_path / "mine").optimum == first.optimum
    assert not calls


def test_a_fixed_parameter_stays_where_it_is() -> None:
    seen: set[float] = set()

    def stress(mu: float, cohesion: float) -> float:
        seen.add(cohesion)
        return 100 + 400 * mu + 3 * cohesion

    found = cs.calibrate(stress, {"mu": (0.1, 0.6), "cohesion": 20}, {"stress": 300})
    assert seen == {20.0} and found.optimum["mu"] == pytest.approx(0.35, rel=1e-3)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"targets": {"shear_stress": 0.0}}, "shear_cell: the target of shear_stress is 0, and Eq. 9"),
        ({"parameters": {"mu": (0.6, 0.1), "cohesion": 1.0}}, "write the smaller one first"),
        ({"parameters": {"mu": 0.1, "cohesion": 1.0}}, "no parameter is calibrated"),
        ({"parameters": {"mu": (0.1, 0.6)}}, "does not take the parameters mu"),
        ({"units": {"mus": "-"}}, "units: mus is unknown; did you mean mu"),
        ({"tolerances": {"wall_angel": 1.0}}, "tolerances: wall_angel is unknown; did you mean wall_angle"),
        ({"mode": "papr"}, "mode 'papr' is unknown; did you mean paper"),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_what_is_wrong_with_the_arguments_is_told(wrong: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {"parameters": SPACE, "targets": TARGETS}
    with pytest.raises(InputError, match=message):
        cs.calibrate(shear_cell, **(arguments | wrong))  # type: ignore[arg-type]


def test_targets_of_zero_below_zero_and_objectives_are_reached() -> None:
    def test(mu: float, cohesion: float) -> dict[str, float]:
        return {"lift": 40 * mu - 10, "suction": -3 * cohesion - 20 * mu, "image_error": (mu - 0.3) ** 2}

    space = {"mu": (0.1, 0.6), "cohesion": (0, 50)}
    found = cs.calibrate(test, space, {"lift": {"value": 0, "scale": 5}, "suction": -65})
    assert found.optimum == pytest.approx({"mu": 0.25, "cohesion": 20.0}, rel=1e-2)
    assert found.responses == pytest.approx({"lift": 0.0, "suction": -65.0}, abs=0.05)
    objective = {"minimise": True, "scale": 0.01}
    found = cs.calibrate(test, space, {"image_error": objective, "suction": {"value": -66, "scale": 10}})
    assert found.optimum == pytest.approx({"mu": 0.3, "cohesion": 20.0}, rel=0.03)
    assert responses_table(found).frame["verdict"].iloc[0] == "to be minimised"
    assert "image_error" not in missed(found)


def test_a_measured_target_weighs_its_error_and_the_runs_noise() -> None:
    """Two tests that contradict each other are averaged by the inverse of their variances."""

    def two(mu: float, seed: int) -> dict[str, float]:
        rng = np.random.default_rng(seed)
        return {"first": 100 * mu + rng.normal(0, 3), "second": 100 * mu + rng.normal(0, 0.1)}

    targets = {"first": {"value": 30, "sd": 4.0}, "second": {"values": [34.5, 35.5]}}
    noise = {"first": 3.0, "second": 0.1}
    found = cs.calibrate(two, {"mu": (0.1, 0.6)}, targets, noise=noise, samples_per_parameter=30)  # type: ignore[arg-type]
    first, second = 1 / (4.0**2 + 3.0**2), 1 / (0.5**2 + 0.1**2)
    mean = (30 * first + 35 * second) / (first + second)
    assert 100 * found.optimum["mu"] == pytest.approx(mean, abs=0.06)
    (note,) = [note for note in responses_table(found).notes if note.startswith("Chi-square")]
    off = np.array([found.responses["first"] - 30, found.responses["second"] - 35])
    assert f"noise of a run: {float(off**2 @ [first, second]):.3g} for 2 response(s)" in note


def test_a_function_that_always_fails_is_told_with_its_reason() -> None:
    def broken(mu: float) -> float:
        raise ValueError("the cell is empty")

    with pytest.raises(RunError, match="the cell is empty"):
        cs.calibrate(broken, {"mu": (0.1, 0.6)}, {"stress": 1.0})


def test_rows_run_from_python_are_the_study_of_the_command(tmp_path: Path) -> None:
    plan, study = cs.load_plan(), tmp_path / "study"
    engine = cs.open_engine("emulator", fidelity="coarse")
    found = cs.run_plan(plan, engine, rows=[1], path=study)
    assert list(found.ok["row"]) == [1]
    words = [
        "--engine",
        "emulator",
        "--fidelity",
        "coarse",
        "--rows",
        "1",
        "--study",
        str(tmp_path / "other"),
    ]
    main(["plan", "run", *words])
    assert read_settings(study).id == read_settings(tmp_path / "other").id
    other = cs.read_study(tmp_path / "other").evaluations
    pd.testing.assert_frame_equal(found.evaluations[other.columns[:12]], other[other.columns[:12]])


def test_an_engine_that_is_open_takes_no_other_place() -> None:
    engine = cs.open_engine("emulator", fidelity="coarse")
    with pytest.raises(InputError, match="leave the scheduler and the command out"):
        cs.run_plan(cs.load_plan(), engine, how=cs.Running(scheduler="tcp://127.0.0.1:9"))


def test_results_show_themselves_escaped(found: Result) -> None:
    shown = found._repr_html_()
    assert "shear_stress" in shown and "&lt;Pa&gt;" in shown and "<Pa>" not in shown
    assert html_table("<a>", ["<b>"], [["<c>"]]).count("&lt;") == 3
    table = Table("t", "A <title>", pd.DataFrame({"x": [1.5]}), (Column("x", "X", ".2f"),), ["a <note>"])
    assert "A &lt;title&gt;" in table._repr_html_() and "1.50" in table._repr_html_()
    assert "72 of 72" in cs.read_study("reports/soft/paper")._repr_html_()
