"""The table of engines: what each line opens, what is found for it, and what a line of one's own is."""

import json
import re
import threading
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.engines.choose import (
    ENGINES,
    ProgramKind,
    engines_and_executor,
    found_engines,
    kind_of,
    open_engine,
    planned_engine,
    program_that_made,
)
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.engines.program import Profile
from calstudy.errors import MISSED, InputError, SetupError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.folder import FolderModel, load_folder
from calstudy.plan_file import load_plan
from calstudy.records import Outcome
from calstudy.study.run.definition import calibrate_file
from calstudy.study.run.work import Running
from closed_form import ClosedForm
from fake_liggghts import COMMAND

FIXED = load_plan().fixed
OWN = SimpleNamespace(open=lambda model, fidelity, variant: ClosedForm(), look=lambda: "always there")


@pytest.fixture(autouse=True)
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIGGGHTS.variable, COMMAND)


@pytest.mark.parametrize("name", ["liggghts", "emulator"])
def test_every_engine_of_the_table_opens_for_a_model_and_without_one(name: str) -> None:
    engine = open_engine(name, fidelity="full")
    assert engine.particle_diameter == 0.005
    assert engine.identity.lower().startswith(name)
    assert engine.model_hash == load_model(FIXED, "full").hash
    model = load_model(FIXED, "soft", "wide")
    assert open_engine(name, model).model_hash == model.hash
    with pytest.raises(InputError, match="a model has its own"):
        open_engine(name, model, fidelity="full")


def test_without_a_fidelity_an_engine_has_its_own() -> None:
    assert open_engine("liggghts").model_hash == load_model(FIXED, "soft").hash
    assert open_engine("emulator").model_hash == load_model(FIXED, "full").hash


def test_what_the_machine_lacks_is_told_engine_by_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    assert found_engines()["liggghts"].identity == "LIGGGHTS 3.8.0"
    monkeypatch.setenv(LIGGGHTS.variable, "/no/such/program")
    found = found_engines()
    assert list(found) == list(ENGINES)
    assert "LIGGGHTS was not found" in found["liggghts"] and "soft-ring" in found["emulator"]
    assert found_engines(COMMAND)["liggghts"].identity == "LIGGGHTS 3.8.0"


def test_an_engine_of_ones_own_is_named_by_where_it_stands() -> None:
    assert kind_of("calstudy.emulator.engine:EMULATOR") is kind_of("emulator")
    for name in ("calstudy.no_such:ENGINE", "calstudy.plan:NO_SUCH", ":"):
        with pytest.raises(InputError, match=r"cannot be loaded .*; write package.module:name"):
            open_engine(name)
    with pytest.raises(InputError, match="choose one of liggghts, lammps, yade, emulator"):
        open_engine("edem")


def test_a_planned_engine_needs_no_program_and_studies_tell_whose_they_are() -> None:
    planned = planned_engine(load_model(FIXED, "tiny"))
    assert planned.identity == f"LIGGGHTS {LIGGGHTS.proven_version}"
    assert planned.expected_seconds == open_engine("liggghts", fidelity="tiny").expected_seconds
    assert program_that_made("LIGGGHTS 2.0.1") == "liggghts"
    assert program_that_made(open_engine("emulator").identity) is None


def test_the_plan_runs_on_an_engine_of_ones_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["plan", "run", "--engine", "test_choose:OWN", "--rows", "1", "--study", str(tmp_path / "study")]
    assert main([*argv, "--dry-run"]) == 0
    assert main([*argv, "--mode", "robust", "--json"]) in (0, MISSED)
    assert ClosedForm.identity in capsys.readouterr().out
    assert main([*argv, "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "is not an external program" in capsys.readouterr().err


OTHER_PROGRAM = """#!/bin/sh
if [ "$1" = --version ]; then echo "Other 1.2"; exit; fi
if [ "$6" = 0.3 ]; then echo "FATAL no mesh in $2" > "$3"; exit 3; fi
echo "angle $6" > "$3"
echo "all done" >> "$3"
"""
OTHER = ProgramKind(
    Profile(
        name="OTHER",
        command="./other",
        variable="CALSTUDY_OTHER",
        option="--other",
        how_to_install="build it",
        banner=re.compile(r"Other (\S+)"),
        called="Other",
        call=("run", "{script}", "{log}"),
        log="other.log",
        question=("--version",),
        error="FATAL",
    )
)
MODEL = """
program = "test_choose:OTHER"
script = "heap.txt"
finished = "all done"
expected_seconds = 1
[parameters]
MU = "-"
[particles]
radius = 0.001
poissons_ratio = 0.3
density = 2500
youngs_modulus = 5e6
[responses.angle]
unit = "deg"
log = "angle"
"""


@pytest.fixture
def other_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "other"
    path.write_text(OTHER_PROGRAM)
    path.chmod(0o755)
    monkeypatch.setenv("CALSTUDY_OTHER", str(path))
    return path


def own_model(folder: Path, text: str = MODEL) -> FolderModel:
    folder.mkdir()
    (folder / "heap.txt").write_text("heap with ${MU}")
    (folder / "model.toml").write_text(text)
    return load_folder(folder)


def test_another_program_is_a_profile_and_nothing_more(other_program: Path, tmp_path: Path) -> None:
    engine = OTHER.open(own_model(tmp_path / "heap"))
    assert engine.identity == "OTHER 1.2"
    found = engine.run({"MU": 0.3}, 1, tmp_path / "run", threading.Event())
    assert found.outcome is Outcome.FAILED
    assert found.reason == "OTHER ended with exit code 3; other.log ends: FATAL no mesh in heap.txt"
    with pytest.raises(
        SetupError, match=r"OTHER was not found as .*; build it or point to it with --other PATH"
    ):
        OTHER.profile.find("/no/such/other")


def test_each_model_is_run_by_its_own_program_and_read_in_its_log(
    other_program: Path, tmp_path: Path
) -> None:
    models = [(own_model(tmp_path / "heap"), "a_"), (load_model(FIXED, "tiny"), "b_")]
    engines, executor = engines_and_executor(models, threading.Event(), workers=1)
    assert [engine.identity for engine in engines] == ["OTHER 1.2", "LIGGGHTS 3.8.0"]
    assert executor.slots == 1
    found = engines[0].run({"MU": 0.25}, 1, tmp_path / "run", threading.Event())
    assert found.responses["a_angle"] == 0.25 and found.outcome is Outcome.OK
    assert planned_engine(models[0][0]).identity.startswith("OTHER")


def test_a_folder_of_another_program_is_calibrated(other_program: Path, tmp_path: Path) -> None:
    own_model(tmp_path / "heap")
    file = tmp_path / "one.toml"
    file.write_text(
        'mode = "robust"\nseed = 1\nWRL = 0\n[[models]]\nname = "heap"\n[parameters]\nMU = [0.1, 0.29]\n'
        "[targets]\nangle = { value = 0.2, tolerance = 0.01 }\n"
    )
    found = calibrate_file(file, tmp_path / "study", Running(workers=2))
    assert found.optimum["MU"] == pytest.approx(0.2, abs=0.01)
    assert found.settings.engine == "OTHER 1.2"


def test_simulate_and_sweep_run_a_folder_by_its_own_program(
    other_program: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "heap"
    own_model(folder)
    assert main(["simulate", "--model", str(folder), "--set", "MU=0.25", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["angle"] == 0.25
    (tmp_path / "design.csv").write_text("label,seed,MU\none,1,0.2\n")
    out = str(tmp_path / "runs")
    assert main(["sweep", str(tmp_path / "design.csv"), "--model", str(folder), "--out", out]) == 0
    assert list(pd.read_parquet(out)["engine"]) == ["OTHER 1.2"]


def test_a_program_that_is_none_is_refused_with_its_line(tmp_path: Path) -> None:
    for name, said in (("lammpsy", "engine 'lammpsy' is unknown"), ("emulator", "not an external program")):
        with pytest.raises(InputError, match=f"model.toml, line 2: .*{said}"):
            own_model(tmp_path / name, MODEL.replace("test_choose:OTHER", name))


def test_the_program_is_no_part_of_a_models_hash_for_it_is_one_of_the_engines_identity(
    tmp_path: Path,
) -> None:
    default = own_model(tmp_path / "heap", MODEL.replace('program = "test_choose:OTHER"', ""))
    named = own_model(tmp_path / "same", MODEL.replace("test_choose:OTHER", "liggghts"))
    assert default.program == named.program == "liggghts" and default.hash == named.hash
