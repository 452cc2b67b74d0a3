"""A stranger's script becomes a model folder that runs, by the smallest change to its text."""

import pytest

from calstudy.cli.main import main
from calstudy.models.folder import load_folder
from calstudy.models.trial.adopt import adopt

SCRIPT = """# a heap
variable friction equal 0.5   # particle-particle
variable density index 2500
variable dt equal 1e-5
variable seed1 equal 15485863
variable half equal ${density}/2
include /home/me/geometry.in
timestep ${dt}
fix m all property/global coefficientFriction peratomtypepair 1 ${friction}
fix t all particletemplate/sphere ${seed1} atom_type 1 density constant ${density}
dump d all custom 1000 post/heap.dump id x y z radius
variable angle equal 30+v_friction
print "angle of repose = ${angle} deg"
quit
"""


def test_numbers_become_variables_of_the_command_line_and_nothing_else_changes():
    adopted = adopt("in.heap", {"in.heap": SCRIPT})
    changed = adopted.files["in.heap"].splitlines()
    before = SCRIPT.splitlines()
    assert [(a, b) for a, b in zip(before, changed, strict=False) if a != b] == [
        (
            "variable friction equal 0.5   # particle-particle",
            "variable friction index 0.5   # particle-particle",
        ),
        ("variable dt equal 1e-5", "variable dt index 1e-5"),
        ("variable seed1 equal 15485863", "variable seed1 index 15485863"),
        ("include /home/me/geometry.in", "include geometry.in"),
        ("quit", 'print "calstudy: finished"'),
    ]
    assert "-variable friction equal 0.5" in adopted.changes


def test_what_the_script_prints_is_a_response_and_what_it_does_not_tell_is_asked():
    adopted = adopt("in.heap", {"in.heap": SCRIPT})
    toml = adopted.files["model.toml"]
    assert '[responses.angle_of_repose]\nunit = "deg"\nlog = "angle of repose ="' in toml
    assert 'seeds = ["seed1"]' in toml
    assert 'density = "kg/m3"' in toml
    assert "# The script writes post/heap.dump." in toml
    assert adopted.questions == ("the unit of dt",)


def test_a_script_without_results_or_variables_is_asked_for_both():
    adopted = adopt("in.bare", {"in.bare": "units si\nrun 10\n"})
    assert len(adopted.questions) == 2


def test_the_command_writes_a_folder_that_loads(tmp_path, capsys):
    (tmp_path / "in.heap").write_text(SCRIPT.replace("/home/me/", ""))
    (tmp_path / "geometry.in").write_text("variable width equal 0.1\nregion r block 0 ${width} 0 1 0 1\n")
    out = tmp_path / "models" / "heap"
    assert main(["adopt", str(tmp_path / "in.heap"), "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "+variable friction index 0.5" in shown
    assert "the unit of dt" in shown
    model = load_folder(out)
    assert set(model.parameters) == {"friction", "density", "dt", "width"}
    assert [r.name for r in model.responses] == ["angle_of_repose"]
    assert main(["adopt", str(tmp_path / "in.heap"), "--out", str(out)]) == 2
    assert "is there already" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["nosuch.in", "."])
def test_a_script_that_is_none_is_refused(tmp_path, name, capsys):
    assert main(["adopt", str(tmp_path / name), "--out", str(tmp_path / "x")]) == 2
    assert "cannot be read" in capsys.readouterr().err
