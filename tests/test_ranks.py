"""Runs on MPI ranks: the launcher, the cores they take, and their place in the identity of a run."""

import json
import shutil
import sys
import threading

import pytest

from beads_in_a_box import MODEL, SCRIPT
from calstudy.cli.main import main
from calstudy.engines import program as programs
from calstudy.engines.choose import engines_and_executor, slots
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.profiles import LIGGGHTS, YADE
from calstudy.engines.program import Program, launcher
from calstudy.errors import InputError, SetupError
from calstudy.models.folder import load_folder
from calstudy.records import Outcome
from calstudy.study.definition import read_definition
from fake_liggghts import COMMAND


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "box"
    path.mkdir()
    (path / "in.box").write_text(SCRIPT)
    (path / "model.toml").write_text(MODEL)
    return path


def test_ranks_are_part_of_the_identity_and_are_whole(folder):
    two = load_folder(folder)
    toml = folder / "model.toml"
    toml.write_text(MODEL.replace("ranks = 2", "ranks = 1"))
    one = load_folder(folder)
    toml.write_text(MODEL.replace("ranks = 2\n", ""))
    assert load_folder(folder).hash == one.hash != two.hash
    toml.write_text(MODEL.replace("ranks = 2", "ranks = 0"))
    with pytest.raises(InputError, match=r"line 5: ranks is 0; give a whole number from 1"):
        load_folder(folder)


def test_ranks_are_counted_against_the_cores(folder, monkeypatch):
    monkeypatch.setenv(LIGGGHTS.variable, COMMAND)
    monkeypatch.setattr("calstudy.engines.choose.cores", lambda: 5)
    two = load_folder(folder)
    _, executor = engines_and_executor([(two, "")], threading.Event())
    assert executor.slots == 2
    executor.close()
    assert slots() == 5 and slots(two, load_folder(folder, ranks=1)) == 2
    (folder / "model.toml").write_text(MODEL.replace("ranks = 2", "ranks = 2\nthreads = 2"))
    assert slots(load_folder(folder)) == 1 == slots(load_folder(folder, ranks=7))


def test_threads_are_part_of_the_identity_and_reach_the_program(folder, tmp_path, monkeypatch):
    one = load_folder(folder)
    (folder / "model.toml").write_text(MODEL.replace("ranks = 2", "ranks = 2\nthreads = 3"))
    three = load_folder(folder)
    assert three.hash != one.hash
    inputs = one.inputs({"MU": 0.3}, 1)
    assert inputs.making(1, "LIGGGHTS 3.8.0", 2) == inputs.making(1, "LIGGGHTS 3.8.0", 2, 1)
    assert inputs.making(1, "LIGGGHTS 3.8.0", 2) != inputs.making(1, "LIGGGHTS 3.8.0", 2, 3)
    assert Program(YADE, ("yade",), "2023.02a").command("heap.py", (), 1, 3) == [
        "yade",
        "-n",
        "-x",
        "-j3",
        "heap.py",
    ]
    said = tmp_path / "liggghts"
    said.write_text('#!/bin/sh\necho "finished" > "$4"\necho "beads = $OMP_NUM_THREADS" >> "$4"\n')
    said.chmod(0o755)
    alone = load_folder(folder, ranks=1)
    run = ProgramEngine(alone, Program(LIGGGHTS, (str(said),), "3.8.0")).run(
        {"MU": 0.3}, 1, tmp_path / "run", threading.Event()
    )
    assert run.responses["beads"] == 3, run.reason


@pytest.mark.parametrize("command", ["mpirun -np 2 liggghts", "env -u X /opt/mpi/bin/mpiexec -n 2 liggghts"])
def test_a_launcher_in_the_command_is_refused_since_its_ranks_would_be_in_no_identity(command):
    with pytest.raises(SetupError, match=r"would neither count nor be part of a run's identity.*--ranks N"):
        LIGGGHTS.find(command)


def test_ranks_of_the_command_line_take_the_place_of_the_model_s(folder, capsys, monkeypatch):
    monkeypatch.setenv(LIGGGHTS.variable, COMMAND)
    toml = folder / "calibration.toml"
    toml.write_text(
        'mode = "robust"\nseed = 1\nWRL = 0.0\n[[models]]\nname = "box"\n[parameters]\nMU = [0.1, 0.9]\n'
        "[targets]\nbeads = { value = 40.0, tolerance = 1.0 }\n"
    )
    places = (folder.parent,)
    by_file, by_option = (read_definition(toml, places, ranks=ranks) for ranks in (None, 4))
    assert [found.models[0].model.ranks for found in (by_file, by_option)] == [2, 4]
    assert by_file.hash != by_option.hash
    assert main(["simulate", "--ranks", "2"]) == 2
    assert "--ranks 2: the model angle_of_repose runs on one core" in capsys.readouterr().err
    toml.write_text(toml.read_text().replace('name = "box"', 'name = "angle_of_repose"\nfidelity = "tiny"'))
    with pytest.raises(InputError, match="--ranks 2: the model angle_of_repose runs on one core"):
        read_definition(toml, places, ranks=2)


@pytest.mark.parametrize(
    ("banner", "words"), [("Open MPI 4", ["--bind-to", "none"]), ("HYDRA build", ["-bind-to", "none"])]
)
def test_ranks_are_bound_to_no_core_by_either_launcher(tmp_path, banner, words):
    mpirun = tmp_path / "mpirun"
    mpirun.write_text(f"#!{sys.executable} -S\nprint({banner!r})\n")
    mpirun.chmod(0o755)
    program = Program(LIGGGHTS, (str(tmp_path / "liggghts"),), "3.8.0")  # the launcher beside it is taken
    command = program.command("in.box", (), 4)
    assert command[0] == str(mpirun)
    place = command.index(words[0])
    assert command[place : place + 2] == words
    assert command[command.index("-np") + 1 :][:2] == ["4", str(tmp_path / "liggghts")]
    assert program.command("in.box")[0] == str(tmp_path / "liggghts")


def test_without_a_launcher_the_remedy_is_said(tmp_path, monkeypatch):
    monkeypatch.setattr(programs.shutil, "which", lambda *_, **__: None)
    with pytest.raises(SetupError, match="mpirun was not found, which ranks need; install it with"):
        launcher(str(tmp_path / "nothing"))


@pytest.mark.liggghts
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="LIGGGHTS is there without mpirun")
def test_real_liggghts_runs_on_two_ranks_of_the_command_line(folder, tmp_path, capsys):
    (folder / "model.toml").write_text(MODEL.replace("ranks = 2\n", ""))
    argv = ["simulate", "--model", str(folder), "--set", "MU=0.3", "--ranks", "2", "--json"]
    assert main([*argv, "--out", str(tmp_path / "run")]) == 0
    assert json.loads(capsys.readouterr().out)["beads"] == 40
    assert "2 by 1 by 1 MPI processor grid" in (tmp_path / "run" / "log.liggghts").read_text()


@pytest.mark.liggghts
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("mpirun") is None, reason="LIGGGHTS is there without mpirun")
def test_real_liggghts_runs_on_two_ranks(folder, tmp_path):
    engine = ProgramEngine(load_folder(folder), LIGGGHTS.find())
    run = engine.run({"MU": 0.3}, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.OK, run.reason
    assert run.responses["beads"] == 40
    assert "2 by 1 by 1 MPI processor grid" in (tmp_path / "run" / "log.liggghts").read_text()
