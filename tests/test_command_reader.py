"""A response is read by any executable; it and a Python function get the parameters."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from calstudy.errors import InputError, RunError
from calstudy.models.folder import load_folder
from calstudy.models.readers import PARAMETERS

HEAD = """
script = "in.heap"
expected_seconds = 1
[parameters]
MU = "-"
law = { unit = "-", values = ["hertz", "hooke"] }
[fixed]
WIDTH = 0.5
"""
SCRIPT = (
    "variable MU index 1\nvariable law index hertz\nvariable WIDTH index 1\nprint '${MU} ${law} ${WIDTH}'\n"
)
SHELL = "#!/bin/sh\ncat out.txt\n"
PYTHON = """
import json, sys
given = json.load(open(sys.argv[1]))
assert given == {"MU": 0.3, "law": "hooke", "WIDTH": 0.5}, given
print("noise that is no number")
print(json.dumps({"angle": 10 * given["MU"], "density": 2.0}))
"""


@pytest.fixture
def read(tmp_path):
    """Read a response of a run that left out.txt; the files are those of the model's folder."""

    def reading(response, name="angle", **files):
        folder, run = tmp_path / "heap", tmp_path / "run"
        folder.mkdir()
        (folder / "model.toml").write_text(f'{HEAD}[responses.{name}]\nunit = "deg"\n{response}\n')
        (folder / "in.heap").write_text(SCRIPT)
        for key, content in files.items():
            (folder / key.replace("_", ".")).write_text(content)
        model = load_folder(folder)
        run.mkdir()
        for file, content in model.files.items():
            (run / file).write_bytes(content)
        (run / "out.txt").write_text("first\n31.5\n")
        return model.read(run, {"MU": 0.3, "law": 2.0})

    return reading


@pytest.mark.parametrize(
    ("words", "value"),
    [
        (["measure.sh"], 31.5),
        (["sh", "measure.sh"], 31.5),
        (["tail", "-n", "1", "{directory}/out.txt"], 31.5),
        ([sys.executable, "measure.py", "{parameters}"], 3.0),
    ],
    ids=["own", "shell", "directory", "parameters"],
)
def test_a_command_reads_what_it_prints_last(read, words, value):
    reading = read(f"command = {words}\nreads = ['out.txt']", measure_sh=SHELL, measure_py=PYTHON)
    assert (reading.responses["angle"], reading.reason) == (pytest.approx(value), "")


@pytest.mark.parametrize(
    ("words", "reads", "says"),
    [
        (["false"], "out.txt", "false ended with exit code 1"),
        (["echo", "heap"], "out.txt", "its last line is 'heap', neither a number nor a JSON object"),
        (["echo", '{"other": 1}'], "out.txt", "a JSON object with angle"),
        (["echo", "nan"], "out.txt", "neither a number"),
        (["true"], "out.txt", "its last line is ''"),
        (["no-such-program"], "out.txt", "no-such-program cannot be started: No such file"),
        (["echo", "1"], "missing.txt", "missing.txt is not there"),
    ],
)
def test_a_command_that_gives_no_number_says_why(read, words, reads, says):
    reading = read(f"command = {words}\nreads = ['{reads}']")
    assert says in reading.reason or (says == "neither a number" and "no finite number" in reading.reason)


def test_a_python_function_of_two_arguments_gets_the_parameters(read):
    text = "def angle(directory, given):\n    assert given['law'] == 'hooke'\n    return given['MU']\n"
    assert read("python = 'read.py:angle'\nreads = []", read_py=text).responses["angle"] == 0.3


def test_a_second_argument_with_a_default_keeps_it(read):
    text = "def angle(directory, n=2):\n    return n\n"
    assert read("python = 'read.py:angle'\nreads = []", read_py=text).responses["angle"] == 2.0


def test_the_parameters_lie_in_the_runs_directory(read, tmp_path):
    read("command = ['echo', '1']\nreads = []")
    assert (tmp_path / "run" / PARAMETERS).is_file()


def test_an_executable_of_the_folder_is_no_part_of_what_makes_a_run(read, tmp_path):
    read("command = ['measure.sh']\nreads = ['out.txt']", measure_sh=SHELL)
    model = load_folder(tmp_path / "heap")
    assert model.of_readers == {"measure.sh"}
    assert model.outputs[-1] == "out.txt"


@pytest.mark.parametrize(
    "line", ["command = []\nreads = []", "command = ['a']", "command = ['a']\nreads = [1]"]
)
def test_a_command_without_words_or_outputs_is_refused(read, line):
    with pytest.raises(InputError, match=r"model\.toml, line"):
        read(line)


def test_a_command_of_a_run_that_said_nothing_is_not_asked(tmp_path):
    folder = tmp_path / "heap"
    folder.mkdir()
    (folder / "in.heap").write_text(SCRIPT)
    response = '[responses.a]\nunit = "-"\ncommand = ["echo", "1"]\nreads = []\n'
    (folder / "model.toml").write_text(f'finished = "end"\n{HEAD.lstrip()}{response}')
    (tmp_path / "run").mkdir()
    Path(tmp_path / "run" / "log.liggghts").write_text("no mark\n")
    with pytest.raises(RunError, match="does not say 'end'"):
        load_folder(folder).read(tmp_path / "run", {"MU": 0.3, "law": 1.0})
