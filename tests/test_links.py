"""Files of a model's folder that are linked instead of copied, and templates that are filled."""

from __future__ import annotations

import os
import sys
import threading
import tracemalloc

import pytest

from calstudy.engines.choose import program_of
from calstudy.engines.engine import ProgramEngine, write_inputs
from calstudy.errors import InputError, SetupError
from calstudy.models.folder import load_folder

PROGRAM = """#!{python} -S
import sys
mesh = open("meshes/box.stl", "a" if "{mode}" == "write" else "r")
if "{mode}" == "write":
    mesh.write("x")
print("angle =", sys.argv[1])
"""
TOML = """
command = ["{program}", "{{MU}}"]
script = "heap.txt"
expected_seconds = 1
links = ["meshes/*"]
[parameters]
MU = "-"
[responses.angle]
unit = "deg"
log = "angle"
"""


@pytest.fixture
def folder(tmp_path):
    def make(mode="read", toml=TOML, size=100):
        program = tmp_path / "program"
        program.write_text(PROGRAM.format(python=sys.executable, mode=mode))
        program.chmod(0o755)
        path = tmp_path / "heap"
        (path / "meshes").mkdir(parents=True)
        (path / "heap.txt").write_text("MU\n")
        (path / "meshes" / "box.stl").write_bytes(b"solid" * (size // 5))
        (path / "model.toml").write_text(toml.format(program=program))
        return path

    return make


def test_a_linked_file_is_read_where_it_lies_and_is_part_of_the_identity(folder, tmp_path):
    path = folder()
    model = load_folder(path)
    engine = ProgramEngine(model, program_of(model))
    run = engine.run({"MU": 0.3}, 1, tmp_path / "run", threading.Event())
    assert run.responses["angle"] == 0.3
    assert (tmp_path / "run/meshes/box.stl").resolve() == path / "meshes/box.stl"
    (path / "meshes/box.stl").write_bytes(b"other")
    other = load_folder(path)
    assert other.hash != model.hash
    assert ProgramEngine(other, engine.program).making({"MU": 0.3}, 1) != engine.making({"MU": 0.3}, 1)


def test_a_run_that_writes_what_it_links_is_refused(folder, tmp_path):
    model = load_folder(folder("write"))
    with pytest.raises(SetupError, match=r"take meshes/box\.stl out of links"):
        ProgramEngine(model, program_of(model)).run({"MU": 0.3}, 1, tmp_path / "run", threading.Event())


def test_a_large_linked_file_takes_no_memory(folder, tmp_path):
    path = folder()
    with (path / "meshes/box.stl").open("wb") as file:
        os.truncate(file.fileno(), 200_000_000)
    tracemalloc.start()
    model = load_folder(path)
    write_inputs(model.inputs({"MU": 0.3}, 1), tmp_path / "run")
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()
    (path / "model.toml").write_text((path / "model.toml").read_text().replace('links = ["meshes/*"]\n', ""))
    with pytest.raises(InputError, match=r"200 MB in .* links = \['meshes/\*'\]"):
        load_folder(path)


def test_a_response_is_not_read_from_what_is_linked(folder):
    toml = TOML.replace('log = "angle"', 'file = "meshes/box.stl"')
    with pytest.raises(InputError, match=r"meshes/box\.stl is linked, so no run writes it"):
        load_folder(folder(toml=toml))


SCRIPT = "variable MU equal {{ MU }}\nvariable n equal {{n}}\nprint 'a ${MU} ${n} ${DENS} {{ MU }}'\n"
TEMPLATE = """
script = "in.heap"
expected_seconds = 1
template = ["in.heap"]
[parameters]
MU = "-"
DENS = "kg/m3"
[fixed]
n = 5
[responses.a]
unit = "-"
log = "a"
"""


def template(tmp_path, toml=TEMPLATE, script=SCRIPT):
    path = tmp_path / "heap"
    path.mkdir()
    (path / "model.toml").write_text(toml)
    (path / "in.heap").write_text(f"variable DENS index 1\n{script}")
    return path


def test_a_template_is_filled_and_what_stands_there_is_not_handed_over_again(tmp_path):
    inputs = load_folder(template(tmp_path)).inputs({"MU": 0.25, "DENS": 2500.0}, 1)
    text = inputs.files["in.heap"].decode()
    assert "variable MU equal 0.25\nvariable n equal 5\n" in text and "{{" not in text
    assert inputs.arguments == ("-var", "DENS", "2500")


@pytest.mark.parametrize(
    ("toml", "script", "says"),
    [
        (TEMPLATE, SCRIPT + "{{ RHO }}\n", "in.heap has {{ RHO }}, which is no variable"),
        (TEMPLATE, SCRIPT + "{% if MU %}\n", "only {{ NAME }} is filled in"),
        (TEMPLATE.replace('["in.heap"]', '["in.heep"]'), SCRIPT, "template in.heep is not in the folder"),
        (TEMPLATE.replace('template = ["in.heap"]\n', ""), SCRIPT, "template = ['in.heap'] in model.toml"),
    ],
)
def test_what_a_template_cannot_be_is_said(tmp_path, toml, script, says):
    with pytest.raises(InputError) as refused:
        load_folder(template(tmp_path, toml, script))
    assert says in str(refused.value)
