import errno
import math
import shlex
import shutil
import subprocess
import threading
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from calstudy.disk.ours import MARK
from calstudy.engines import engine as engine_module
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS, markers
from calstudy.engines.process import Finished
from calstudy.errors import InputError, RunError, SetupError, Stopped
from calstudy.models.angle_of_repose import AngleOfReposeModel, load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, REFERENCE
from calstudy.models.measurement import measure_heap
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome
from fake_liggghts import BEHAVIOURS, COMMAND
from processes import runs, wait_until

FIXED = load_plan().fixed
FIDELITIES = ("full", "fast", "soft", "coarse", "tiny")
LOW = {**REFERENCE, "MU_PP": 0.1, "RF_PP": 0.001}
HIGH = {**REFERENCE, "MU_PP": 0.3, "RF_PP": 0.1}

# What each misbehaviour must end in, and words of the reason.
EXPECTED = {
    "error": (Outcome.FAILED, "exit code 1; log.liggghts ends: ERROR: Particle overlap is too large"),
    "silent": (Outcome.FAILED, "did not reach the last line"),
    "truncated": (Outcome.FAILED, "heap.dump: cut short"),
    "hang": (Outcome.TIMED_OUT, "no end after"),
    "killed": (Outcome.FAILED, "signal SIGKILL"),
    "nan": (Outcome.FAILED, "heap.dump: a position or velocity is not finite"),
    "fast": (Outcome.FAILED, "heap.dump: a bead is faster than 20 m/s"),
    "shaking": (Outcome.FAILED, "the heap still shook at the end, with"),
    "not_full": (Outcome.FAILED, "the cylinder was not full"),
    "flat": (Outcome.NO_HEAP, "nothing stands above the first layer"),
    "empty": (Outcome.NO_HEAP, "nothing stands above the first layer"),
    "far": (Outcome.FAILED, "heap.dump: a bead is more than 1 m away"),
    "round": (Outcome.UNMEASURABLE, "top picture: the two largest objects are equally round"),
    "no_dump": (Outcome.FAILED, "heap.dump cannot be read"),
    "no_log": (Outcome.FAILED, "log.liggghts cannot be read"),
    "log_is_a_folder": (Outcome.FAILED, "log.liggghts cannot be read"),
    "no_mark": (Outcome.FAILED, "beads_filled is not there"),
    "garbled_mark": (Outcome.FAILED, "simulated_time is not there or no number"),
    "garbled_count": (Outcome.FAILED, "heap.dump: cut short or garbled"),
    "negative_count": (Outcome.FAILED, "beads_poured is not there or no number"),
    "other_count": (Outcome.FAILED, "the dumps hold other numbers of beads than the log"),
    "more_beads": (Outcome.FAILED, "more than the 146 that it was made of"),
    "endless_number": (Outcome.FAILED, "beads_heap is not there or no number"),
    "binary": (Outcome.FAILED, "cannot be read"),
    "exploded": (Outcome.FAILED, "only 7 of 1250 beads were left after pouring; the simulation exploded"),
    "vanished": (Outcome.FAILED, "only 0 of 1250 beads were left after pouring"),
    "outside": (Outcome.FAILED, "filled.dump: a bead lies outside the cylinder"),
}


@pytest.fixture(autouse=True)
def no_settings_from_outside(monkeypatch):
    for name in (
        LIGGGHTS.variable,
        "FAKE_LIGGGHTS",
        "FAKE_LIGGGHTS_SHARE",
        "FAKE_LIGGGHTS_SECONDS",
        "FAKE_LIGGGHTS_UNTIL",
    ):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(scope="module")
def program():
    return LIGGGHTS.find(COMMAND)


def engine_of(program, fidelity="coarse"):
    return ProgramEngine(load_model(FIXED, fidelity), program)


def run(engine, folder, parameters=REFERENCE, seed=1, stop=None):
    return engine.run(parameters, seed, folder / "run", stop or threading.Event())


# ---- a run that goes well ------------------------------------------------------------------------------


def test_a_good_run_answers_with_all_responses(program, tmp_path):
    found = run(engine_of(program), tmp_path)
    assert (found.outcome, found.reason) == (Outcome.OK, "")
    assert found.usable
    assert 22 < found.responses[ANGLE_OF_REPOSE] < 32
    assert 1450 < found.responses[BULK_DENSITY] < 1560
    assert math.tan(math.radians(found.responses[ANGLE_OF_REPOSE])) == pytest.approx(
        found.height / found.radius
    )
    assert found.beads.poured >= found.beads.filled >= found.beads.on_plate == len(found.positions)
    assert found.beads.lost == found.beads.filled - found.beads.on_plate
    assert found.wall_time > 0
    assert found.cpu_time > 0


def test_bulk_density_is_counted_beads_times_mass_over_volume(program, tmp_path):
    found = run(engine_of(program), tmp_path, {**REFERENCE, "DENS": 2410.0})
    lines = (tmp_path / "run" / "filled.dump").read_text().splitlines()
    counted = len(lines) - 1 - next(k for k, line in enumerate(lines) if line.startswith("ITEM: ATOMS"))
    mass = 2410.0 * math.pi / 6 * 0.0075**3
    volume = math.pi / 4 * 0.1**2 * 0.05
    assert found.beads.filled == counted
    assert found.responses[BULK_DENSITY] == pytest.approx(counted * mass / volume, rel=1e-12)


@pytest.mark.parametrize("fidelity", FIDELITIES)
def test_the_rayleigh_time_step_is_the_papers_whatever_is_simulated(program, tmp_path, fidelity):
    engine = engine_of(program, fidelity)
    found = run(engine, tmp_path)
    assert found.responses[RAYLEIGH_TIME_STEP] == pytest.approx(2.98852e-5, rel=5e-6)
    assert found.engine_time_step == engine.model.engine_time_step(REFERENCE)


def test_the_heap_is_what_the_dump_says_and_measures_the_same_again(program, tmp_path):
    engine = engine_of(program)
    found = run(engine, tmp_path)
    lines = (tmp_path / "run" / "heap.dump").read_text().splitlines()[9:]
    rows = sorted([float(word) for word in line.split()] for line in lines)
    np.testing.assert_allclose(found.positions, np.array(rows)[:, 1:4], rtol=1e-6, atol=1e-9)
    stored = found.positions.astype(np.float32)
    np.testing.assert_array_equal(found.positions, stored)
    again = measure_heap(stored, engine.particle_diameter, pixels_per_mm=engine.model.pixels_per_mm)
    assert again.angle_of_repose_deg == found.responses[ANGLE_OF_REPOSE]


def test_the_simulated_time_is_the_one_that_the_script_prints(program, tmp_path):
    found = run(engine_of(program), tmp_path)
    printed = markers(tmp_path / "run" / "log.liggghts")["simulated_time"]
    assert found.simulated_time == float(printed) > 3.9


def test_the_directory_holds_the_deck_as_it_was_run(program, tmp_path):
    engine = engine_of(program)
    run(engine, tmp_path, seed=5)
    folder = tmp_path / "run"
    for name, text in engine.model.files.items():
        assert (folder / name).read_text() == text
    assert {p.name for p in folder.iterdir()} == {
        *("in.angle_of_repose", "contact.in", "ring.stl", "cylinder.stl", "parameters.in"),
        *("log.liggghts", "output.txt", "filled.dump", "heap.dump", MARK),
    }
    seeds = {line.split()[1]: line.split()[3] for line in (folder / "parameters.in").read_text().splitlines()}
    assert seeds == engine.model.variables(REFERENCE, 5)


def test_the_same_seed_gives_the_same_numbers_and_another_one_others(program, tmp_path):
    engine = engine_of(program)
    one, again, other = (run(engine, tmp_path / name, seed=s) for name, s in (("a", 3), ("b", 3), ("c", 4)))
    assert one.responses == again.responses
    np.testing.assert_array_equal(one.positions, again.positions)
    assert one.responses != other.responses


def test_parameters_reach_the_program(program, tmp_path):
    low, high = (run(engine_of(program), tmp_path / name, p) for name, p in (("l", LOW), ("h", HIGH)))
    assert high.responses[ANGLE_OF_REPOSE] > low.responses[ANGLE_OF_REPOSE] + 5
    assert high.responses[BULK_DENSITY] < low.responses[BULK_DENSITY]


def test_identity_names_the_program_and_its_version(program, monkeypatch):
    assert engine_of(program).identity == "LIGGGHTS 3.8.0"
    monkeypatch.setenv("FAKE_LIGGGHTS", "wrong_version")
    assert engine_of(LIGGGHTS.find(COMMAND)).identity == "LIGGGHTS 3.7.0"


def test_an_engine_tells_what_its_model_says(program):
    engine = engine_of(program, "tiny")
    assert engine.model_hash == engine.model.hash
    assert engine.particle_diameter == 0.010
    assert engine.expected_seconds == engine.model.fidelity.expected_seconds
    wide = ProgramEngine(load_model(FIXED, "tiny", "wide"), program)
    assert wide.expected_seconds > engine.expected_seconds


# ---- a run that goes wrong -----------------------------------------------------------------------------


def test_every_misbehaviour_has_an_expected_outcome():
    assert set(BEHAVIOURS) - set(EXPECTED) == {"wrong_version", "no_liggghts", "directory_gone"}


@pytest.mark.parametrize("behaviour", EXPECTED)
def test_a_run_that_goes_wrong_is_an_outcome_with_a_reason(program, tmp_path, monkeypatch, behaviour):
    if behaviour == "hang":
        monkeypatch.setattr(engine_module, "SHORTEST_TIME_LIMIT", 2.0)
        monkeypatch.setattr(engine_module, "TIME_LIMIT_FACTOR", 0.0)
    monkeypatch.setenv("FAKE_LIGGGHTS", behaviour)
    found = run(engine_of(program), tmp_path)
    outcome, words = EXPECTED[behaviour]
    assert found.outcome is outcome
    assert words in found.reason
    assert len(found.reason.splitlines()) == 1
    assert len(found.reason) < 1000
    assert not found.usable
    assert math.isnan(found.responses[ANGLE_OF_REPOSE])
    assert found.responses[RAYLEIGH_TIME_STEP] == pytest.approx(2.98852e-5, rel=5e-6)
    assert found.wall_time > 0
    if outcome in (Outcome.FAILED, Outcome.TIMED_OUT):
        assert math.isnan(found.responses[BULK_DENSITY])
        assert found.beads is None
        assert found.positions is None
    else:
        assert 1450 < found.responses[BULK_DENSITY] < 1560
        assert found.beads.on_plate == len(found.positions)
    if behaviour == "hang":
        child = int((tmp_path / "run" / "child.pid").read_text())
        assert wait_until(lambda: not runs(child))


LEAVES_NO_LOG = {"killed", "no_log", "log_is_a_folder"}
LEAVES_A_LOG = [
    b for b, (outcome, _) in EXPECTED.items() if outcome is Outcome.FAILED and b not in LEAVES_NO_LOG
]


@pytest.mark.parametrize("behaviour", LEAVES_A_LOG)
def test_the_reason_of_a_failed_run_ends_with_the_end_of_its_log(program, tmp_path, monkeypatch, behaviour):
    monkeypatch.setenv("FAKE_LIGGGHTS", behaviour)
    assert "; log.liggghts ends: " in run(engine_of(program), tmp_path).reason


@pytest.mark.parametrize("fidelity", FIDELITIES)
@pytest.mark.parametrize("variant", ["ring", "wide"])
def test_the_time_limit_follows_from_the_expected_cost(program, tmp_path, monkeypatch, fidelity, variant):
    asked = []

    def refuse(*_, time_limit, **__):
        asked.append(time_limit)
        raise SetupError("not started")

    monkeypatch.setattr(engine_module, "run_process", refuse)
    engine = ProgramEngine(load_model(FIXED, fidelity, variant), program)
    with pytest.raises(SetupError, match="not started"):
        run(engine, tmp_path)
    assert asked == [max(120.0, 20 * engine.expected_seconds)]
    slower = replace(engine.model, variant=replace(engine.model.variant, relative_cost=100.0))
    with pytest.raises(SetupError):
        run(ProgramEngine(slower, program), tmp_path / "slower")
    assert asked[1] == 20 * 100 * engine.model.fidelity.expected_seconds


def test_a_program_that_was_ended_with_us_leaves_no_failure(program, tmp_path, monkeypatch):
    stop = threading.Event()

    def ended_from_outside(*_, **__):
        stop.set()
        return Finished(exit_code=-15, timed_out=False, stopped=False, wall_time=1.0, cpu_time=1.0)

    monkeypatch.setattr(engine_module, "run_process", ended_from_outside)
    with pytest.raises(Stopped):
        run(engine_of(program), tmp_path, stop=stop)


def test_a_directory_that_is_removed_meanwhile_is_the_machine_s_failure(program, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "directory_gone")
    with pytest.raises(SetupError, match=r"gone while the run went on; see --scratch"):
        run(engine_of(program), tmp_path)


@pytest.mark.parametrize(("share", "outcome"), [(0.999, Outcome.OK), (0.98, Outcome.FAILED)])
def test_insertion_may_fall_short_by_a_few_beads_and_by_no_more(program, tmp_path, share, outcome):
    class AsksForMore(AngleOfReposeModel):
        def variables(self, parameters, seed):
            return {**super().variables(parameters, seed), "poured_beads": str(round(share * 1250))}

    model = load_model(FIXED, "coarse")
    model = AsksForMore(**{f.name: getattr(model, f.name) for f in fields(model)})
    assert run(ProgramEngine(model, program), tmp_path).outcome is outcome


@pytest.mark.parametrize(
    "parameters",
    [{"MU_PP": -0.1}, {"RF_PW": -1e-9}, {"DENS": 0.0}, {"YM": 0.0}, {"MU_PW": math.nan}, {"YM": math.inf}],
)
def test_parameters_that_are_no_physics_are_refused_before_anything_is_started(
    program, tmp_path, monkeypatch, parameters
):
    monkeypatch.setattr(engine_module, "run_process", lambda *_, **__: pytest.fail("it was started"))
    with pytest.raises(InputError):
        run(engine_of(program), tmp_path, {**REFERENCE, **parameters})
    assert list(tmp_path.iterdir()) == []


def test_fixed_inputs_that_are_no_physics_are_refused_before_anything_is_started(program, tmp_path):
    model = load_model(replace(FIXED, poissons_ratio=0.5), "coarse")
    with pytest.raises(InputError, match=r"poissons_ratio is 0\.5"):
        run(ProgramEngine(model, program), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_log_without_a_line_says_nothing_more(program, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "killed")
    assert run(engine_of(program), tmp_path).reason == (
        "LIGGGHTS ended by signal SIGKILL (out of memory?), 3 times in turn"
    )


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, None])
def test_a_run_that_fails_on_a_full_disk_or_quota_is_the_machine_s_failure(
    program, tmp_path, monkeypatch, number
):
    monkeypatch.setenv("FAKE_LIGGGHTS", "truncated")

    def fsync(_):
        if number is not None:
            raise OSError(number, "no room")

    monkeypatch.setattr("os.fsync", fsync)
    if number is None:
        assert run(engine_of(program), tmp_path).outcome is Outcome.FAILED
    else:
        with pytest.raises(SetupError, match="disk is full"):
            run(engine_of(program), tmp_path)


@pytest.mark.parametrize("name", ["heap.dump", "log.liggghts"])
def test_a_file_that_the_machine_cannot_read_is_the_machine_s_failure(program, tmp_path, monkeypatch, name):
    read_text = Path.read_text

    def stale(path, **options):
        if path.name == name:
            raise OSError(errno.ESTALE, "Stale file handle")
        return read_text(path, **options)

    monkeypatch.setattr(Path, "read_text", stale)
    with pytest.raises(SetupError, match=f"{name}: cannot be read: Stale file handle"):
        run(engine_of(program), tmp_path)


@pytest.mark.parametrize("ending", ["kill -KILL $$", "kill -TERM $$", "exit 137"])
def test_a_program_that_somebody_else_ended_is_run_again(program, tmp_path, monkeypatch, ending):
    monkeypatch.setattr("calstudy.engines.engine.GRACE_SECONDS", 0.01)
    once = tmp_path / "liggghts"
    there = tmp_path / "was there"
    once.write_text(
        f"#!/bin/sh\n[ -e '{there}' ] || {{ touch '{there}'; echo half > heap.dump; {ending}; }}\n"
        f'exec {shlex.join(program.argv)} "$@"\n'
    )
    once.chmod(0o755)
    found = run(engine_of(replace(program, argv=(str(once),))), tmp_path / "a")
    expected = run(engine_of(program), tmp_path / "b")
    assert there.exists()
    assert found.outcome is Outcome.OK
    assert found.responses == expected.responses


def test_who_ends_the_program_and_then_stops_us_leaves_no_record(program, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "killed")
    stop = threading.Event()
    ran = threading.Timer(0.7, stop.set)
    ran.start()
    with pytest.raises(Stopped):
        run(engine_of(program), tmp_path, stop=stop)
    ran.join()


def test_only_the_share_that_was_asked_for_misbehaves(program, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "error")
    monkeypatch.setenv("FAKE_LIGGGHTS_SHARE", "0.5")
    outcomes = [run(engine_of(program, "tiny"), tmp_path / str(s), seed=s).outcome for s in range(12)]
    assert {*outcomes} == {Outcome.OK, Outcome.FAILED}


def test_a_stop_ends_the_run_without_a_record(program, tmp_path, monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "hang")
    stop, pid = threading.Event(), tmp_path / "run" / "child.pid"

    def stop_when_the_child_is_there():
        wait_until(lambda: pid.exists() and pid.read_text() != "")
        stop.set()

    watcher = threading.Thread(target=stop_when_the_child_is_there)
    watcher.start()
    with pytest.raises(Stopped):
        run(engine_of(program), tmp_path, stop=stop)
    watcher.join()
    child = int(pid.read_text())
    assert wait_until(lambda: not runs(child))


@pytest.mark.parametrize("content", [{}, {"heap.dump": "of somebody else"}])
def test_a_directory_that_is_there_is_refused_and_left_alone(program, tmp_path, content):
    folder = tmp_path / "run"
    folder.mkdir()
    for name, text in content.items():
        (folder / name).write_text(text)
    with pytest.raises(SetupError, match="cannot write the run's files") as caught:
        run(engine_of(program), tmp_path)
    assert str(folder) in str(caught.value)
    assert "--scratch" in str(caught.value)
    assert {p.name: p.read_text() for p in folder.iterdir()} == content


def test_a_place_that_is_no_directory_is_refused(program, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SetupError, match=r"Not a directory; see --scratch"):
        run(engine_of(program), tmp_path / "file")


def test_a_program_that_went_away_is_a_matter_of_set_up(program, tmp_path):
    gone = replace(program, argv=("/no/such/liggghts",))
    with pytest.raises(SetupError, match="cannot start /no/such/liggghts"):
        run(engine_of(gone), tmp_path)


# ---- the log -------------------------------------------------------------------------------------------


def test_markers_are_the_lines_that_begin_with_the_marker(tmp_path):
    log = tmp_path / "log.liggghts"
    log.write_text("x calstudy: a 1\ncalstudy: b 2\nb 3\ncalstudy: c\ncalstudy: long 4 5\n")
    assert markers(log) == {"b": "2", "c": "", "long": "4 5"}


def test_a_log_that_is_not_there_is_a_failed_run(tmp_path):
    with pytest.raises(RunError, match=r"log\.liggghts cannot be read"):
        markers(tmp_path / "log.liggghts")


# ---- finding the program -------------------------------------------------------------------------------


def wrapper(path, command=COMMAND):
    path.write_text(f'#!/bin/sh\nexec {command} "$@"\n')
    path.chmod(0o755)
    return path


def refusal(command=None):
    with pytest.raises(SetupError) as caught:
        LIGGGHTS.find(command)
    message = str(caught.value)
    assert "\n" not in message
    for remedy in ("apt-get install liggghts", "--liggghts", LIGGGHTS.variable):
        assert remedy in message
    return message


def test_a_command_may_hold_arguments(program):
    assert program.argv == tuple(shlex.split(COMMAND))
    assert program.version == "3.8.0"
    assert program.command("in.x") == [*program.argv, *shlex.split("-in in.x -log log.liggghts -echo none")]


@pytest.mark.parametrize("command", ["no-such-liggghts", "/no/such/liggghts", ".", "'"])
def test_a_missing_program_is_refused_with_the_remedy(command):
    assert repr(command) in refusal(command)


def test_without_a_command_the_search_path_is_asked(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "'liggghts'" in refusal()
    found = wrapper(tmp_path / "liggghts")
    assert LIGGGHTS.find().argv == (str(found),)


def test_the_environment_variable_is_honoured_before_the_search_path(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    wrapper(tmp_path / "liggghts")
    chosen = wrapper(tmp_path / "other")
    monkeypatch.setenv(LIGGGHTS.variable, str(chosen))
    assert LIGGGHTS.find().argv == (str(chosen),)
    monkeypatch.setenv(LIGGGHTS.variable, "/no/such/liggghts")
    assert "'/no/such/liggghts'" in refusal()


def test_the_command_is_honoured_before_the_environment_variable(tmp_path, monkeypatch):
    monkeypatch.setenv(LIGGGHTS.variable, "/no/such/liggghts")
    assert LIGGGHTS.find(COMMAND).version == "3.8.0"


def test_a_relative_path_holds_in_every_runs_directory(tmp_path, monkeypatch):
    wrapper(tmp_path / "liggghts")
    monkeypatch.chdir(tmp_path)
    found = run(engine_of(LIGGGHTS.find("./liggghts"), "tiny"), tmp_path)
    assert found.outcome is Outcome.OK


def test_a_path_with_a_blank_is_found_when_quoted(tmp_path):
    found = wrapper(tmp_path / "my liggghts")
    assert LIGGGHTS.find(shlex.quote(str(found))).argv == (str(found),)


@pytest.mark.parametrize("command", ["true", "false", "cat", r"printf '\377\376'", "echo LIGGGHTS"])
def test_a_program_that_is_no_liggghts_is_refused(command):
    assert shutil.which(shlex.split(command)[0])
    assert "does not answer as LIGGGHTS" in refusal(command)


def test_another_program_of_the_name_is_refused(monkeypatch):
    monkeypatch.setenv("FAKE_LIGGGHTS", "no_liggghts")
    assert "does not answer as LIGGGHTS" in refusal(COMMAND)


def test_a_program_that_cannot_be_started_is_refused(tmp_path):
    broken = tmp_path / "liggghts"
    broken.write_text("no program")
    broken.chmod(0o755)
    assert "could not be started" in refusal(str(broken))


def test_a_file_that_may_not_be_executed_is_refused(tmp_path):
    plain = wrapper(tmp_path / "liggghts")
    plain.chmod(0o644)
    assert "was not found" in refusal(str(plain))


def test_a_program_that_may_no_longer_be_executed_is_a_matter_of_set_up(tmp_path):
    there = wrapper(tmp_path / "liggghts")
    engine = engine_of(LIGGGHTS.find(str(there)))
    there.chmod(0o644)
    with pytest.raises(SetupError, match="Permission denied"):
        run(engine, tmp_path)


def test_the_fake_takes_liggghts_arguments_and_no_others(tmp_path):
    done = subprocess.run(
        [*shlex.split(COMMAND), "-screen", "none"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode != 0
    assert "Invalid command-line argument" in done.stderr


@pytest.mark.parametrize("name", MEASURED)
def test_the_fakes_responses_vary_smoothly(program, tmp_path, name):
    engine, values = engine_of(program, "soft"), []
    for k in range(5):
        p = {**REFERENCE, "MU_PP": 0.1 + 0.05 * k}
        values.append(run(engine, tmp_path / str(k), p).responses[name])
    steps = np.diff(values)
    assert (steps > 0).all() if name == ANGLE_OF_REPOSE else (steps < 0).all()
    assert abs(steps).max() < 2 * abs(steps).min()
