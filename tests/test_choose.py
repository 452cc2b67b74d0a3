"""The table of engines: what each line opens, what is found for it, and what a line of one's own is."""

import re
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from calstudy.cli.main import main
from calstudy.engines.choose import (
    ENGINES,
    ProgramKind,
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
from calstudy.models.heap import REFERENCE
from calstudy.plan_file import load_plan
from calstudy.records import Outcome
from closed_form import ClosedForm
from fake_liggghts import COMMAND

FIXED = load_plan().fixed
OWN = SimpleNamespace(open=lambda model, fidelity, variant: ClosedForm(), look=lambda: "always there")


@pytest.fixture(autouse=True)
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(LIGGGHTS.variable, COMMAND)


@pytest.mark.parametrize("name", ENGINES)
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
    assert found_engines({})["liggghts"].startswith("LIGGGHTS 3.8.0, ")
    monkeypatch.setenv(LIGGGHTS.variable, "/no/such/program")
    found = found_engines({})
    assert list(found) == list(ENGINES)
    assert "LIGGGHTS was not found" in found["liggghts"] and "soft-ring" in found["emulator"]
    assert found_engines({"liggghts": "known"})["liggghts"] == "known"


def test_an_engine_of_ones_own_is_named_by_where_it_stands() -> None:
    assert kind_of("calstudy.emulator.engine:EMULATOR") is kind_of("emulator")
    for name in ("calstudy.no_such:ENGINE", "calstudy.plan:NO_SUCH", ":"):
        with pytest.raises(InputError, match=r"cannot be loaded .*; write package.module:name"):
            open_engine(name)
    with pytest.raises(InputError, match="choose one of liggghts, emulator"):
        open_engine("lammps")


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
    assert "not an external program, which a cluster needs" in capsys.readouterr().err


OTHER = """#!/bin/sh
if [ "$1" = --version ]; then echo "Other 1.2"; exit; fi
echo "FATAL no mesh in $2" > "$3"
exit 3
"""


def test_another_program_is_a_profile_and_nothing_more(tmp_path: Path) -> None:
    path = tmp_path / "other"
    path.write_text(OTHER)
    path.chmod(0o755)
    other = Profile(
        name="OTHER",
        command=str(path),
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
    engine = ProgramKind(other).open(load_model(FIXED, "tiny"))
    assert engine.identity == "OTHER 1.2"
    found = engine.run(REFERENCE, 1, tmp_path / "run", threading.Event())
    assert found.outcome is Outcome.FAILED
    script = "in.angle_of_repose"
    assert found.reason == f"OTHER ended with exit code 3; other.log ends: FATAL no mesh in {script}"
    with pytest.raises(
        SetupError, match=r"OTHER was not found as .*; build it or point to it with --other PATH"
    ):
        other.find("/no/such/other")
