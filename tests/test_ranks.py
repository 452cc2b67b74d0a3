"""Runs on MPI ranks: the launcher, the cores they take, and their place in the identity of a run."""

import shutil
import sys
import threading

import pytest

from calstudy.engines import program as programs
from calstudy.engines.choose import engines_and_executor
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.profiles import LIGGGHTS
from calstudy.engines.program import Program, launcher
from calstudy.errors import InputError, SetupError
from calstudy.models.folder import load_folder
from calstudy.records import Outcome
from fake_liggghts import COMMAND

SCRIPT = """
units si
atom_style granular
boundary f f f
newton off
communicate single vel yes
processors 2 1 1
region box block -0.02 0.02 -0.02 0.02 0 0.04 units box
create_box 1 box
neighbor 0.002 bin
neigh_modify delay 0
fix m1 all property/global youngsModulus peratomtype 5e6
fix m2 all property/global poissonsRatio peratomtype 0.3
fix m3 all property/global coefficientRestitution peratomtypepair 1 0.5
fix m4 all property/global coefficientFriction peratomtypepair 1 ${MU}
pair_style gran model hertz tangential history
pair_coeff * *
timestep 1e-5
fix gravity all gravity 9.81 vector 0 0 -1
fix floor all wall/gran model hertz tangential history primitive type 1 zplane 0
fix bead all particletemplate/sphere 15485863 atom_type 1 density constant 2500 radius constant 0.002
fix beads all particledistribution/discrete 32452843 1 bead 1.0
region above block -0.018 0.018 -0.018 0.018 0.005 0.035 units box
fix pack all insert/pack seed 49979687 distributiontemplate beads maxattempt 100 insert_every once &
 overlapcheck yes all_in yes region above particles_in_region 40
fix integrate all nve/sphere
run 500
variable n equal atoms
print "beads = ${n}"
print "finished"
"""
MODEL = """
script = "in.box"
finished = "finished"
expected_seconds = 2
ranks = 2

[parameters]
MU = "-"

[responses.beads]
unit = "1"
log = "beads ="
"""


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
    _, executor = engines_and_executor([(load_folder(folder), "")], threading.Event())
    assert executor.slots == 2
    executor.close()


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
def test_real_liggghts_runs_on_two_ranks(folder, tmp_path):
    engine = ProgramEngine(load_folder(folder), LIGGGHTS.find())
    run = engine.run({"MU": 0.3}, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.OK, run.reason
    assert run.responses["beads"] == 40
    assert "2 by 1 by 1 MPI processor grid" in (tmp_path / "run" / "log.liggghts").read_text()
