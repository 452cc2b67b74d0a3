"""`calstudy plan rerun`: a shipped row again, by the study's own settings, compared run by run."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.errors import MISSED
from calstudy.study.directory.store import write_table
from calstudy.study.reading import read_study
from calstudy.study.schema import arrow_schema
from calstudy.study.settings import read_settings
from closed_form import resettle
from fake_liggghts import COMMAND
from shipped_model import QUANTITIES

pytestmark = pytest.mark.slow

ROW = 31


@pytest.fixture(autouse=True)
def fake_liggghts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study whose mode, budget, seed and target are none of the defaults."""
    directory = tmp_path_factory.mktemp("shipped") / "study"
    settings = ("--fidelity", "tiny", "--mode", "robust", "--budget", "2", "--seed", "7", "--target", "twin")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
        words = ("plan", "run", "--rows", f"1,{ROW}", *settings, "--study", str(directory))
        assert main(words) in (0, MISSED)
    return directory


@pytest.fixture
def shipped(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "shipped"))


def rerun(capsys: pytest.CaptureFixture[str], study: Path, *more: str) -> tuple[int, list[dict]]:
    capsys.readouterr()
    code = main(("plan", "rerun", str(study), "--rows", str(ROW), "--json", *more))
    return code, json.loads(capsys.readouterr().out)


def test_a_row_comes_out_again_to_the_last_digit(capsys: pytest.CaptureFixture[str], shipped: Path) -> None:
    code, (found,) = rerun(capsys, shipped)
    assert code == 0 and found["same"]
    assert found["row"] == ROW and found["runs"] == found["runs_again"] == found["equal"] > 6
    there = read_settings(shipped)
    again = Path("studies") / f"rerun-{there.id}"
    assert read_settings(again) == there
    assert not (again / "evaluations" / "row-01.parquet").exists()


def test_a_row_comes_out_again_with_its_confirmation(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    how = ("--fidelity", "tiny", "--mode", "robust", "--budget", "1", "--confirm", "2")
    assert main(("plan", "run", "--rows", str(ROW), *how, "--study", "confirmed")) in (0, MISSED)
    runs = read_study(tmp_path / "confirmed").evaluations["phase"]
    assert (runs == "confirmation").sum() >= 2
    code, (found,) = rerun(capsys, tmp_path / "confirmed")
    assert code == 0 and found["same"] and found["equal"] == len(runs)


def test_a_result_that_is_not_what_the_program_gives_is_found(
    capsys: pytest.CaptureFixture[str], shipped: Path
) -> None:
    path = shipped / "evaluations" / f"row-{ROW}.parquet"
    runs = pd.read_parquet(path)
    runs.loc[2, "bulk_density"] += 1.0
    write_table(path, runs, arrow_schema("evaluations", QUANTITIES))
    code, (found,) = rerun(capsys, shipped)
    assert code == 10 and not found["same"]
    assert found["equal"] == 2 and found["first_difference"] == "sampling 2"
    assert found["largest"] == {"angle_of_repose_deg": 0.0, "bulk_density": pytest.approx(1.0)}


def test_it_says_in_words_what_differs(capsys: pytest.CaptureFixture[str], shipped: Path) -> None:
    resettle(shipped, calstudy="0.0.1")
    assert main(("plan", "rerun", str(shipped), "--rows", str(ROW))) == 0
    out = capsys.readouterr().out
    assert "all digits" in out and "calstudy: 0.0.1 made the study" in out


def test_a_dry_run_says_what_it_took(capsys: pytest.CaptureFixture[str], shipped: Path) -> None:
    assert main(("plan", "rerun", str(shipped), "--rows", "1", "--dry-run")) == 0
    assert "1 row(s) took" in capsys.readouterr().out
    assert main(("plan", "rerun", str(shipped), "--rows", "1", "--dry-run", "--json")) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["rows"] == [1] and said["runs"] > 0 and said["core_hours"] > 0
    assert not Path("studies").exists()


@pytest.mark.parametrize(
    ("changed", "said", "code"),
    [
        ({}, "has no row 4 to compare with", 2),
        ({"engine": "emulator 0123456789ab"}, "was made by emulator 0123456789ab", 2),
        ({"model_hash": "0" * 64, "deck": 1}, "was made with deck 1 of the model, hash 000000000000", 6),
    ],
)
def test_what_cannot_be_compared_is_refused(
    capsys: pytest.CaptureFixture[str], shipped: Path, changed: dict, said: str, code: int
) -> None:
    resettle(shipped, **changed)
    capsys.readouterr()
    assert main(("plan", "rerun", str(shipped), "--rows", "1" if changed else "1,4")) == code
    out, err = capsys.readouterr()
    assert out == "" and said in err and len(err.splitlines()) == 1
    assert not Path("studies").exists()


def test_a_row_of_two_fidelities_comes_out_again_with_its_confirmation(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    two = ("--fidelity", "coarse", "--cheap", "tiny", "--mode", "robust", "--confirm", "2", "--seed", "3")
    words = ("plan", "run", "--rows", str(ROW), *two, "--study", "two")
    assert main(words) in (0, MISSED)
    runs = read_study(tmp_path / "two").evaluations["phase"].value_counts()
    assert runs["cheap"] >= 6 and runs["confirmation"] >= 2
    code, (found,) = rerun(capsys, tmp_path / "two")
    assert found["first_difference"] == "" and found["equal"] == runs.sum() and code == 0
