"""Any executable is a DEM program: it takes parameters as arguments, or as a file, and writes results."""

import json
import re
import sys
import threading

import pytest

from calstudy.cli.main import main
from calstudy.engines.choose import program_of
from calstudy.engines.engine import ProgramEngine
from calstudy.errors import InputError, SetupError
from calstudy.models.folder import load_folder
from calstudy.records import Outcome
from calstudy.study.definition import read_definition
from calstudy.study.directory.store import read_table
from calstudy.study.settings import read_settings

PROGRAM = """
import json, sys
if sys.argv[1:] == ["--version"]:
    print("Heap 4.2")
    sys.exit()
script, *given = sys.argv[1:]
assert open(script).read() == "a heap"
if given == ["json"]:
    values = json.load(open("parameters.json"))
elif given == ["csv"]:
    names, numbers = open("parameters.csv").read().split()
    values = dict(zip(names.split(","), map(float, numbers.split(","))))
elif given == ["lines"]:
    values = {}
    exec(open("parameters.py").read(), values)
else:
    values = {"MU": float(given[0].partition("=")[2]), "SEED": int(given[1])}
print("angle =", 10 + 30 * values["MU"], "of seed", values["SEED"])
print("done")
"""
MODEL = """
command = [{python}, "heap.py", "{{script}}", {arguments}]
version = ["{program}", "--version"]
script = "heap.txt"
seeds = ["SEED"]
finished = "done"
expected_seconds = 1
{more}

[parameters]
MU = "-"

[responses.angle]
unit = "deg"
log = "angle"
"""
WAYS = {
    "arguments": ('"--mu={MU}", "{SEED}"', ""),
    "json": ('"json"', 'include = "parameters.json"'),
    "csv": ('"csv"', 'include = "parameters.csv"'),
    "lines": ('"lines"', 'include = "parameters.py"'),
}


@pytest.fixture
def folder(tmp_path, coarse_profiles):
    """Make the model's folder for a way of handing parameters over."""

    def make(way="arguments", *changes):
        path = tmp_path / "heap"
        path.mkdir(exist_ok=True)
        (path / "heap.txt").write_text("a heap")
        (path / "heap.py").write_text(PROGRAM)
        arguments, more = WAYS[way]
        program = tmp_path / "version.py"
        program.write_text(PROGRAM)
        text = MODEL.format(
            python=json.dumps(sys.executable), arguments=arguments, more=more, program=program
        )
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (path / "model.toml").write_text(text)
        return path

    return make


@pytest.mark.parametrize("way", WAYS)
def test_parameters_reach_any_program(folder, tmp_path, way):
    model = load_folder(folder(way))
    engine = ProgramEngine(model, program_of(model))
    run = engine.run({"MU": 0.5}, 7, tmp_path / "run", threading.Event())
    assert run.outcome is Outcome.OK, run.reason
    assert run.responses["angle"] == 25.0


def test_its_version_is_part_of_the_runs_identity(folder):
    model = load_folder(folder())
    assert program_of(model).identity.endswith(" Heap 4.2")
    unasked = load_folder(folder("arguments", ("version = [", "# [")))
    assert program_of(unasked).identity.endswith("of unknown version")


def test_the_arguments_are_part_of_the_models_hash(folder):
    assert load_folder(folder()).hash != load_folder(folder("arguments", ("--mu=", "--friction="))).hash


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ([("--mu={MU}", "--mu=1")], "no file of the folder mentions MU"),
        ([("script =", 'program = "liggghts"\nscript =')], "command and program both say what is run"),
        ([("seeds = ", 'style = "assigned"\nseeds = ')], "style 'assigned'"),
    ],
)
def test_what_cannot_work_is_refused_with_its_line(folder, changes, says):
    path = folder("arguments", *changes)
    (path / "heap.py").write_text("print()")
    with pytest.raises(InputError, match=rf"line \d+: .*{says}|line \d+: {says}"):
        load_folder(path)


def test_a_program_that_is_not_there_names_the_key(folder):
    path = folder("arguments", (json.dumps(sys.executable), '"no-such-program"'))
    with pytest.raises(SetupError, match=r"no-such-program.*correct command in"):
        program_of(load_folder(path))


def test_it_is_tried_and_calibrated_like_any_other(folder, tmp_path, monkeypatch, capsys):
    folder("json")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heap.toml").write_text(
        'mode = "robust"\nseed = 1\nWRL = 0.0\n[[models]]\nname = "heap"\n[parameters]\nMU = [0.1, 0.9]\n'
        "[targets]\nangle = { value = 22.0, tolerance = 0.5 }\n"
    )
    assert main(["try", "heap.toml"]) == 0
    assert "angle = 37.0 of seed" in capsys.readouterr().out
    assert main(["calibrate", "heap.toml", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["dem_MU"] == pytest.approx(0.4, abs=0.02)
    assert main(["calibrate", "heap.toml", "--dry-run"]) == 0


COUNTS = """
mode = "{mode}"
seed = 1
WRL = 0.0
{samples}
[[models]]
name = "heap"
[parameters]
MU = {{ interval = {interval}, integer = {integer} }}
[targets]
angle = {{ value = 171.0, tolerance = 20.0 }}
"""
ROBUST = {"mode": "robust", "samples": "", "interval": "[1, 9]", "integer": "true"}


def test_a_parameter_that_counts_is_whole_in_every_run(folder, tmp_path, monkeypatch, capsys):
    folder("json")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heap.toml").write_text(COUNTS.format(**ROBUST))
    assert main(["calibrate", "heap.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["dem_MU"] == 5.0
    study = tmp_path / "studies" / "heap"
    runs = read_table(study, "evaluations", read_settings(study).quantities)
    assert (runs["MU"] == runs["MU"].round()).all()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"interval": "[1.5, 9]"},
            "line 9: MU counts, so its interval must begin and end with whole numbers",
        ),
        ({"integer": "1"}, "integer is 1; give true or false"),
        (
            {"mode": "paper", "samples": "samples_per_parameter = 4"},
            "mode paper takes differences that are shorter than 1",
        ),
    ],
)
def test_what_cannot_count_is_refused(folder, tmp_path, change, says):
    folder("json")
    (tmp_path / "heap.toml").write_text(COUNTS.format(**ROBUST | change))
    with pytest.raises(InputError, match=re.escape(says)):
        read_definition(tmp_path / "heap.toml")
