"""``--model``: every command that runs a DEM model takes any model's folder, with its own responses."""

import json
import shlex
import shutil
import sys
import threading
from pathlib import Path

import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.emulator.emulator import read_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.errors import MISSED, InputError
from calstudy.models.folder import load_folder
from calstudy.models.heap import REFERENCE
from calstudy.plan_file import load_plan
from calstudy.study.reading import read_study
from calstudy.study.run.rows import run_plan

PROGRAM = """
import sys
words = sys.argv[1:]
if words == ["-help"]:
    print("LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled)")
    raise SystemExit
values = {words[k + 1]: float(words[k + 2]) for k, word in enumerate(words) if word == "-var"}
noise = (values["SEED"] % 1009 - 504) / 1009
with open("log.liggghts", "w") as log:
    log.write(f"shear_stress = {values['DENS'] * (1 + values['MU'] + 0.01 * noise)}\\n")
    log.write(f"wall_angle = {10 + 20 * values['MU'] * values['MU'] + 0.1 * noise}\\n")
"""
MODEL = """
script = "in.shear"
expected_seconds = 1
seeds = ["SEED"]
[parameters]
DENS = "kg/m3"
MU = "-"
[particles]
radius = 0.002
poissons_ratio = 0.3
density = "DENS"
youngs_modulus = 5e6
[responses.shear_stress]
unit = "Pa"
log = "shear_stress ="
proportional_to = "DENS"
[responses.wall_angle]
unit = "deg"
log = "wall_angle ="
"""
SET = ("--set", "DENS=2000", "--set", "MU=0.5")
INTERVALS = ("--interval", "DENS=1000:3000", "--interval", "MU=0.1:0.9")


def write_model(directory):
    """A model's folder in a directory; returns the command of the program that runs it."""
    (directory / "program.py").write_text(PROGRAM)
    folder = directory / "shear_cell"
    folder.mkdir()
    (folder / "in.shear").write_text("run ${DENS} ${MU} ${SEED}\n")
    (folder / "model.toml").write_text(MODEL)
    return f"{shlex.quote(sys.executable)} -S {shlex.quote(str(directory / 'program.py'))}"


@pytest.fixture(autouse=True)
def shear_cell(tmp_path, monkeypatch, coarse_profiles):
    """A model's folder in the working directory, and the program that runs it."""
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", write_model(tmp_path))
    monkeypatch.chdir(tmp_path)


def run(capsys, *argv):
    code = main(list(argv))
    said = capsys.readouterr()
    assert code == 0, said.err
    return said.out


def refused(capsys, *argv):
    assert main(list(argv)) == 2
    return capsys.readouterr().err


def test_a_folder_is_simulated_with_its_own_responses(capsys):
    found = json.loads(run(capsys, "simulate", "--model", "shear_cell", *SET, "--json"))
    assert found["shear_stress"] == pytest.approx(3000, rel=0.01)
    assert found["wall_angle"] == pytest.approx(15, abs=0.1)
    assert (found["DENS"], found["MU"], found["fidelity"], found["outcome"]) == (2000, 0.5, "", "ok")
    table = run(capsys, "simulate", "--model", "shear_cell", *SET)
    assert "shear_stress" in table and "bulk_density" not in table and "beads" not in table
    several = json.loads(run(capsys, "simulate", "--model", "shear_cell", *SET, "--seeds", "3", "--json"))
    assert several["wall_angle_sd"] > 0 and several["replicates"] == 3


def test_the_name_that_the_option_had_before_works_and_says_the_new_one(capsys):
    assert main(["simulate", "--model", "shear_cell", *SET, "--replicates", "2", "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["replicates"] == 2 and "--replicates is now called --seeds" in said.err
    with pytest.raises(SystemExit):
        main(["simulate", "--help"])
    assert "--replicates" not in capsys.readouterr().out


def test_what_a_run_of_a_folder_leaves_is_kept(capsys, tmp_path):
    run(capsys, "simulate", "--model", "shear_cell", *SET, "--out", "kept")
    assert {"in.shear", "log.liggghts", "output.txt"} <= {p.name for p in (tmp_path / "kept").iterdir()}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--model", "shear_sell", *SET), "there is no model shear_sell"),
        (("--model", "no/such/folder", *SET), "not a path such as 'no/such/folder'"),
        (("--model", "shear_cell", "--set", "MU=0.5"), "set DENS with --set, too"),
        (("--model", "shear_cell", *SET, "--set", "MU_PP=0.5"), "--set MU_PP=0.5: use NAME=VALUE"),
        (
            ("--model", "shear_cell", *SET, "--fidelity", "soft"),
            "fidelity soft is unknown to the model shear_cell; it has none, so leave it out",
        ),
        (
            ("--model", "shear_cell", *SET, "--variant", "ring"),
            "--variant ring: the model shear_cell has none",
        ),
        (("--model", "shear_cell", *SET, "--set", "DENS=2.5"), "it looks like g/cm3: write 2500"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_a_folder_does_not_have_is_refused(capsys, options, said):
    assert said in refused(capsys, "simulate", *options)


def test_a_twin_of_a_folder_has_its_own_columns(capsys):
    for _ in range(2):  # the second takes the first one's place
        run(capsys, "twin", "--model", "shear_cell", *SET, "--seeds", "2", "--out", "twins.csv")
    (line,) = pd.read_csv("twins.csv").to_dict("records")
    assert (line["DENS"], line["MU"], line["replicates"]) == (2000, 0.5, 2)
    assert line["shear_stress"] == pytest.approx(3000, rel=0.01) and line["wall_angle_sd"] > 0
    assert "--model shear_cell" in line["command"] and "--fidelity" not in line["command"]


def test_the_shipped_model_is_the_default_and_goes_by_its_name(capsys, monkeypatch):
    from fake_liggghts import COMMAND

    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    by_name, unnamed = (
        json.loads(run(capsys, "simulate", *named, "--json"))
        for named in (("--model", "angle_of_repose"), ())
    )
    assert by_name["model_hash"] == unnamed["model_hash"] and unnamed["fidelity"] == "coarse"
    assert unnamed["variant"] == "ring" and {name: unnamed[name] for name in REFERENCE} == REFERENCE


# ---- sweep and emulator ------------------------------------------------------------------------------


def test_an_option_without_a_value_works_by_its_former_name_too(capsys, tmp_path):
    (tmp_path / "design.csv").write_text("label,seed,DENS,MU\na,1,2000,0.5\n")
    assert main(["sweep", "design.csv", "--model", "shear_cell", "--out", "runs", "--keep-heaps"]) == 0
    assert "--keep-heaps is now called --keep-beads" in capsys.readouterr().err
    assert (tmp_path / "runs" / "heaps.parquet").is_file()


def test_a_design_of_a_folder_has_its_own_columns(capsys, tmp_path):
    (tmp_path / "design.csv").write_text("label,seed,DENS,MU\na,1,2000,0.5\nb,2,1500,0.2\n")
    for _ in range(2):  # the second finds all runs done
        run(capsys, "sweep", "design.csv", "--model", "shear_cell", "--out", "runs")
    runs = pd.read_parquet("runs/runs.parquet")
    assert list(runs["label"]) == ["a", "b"] and set(runs["outcome"]) == {"ok"}
    assert "bulk_density" not in runs and list(runs["fidelity"]) == ["", ""]
    assert runs["shear_stress"].to_numpy() == pytest.approx([3000, 1800], rel=0.02)


@pytest.mark.parametrize(
    ("design", "said"),
    [
        ("label,fidelity,variant,seed,DENS,MU\n", "the columns must be label,seed,DENS,MU"),
        ("label,seed,DENS,MU\na,1,2.5,0.5\n", "line 2: DENS is 2.5"),
        ("label,seed,DENS,MU\na,1,2500\n", "line 2: has 3 cells; write 4"),
    ],
    ids=["columns", "implausible", "cells"],
)
def test_a_design_that_is_not_the_folders_is_refused(capsys, tmp_path, design, said):
    (tmp_path / "design.csv").write_text(design)
    assert said in refused(capsys, "sweep", "design.csv", "--model", "shear_cell", "--out", "runs")


def test_an_emulator_of_a_folder_answers_what_its_runs_say(capsys, tmp_path):
    sample = ("emulator", "sample", "--model", "shear_cell", *INTERVALS)
    run(capsys, *sample, "--points", "20", "--out", "runs")
    run(capsys, *sample, "--fresh", "6", "--seed", "2", "--out", "fresh")
    run(capsys, "emulator", "fit", "runs", "--model", "shear_cell", *INTERVALS, "--out", "emulator")
    emulator = read_emulator(tmp_path / "emulator")
    assert [r.name for r in emulator.responses] == ["shear_stress/DENS", "wall_angle"]
    answers = emulator.means()
    for mu in (0.2, 0.5, 0.8):
        point = emulator.point({"DENS": 2000.0, "MU": mu})
        values = [float(answers[name].noise_free(point)[0]) for name in answers]
        assert values == pytest.approx([1 + mu, 10 + 20 * mu * mu], rel=0.02)
    options = ("--fresh", "fresh", "--folds", "3", "--out", "figure.png", "--json")
    found = json.loads(run(capsys, "emulator", "validate", "emulator", *options))
    assert [of["response"] for of in found["fresh"]] == ["shear_stress/DENS", "wall_angle"]
    assert (tmp_path / "figure.png").stat().st_size > 0
    said = run(capsys, "emulator", "fit", "runs", "--model", "shear_cell", "--out", "by_range")
    assert "shear_cell, from 22 runs" in said and "at the centre of the box" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "give the interval of DENS, MU with --interval"),
        (("--interval", "DENS=1:2"), "give the interval of MU"),
        ((*INTERVALS, "--interval", "NU=1:2"), "--interval NU=1:2: use NAME=LOW:HIGH"),
        (("--interval", "MU=2:1"), "write the smaller end first"),
        ((*INTERVALS, "--reference", "full"), "--reference full: the model shear_cell has none"),
    ],
    ids=["none", "one", "unknown", "downwards", "reference"],
)
def test_a_sample_of_a_folder_needs_its_intervals(capsys, options, said):
    argv = ("emulator", "sample", "--model", "shear_cell", *options, "--out", "runs")
    assert said in refused(capsys, *argv)


# ---- an emulator of a folder in LIGGGHTS's place -----------------------------------------------------


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """An emulator of the model's folder."""
    directory = tmp_path_factory.mktemp("fitted")
    with pytest.MonkeyPatch.context() as here:
        here.setenv("CALSTUDY_LIGGGHTS", write_model(directory))
        here.chdir(directory)
        of = ("--model", "shear_cell", *INTERVALS)
        assert main(["emulator", "sample", *of, "--points", "20", "--out", "runs"]) == 0
        assert main(["emulator", "fit", "runs", *of, "--out", "emulator"]) == 0
    return directory / "emulator"


@pytest.fixture
def emulated(fitted, tmp_path):
    """The model's folder, and an emulator of it."""
    shutil.copytree(fitted, tmp_path / "emulator")
    return load_folder(tmp_path / "shear_cell"), read_emulator(tmp_path / "emulator")


def answer(engine, parameters, seed=1):
    return engine.run(parameters, seed, Path(), threading.Event())


def test_the_engine_answers_with_the_folders_own_responses(emulated):
    engine = EmulatorEngine(*emulated, rounded=True, prefix="cell_")
    found = answer(engine, {"DENS": 2000.0, "MU": 0.5})
    assert found.usable
    assert set(found.responses) == {"cell_shear_stress", "cell_wall_angle", "rayleigh_time_step"}
    assert found.responses["cell_shear_stress"] == pytest.approx(3000, rel=0.02)
    assert found.responses["cell_wall_angle"] == pytest.approx(15, rel=0.02)
    assert found.responses == answer(engine, {"DENS": 2000.0, "MU": 0.5}).responses
    twin = EmulatorEngine(*emulated).twin({"DENS": 2000.0, "MU": 0.5})
    assert list(twin.values) == ["shear_stress", "wall_angle"] and " Pa and " in twin.origin


def test_an_answer_has_eight_digits_of_the_responses_mean(emulated):
    mean = emulated[1].responses[1].process.members[0].centre
    assert 10 < mean < 100  # deg, so six decimals are left
    rounded, plain = (EmulatorEngine(*emulated, rounded=r) for r in (True, False))
    angles = [answer(e, {"DENS": 2000.0, "MU": 0.5}).responses["wall_angle"] for e in (rounded, plain)]
    assert angles[0] == round(angles[1], 6) != angles[1]


def test_a_calibration_runs_on_an_emulator_without_the_program(emulated, capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", "no-such-program")
    (tmp_path / "calibration.toml").write_text(CALIBRATION.format(WRL=0))
    calibrate = ("calibrate", "calibration.toml", "--models", ".", "--emulator", "emulator", "--json")
    assert json.loads(run(capsys, *calibrate, "--dry-run"))["core_hours_expected"] == 0
    found = json.loads(run(capsys, *calibrate))
    assert found["dem_MU"] == pytest.approx(0.5, abs=0.02)
    assert found["engine"] == f"emulator {emulated[1].version}"
    again = json.loads(run(capsys, *calibrate, "--study", "again"))
    assert {n: again[n] for n in found if n.startswith("dem_")} == {
        n: found[n] for n in found if n.startswith("dem_")
    }


HEAP_LIKE = """
script = "in.pile"
seeds = ["SEED"]
expected_seconds = 1
[parameters]
DENS = "kg/m3"
MU_PP = "-"
MU_PW = "-"
RF_PP = "-"
RF_PW = "-"
YM = "Pa"
[responses.bulk_density]
unit = "kg/m3"
log = "density ="
proportional_to = "DENS"
[responses.angle_of_repose_deg]
unit = "deg"
log = "angle ="
[responses.height]
unit = "m"
log = "height ="
"""
PILE = """
import sys
words = sys.argv[1:]
if words == ["-help"]:
    print("LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled)")
    raise SystemExit
v = {words[k + 1]: float(words[k + 2]) for k, word in enumerate(words) if word == "-var"}
noise = 1 + 0.002 * ((v["SEED"] % 1009 - 504) / 1009)
with open("log.liggghts", "w") as log:
    log.write(f"density = {v['DENS'] * (0.62 - 0.1 * v['MU_PP']) * noise}\\n")
    log.write(f"angle = {(12 + 40 * v['MU_PP'] + 30 * v['RF_PP'] + 10 * v['MU_PW']) * noise}\\n")
    log.write(f"height = {0.1 * v['MU_PP'] * noise}\\n")
"""


@pytest.fixture
def pile(tmp_path):
    """Make a model with the plan's parameters and responses in the working directory."""
    (tmp_path / "program.py").write_text(PILE)
    (tmp_path / "pile").mkdir()
    (tmp_path / "pile" / "in.pile").write_text(
        "run ${DENS} ${MU_PP} ${MU_PW} ${RF_PP} ${RF_PW} ${YM} ${SEED}\n"
    )
    (tmp_path / "pile" / "model.toml").write_text(HEAP_LIKE)


def test_rows_of_the_plan_run_on_a_model_of_ones_own_to_its_own_twin(pile, capsys, tmp_path):
    settings = [f"--set={name}={value}" for name, value in REFERENCE.items()]
    run(capsys, "twin", "--model", "pile", *settings, "--seeds", "2", "--out", "twins.csv")
    argv = ("plan", "run", "--model", "pile", "--rows", "1", "--target", "twin:twins.csv")
    assert "of pile in studies/pile-paper-1" in run(capsys, *argv, "--dry-run")
    assert main([*argv, "--json"]) in (0, MISSED)
    (line,) = json.loads(capsys.readouterr().out)
    assert (line["model"], line["fidelity"], line["outcome"]) == ("pile", "", "ok")
    assert line["dem_bulk_density"] == pytest.approx(1500, rel=0.01)
    assert read_study(Path("studies/pile-paper-1")).settings.target.truth == dict(REFERENCE)
    assert main([*argv[:-1], "paper", "--study", "other"]) in (0, MISSED)
    shown = capsys.readouterr().out
    assert "bulk_density" in shown and "height" not in shown  # which is no target of the paper's
    assert "pile, paper mode" in " ".join(shown.split())
    said = refused(capsys, "plan", "rerun", "studies/pile-paper-1", "--rows", "1")
    assert "its model pile is not a shipped one; run the rows again with 'calstudy plan run" in said


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--model", "draw_down"), "draw_down has no angle_of_repose_deg, which the plan needs"),
        (("--model", "pile", "--variant", "wide"), "--variant wide: the model pile has none"),
        (
            ("--model", "pile", "--engine", "emulator"),
            "no emulator of it is shipped; name one with --emulator",
        ),
    ],
)
def test_rows_that_a_model_cannot_be_calibrated_for_are_refused(pile, capsys, options, said):
    assert said in refused(capsys, "plan", "run", *options)


def test_a_plan_runs_on_an_emulator_of_ones_own_model(pile, capsys, tmp_path):
    plan = load_plan()
    of = ("--model", "pile", *(f"--interval={p.name}={p.lower}:{p.upper}" for p in plan.parameters))
    run(capsys, "emulator", "sample", *of, "--points", "24", "--out", "runs")
    run(capsys, "emulator", "fit", "runs", *of, "--out", "pile_emulator")
    engine = EmulatorEngine(load_folder(tmp_path / "pile"), read_emulator(tmp_path / "pile_emulator"))
    study = run_plan(plan, engine, [1], tmp_path / "study")
    assert study.settings.quantities.measured == {
        "bulk_density": "kg/m3",
        "angle_of_repose_deg": "deg",
        "height": "m",
    }
    assert list(study.ok["row"]) == [1] and study.evaluations["height"].notna().all()
    assert read_study(tmp_path / "study").settings == study.settings


def test_a_plan_needs_its_parameters_and_responses(emulated, tmp_path):
    with pytest.raises(InputError, match="shear_cell has no MU_PP, which the plan needs"):
        run_plan(load_plan(), EmulatorEngine(*emulated), [1], tmp_path / "study")


def test_an_emulator_of_no_model_of_the_calibration_is_refused(emulated, capsys, tmp_path):
    (tmp_path / "calibration.toml").write_text(CALIBRATION.format(WRL=0))
    with (tmp_path / "shear_cell" / "in.shear").open("a") as script:
        script.write("# another version\n")
    said = refused(capsys, "calibrate", "calibration.toml", "--models", ".", "--emulator", "emulator")
    assert "emulator: is an emulator of shear_cell, not of shear_cell as it is here" in said


def test_an_emulator_of_another_model_is_refused(emulated, tmp_path):
    (tmp_path / "shear_cell").rename(tmp_path / "other_cell")
    with pytest.raises(InputError, match="is of shear_cell, not of other_cell"):
        EmulatorEngine(load_folder(tmp_path / "other_cell"), emulated[1])


def test_a_parameter_that_stays_constant_is_no_input(capsys, tmp_path):
    constant = ("--interval", "DENS=2000", "--interval", "MU=0.1:0.9")
    sample = ("emulator", "sample", "--model", "shear_cell", *constant)
    run(capsys, *sample, "--points", "16", "--out", "runs")
    for name, options in (("given", constant), ("by_range", ())):
        run(capsys, "emulator", "fit", "runs", "--model", "shear_cell", *options, "--out", name)
        emulator = read_emulator(tmp_path / name)
        assert emulator.box.names == ("MU",) and emulator.similarity.constants == (("DENS", 2000.0),)
    engine = EmulatorEngine(load_folder(tmp_path / "shear_cell"), emulator)
    found = answer(engine, {"DENS": 2000.0, "MU": 0.5})
    assert found.responses["shear_stress"] == pytest.approx(3000, rel=0.02)
    with pytest.raises(InputError, match="DENS is 2500, but it was 2000 in all runs of the emulator"):
        answer(engine, {"DENS": 2500.0, "MU": 0.5})
    everything = ("--interval", "DENS=2000", "--interval", "MU=0.5")
    said = refused(capsys, "emulator", "sample", "--model", "shear_cell", *everything, "--out", "none")
    assert "no parameter of shear_cell varies" in said


# ---- what a folder declares --------------------------------------------------------------------------


def declares(folder, text):
    content = MODEL.replace('MU = "-"', 'MU = "-"\nYM = "Pa"')
    (folder / "model.toml").write_text(f"{text}\n{content}")
    (folder / "in.shear").write_text("run ${DENS} ${MU} ${YM} ${SEED}\n")


def test_a_declared_ratio_takes_the_place_of_its_two_parameters_and_can_be_checked(capsys, tmp_path):
    declares(tmp_path / "shear_cell", "ratio = ['YM', 'DENS']")
    more = ("--model", "shear_cell", *INTERVALS, "--interval", "YM=1e7:1e8")
    run(capsys, "emulator", "sample", *more, "--points", "20", "--out", "runs")
    run(capsys, "emulator", "fit", "runs", *more, "--out", "emulator")
    assert read_emulator(tmp_path / "emulator").box.names == ("MU", "YM/DENS")
    check = ("emulator", "similarity", *more, "--seeds", "2", "--out", "check", "--json")
    lines = json.loads(run(capsys, *check))
    assert [line["response"] for line in lines] == ["shear_stress/DENS", "wall_angle"]
    assert [line["doubled"] for line in lines] == pytest.approx([0, 0], abs=1e-9)
    assert all(abs(line["difference"]) < 0.01 for line in lines)


@pytest.mark.parametrize("ratio", ["['YM']", "['YM', 'YM']", "['YM', 'NU']"])
def test_a_ratio_of_other_than_two_parameters_is_refused(tmp_path, ratio):
    declares(tmp_path / "shear_cell", f"ratio = {ratio}")
    with pytest.raises(InputError, match="line 1: ratio: name two of the parameters"):
        load_folder(tmp_path / "shear_cell")


def test_a_model_without_a_ratio_has_none_to_check(capsys):
    said = refused(capsys, "emulator", "similarity", "--model", "shear_cell", *INTERVALS, "--out", "check")
    assert "declares no ratio" in said


def without_particles(folder):
    text = (folder / "model.toml").read_text()
    start, end = text.index("[particles]"), text.index("[responses.shear_stress]")
    (folder / "model.toml").write_text(text[:start] + text[end:])


CALIBRATION = """
mode = "robust"
seed = 1
WRL = {WRL}
[[models]]
name = "shear_cell"
[parameters]
DENS = 2000.0
MU = [0.1, 0.9]
[targets]
wall_angle = 15.0
"""


def test_particles_are_needed_for_the_time_step_alone(capsys, tmp_path):
    without_particles(tmp_path / "shear_cell")
    found = json.loads(run(capsys, "simulate", "--model", "shear_cell", *SET, "--json"))
    assert found["wall_angle"] == pytest.approx(15, abs=0.1) and found["rayleigh_time_step"] is None
    assert "rayleigh" not in run(capsys, "simulate", "--model", "shear_cell", *SET)
    (tmp_path / "calibration.toml").write_text(CALIBRATION.format(WRL=0))
    found = json.loads(run(capsys, "calibrate", "calibration.toml", "--models", ".", "--json"))
    assert found["dem_MU"] == pytest.approx(0.5, abs=0.02)


def test_a_weight_of_the_time_step_without_particles_is_refused(capsys, tmp_path):
    without_particles(tmp_path / "shear_cell")
    (tmp_path / "calibration.toml").write_text(CALIBRATION.format(WRL=0.5))
    said = refused(capsys, "calibrate", "calibration.toml", "--models", ".")
    assert "line 4: WRL is 0.5, but shear_cell has no [particles]" in said and "set WRL to 0" in said
