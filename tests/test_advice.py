"""What tests would tell is foretold from emulators, given what the file has; what is not known is said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calstudy.cli.main import main
from calstudy.emulator.advice import advice, foretold
from calstudy.emulator.advice.advice import Advice, advise, question_of
from calstudy.emulator.advice.emulated import corners_of
from calstudy.emulator.advice.foretold import Now, Runs, foretell
from calstudy.emulator.advice.laboratory import NOT_COUNTED, USUAL
from calstudy.emulator.design import Choice, emulator_design
from calstudy.emulator.emulator import Emulator, fit_emulator, write_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import shipped_model
from calstudy.models.find import declaration
from calstudy.models.folder.content import files_of
from calstudy.study.definition import Definition, read_definition
from shipped_model import SIMILARITY
from synthetic_runs import EXPENSIVE, PLAN, synthetic_runs

HEAP = "angle_of_repose"
FILE = """\
mode = "robust"
seed = 1
WRL = 0
[[models]]
name = "angle_of_repose"
fidelity = "coarse"
[parameters]
DENS = [2400.0, 2600.0]
MU_PP = [0.1, 0.3]
MU_PW = 0.2
RF_PP = [0.001, 0.1]
RF_PW = 0.01
YM = 5e8
[targets]
angle_of_repose_deg = { value = 27.0, sd = 0.5 }
"""
ALONE = ((HEAP, "bulk_density"),)


@pytest.fixture(scope="module")
def emulator() -> Emulator:
    choice = Choice(EXPENSIVE, EXPENSIVE, "ring", 1)
    runs = synthetic_runs(emulator_design(PLAN.parameters, choice, 24, SIMILARITY))
    return fit_emulator(runs, PLAN.parameters, SIMILARITY)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foretold, "POINTS", 512)
    monkeypatch.setattr(foretold, "FIRST", 1024)


def written(tmp_path: Path, *changes: tuple[str, str]) -> Definition:
    text = FILE
    for old, new in changes:
        text = text.replace(old, new)
    (tmp_path / "mine.toml").write_text(text)
    return read_definition(tmp_path / "mine.toml")


def test_what_is_a_target_is_no_candidate_and_its_test_costs_nothing_more(tmp_path, emulator):
    question = question_of(written(tmp_path), None, {HEAP: emulator}, {})
    assert question.candidates == {HEAP: ("bulk_density",)}
    assert question.hours(ALONE) == 0.0
    assert replace(question, there={}).hours(ALONE) == pytest.approx(question.procedure.runs.total * 9 / 3600)


def test_the_files_error_counts_and_else_the_given_or_the_usual_one(tmp_path, emulator):
    test = question_of(written(tmp_path), None, {HEAP: emulator}, {}).tests[HEAP]
    mean = float(emulator.runs["bulk_density"].mean())
    assert test.errors == {"angle_of_repose_deg": 0.5, "bulk_density": pytest.approx(0.005 * mean)}
    given = question_of(written(tmp_path), None, {HEAP: emulator}, {(HEAP, "bulk_density"): 3.0}).tests[HEAP]
    assert given.errors["bulk_density"] == 3.0


def test_a_test_answers_as_the_emulator_does_in_the_place_of_the_program(tmp_path, emulator):
    question = question_of(written(tmp_path), None, {HEAP: emulator}, {})
    space, test = question.procedure.space, question.tests[HEAP]
    point = space.box.from_unit(np.array([0.2, 0.7, 0.4]))
    there = EmulatorEngine(shipped_model("coarse"), emulator).twin(space.complete(point)).values
    assert test.means(space, point[None])[0][0] == pytest.approx([there[name] for name in test.responses])


@pytest.mark.slow
def test_a_density_tells_of_the_beads_density_and_the_same_question_has_the_same_answer(
    tmp_path, emulator, small
):
    question = question_of(written(tmp_path), None, {HEAP: emulator}, {})
    found = Advice(question, foretell(question.procedure, question.now, question.tests, [ALONE], simulated=2))
    line = found.tests_table().iloc[0]
    assert line["left_DENS"] < 0.7 < line["left_RF_PP"] and "DENS" in line["told"]
    assert line["volume"] == pytest.approx(np.exp(-line["nats"])) and line["volume"] < 0.8
    again = foretell(question.procedure, question.now, question.tests, [ALONE], simulated=1)
    assert again.now[0] == pytest.approx(found.foretold.now[0], rel=1e-9)
    assert again.after[ALONE].covariance == pytest.approx(found.foretold.after[ALONE].covariance[:16])


def test_what_is_known_by_a_study_is_taken_from_it(tmp_path, emulator, small):
    question = question_of(written(tmp_path), None, {HEAP: emulator}, {})
    space = question.procedure.space
    unit = np.random.default_rng(0).random((600, 3)) * [0.02, 1.0, 1.0]  # DENS is known already
    now = Now(points=space.box.from_unit(unit))
    found = foretell(question.procedure, now, question.tests, [ALONE], simulated=2)
    assert np.sqrt(found.now[:, 0, 0]).max() < 0.01
    assert found.left(ALONE)[0] > 0.9


@pytest.mark.slow
def test_more_runs_tell_more(tmp_path, emulator, small):
    question = question_of(written(tmp_path), None, {HEAP: emulator}, {(HEAP, "bulk_density"): 1.0})
    nats = []
    for runs in (Runs(7, 1, 0), Runs(40, 10, 10)):
        procedure = replace(question.procedure, runs=runs)
        found = foretell(procedure, Now(), question.tests, [ALONE], simulated=2)
        nats.append(found.after[ALONE].information.mean())
    assert nats[1] > nats[0] + 0.3


def test_a_box_that_an_emulator_does_not_know_is_said(tmp_path, emulator):
    wide = written(tmp_path, ("MU_PP = [0.1, 0.3]", "MU_PP = [0.1, 0.6]"))
    test = question_of(written(tmp_path), None, {HEAP: emulator}, {}).tests[HEAP]
    with pytest.raises(InputError, match=r"MU_PP goes from 0.1 to 0.6, its emulator from 0.1 to 0.3"):
        test.require_covered(wide.task.space, corners_of(wide.task.space))
    with pytest.raises(InputError, match=r"no emulator knows angle_of_repose.*MU_PP goes from 0.1 to 0.6"):
        question_of(wide, None, {HEAP: emulator}, {})


def test_another_fidelity_of_the_test_is_said(tmp_path, emulator):
    soft = written(tmp_path, ('"coarse"', '"soft"'))
    notes = question_of(soft, None, {HEAP: emulator}, {}).notes
    assert len(notes) == 1 and "another fidelity, material or version" in notes[0]
    assert question_of(written(tmp_path), None, {HEAP: emulator}, {}).notes == ()


def test_without_a_candidate_there_is_no_advice(tmp_path, emulator):
    both = written(tmp_path, ("sd = 0.5 }\n", "sd = 0.5 }\nbulk_density = { value = 1500.0, sd = 7.0 }\n"))
    with pytest.raises(InputError, match="no test is left"):
        advise(question_of(both, None, {HEAP: emulator}, {}))
    with pytest.raises(InputError, match="no emulator of any test"):
        question_of(None, None, {}, {})
    with pytest.raises(InputError, match="interval of DENS for itself"):
        question_of(None, None, {HEAP: emulator}, {})


def test_every_usual_error_is_of_a_response_that_there_is_and_has_its_reason():
    for (name, response), usual in USUAL.items():
        assert response in {r.name for r in declaration(name).responses}
        assert usual.reason and (usual.sd > 0) != (usual.share > 0)
    for name in {test for test, _ in USUAL}:
        counted = {r for t, r in [*USUAL, *NOT_COUNTED] if t == name}
        assert counted == {r.name for r in declaration(name).responses}


def test_a_models_emulators_are_no_part_of_it(tmp_path, emulator):
    (tmp_path / "in.model").write_text("run 1\n")
    before = files_of(tmp_path)
    write_emulator(tmp_path / "emulators" / "coarse", emulator)
    assert files_of(tmp_path) == before


@pytest.mark.parametrize(
    ("error", "line"),
    [
        ("heap.bulk_density=3", "use TEST.RESPONSE=SD"),
        (f"{HEAP}.bulk=3", "has no response bulk"),
        (f"{HEAP}.bulk_density=0", "an error is above 0"),
        (f"{HEAP}.bulk_density=x", "--error"),
    ],
)
def test_a_mistaken_error_is_refused_in_one_line(error, line, tmp_path, emulator, capsys):
    written(tmp_path)
    write_emulator(tmp_path / "emulator", emulator)
    command = ["advise", str(tmp_path / "mine.toml"), "--emulator", str(tmp_path / "emulator")]
    assert main([*command, "--error", error, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert line in said and said.count("\n") == 1 and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "option", [("--error", "shear_cell.cohesion=-1"), ("--error", "shear_cell=1"), ("--tests", "drum")]
)
def test_a_mistaken_option_is_refused_before_any_shipped_emulator_is_read(option, monkeypatch, capsys):
    read = []
    monkeypatch.setattr(advice, "read_emulator", read.append)
    assert main(["advise", *option]) == 2
    assert option[0] in capsys.readouterr().err and not read
