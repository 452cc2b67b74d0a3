"""The file that ``calibrate --init --tests`` writes: it runs as it is, with each test's own targets."""

import pytest

from calstudy.cli.main import main
from calstudy.errors import InputError
from calstudy.study.definition import example_of, read_definition

TESTS = ("angle_of_repose", "draw_down")
ALONE = [(name,) for name in (*TESTS, "angle_of_repose_lammps")]


@pytest.mark.parametrize("tests", [*ALONE, TESTS], ids="+".join)
def test_a_file_for_chosen_tests_is_a_calibration(tests, tmp_path, capsys):
    path = tmp_path / "mine.toml"
    assert main(["calibrate", "--init", "--tests", ",".join(tests), str(path)]) == 0
    found = read_definition(path)
    assert [chosen.model.name for chosen in found.models] == list(tests)
    assert set(found.task.space.calibrated) == {"DENS", "MU_PP", "RF_PP", "YM"}
    for chosen in found.models:
        given = {*chosen.responses} & {*found.task.cost.target.values}
        assert len(given) >= 2 and given <= {*chosen.noise}
        for name in given:
            assert found.task.tolerances[name] == pytest.approx(2 * chosen.noise[name], rel=0.5)
    assert main(["calibrate", str(path), "--dry-run", "--study", str(tmp_path / "study")]) == 0
    assert "Nothing was run" in capsys.readouterr().out


def test_every_response_of_a_test_is_in_the_file():
    """Those too noisy for a target as comments, so that a newcomer sees what there is."""
    text = example_of(["draw_down"])
    for name in ("discharge_rate", "discharge_time", "crater_angle_deg", "heap_angle_deg"):
        assert f"{name} = {{ value = " in text


@pytest.mark.parametrize(
    ("tests", "says"),
    [
        (["draw_dwon"], "there is no model draw_dwon"),
        (["draw_down", "draw_down"], "name each test once"),
        ([], "name each test once"),
    ],
)
def test_tests_that_are_not_there_are_refused(tests, says):
    with pytest.raises(InputError, match=says):
        example_of(tests)


def test_the_curves_of_a_test_are_in_the_file_as_comments():
    lines = example_of(["uniaxial_compression"]).splitlines()
    assert '# loading = { curve = "loading.csv" }    # -; a measured curve, over normal stress' in lines


def test_tests_are_chosen_for_a_new_file_alone(capsys):
    assert main(["calibrate", "there.toml", "--tests", "draw_down"]) == 2
    assert "give it with --init" in capsys.readouterr().err
