"""What a project has run is not run again: another target, interval, budget or number of samples is free."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.study.directory.store import read_table
from calstudy.study.settings import read_settings
from calstudy.study.stored import TRIALS
from fake_liggghts import COMMAND

FILE = """
mode = "{mode}"
seed = {seed}
WRL = 0.0
{budget}
{samples}
[[models]]
name = "angle_of_repose"
fidelity = "tiny"
[parameters]
DENS = [2450.0, 2550.0]
MU_PP = {MU_PP}
MU_PW = 0.2
RF_PP = [0.02, 0.08]
RF_PW = 0.01
YM = 5.06e8
[targets]
angle_of_repose_deg = {{ value = {angle}, tolerance = 1.5 }}
bulk_density = {{ value = 1500.0, tolerance = 40.0 }}
"""
pytestmark = pytest.mark.usefixtures("no_report")
DEFAULTS = {"mode": "robust", "seed": 1, "budget": "", "samples": "", "MU_PP": "[0.1, 0.3]", "angle": 26.0}


@pytest.fixture(autouse=True)
def fake_liggghts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.setenv("FAKE_LIGGGHTS_LOG", str(tmp_path / "called"))
    monkeypatch.chdir(tmp_path)


def calls() -> int:
    return Path("called").read_text().count("\n") if Path("called").exists() else 0


def calibrate(capsys: pytest.CaptureFixture[str], name: str, *words: str, **changes: object) -> str:
    """Calibrate a file with changes; what was said."""
    Path(f"{name}.toml").write_text(FILE.format(**DEFAULTS | changes))
    assert main(["calibrate", f"{name}.toml", "--workers", "2", *words]) in (0, 11)
    said = capsys.readouterr()
    return said.out if "--json" in words else said.err


def evaluations(name: str) -> pd.DataFrame:
    study = Path("studies") / name
    return read_table(study, "evaluations", read_settings(study).quantities)


@pytest.mark.parametrize(
    "change",
    [
        {"angle": 27.0},
        {"budget": "budget = 2"},
        {"seed": 5},
        {"samples": "samples_per_parameter = 2"},
        {"MU_PP": "[0.05, 0.35]"},
    ],
    ids=lambda change: next(iter(change)),
)
def test_what_was_not_part_of_a_run_costs_no_sample(capsys, change):
    calibrate(capsys, "first")
    before, known = calls(), set(evaluations("first")["run_id"])
    said = calibrate(capsys, "second", **change)
    taken = re.search(r"Stored: (\d+) run\(s\) of \S*first; (\d+) serve\(s\) as samples", said)
    assert taken and int(taken[1]) == len(known)
    runs = evaluations("second")
    new = runs[~runs["run_id"].isin(known)]
    assert set(new["phase"]) <= {"start", "trial", "confirmation"}
    assert calls() - before == new["run_id"].nunique()


def test_a_narrower_interval_takes_what_lies_inside_and_samples_the_rest(capsys):
    calibrate(capsys, "first")
    first = evaluations("first")
    inside = first[first["MU_PP"].between(0.2, 0.3)]
    calibrate(capsys, "second", MU_PP="[0.2, 0.3]")
    runs = evaluations("second")
    samples = runs[runs["phase"] == "sampling"]
    assert set(inside["run_id"]) <= set(samples["run_id"])
    assert samples["MU_PP"].between(0.2, 0.3).all()
    assert len(samples) == max(len(inside), 3 + 4)  # d + 4


def test_in_mode_paper_equal_samples_are_shared_and_others_are_none(capsys):
    samples = {"mode": "paper", "samples": "samples_per_parameter = 4", "budget": "budget = 8"}
    calibrate(capsys, "first", **samples)
    before = calls()
    calibrate(capsys, "second", **samples, angle=27.0)
    first, second = evaluations("first"), evaluations("second")
    sampled = [set(runs.loc[runs["phase"] == "sampling", "run_id"]) for runs in (first, second)]
    assert sampled[0] == sampled[1]
    assert calls() - before == len(set(second["run_id"]) - set(first["run_id"]))
    assert "stored" not in read_settings(Path("studies/second")).case.definition


def test_a_dry_run_counts_what_is_there(capsys):
    calibrate(capsys, "first")
    assert json.loads(calibrate(capsys, "second", "--dry-run", "--json", angle=27.0))["runs_sampling"] == 0


def test_a_study_keeps_the_samples_with_which_it_was_begun(capsys):
    calibrate(capsys, "first")
    calibrate(capsys, "second", angle=27.0)
    settings, before = read_settings(Path("studies/second")), evaluations("second")
    calibrate(capsys, "third", angle=24.0)
    for part in ("evaluations", "calibrations"):  # as if it had been stopped before its end
        shutil.rmtree(Path("studies/second") / part)
    calibrate(capsys, "second", angle=27.0)
    assert read_settings(Path("studies/second")) == settings
    again = evaluations("second")
    columns = ["phase", "index", "run_id", "seed", "MU_PP", "angle_of_repose_deg"]
    pd.testing.assert_frame_equal(again[columns], before[columns])


def test_a_damaged_study_and_a_trial_cut_short_are_passed_over(capsys):
    calibrate(capsys, "first")
    shutil.copytree("studies/first", "studies/bad")
    next(Path("studies/bad/evaluations").iterdir()).write_bytes(b"cut")
    shutil.copytree("studies/first", "studies/worse")
    Path("studies/worse/study.json").write_text("{")
    Path("studies", TRIALS).write_text("deadbeef {}\n")
    said = calibrate(capsys, "second", angle=27.0)
    assert re.search(r"of \S*studies/first; \d+ serve", said)


def test_broken_runs_are_not_believed(capsys, monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "error")
    Path("first.toml").write_text(FILE.format(**DEFAULTS))
    assert main(["calibrate", "first.toml"]) == 8
    monkeypatch.delenv("FAKE_LIGGGHTS")
    said = calibrate(capsys, "second")
    assert "Stored:" not in said
    assert set(evaluations("second")["outcome"]) == {"ok"}


def test_a_parameter_that_was_constant_before_is_sampled_though_many_runs_are_there(capsys):
    calibrate(capsys, "first", MU_PP="0.2", samples="samples_per_parameter = 4")
    there = set(evaluations("first")["run_id"])
    expected = json.loads(calibrate(capsys, "second", "--dry-run", "--json"))["runs_sampling"]
    calibrate(capsys, "second")
    runs = evaluations("second")
    samples = runs[runs["phase"] == "sampling"]
    new = samples[~samples["run_id"].isin(there)]
    assert len(there) > 7  # more than the design's d + 4 points
    assert len(new) == expected == 4  # half of them
    assert new["MU_PP"].nunique() == len(new)
