"""A model is tried at both ends of its intervals before any sample; what would fail late is told at once."""

import json
import sys
import threading

import pytest

from calstudy.cli.main import main
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.engines.program import Program
from calstudy.models.folder import load_folder
from calstudy.models.trial.runs import try_model
from calstudy.study.directory.store import read_table
from calstudy.study.settings import read_settings
from calstudy.study.stored import TRIALS

PROGRAM = """#!{python} -S
import os, sys
if "-help" in sys.argv:
    print("LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled)")
    sys.exit()
values = dict(line.split()[1:4:2] for line in open("params.in"))
script = open(sys.argv[sys.argv.index("-in") + 1]).read()
if "fixed" in script:
    values["MU"] = "0.5"
os.makedirs("post", exist_ok=True)
with open("post/result_2.txt", "w") as out:
    out.write(values["MU"])
said = "ERROR: Cannot redefine variable" if "fails" in script else "torque = %s\\ndone" % values["MU"]
with open("log.liggghts", "w") as log:
    log.write(said + "\\n")
sys.exit(1 if "fails" in script else 0)
"""
MODEL = """
script = "in.shear"
include = "params.in"
expected_seconds = 2
finished = "done"

[parameters]
MU = "-"

[particles]
radius = 0.002
poissons_ratio = 0.3
density = 2500.0
youngs_modulus = 5e6

[responses.torque]
unit = "N m"
log = "torque"

[responses.latest]
unit = "-"
python = "latest.py:latest"
reads = []
"""
LATEST = """
def latest(directory):
    return float(sorted((directory / "post").glob("*.txt"))[-1].read_text())
"""
FILE = """
mode = "robust"
seed = 1
WRL = 0.0
[[models]]
name = "shear"
[parameters]
MU = [0.1, 0.6]
[targets]
torque = { value = 0.3, tolerance = 0.01 }
"""


@pytest.fixture
def case(tmp_path, no_report):
    """Write a calibration's file, its model and a program; returns the file and the program."""

    def make(script="print ${MU}", old=False):
        folder = tmp_path / "shear"
        folder.mkdir(parents=True)
        (folder / "model.toml").write_text(MODEL)
        (folder / "in.shear").write_text(f"include params.in\n{script}\n")
        (folder / "latest.py").write_text(LATEST)
        if old:
            (folder / "post").mkdir()
            (folder / "post" / "result_9.txt").write_text("31.5")
        program = tmp_path / "program"
        program.write_text(PROGRAM.format(python=sys.executable))
        program.chmod(0o755)
        (tmp_path / "box.toml").write_text(FILE)
        return tmp_path / "box.toml", program

    return make


def tried(case, tmp_path):
    _, program = case
    engine = ProgramEngine(load_folder(tmp_path / "shear"), Program(LIGGGHTS, (str(program),), "3.8.0"))
    return try_model(engine, ({"MU": 0.1}, {"MU": 0.6}), 7, tmp_path / "scratch", threading.Event())


def test_a_sound_model_shows_each_response_at_both_ends_and_where_it_was_read(case, tmp_path):
    trial = tried(case(), tmp_path)
    assert trial.faults == ()
    assert [run.responses["torque"] for run in trial.runs] == [0.1, 0.6]
    assert trial.shown["torque"] == "log.liggghts, line 1: torque = 0.6"
    assert trial.seconds > 0
    assert not any((tmp_path / "scratch").iterdir())


@pytest.mark.parametrize(
    ("script", "old", "says", "runs"),
    [
        ("fixed ${MU}", False, "torque is 0.5 N m at the lower and at the upper ends of all intervals", 2),
        ("fails ${MU}", False, "let it be of style index, or name its file as include", 1),
        ("print ${MU}", True, "latest: latest.py:latest gives 31.5 before anything has run", 0),
    ],
)
def test_what_would_fail_late_or_silently_is_a_fault(case, tmp_path, script, old, says, runs):
    trial = tried(case(script, old), tmp_path)
    assert says in trial.faults[0]
    assert len(trial.runs) == runs


def test_the_command_shows_the_trial_and_says_what_comes_next(case, capsys, tmp_path):
    file, program = case()
    assert main(["try", str(file), "--liggghts", str(program)]) == 0
    shown = capsys.readouterr().out
    assert "log.liggghts, line 1: torque = 0.6" in shown
    assert f"Ready: calstudy calibrate {file}" in shown
    assert main(["try", str(file), "--liggghts", str(program), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["shear"]["faults"] == []


def test_a_fault_is_one_line_and_the_exit_code_of_a_failed_run(case, capsys):
    file, program = case("fixed ${MU}")
    assert main(["try", str(file), "--liggghts", str(program)]) == 4
    said = capsys.readouterr().err.splitlines()[-1]
    assert said.startswith("calstudy: trial of shear: torque is 0.5 N m at the lower and at the upper ends")


def test_shipped_models_need_no_trial(tmp_path, capsys):
    assert main(["calibrate", "--init", str(tmp_path / "beads.toml")]) == 0
    assert main(["try", str(tmp_path / "beads.toml")]) == 0
    assert "shipped models alone" in capsys.readouterr().out


def test_a_calibration_tries_a_new_model_before_its_first_sample(case, tmp_path, monkeypatch, capsys):
    file, program = case("fixed ${MU}")
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", str(file), "--liggghts", str(program)]) == 4
    assert "trial of shear: torque is 0.5 N m" in capsys.readouterr().err
    assert not (tmp_path / "studies" / "box" / "study.json").exists()
    assert not (tmp_path / "studies" / TRIALS).exists()  # a run that proves nothing is not kept


def test_runs_of_a_trial_are_samples_and_no_model_is_tried_twice(case, tmp_path, monkeypatch, capsys):
    file, program = case()
    monkeypatch.chdir(tmp_path)
    assert main(["try", str(file), "--liggghts", str(program)]) == 0
    assert main(["calibrate", str(file), "--liggghts", str(program)]) in (0, 11)
    said = capsys.readouterr().err
    assert said.count("Trial of shear") == 1
    assert "2 serve(s) as samples" in said
    study = tmp_path / "studies" / "box"
    runs = read_table(study, "evaluations", read_settings(study).quantities)
    samples = runs[runs["phase"] == "sampling"]
    assert len(samples) == 5  # d + 4
    assert {0.1, 0.6} <= set(samples["MU"])


def test_a_model_whose_files_have_changed_is_tried_again(case, tmp_path, monkeypatch, capsys):
    file, program = case()
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", str(file), "--liggghts", str(program)]) in (0, 11)
    assert "Trial of shear" in capsys.readouterr().err
    script = tmp_path / "shear" / "in.shear"
    script.write_text(script.read_text() + "print ${MU}\n")
    assert main(["calibrate", str(file), "--liggghts", str(program), "--study", "studies/other"]) in (0, 11)
    assert "Trial of shear" in capsys.readouterr().err
