"""A model folder of anybody's: what reaches the script, what is read, and what is refused before any run."""

import math
import re
import sys
import threading

import numpy as np
import pytest

from calstudy import machine
from calstudy.engines import guardian
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LIGGGHTS, insertion_seeds
from calstudy.engines.program import Program
from calstudy.errors import InputError, SetupError
from calstudy.models.folder import FolderModel, load_folder
from calstudy.models.noise import noise_in
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome

FAKE = """
import os, sys
words = sys.argv[1:]
values = {words[k + 1]: words[k + 2] for k, word in enumerate(words) if word == "-var"}
if os.path.exists("params.in"):
    for line in open("params.in"):
        if line.startswith("variable"):
            values[line.split()[1]] = line.split()[3]
script = open(words[words.index("-in") + 1]).read()
name = "other.log" if "moves" in script else "log.liggghts"
with open("log.liggghts", "w") as log:
    log.write("LIGGGHTS\\n")
with open(name, "a") as log:
    log.write("height = 0.5\\n")
    log.write("height = " + values.get("MU", "none") + " m\\n")
    if "dies" not in script and "fails" not in script:
        log.write("all done\\n")
if "moves" in script:
    print(open(name).read())
    if "fails" in script:
        print("ERROR: no such pair style")
if "silent" not in script:
    os.makedirs("out", exist_ok=True)
    with open("out/forces.txt", "w") as out:
        out.write("# step force torque\\n1 10 20\\n2 %s %s\\n" % (values["MU"], values.get("DENS", "nan")))
if "heap" in script:
    with open("heap.dump", "w") as out:
        out.write(open("beads.txt").read())
sys.exit(3 if "fails" in script or "quits" in script else 0)
"""
MODEL = """
script = "in.shear"
expected_seconds = 2
finished = "all done"

[parameters]
DENS = "kg/m3"
MU = "-"

[particles]
radius = 0.002
poissons_ratio = 0.3
density = "DENS"
youngs_modulus = 5e6

[responses.torque]
unit = "N m"
file = "out/forces.txt"

[responses.height]
unit = "m"
log = "height ="

[responses.product]
unit = "-"
python = "measure.py:product"
reads = ["out/forces.txt"]
"""
MEASURE = """
def product(directory):
    numbers = (directory / "out/forces.txt").read_text().split()
    return float(numbers[-1]) * float(numbers[-2])
"""
WRONG = """
import os
def wrong(directory):
    raise ValueError("no\\nsuch thing")
def nothing(directory):
    return float("nan")
def leave(directory):
    raise SystemExit("no steady state")
def die(directory):
    os._exit(7)
"""
PARAMETERS = {"DENS": 2500.123456789012, "MU": 0.1 + 0.2}


@pytest.fixture
def folder(tmp_path):
    """Make a model's folder, with changes to its model.toml and further files."""

    def make(*changes, script="run 1\n", name="shear", **files):
        path = tmp_path / name
        (path / "meshes").mkdir(parents=True)
        (path / "post").mkdir()
        (path / "meshes" / "cell.stl").write_bytes(b"solid \xff\n")
        (path / "in.shear").write_text(
            f"{script}\ninclude params.in\nvariable x equal ${{DENS}}*v_MU # $ONE TWO\n"
        )
        (path / "measure.py").write_text(MEASURE)
        text = MODEL
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (path / "model.toml").write_text(text)
        for file, content in files.items():
            (path / file.replace("__", ".")).write_text(content)
        return path

    return make


@pytest.fixture
def run(tmp_path):
    """Run a model with the stand-in for LIGGGHTS."""
    (tmp_path / "fake.py").write_text(FAKE)
    program = Program(LIGGGHTS, (sys.executable, "-S", str(tmp_path / "fake.py")), "3.8.0")

    def go(model, parameters=PARAMETERS, prefix="", directory="run"):
        engine = ProgramEngine(model, program, prefix)
        return engine.run(parameters, 7, tmp_path / directory, threading.Event())

    return go


# ---- what it says of itself --------------------------------------------------------------------------


def test_noise_beside_the_model_is_known_and_part_of_neither_hash_nor_run(folder):
    without = load_folder(folder(name="without"))
    table = f"model_hash,n,torque_sd\n{without.hash},3,0.5\n{without.hash},2,0.2\n{'0' * 64},9,7\n"
    model = load_folder(folder(name="with", noise__csv=table))
    assert model.hash == without.hash and set(model.files) == set(without.files)
    assert noise_in(model.noise_table, model.hash) == pytest.approx({"torque": math.sqrt(0.54 / 3)})
    assert noise_in(without.noise_table, without.hash) is None


def test_noise_that_cannot_be_read_is_said_to_be_damaged(folder):
    model = load_folder(folder(noise__csv="model_hash,n,torque_sd\n"))
    with pytest.raises(SetupError, match=r"noise.csv is damaged"):
        noise_in(f"model_hash,n,torque_sd\n{model.hash},three,0.5\n", model.hash)


@pytest.mark.parametrize(("name", "value"), [("MU", math.nan), ("DENS", 0.0), ("DENS", -1.0)])
def test_values_that_no_particles_have_are_refused(folder, name, value):
    model = load_folder(folder())
    model.check(PARAMETERS)
    with pytest.raises(InputError, match=f"^{name} is "):
        model.check({**PARAMETERS, name: value})


# ---- what goes in, what comes out --------------------------------------------------------------------


def test_every_response_is_read_where_model_toml_says(folder, run):
    found = run(load_folder(folder()))
    assert (found.outcome, found.reason) == (Outcome.OK, "")
    assert found.responses["torque"] == PARAMETERS["DENS"]
    assert found.responses["height"] == PARAMETERS["MU"]  # the last one that was printed
    assert found.responses["product"] == PARAMETERS["DENS"] * PARAMETERS["MU"]
    by_hand = math.pi * 0.002 * math.sqrt(PARAMETERS["DENS"] * 2.6 / 5e6) / (0.1631 * 0.3 + 0.8766)
    assert found.responses[RAYLEIGH_TIME_STEP] == pytest.approx(by_hand)


@pytest.mark.parametrize("include", [False, True], ids=["command line", "include file"])
def test_parameters_reach_the_script_with_all_their_digits(folder, run, tmp_path, include):
    changes = [("expected_seconds", 'include = "params.in"\nexpected_seconds')] if include else []
    files = {"params__in": "variable OTHER equal 3\nvariable MU equal 9"} if include else {}
    model = load_folder(folder(*changes, **files))
    found = run(model)
    assert found.responses["height"] == PARAMETERS["MU"] != round(PARAMETERS["MU"], 15)
    written = (tmp_path / "run" / "params.in").read_text() if include else ""
    assert written == (
        "variable OTHER equal 3\nvariable MU equal 9\n"
        "variable DENS equal 2500.123456789012\nvariable MU equal 0.30000000000000004\n"
        if include
        else ""
    )


def test_variables_may_be_of_the_style_that_liggghts_does_not_round(folder, tmp_path):
    model = load_folder(
        folder(("expected_seconds", 'include = "params.in"\nstyle = "index"\nexpected_seconds'))
    )
    lines = model.inputs(PARAMETERS, 7).files["params.in"].decode().splitlines()
    assert lines[2:] == ["variable MU delete", "variable MU index 0.30000000000000004"]


def test_the_folder_itself_is_never_written_to(folder, run):
    path = folder()
    before = {p: p.read_bytes() for p in path.rglob("*") if p.is_file()}
    run(load_folder(path))
    assert {p: p.read_bytes() for p in path.rglob("*") if p.is_file()} == before


def test_meshes_and_empty_folders_are_there_in_the_run(folder, run, tmp_path):
    run(load_folder(folder()))
    assert (tmp_path / "run" / "meshes" / "cell.stl").read_bytes() == b"solid \xff\n"
    assert list((tmp_path / "run" / "post").iterdir()) == []


def test_seeds_are_primes_drawn_from_the_run_s_seed(folder):
    seeds = ("expected_seconds", 'seeds = ["ONE", "TWO"]\nexpected_seconds')
    model = load_folder(folder(seeds, script="print ${ONE}${TWO}\n"))
    arguments = model.inputs(PARAMETERS, 7).arguments
    assert arguments[6:] == (
        "-var",
        "ONE",
        str(insertion_seeds(7)[0]),
        "-var",
        "TWO",
        str(insertion_seeds(7)[1]),
    )


def test_a_prefix_tells_equal_responses_apart(folder, run):
    found = run(load_folder(folder()), prefix="cell_")
    assert set(found.responses) == {"cell_torque", "cell_height", "cell_product", RAYLEIGH_TIME_STEP}


@pytest.mark.parametrize(
    ("place", "value"), [("line = 1\ncolumn = 2", 10.0), ("line = -2", 20.0), ("column = -3", 2.0)]
)
def test_a_number_is_found_by_line_and_column(folder, run, place, value):
    model = load_folder(folder(('file = "out/forces.txt"', f'file = "out/forces.txt"\n{place}')))
    assert run(model).responses["torque"] == value


def dump(points, steps=(1,)):
    frames = []
    for step in steps:
        frames += [f"ITEM: TIMESTEP\n{step}\nITEM: NUMBER OF ATOMS\n{len(points)}\nITEM: BOX BOUNDS f f f"]
        frames += ["0 1", "0 1", "0 1", "ITEM: ATOMS id type z y x"]
        frames += [
            f"{k} 1 {z:.9g} {y:.9g} {x + 1e-3 * (step - steps[-1]):.9g}" for k, (x, y, z) in enumerate(points)
        ]
    return "\n".join([*frames, ""])


def heap_points():
    """A cone of layers."""
    grid = np.mgrid[-10:11, -10:11].reshape(2, -1).T * 0.004
    layers = [(*g, 0.002 + 0.004 * n) for n in range(5) for g in grid if np.hypot(*g) <= 0.04 * (1 - n / 5)]
    return np.array(layers)


SILHOUETTE = ('file = "out/forces.txt"', 'silhouette = "heap.dump"')


def test_the_silhouette_of_the_last_frame_is_measured(folder, run):
    from calstudy.models.measurement import measure_heap

    points = heap_points()
    model = load_folder(folder(SILHOUETTE, script="heap\n", beads__txt=dump(points, (1, 2))))
    found = run(model)
    assert found.outcome is Outcome.OK
    expected = measure_heap(points.astype(np.float32), 0.004)
    assert found.responses["torque"] == pytest.approx(expected.angle_of_repose_deg, abs=0.05)
    assert found.positions == pytest.approx(points, abs=1e-6) and found.height > 0


@pytest.mark.parametrize(
    ("points", "outcome"),
    [(heap_points()[:300] * [1, 1, 0], Outcome.NO_HEAP), (heap_points() * [1e5, 1, 1], Outcome.UNMEASURABLE)],
    ids=["flat", "scattered"],
)
def test_what_cannot_be_measured_is_an_outcome(folder, run, points, outcome):
    found = run(load_folder(folder(SILHOUETTE, script="heap\n", beads__txt=dump(points))))
    assert found.outcome is outcome and found.reason
    assert math.isnan(found.responses["torque"])
    assert found.responses["height"] == PARAMETERS["MU"]  # what was measured is kept


# ---- fidelities, and what is fixed ---------------------------------------------------------------------

FIDELITIES = (
    "[responses.product]\n",
    """[reference]
DENS = 2500
MU = 0.5
[fixed]
DIAMETER = 0.004
STEPS = 100
[fidelity.cheap]
STEPS = 10
expected_seconds = 3
[fidelity.expensive]
[responses.product]
""",
)


def test_a_fidelity_s_numbers_stand_in_for_those_that_are_fixed(folder):
    path = folder(FIDELITIES, script="run ${DIAMETER} ${STEPS}\n")
    first, expensive = load_folder(path), load_folder(path, fidelity="expensive")
    assert first == load_folder(path, fidelity="cheap") != expensive
    assert first.inputs(PARAMETERS, 7).arguments[6:] == ("-var", "DIAMETER", "0.004", "-var", "STEPS", "10")
    assert expensive.inputs(PARAMETERS, 7).arguments[6:] == (
        "-var",
        "DIAMETER",
        "0.004",
        "-var",
        "STEPS",
        "100",
    )
    assert (first.labels["fidelity"], first.expected_seconds, expensive.expected_seconds) == ("cheap", 3, 2)
    assert first.reference == {"DENS": 2500, "MU": 0.5}
    changed = load_folder(path, fidelity="expensive", changes={"DIAMETER": 0.005})
    assert changed.fixed == {"DIAMETER": 0.005, "STEPS": 100}
    assert len({first.hash, expensive.hash, changed.hash}) == 3


def test_what_a_run_costs_is_not_in_the_hash(folder):
    path = folder(FIDELITIES, script="run ${DIAMETER} ${STEPS}\n")
    there = load_folder(path).hash
    text = (path / "model.toml").read_text()
    (path / "model.toml").write_text(text.replace("expected_seconds = 3\n", "expected_seconds = 4\n"))
    assert load_folder(path).hash == there


def test_notes_are_part_of_neither_hash_nor_run(folder):
    without = load_folder(folder(name="without"))
    model = load_folder(folder(name="with", NOTES__md="# what was measured\n"))
    assert model.hash == without.hash and set(model.files) == set(without.files)


@pytest.mark.parametrize(
    ("change", "given", "says"),
    [
        (
            (),
            {"fidelity": "chaep"},
            "^fidelity chaep is unknown to the model shear; did you mean cheap",
        ),
        (
            (),
            {"changes": {"STEP": 1.0}},
            "^STEP is not among what the model holds fixed; did you mean STEPS",
        ),
        (("STEPS = 10\n", "STEP = 10\n"), {}, r"line \d+: key STEP is unknown"),
        (("STEPS = 100\n", "STEPS = 100\nMU = 1\n"), {}, r"line \d+: MU is set by a run already"),
        (
            ("STEPS = 100\n", "STEPS = 100\nOTHER = 1\n"),
            {},
            r"line \d+: in.shear never uses OTHER",
        ),
        (("MU = 0.5\n", ""), {}, r"\[reference\] lacks MU"),
        (("expected_seconds = 3\n", "expected_seconds = 0\n"), {}, r"line \d+: expected_seconds is 0"),
    ],
)
def test_fixed_variables_that_cannot_be_meant_are_refused(folder, change, given, says):
    old, new = FIDELITIES
    path = folder((old, new.replace(*change) if change else new), script="run ${DIAMETER} ${STEPS}\n")
    with pytest.raises(InputError, match=says):
        load_folder(path, **given)


# ---- runs that went wrong ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("script", "changes", "lost", "reason"),
    [
        ("fails", (), "torque", "LIGGGHTS ended with exit code 3"),
        ("dies", (), "torque", "log.liggghts does not say 'all done', so the script did not reach its end"),
        ("silent", (), "torque", r"^torque: forces.txt cannot be read"),
        (
            "run",
            [('file = "out/forces.txt"', 'file = "out/forces.txt"\nline = 9')],
            "torque",
            "no number at line 9, column -1",
        ),
        ("run", [('log = "height ="', 'log = "width ="')], "height", "no line that begins with 'width ='"),
        ("run", [("measure.py:product", "measure.py:wrong")], "product", "measure.py:wrong: ValueError: no"),
        ("run", [("measure.py:product", "measure.py:leave")], "product", "leave: SystemExit: no steady"),
        (
            "run",
            [("measure.py:product", "measure.py:die")],
            "product",
            "die: it ended with exit code 7 and no",
        ),
        ("run", [("measure.py:product", "measure.py:nothing")], "product", "product: it is nan, no finite"),
        ("run", [('"out/forces.txt"]', '"out/other.txt"]')], "product", "out/other.txt is not there"),
    ],
)
def test_a_response_that_is_not_there_fails_the_run_with_its_reason(
    folder, run, script, changes, lost, reason
):
    path = folder(*changes, script=script)
    (path / "measure.py").write_text(MEASURE + WRONG)
    found = run(load_folder(path))
    ran = script == "run"
    if script == "silent":  # the log was written
        assert found.responses["height"] == PARAMETERS["MU"]
        return
    assert found.outcome is Outcome.FAILED and re.search(reason, found.reason), found.reason
    assert math.isnan(found.responses[lost]) and "\n" not in found.reason
    others = {"torque", "height", "product"} - {lost, "product"}
    assert all(math.isfinite(found.responses[name]) == ran for name in others)
    assert found.responses[RAYLEIGH_TIME_STEP] > 0


# ---- stale output ----------------------------------------------------------------------------------------


PYTHON = """
from __future__ import annotations
import os, sys
from dataclasses import dataclass
from pathlib import Path
from helper import factor

@dataclass
class Line:
    force: float
    torque: "float"

def product(directory):
    print("reading", directory)
    assert Path("out").samefile(directory / "out") and Path(__file__).parent.samefile(directory)
    words = (directory / "out/forces.txt").read_text().split()
    line = Line(float(words[-2]), float(words[-1]))
    return factor * line.force * line.torque
"""


def test_python_runs_as_it_does_outside(folder, run, capfd):
    path = folder(helper__py="factor = 2.0\n")
    (path / "measure.py").write_text(PYTHON)
    found = run(load_folder(path))
    assert found.reason == ""
    assert found.responses["product"] == 2.0 * PARAMETERS["DENS"] * PARAMETERS["MU"]
    assert capfd.readouterr().out == ""


ENDLESS = """
import os, time

def product(directory):
    (directory / "mark").write_text(os.environ["CALSTUDY_PARENT"])
    time.sleep(600)
"""


def test_python_that_never_answers_is_ended_and_does_not_outlive_us(folder, run, monkeypatch):
    monkeypatch.setattr("calstudy.models.readers.FUNCTION_SECONDS", 1.5)
    path = folder()
    (path / "measure.py").write_text(ENDLESS)
    found = run(load_folder(path))
    assert found.outcome is Outcome.FAILED and "product: no answer after 2 s, so it was ended" in found.reason
    assert (path.parent / "run" / "mark").read_text() == guardian.mark()[machine.PARENT]


def test_a_whole_number_is_written_as_one(folder):
    arguments = load_folder(folder()).inputs({"DENS": 2500.0, "MU": 1e-7}, 7).arguments
    assert arguments == ("-var", "DENS", "2500", "-var", "MU", "1e-07")
    large = load_folder(folder(name="other")).inputs({"DENS": 1e300, "MU": -3.0}, 7).arguments
    assert large[2::3] == ("1e+300", "-3")


@pytest.mark.parametrize("output", ["out/forces.txt", "log.liggghts"])
def test_an_output_that_lies_in_the_folder_is_refused(folder, output):
    path = folder()
    (path / output).parent.mkdir(exist_ok=True)
    (path / output).write_text("1 2 3\n")
    with pytest.raises(
        InputError, match=rf"the folder holds {output}.*old result .* remove it from the folder"
    ):
        load_folder(path)


@pytest.mark.parametrize(
    "change",
    [
        ('file = "out/forces.txt"', 'file = "./out//forces.txt"'),
        ('reads = ["out/forces.txt"]', 'reads = ["out"]'),
        ('reads = ["out/forces.txt"]', 'reads = ["out/"]'),
        ('reads = ["out/forces.txt"]', 'reads = ["."]'),
    ],
)
def test_no_other_name_of_it_passes(folder, change):
    path = folder(change)
    (path / "out").mkdir()
    (path / "out" / "forces.txt").write_text("1 2 3\n")
    with pytest.raises(InputError, match=r"the folder holds .*old result"):
        load_folder(path)


def test_an_empty_folder_may_stay(folder, run):
    path = folder(('reads = ["out/forces.txt"]', 'reads = ["out", "post"]'))
    (path / "out").mkdir()
    assert run(load_folder(path)).usable


def test_a_run_that_writes_nothing_reads_nothing_though_another_has_written(folder, run):
    good = run(load_folder(folder()), directory="first")
    stale = run(load_folder(folder(script="silent", name="other")), directory="second")
    assert good.usable and not stale.usable


def test_a_directory_that_is_there_already_is_not_used(folder, run, tmp_path):
    from calstudy.errors import SetupError

    (tmp_path / "run" / "out").mkdir(parents=True)
    (tmp_path / "run" / "out" / "forces.txt").write_text("9 9 9\n")
    with pytest.raises(SetupError, match="cannot write the run's files: File exists"):
        run(load_folder(folder()))


# ---- identity ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        ("radius = 0.002", "radius = 0.003"),
        ('log = "height ="', 'log = "height"'),
        ('finished = "all done"\n', ""),
        ("expected_seconds", 'include = "params.in"\nexpected_seconds'),
        ('file = "out/forces.txt"', 'file = "out/forces.txt"\nline = 1'),
        ('unit = "m"', 'unit = "m"\nproportional_to = "MU"'),
    ],
)
def test_what_decides_the_responses_changes_the_hash(folder, change):
    assert load_folder(folder(name="a")).hash != load_folder(folder(change, name="b")).hash


def test_files_decide_the_hash_and_the_folder_s_name_and_place_do_not(folder):
    one, moved, other = (
        load_folder(folder(name=name, script=script)) for name, script in (("a", "x"), ("b", "x"), ("c", "y"))
    )
    assert one.hash == moved.hash != other.hash


def test_the_hash_is_of_content_that_no_renaming_in_the_code_changes(folder):
    # A user's studies are of this hash: a change of it orphans them.
    assert load_folder(folder()).hash == "526afdecf5e69604f7bc8ada52fa39ac69ed0160c8b66fd4953a34f41e89a469"


def test_what_a_run_costs_does_not_change_the_hash(folder):
    cheap = load_folder(folder(name="a"))
    expensive = load_folder(folder(("expected_seconds = 2", "expected_seconds = 20"), name="b"))
    assert isinstance(cheap, FolderModel) and cheap.hash == expensive.hash


# ---- refusals ---------------------------------------------------------------------------------------

REFUSALS = {
    "script is missing": (('"in.shear"', '"in.sheer"'), "script", "in.sheer is not in the folder; correct"),
    "unknown key": (("finished =", "finish ="), "finish =", "did you mean finished"),
    "no seconds": (("expected_seconds = 2", "expected_seconds = 0"), "expected", "must be positive"),
    "radius of zero": (("radius = 0.002", "radius = 0"), "radius", "must be positive"),
    "radius is a word": (
        ("radius = 0.002", 'radius = "2 mm"'),
        "radius",
        "'2 mm', which is none of the parameters",
    ),
    "poissons_ratio": (("poissons_ratio = 0.3", "poissons_ratio = 0.5"), "poissons", r"\[0; 0.5\)"),
    "density unknown": (
        ('density = "DENS"', 'density = "RHO"'),
        "density",
        "none of the parameters .DENS, MU",
    ),
    "stiffness of zero": (("youngs_modulus = 5e6", "youngs_modulus = 0"), "youngs", "must be positive"),
    "a name with a blank": (('MU = "-"', '"M U" = "-"'), '"M U"', "is no name of a variable"),
    "no unit": (('unit = "N m"\n', ""), "[responses.torque]", "lacks unit; add it"),
    "two ways": (
        ('log = "height ="', 'log = "height ="\nfile = "x"'),
        "[responses.height]",
        "read in 2 ways",
    ),
    "no way": (('log = "height ="\n', ""), "[responses.height]", "read in 0 ways; give one of file, log"),
    "line zero": (
        ('file = "out/forces.txt"', 'file = "out/forces.txt"\nline = 0'),
        "[responses.torque]",
        "0 is none",
    ),
    "leads out": (('file = "out/forces.txt"', 'file = "../forces.txt"'), "file", "leads out of the run's"),
    "no function": (("measure.py:product", "measure.py"), "python", "no FILE:FUNCTION"),
    "wrong function": (("measure.py:product", "measure.py:sum"), "python", "has no function sum"),
    "no reads": (('reads = ["out/forces.txt"]', ""), "[responses.product]", "lacks reads; add it"),
    "proportional": (('unit = "m"', 'unit = "m"\nproportional_to = "X"'), "proportional", "X is none of the"),
    "include": (
        ("expected_seconds", 'include = "/x"\nexpected_seconds'),
        "include",
        "leads out of the folder",
    ),
    "style": (
        ("expected_seconds", 'style = "loop"\nexpected_seconds'),
        "style",
        "choose one of",
    ),
    "a name that nothing mentions": (('MU = "-"', 'MUX = "-"'), "MUX", "in.shear never uses MUX"),
    "a seed that nothing mentions": (
        ("expected_seconds", 'seeds = ["THREE"]\nexpected_seconds'),
        "seeds",
        "in.shear never uses THREE",
    ),
    "the script as include": (
        ("expected_seconds", 'include = "./in.shear"\nexpected_seconds'),
        "include",
        "is the script itself, at whose end parameters come too late; name a file",
    ),
    "an include of nobody": (
        ("expected_seconds", 'include = "numbers.in"\nexpected_seconds'),
        "include",
        "in.shear never includes numbers.in; write",
    ),
    "reads lead out": (
        ('reads = ["out/forces.txt"]', 'reads = ["../x"]'),
        "[responses.product]",
        "leads out",
    ),
    "few pixels": (
        ('file = "out/forces.txt"', 'silhouette = "heap.dump"\npixels_per_mm = 0.1'),
        "pixels_per_mm",
        "the bead must be 2 pixels across or more; give 0.5",
    ),
    "small sphere": (
        ('file = "out/forces.txt"', 'silhouette = "heap.dump"\nsphere_diameter = 0.003'),
        "sphere_diameter",
        "must be larger than a particle",
    ),
    "seeds": (
        ("expected_seconds", 'seeds = ["MU"]\nexpected_seconds'),
        "seeds",
        "names that no parameter has",
    ),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_a_mistake_in_model_toml_is_refused_with_its_line(folder, case):
    change, start, says = REFUSALS[case]
    path = folder(change)
    lines = (path / "model.toml").read_text().splitlines()
    number = next(k for k, line in enumerate(lines, 1) if line.startswith(start))
    with pytest.raises(InputError) as refused:
        load_folder(path)
    message = str(refused.value)
    assert message.startswith(f"{path / 'model.toml'}, line {number}: "), message
    assert re.search(says, message) and "\n" not in message


def test_a_picture_too_coarse_by_default_is_refused_before_any_run(folder):
    path = folder(
        ("radius = 0.002", "radius = 0.0002"), ('file = "out/forces.txt"', 'silhouette = "heap.dump"')
    )
    with pytest.raises(InputError, match=r"4.0 pixels per mm are too few: .*; give 5"):
        load_folder(path)


def test_a_linked_folder_is_refused(folder, tmp_path):
    path = folder()
    (tmp_path / "elsewhere").mkdir()
    (path / "more").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match=r"more: is a link to a folder, .*; put a folder there"):
        load_folder(path)


def test_python_that_does_not_compile_is_refused(folder):
    path = folder()
    (path / "measure.py").write_text("def product(directory)\n")
    with pytest.raises(InputError, match=r"measure\.py, line 1: .*correct it"):
        load_folder(path)


def test_an_own_model_declares_what_is_plausible_of_its_parameters_and_responses(folder):
    declared = (
        ('MU = "-"', 'MU = { unit = "-", plausible = [0.0, 1.5] }'),
        ('unit = "N m"', 'unit = "N m"\nplausible = [1e-3, 10.0]'),
    )
    plain, model = load_folder(folder()), load_folder(folder(*declared, name="other"))
    assert plain.hash == model.hash and plain.parameters == model.parameters
    assert "MU" not in plain.plausible and "torque" not in plain.plausible
    assert plain.plausible["DENS"].objection("DENS", 2.5)  # known by name and unit
    assert model.plausible["MU"].objection("MU", 1.6) and not model.plausible["MU"].objection("MU", 1.5)
    assert "N m, outside" in model.plausible["torque"].objection("torque", 11.0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (('MU = "-"', 'MU = { unit = "-", plausible = [1.5, 0.0] }'), "plausible: write .lowest, highest."),
        (('MU = "-"', "MU = { plausible = [0.0, 1.5] }"), "lacks unit"),
        (("radius = 0.002", "radius = 2"), "radius is 2 m, outside .* looks like mm: write 0.002"),
        (("youngs_modulus = 5e6", "youngs_modulus = 5"), "looks like GPa: write 5e.09"),
    ],
)
def test_a_wrong_declaration_and_implausible_particles_are_refused(folder, change, says):
    path = folder(change)
    with pytest.raises(InputError, match=says):
        load_folder(path)
    if "looks like" in says:
        assert load_folder(path, insist=True).particles


# ---- scripts that end or log in their own way ------------------------------------------------------------


def test_a_run_that_quits_after_its_mark_counts(folder, run):
    """LIGGGHTS ends ``quit`` with exit code 1."""
    assert run(load_folder(folder(script="fails after its end\n"))).outcome is Outcome.FAILED
    quits = load_folder(folder(script="quits\n", name="quits"))
    assert run(quits, directory="quitting").outcome is Outcome.OK


def test_a_log_that_the_script_moves_is_read_on_the_screen(folder, run):
    found = run(load_folder(folder(script="moves the log\n")))
    assert found.outcome is Outcome.OK
    assert found.responses["height"] == PARAMETERS["MU"]


def test_the_error_of_a_run_that_moved_its_log_is_found_on_the_screen(folder, run):
    found = run(load_folder(folder(script="moves the log\nfails after its end\n")))
    assert found.outcome is Outcome.FAILED
    assert found.reason.endswith("; output.txt ends: ERROR: no such pair style")


# ---- large folders ---------------------------------------------------------------------------------------


def test_a_folder_of_old_results_is_refused_before_it_is_read_and_a_run_can_do_without(folder):
    path = folder()
    with (path / "post" / "dump_1.txt").open("wb") as file:
        file.truncate(60_000_000)  # takes no room on disk
    with pytest.raises(
        InputError, match=r"60 MB in \d files, .*post/dump_1.txt.* name what a run needs with files"
    ):
        load_folder(path)
    toml = path / "model.toml"
    toml.write_text('files = ["in.*", "measure.py", "meshes/*"]\n' + toml.read_text())
    assert set(load_folder(path).files) == {"in.shear", "measure.py", "meshes/cell.stl"}
