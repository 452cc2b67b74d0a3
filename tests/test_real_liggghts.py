"""The real LIGGGHTS at the smallest fidelity: what no stand-in can prove."""

import json
import math
import re
import shlex
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import calstudy as cs
from calstudy.cli.main import main
from calstudy.engines import engine as engine_module
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS, markers, read_dump
from calstudy.errors import SetupError, Stopped
from calstudy.models.angle_of_repose import load_model
from calstudy.models.folder import load_folder
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, REFERENCE
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome
from calstudy.study.definition import example
from calstudy.study.directory.store import read_table
from calstudy.study.settings import read_settings
from processes import runs

pytestmark = pytest.mark.liggghts

RADIUS = 0.005
MASS = REFERENCE["DENS"] * math.pi / 6 * (2 * RADIUS) ** 3


@pytest.fixture(scope="module")
def program():
    try:
        return LIGGGHTS.find()
    except SetupError as error:
        pytest.fail(f"these tests need the real LIGGGHTS: {error}", pytrace=False)


@pytest.fixture(scope="module")
def engine(program):
    return ProgramEngine(load_model(load_plan().fixed, "tiny"), program)


@pytest.fixture(scope="module")
def answers(engine, tmp_path_factory):
    """Three runs and their directories: seed 1, seed 1 again, seed 2."""
    root = tmp_path_factory.mktemp("runs")

    def answer(name, seed):
        run = engine.run(REFERENCE, seed, root / name, threading.Event())
        assert run.outcome is Outcome.OK, run.reason
        return SimpleNamespace(run=run, directory=root / name)

    with ThreadPoolExecutor(2) as pool:
        jobs = {name: pool.submit(answer, name, seed) for name, seed in (("a", 1), ("again", 1), ("b", 2))}
        return SimpleNamespace(**{name: job.result() for name, job in jobs.items()})


@pytest.fixture(scope="module")
def frames(answers):
    """Beads (n, 7) of both dumps of the first run."""
    return SimpleNamespace(
        filled=read_dump(answers.a.directory / "filled.dump"),
        heap=read_dump(answers.a.directory / "heap.dump"),
    )


def test_it_is_the_version_that_calstudy_was_proven_with(engine):
    assert engine.identity == f"LIGGGHTS {LIGGGHTS.proven_version}"


@pytest.mark.parametrize("command", ["doctor", "simulate --fidelity tiny"])
def test_a_command_leaves_the_users_own_log_as_it_was(
    command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.liggghts").write_text("of the user's own run")
    assert main(command.split()) == 0
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [
        ("log.liggghts", "of the user's own run")
    ]


def test_responses_are_plausible(answers):
    for answer in (answers.a, answers.b):
        assert answer.run.reason == ""
        assert 20 < answer.run.responses[ANGLE_OF_REPOSE] < 40
        assert 1350 < answer.run.responses[BULK_DENSITY] < 1600
        assert answer.run.responses[RAYLEIGH_TIME_STEP] == pytest.approx(2.98852e-5, rel=5e-6)
        assert 0.040 < answer.run.radius < 0.055
        assert 2 * RADIUS < answer.run.height < 0.050


def test_beads_are_conserved(answers):
    for answer in (answers.a, answers.b):
        beads = answer.run.beads
        assert beads.poured > beads.filled > beads.on_plate > 0
        assert beads.lost == beads.filled - beads.on_plate
        assert beads.on_plate == len(answer.run.positions)


def test_all_beads_that_were_asked_for_are_poured(engine, answers):
    assert answers.a.run.beads.poured == engine.model.fidelity.poured_beads


def test_every_bead_keeps_its_identity_from_the_filling_to_the_heap(frames):
    filled, heap = frames.filled[:, 0], frames.heap[:, 0]
    assert len(np.unique(filled)) == len(filled)
    assert set(heap) < set(filled)


def test_the_filling_lies_in_the_cylinder(frames):
    x, y, z = frames.filled[:, 1:4].T
    # The polygon of equal area reaches 0.6 % beyond the circle at its corners; soft beads overlap.
    assert np.hypot(x, y).max() < 0.05 * 1.006 - RADIUS + 0.1 * RADIUS
    assert z.min() > 0.9 * RADIUS
    assert z.max() < 0.05 + 0.1 * RADIUS


def test_bulk_density_agrees_with_the_volume_below_the_fill_height(answers, frames):
    below = np.count_nonzero(frames.filled[:, 3] < 0.05)
    volume = math.pi * 0.05**2 * 0.05
    assert answers.a.run.responses[BULK_DENSITY] == pytest.approx(below * MASS / volume, rel=0.005)
    # Sphere caps above the plane taken off one by one: what stays is the packing without the parts of the
    # removed beads that reached below it, a few percent.
    cap = np.clip(frames.filled[:, 3] + RADIUS - 0.05, 0, 2 * RADIUS)
    solid = len(cap) * 4 / 3 * math.pi * RADIUS**3 - (math.pi * cap**2 / 3 * (3 * RADIUS - cap)).sum()
    share = REFERENCE["DENS"] * solid / volume / answers.a.run.responses[BULK_DENSITY]
    assert 0.94 < share < 1.0


def test_the_heap_lies_on_the_plate(engine, frames):
    x, y, z = frames.heap[:, 1:4].T
    assert np.hypot(x, y).max() <= engine.model.variant.plate_radius * (1 + 1e-5)
    assert z.min() > 0.9 * RADIUS, "no bead has sunk into the plate by more than a tenth of its radius"
    assert z.min() < 1.01 * RADIUS, "the lowest bead lies on the plate"


def test_beads_overlap_little(frames):
    for frame in (frames.filled, frames.heap):
        gaps = np.linalg.norm(frame[:, None, 1:4] - frame[None, :, 1:4], axis=2)
        np.fill_diagonal(gaps, np.inf)
        assert gaps.min() > 0.95 * 2 * RADIUS


def test_the_heap_is_at_rest(engine, answers, frames):
    rest_energy = 0.5 * MASS * engine.model.schedule["rest_speed"] ** 2
    energy = 0.5 * MASS * (frames.heap[:, 4:7] ** 2).sum()
    assert energy < rest_energy
    assert float(markers(answers.a.directory / "log.liggghts")["kinetic_energy"]) < rest_energy
    # It ended because of that, and not by the limit.
    marks = markers(answers.a.directory / "log.liggghts")
    assert int(marks["lift_intervals"]) < engine.model.schedule["lift_intervals"]
    assert int(marks["settle_intervals"]) < engine.model.schedule["settle_intervals"]


def test_the_packing_stands_before_what_lies_above_the_fill_height_is_removed(answers):
    poured = read_dump(answers.a.directory / "poured.dump")
    assert len(poured) == answers.a.run.beads.poured
    assert math.sqrt((poured[:, 4:7] ** 2).sum(axis=1).mean()) < 0.010
    assert np.count_nonzero(poured[:, 3] < 0.05) == answers.a.run.beads.filled


def test_the_cylinder_was_raised_clear_of_the_heap(answers, frames):
    lifting = 0.05 * int(markers(answers.a.directory / "log.liggghts")["lift_intervals"])
    bottom = 0.006 + 0.8 * 2 * RADIUS + 0.010 * lifting
    assert bottom > frames.heap[:, 3].max() + RADIUS


def test_the_same_seed_gives_the_same_heap_bead_by_bead(answers):
    assert answers.a.run.responses == answers.again.run.responses
    np.testing.assert_array_equal(answers.a.run.positions, answers.again.run.positions)
    one, again = (Path(x.directory / "heap.dump").read_bytes() for x in (answers.a, answers.again))
    assert one == again


def test_another_seed_gives_another_heap(answers):
    one, other = answers.a.run.positions, answers.b.run.positions
    assert one.shape != other.shape or not np.allclose(one, other, atol=RADIUS / 10)


def test_an_error_of_liggghts_is_an_outcome_with_its_own_words(engine, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "calstudy.models.angle_of_repose.LEAST_ENGINE_STIFFNESS", 0.0
    )  # what is refused before is LIGGGHTS's
    too_soft = replace(engine.model, fidelity=replace(engine.model.fidelity, softening=200.0))
    run = ProgramEngine(too_soft, engine.program).run(REFERENCE, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.FAILED
    assert "exit code 1" in run.reason
    assert "ERROR" in run.reason
    assert "youngsModulus >= 5e6" in run.reason
    assert "\n" not in run.reason
    assert math.isnan(run.responses[BULK_DENSITY])


@pytest.mark.parametrize("share", [1.1, 3.0])
def test_a_run_that_explodes_is_a_failure_and_no_heap_is_made_of_what_is_left(engine, tmp_path, share):
    # Beads that overlap at all are thrown out of the box within a few such time-steps.
    unstable = replace(engine.model, fidelity=replace(engine.model.fidelity, time_step_share=share))
    run = ProgramEngine(unstable, engine.program).run(REFERENCE, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.FAILED
    assert "beads were left after pouring; the simulation exploded; log.liggghts ends: " in run.reason
    assert math.isnan(run.responses[BULK_DENSITY])


def wrapped(engine, folder, before):
    """The engine with LIGGGHTS behind a line of shell, which stays the same process."""
    script = folder / "liggghts"
    script.write_text(f'#!/bin/sh\n{before}\nexec {shlex.join(engine.program.argv)} "$@"\n')
    script.chmod(0o755)
    return ProgramEngine(engine.model, replace(engine.program, argv=(str(script),)))


def test_the_real_program_killed_is_an_outcome(engine, tmp_path):
    killed = wrapped(engine, tmp_path, "(sleep 1; kill -9 $$) &")
    run = killed.run(REFERENCE, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.FAILED
    assert "LIGGGHTS ended by signal SIGKILL" in run.reason


def test_the_real_program_that_may_not_write_on_is_an_outcome(engine, tmp_path):
    full = wrapped(engine, tmp_path, "ulimit -f 8")  # blocks of 512 bytes, or of 1024
    run = full.run(REFERENCE, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.FAILED
    assert "LIGGGHTS ended by signal SIGXFSZ" in run.reason


def test_a_time_limit_ends_the_real_program_and_nothing_is_left_running(engine, tmp_path, monkeypatch):
    monkeypatch.setattr(engine_module, "SHORTEST_TIME_LIMIT", 1.0)
    monkeypatch.setattr(engine_module, "TIME_LIMIT_FACTOR", 0.0)
    noted = wrapped(engine, tmp_path, "echo $$ > pid")
    run = noted.run(REFERENCE, 1, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.TIMED_OUT
    assert run.reason.startswith("no end after ")
    assert 1.0 <= run.wall_time < 30.0
    assert not runs(int((tmp_path / "run" / "pid").read_text()))


def test_a_stop_ends_the_real_program(engine, tmp_path):
    stop = threading.Event()
    threading.Timer(0.5, stop.set).start()
    with pytest.raises(Stopped):
        engine.run(REFERENCE, 1, tmp_path / "run", stop)
    assert "calstudy: finished" not in (tmp_path / "run" / "output.txt").read_text(errors="replace")


@pytest.mark.usefixtures("coarse_profiles")
def test_two_bead_sizes_are_calibrated_at_once(tmp_path, monkeypatch):
    """The angle of 10 mm and the density of 12 mm beads in one cost; each parameter set is two DEM runs."""
    monkeypatch.chdir(tmp_path)
    text = example().replace('fidelity = "soft"', 'fidelity = "tiny"\nlabel = "small"')
    second = '[[models]]\nname = "angle_of_repose"\nlabel = "big"\nfidelity = "tiny"\n[models.material]\n'
    second += "diameter = 0.012\n\n[parameters]"
    text = text.replace("[parameters]", second)
    text = re.sub(r"(?m)^(DENS|RF_PP|YM) = \[([\d.e]+),.*$", r"\1 = \2", text)  # MU_PP alone is calibrated
    text = text.replace("WRL = 0.1", "WRL = 0").replace("# budget = 6", "budget = 2")
    text = text.replace("# samples_per_parameter", "samples_per_parameter")
    text = text[: text.index("[targets]")] + "[targets]\n"
    text += "small_angle_of_repose_deg = { value = 27.0, tolerance = 9.0 }\n"
    text += "big_bulk_density = { value = 1400.0, tolerance = 150.0 }\n"
    Path("two.toml").write_text(text)
    assert main(["calibrate", "two.toml", "--workers", "2"]) == 0
    quantities = read_settings(Path("studies/two")).quantities
    runs = read_table(Path("studies/two"), "evaluations", quantities)
    assert len(runs) == 8 and set(runs["outcome"]) == {
        "ok"
    }  # three samples and the first of the second optimisation
    assert runs.groupby(["phase", "index"])["model_hash"].nunique().eq(2).all()
    result = read_table(Path("studies/two"), "calibrations", quantities).iloc[0]
    assert result["dem_stop"] == "tolerance"
    assert abs(result["dem_small_angle_of_repose_deg"] - 27) <= 9
    assert set(read_table(Path("studies/two"), "heaps", quantities)["particle_diameter"]) == {0.010, 0.012}
    assert Path("studies/two/report/report.html").stat().st_size > 10_000


@pytest.mark.usefixtures("coarse_profiles")
def test_a_file_calibrated_from_python_is_what_the_command_makes_of_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = example().replace('fidelity = "soft"', 'fidelity = "tiny"')
    text = re.sub(r"(?m)^(DENS|RF_PP|YM) = \[([\d.e]+),.*$", r"\1 = \2", text)  # MU_PP alone is calibrated
    text = text.replace("# samples_per_parameter", "samples_per_parameter")
    text = text.replace("# budget = 6", "budget = 1").replace("WRL = 0.1", "WRL = 0")
    text = text.replace("value = 22.0, tolerance = 2.0", "value = 27.0, tolerance = 9.0")
    text = text.replace("tolerance = 15.0", "tolerance = 200.0")
    Path("one.toml").write_text(text)
    found = cs.calibrate_file("one.toml", how=cs.Running(workers=2))
    assert found.line["runs_total"] == 4 and abs(found.responses[ANGLE_OF_REPOSE] - 27) <= 9
    pages = {path.name: path.read_bytes() for path in cs.write_report(found, "studies/one")}
    assert main(["calibrate", "one.toml", "--study", "other", "--workers", "2"]) == 0
    assert read_settings(Path("other")).id == found.settings.id
    again = read_table(Path("other"), "evaluations", found.settings.quantities)
    assert list(again["run_id"]) == list(found.evaluations["run_id"])
    assert again[ANGLE_OF_REPOSE].equals(found.evaluations[ANGLE_OF_REPOSE])
    assert {path.name: path.read_bytes() for path in Path("other/report").iterdir()} == pages


# ---- a model of one's own -----------------------------------------------------------------------

OWN = """
units si
atom_style granular
boundary f f f
newton off
communicate single vel yes
region box block -1 1 -1 1 -1 1 units box
create_box 1 box
print "by equal ${EQUAL}"
variable exact equal v_EQUAL*1e10-floor(v_EQUAL*1e10)
print "digits: ${exact}"
print "${TEXT}" file text.txt
print "end of script"
"""


def own_model(folder, before="", **more):
    (folder / "own").mkdir()
    (folder / "own" / "in.own").write_text(before + OWN)
    lines = ['script = "in.own"', 'finished = "end of script"', "expected_seconds = 1"]
    lines += [f"{name} = {value}" for name, value in more.items()]
    lines += ["[parameters]", 'TEXT = "-"', 'EQUAL = "-"', "[particles]", "radius = 0.001"]
    lines += ["poissons_ratio = 0.3", "density = 2500", "youngs_modulus = 5e6"]
    lines += ["[responses.text]", 'unit = "-"', 'file = "text.txt"']
    lines += ["[responses.digits]", 'unit = "-"', 'log = "digits:"']
    (folder / "own" / "model.toml").write_text("\n".join(lines))
    return load_folder(folder / "own")


def test_all_digits_of_a_parameter_reach_the_script_by_the_command_line(program, tmp_path):
    value = 0.1 + 0.2
    run = ProgramEngine(own_model(tmp_path), program).run(
        {"TEXT": value, "EQUAL": value}, 1, tmp_path / "run", threading.Event()
    )
    assert run.outcome is Outcome.OK, run.reason
    assert run.responses["text"] == value != round(value, 15)


def test_all_digits_of_a_parameter_reach_the_script_by_an_include_file(program, tmp_path):
    """Index variables have them all; equal ones those that LIGGGHTS keeps, which are 15."""
    value, answers = 0.12345678901234567, {}
    for style in ("index", "equal"):
        (tmp_path / style).mkdir()
        before = "variable TEXT equal 1\nvariable EQUAL equal 1\ninclude set.in\n"
        model = own_model(tmp_path / style, before, include='"set.in"', style=f'"{style}"')
        engine = ProgramEngine(model, program)
        run = engine.run({"TEXT": value, "EQUAL": value}, 1, tmp_path / style / "run", threading.Event())
        assert run.outcome is Outcome.OK, run.reason
        answers[style] = run.responses
    assert answers["index"]["text"] == value
    assert answers["index"]["digits"] == pytest.approx(value * 1e10 % 1, abs=1e-7)
    assert answers["equal"]["text"] == float(f"{value:.15g}") != value


def test_doubled_density_and_stiffness_leave_every_bit_as_it_is(engine, answers, tmp_path):
    doubled = REFERENCE | {name: 2.0 * REFERENCE[name] for name in ("DENS", "YM")}
    run = engine.run(doubled, 1, tmp_path / "run", threading.Event())
    np.testing.assert_array_equal(run.positions, answers.a.run.positions)
    assert run.responses[ANGLE_OF_REPOSE] == answers.a.run.responses[ANGLE_OF_REPOSE]
    assert run.responses[BULK_DENSITY] == 2.0 * answers.a.run.responses[BULK_DENSITY]


FALL = """
variable H index 0.5
variable G index 9.81
variable SEED index 10007
variable v equal sqrt(2*${G}*${H})*(1+0.001*random(-1,1,${SEED}))
variable t equal sqrt(2*${H}/${G})*(1+0.001*random(-1,1,${SEED}))
print "speed = $v"
print "time = $t"
"""
FALL_MODEL = """
script = "in.fall"
seeds = ["SEED"]
expected_seconds = 1
[parameters]
H = "m"
G = "m/s2"
[responses.speed]
unit = "m/s"
short = "v"
log = "speed ="
[responses.time]
unit = "s"
log = "time ="
"""
FALL_FILE = """
mode = "robust"
seed = 1
WRL = 0
[[models]]
name = "fall"
[parameters]
H = [0.2, 1.0]
G = 9.81
[targets]
speed = { value = 3.5, tolerance = 0.01 }
"""


@pytest.mark.usefixtures("coarse_profiles")
def test_a_folder_without_particles_or_code_goes_through_every_command(tmp_path, monkeypatch, capsys):
    """A model with responses of its own: two text files, and no Python."""
    monkeypatch.chdir(tmp_path)
    Path("fall").mkdir()
    Path("fall/in.fall").write_text(FALL)
    Path("fall/model.toml").write_text(FALL_MODEL)
    Path("design.csv").write_text("label,seed,H,G\na,1,0.5,9.81\nb,2,1.0,1.62\n")
    Path("fall.toml").write_text(FALL_FILE)
    intervals = ("--interval", "H=0.2:1.0", "--interval", "G=9.81")

    def said(*argv):
        assert main([*argv, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    at = ("--model", "fall", "--set", "H=0.5", "--set", "G=9.81")
    one = said("simulate", *at)
    assert one["speed"] == pytest.approx(math.sqrt(9.81), rel=2e-3) and one["rayleigh_time_step"] is None
    assert said("twin", *at, "--seeds", "4", "--out", "twins.csv")["speed_sd"] > 0
    assert said("sweep", "design.csv", "--model", "fall", "--out", "swept")["failed"] == 0
    made_of = said("emulator", "sample", "--model", "fall", *intervals, "--points", "16", "--out", "runs")
    assert made_of == {"runs": 17, "failed": 0, "table": "runs/runs.parquet"}
    made = said("emulator", "fit", "runs", "--model", "fall", *intervals, "--out", "emulator")
    assert set(made["responses"]) == {"speed", "time"}
    height = 3.5**2 / (2 * 9.81)
    for options in ((), ("--emulator", "emulator", "--study", "studies/emulated")):
        found = said("calibrate", "fall.toml", "--models", ".", *options)
        assert found["dem_H"] == pytest.approx(height, rel=0.01)
    assert main(["plan", "status", "--study", "studies/fall"]) == 0
    assert "speed" in capsys.readouterr().out
