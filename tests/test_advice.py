"""What is said of a calibration before it is run."""

from __future__ import annotations

from pathlib import Path

import pytest

from calstudy.cli.main import main
from calstudy.study.definition import example, read_definition
from calstudy.study.definition.advice import advice
from fake_liggghts import COMMAND


def said(folder: Path, *changes: tuple[str, str]) -> str:
    text = example()
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "mine.toml").write_text(text)
    return " ".join(advice(read_definition(folder / "mine.toml")))


ONE = (
    ("DENS = [2400.0, 2600.0]", "DENS = 2500.0"),
    ("YM = [4.175e8, 6.5e8]", "YM = 5.06e8"),
    ("WRL = 0.1 ", "WRL = 0.0 "),
)


def test_the_example_needs_no_advice(tmp_path: Path) -> None:
    assert said(tmp_path) == ""


def test_one_or_two_unknowns_need_less(tmp_path: Path) -> None:
    assert "Only MU_PP and RF_PP are calibrated: for one or two unknowns" in said(tmp_path, *ONE)
    only = said(tmp_path, *ONE, ("MU_PP = [0.1, 0.3]", "MU_PP = 0.2"))
    assert "Only RF_PP is calibrated" in only


def test_wide_intervals_of_what_moves_the_time_step_are_told_what_wrl_does(tmp_path: Path) -> None:
    wide = ("YM = [4.175e8, 6.5e8]", "YM = [4.1e8, 4.1e9]")
    text = said(tmp_path, wide)
    assert "changes by a factor of 3.3" in text  # sqrt(2600 / 2400 * 10)
    assert "counts that as 0.1 times a target" in text and "narrow DENS and YM" in text
    assert said(tmp_path, wide, ("WRL = 0.1 ", "WRL = 0.0 ")) == ""


def test_the_command_says_it_before_any_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.chdir(tmp_path)
    said(tmp_path, *ONE)
    assert main(["calibrate", "mine.toml", "--dry-run"]) == 0
    assert "more than is needed (section 2.3.3)" in " ".join(capsys.readouterr().err.split())
