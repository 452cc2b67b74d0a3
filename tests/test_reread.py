"""What made a run is told apart from what is read of it: a corrected reader or marker costs no DEM run."""

from __future__ import annotations

import io
import json
import re
import shutil
import sys
import tarfile
import tracemalloc
from pathlib import Path

import pytest

from calstudy.cli.main import main
from calstudy.disk.kept import KeptRuns
from calstudy.models.folder import load_folder
from calstudy.study.directory.store import read_table
from calstudy.study.reread import KEPT, REREAD
from calstudy.study.settings import read_settings

pytestmark = pytest.mark.usefixtures("no_report")

PROGRAM = """#!{python} -S
import os, sys
if "-help" in sys.argv:
    print("LIGGGHTS (Version LIGGGHTS-PUBLIC 3.8.0, compiled)")
    sys.exit()
open("{calls}", "a").write("run\\n")
values = dict(line.split()[1:4:2] for line in open("params.in"))
os.makedirs("post")
open("post/result.txt", "w").write("%.6f %.6f" % (float(values["MU"]), 10 * float(values["MU"])))
open("log.liggghts", "w").write("torque = %s\\ndone\\n" % values["MU"])
"""
MODEL = {
    "script": "in.shear",
    "include": "params.in",
    "expected_seconds": 2,
    "finished": "done",
    "responses": {"torque": {"unit": "N m", "python": "read.py:torque", "reads": ["post"]}},
}
READ = "def torque(directory):\n    return float((directory / 'post/result.txt').read_text().split()[0])\n"
FILE = """
mode = "robust"
seed = 1
WRL = 0.0
[[models]]
name = "shear"
[parameters]
MU = [0.1, 0.6]
[targets]
torque = {{ value = {target}, tolerance = 0.01 }}
"""


def toml(value):
    """A value as TOML writes it."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {toml(one)}" for name, one in value.items()) + " }"
    return json.dumps(value)


@pytest.fixture(autouse=True)
def project(monkeypatch, tmp_path):
    """A project with a model, a program, and a calibration's file."""
    monkeypatch.chdir(tmp_path)
    program = tmp_path / "program"
    program.write_text(PROGRAM.format(python=sys.executable, calls=tmp_path / "calls"))
    program.chmod(0o755)
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", str(program))
    Path("shear").mkdir()
    write_model()
    Path("shear/in.shear").write_text("include params.in\nprint ${MU}\n")
    Path("shear/read.py").write_text(READ)
    Path("box.toml").write_text(FILE.format(target=0.3))


def write_model(**changes):
    lines = [f"{name} = {toml(value)}" for name, value in (MODEL | changes).items() if value is not None]
    Path("shear/model.toml").write_text("\n".join([*lines, "[parameters]", 'MU = "-"', ""]))


def calls():
    return Path("calls").read_text().count("\n") if Path("calls").exists() else 0


def calibrate(capsys, *words, codes=(0, 11)):
    assert main(["calibrate", "box.toml", *words]) in codes
    return capsys.readouterr().err


def making():
    """Identity of the making of a run of the model as it is."""
    model = load_folder(Path("shear"))
    return model.inputs({"MU": 0.3}, 1).making(1, "LIGGGHTS 3.8.0", model.ranks)


def rename_script():
    Path("shear/in.shear").rename("shear/in.box")
    write_model(script="in.box")


def helper_of_the_reader():
    Path("shear/read.py").write_text(f"import tools\n{READ}")
    Path("shear/tools.py").write_text("factor = 2\n")


@pytest.mark.parametrize(
    "change",
    [
        lambda: write_model(finished="torque"),
        lambda: write_model(finished=None),
        lambda: write_model(expected_seconds=9),
        lambda: write_model(responses=MODEL["responses"] | {"more": {"unit": "-", "log": "torque"}}),
        lambda: write_model(responses={"work": {"unit": "J", "log": "torque", "proportional_to": "MU"}}),
        lambda: Path("shear/read.py").write_text(READ.replace("[0]", "[1]")),
        helper_of_the_reader,
        rename_script,
    ],
    ids=["finished", "no_end", "seconds", "added", "renamed", "reader", "helper", "script"],
)
def test_what_is_read_of_a_run_is_no_part_of_what_makes_it(change):
    before = making()
    change()
    assert making() == before


def set_width():
    """The script sees another value of a variable that is no parameter."""
    Path("shear/in.shear").write_text("include params.in\nprint ${MU}\n# WIDTH\nprint ${WIDTH}\n")
    write_model(fixed={"WIDTH": 1.0})
    other = making()
    write_model(fixed={"WIDTH": 2.0})
    assert making() != other


@pytest.mark.parametrize(
    "change",
    [
        lambda: Path("shear/in.shear").write_text("include params.in\nprint ${MU}\nrun 1\n"),
        lambda: Path("shear/mesh.stl").write_text("solid"),
        set_width,
        lambda: write_model(ranks=2),
        lambda: Path("shear/in.shear").write_text("include params.in\nprint ${MU}\nshell python read.py\n"),
    ],
    ids=["script", "file", "fixed", "ranks", "program runs the reader"],
)
def test_what_the_program_gets_is_part_of_what_makes_a_run(change):
    before = making()
    change()
    assert making() != before


def test_a_corrected_reader_costs_no_run_that_is_kept(capsys):
    calibrate(capsys)
    before = calls()
    first = read_table(Path("studies/box"), "evaluations", read_settings(Path("studies/box")).quantities)
    Path("shear/read.py").write_text(READ.replace("[0]", "[1]"))
    Path("box.toml").write_text(FILE.format(target=3.0))
    said = calibrate(capsys, "--study", "studies/again")
    kept = len(set(first["run_id"]))
    assert f"Read anew: {kept} kept run(s) of shear" in said
    settings = read_settings(Path("studies/again"))
    again = read_table(Path("studies/again"), "evaluations", settings.quantities)
    same = first.merge(again, on=["MU", "seed"])
    assert len(same) >= kept
    assert same["torque_y"].to_numpy() == pytest.approx(10 * same["torque_x"].to_numpy(), abs=1e-4)
    assert (same["wall_time_y"] == same["wall_time_x"]).all()
    assert calls() - before == len(set(again["run_id"])) - len(set(same["run_id_y"]))
    samples = again[again["phase"] == "sampling"]
    assert set(samples["run_id"]) <= set(same["run_id_y"])


def test_a_dry_run_counts_kept_runs_and_writes_nothing(capsys):
    calibrate(capsys)
    Path("shear/read.py").write_text(READ.replace("[0]", "[1]"))
    Path("box.toml").write_text(FILE.format(target=3.0))
    assert main(["calibrate", "box.toml", "--dry-run", "--json", "--study", "studies/again"]) == 0
    assert json.loads(capsys.readouterr().out)["runs_sampling"] == 0
    assert not Path("studies", REREAD).exists()


def test_a_wrong_mark_of_the_end_is_mended_without_a_run(capsys):
    write_model(finished="never said")
    assert main(["calibrate", "box.toml"]) == 4
    assert "does not say 'never said'" in capsys.readouterr().err
    assert calls() == 1
    assert main(["reread", "box.toml"]) == 4
    assert "no kept run gives a result" in capsys.readouterr().err
    write_model()
    assert main(["reread", "box.toml"]) == 0
    assert "Read anew: 1 kept run(s) of shear. No DEM run was made." in capsys.readouterr().out
    assert calls() == 1
    assert main(["try", "box.toml"]) == 0
    assert calls() == 2  # the upper ends alone


def test_reading_anew_twice_remembers_a_run_once(capsys):
    assert main(["try", "box.toml"]) == 0
    Path("shear/read.py").write_text(READ.replace("[0]", "[1]"))
    for _ in range(2):
        assert main(["reread", "box.toml"]) == 0
    assert len(Path("studies", REREAD).read_text().splitlines()) == 2
    assert "3 kept" not in capsys.readouterr().out


def test_a_kept_run_that_gives_no_result_is_run_again(capsys):
    write_model(finished="never said")
    assert main(["try", "box.toml"]) == 4
    assert main(["try", "box.toml"]) == 4
    assert calls() == 2


@pytest.mark.parametrize("keep", [0, 0.00001])
def test_no_more_than_keep_says_is_kept(keep):
    write_model(keep=keep)
    assert main(["try", "box.toml"]) == 0
    assert not list(Path("studies").glob(f"{KEPT}/*"))


def test_a_run_is_kept_with_all_that_is_read_and_then_with_what_is_small(tmp_path):
    run = tmp_path / "run"
    (run / "post").mkdir(parents=True)
    for name, size in {"post/large": 50, "small": 10, "larger": 60, "given": 5, "changed": 5}.items():
        (run / name).write_bytes(b"x" * size)
    kept = KeptRuns(tmp_path / KEPT, ("post",), most=70)
    assert kept.keep("one", {"seed": 1}, run, {"given": b"xxxxx", "changed": b"yyyyy"})
    with tarfile.open(next((tmp_path / KEPT).iterdir())) as archive:
        assert archive.getnames() == ["run.json", "post/large", "changed", "small"]
    assert not KeptRuns(tmp_path / KEPT, ("post", "larger"), most=70).keep("two", {}, run, {})
    assert [making for making, _ in kept.all()] == ["one"]


def test_a_kept_run_that_unpacks_without_end_is_no_run(tmp_path):
    kept = KeptRuns(tmp_path, most=100)
    with tarfile.open(tmp_path / "one.tar.gz", "w:gz") as archive:
        for name, size in (("run.json", 2), ("file", 60_000_000)):
            member = tarfile.TarInfo(name)
            member.size = size
            archive.addfile(member, io.BytesIO(b"{}" + bytes(size - 2)))
    assert (tmp_path / "one.tar.gz").stat().st_size < 100_000
    assert list(kept.all()) == [("one", {})]
    tracemalloc.start()
    assert not kept.unpack("one", tmp_path / "run")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 100e6 and not (tmp_path / "run" / "file").exists()


def test_a_damaged_kept_run_is_run_again(capsys):
    assert main(["try", "box.toml"]) == 0
    for path in Path("studies", KEPT).iterdir():
        path.write_bytes(path.read_bytes()[:-30])
    Path("shear/read.py").write_text(READ.replace("[0]", "[1]"))
    assert main(["reread", "box.toml"]) == 0
    assert "no kept run was made by the models" in capsys.readouterr().out
    assert main(["try", "box.toml"]) == 0
    assert calls() == 4


def test_the_words_of_calibrate_say_how_many_runs_were_taken_over(capsys):
    assert main(["try", "box.toml"]) == 0
    Path("shear/read.py").write_text(READ + "\n")
    said = calibrate(capsys)
    assert "Read anew: 2 kept run(s) of shear" in said
    assert re.search(r"Stored: 2 run\(s\) of \S*reread.jsonl; 2 serve\(s\) as samples", said)


def refused(capsys, *words):
    assert main(["calibrate", "box.toml", *words]) == 6
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "says", "samples"),
    [
        (
            lambda: Path("shear/in.shear").write_text("include params.in\nprint ${MU}\nrun 1\nrun 2\n"),
            "shear: in.shear, lines 3 to 4: none → 'run 1'",
            r"0 stored run\(s\) serve, 5 sampling run\(s\)",
        ),
        (
            lambda: write_model(finished="torque"),
            "shear: finished: 'done' → 'torque'",
            r"\d+ stored run\(s\) serve, 0 sampling run\(s\)",
        ),
        (
            lambda: Path("shear/read.py").write_text(READ.replace("[0]", "[1]")),
            "shear: read.py, line 2: 'read_text().split()[0])' → 'read_text().split()[1])'",
            r"\d+ stored run\(s\) serve, 0 sampling run\(s\)",
        ),
        (
            lambda: Path("shear/mesh.stl").write_bytes(b"\xff\xfe"),
            "shear: mesh.stl is new",
            r"0 stored run\(s\) serve",
        ),
        (
            lambda: Path("box.toml").write_text(FILE.format(target=0.4)),
            "the target of torque: 0.3 → 0.4",
            r"\d+ stored run\(s\) serve, 0 sampling run\(s\)",
        ),
    ],
    ids=["script", "finished", "reader", "file", "target"],
)
def test_a_refusal_names_the_lines_that_changed_and_what_a_new_study_costs(capsys, change, says, samples):
    calibrate(capsys)
    before = calls()
    change()
    said = refused(capsys)
    assert says in said
    assert re.search(samples, said)
    assert re.search(r"Its result and \d+ run\(s\) stay there", said)
    assert "add --study studies/box-2" in said
    assert refused(capsys, "--dry-run") == said
    assert calls() == before


def test_a_study_from_before_models_were_told_is_refused_as_it_was(capsys):
    calibrate(capsys)
    Path("studies/box/models.json").unlink()
    write_model(finished="torque")
    assert "the model's files or fixed inputs are others" in refused(capsys)
    write_model()
    calibrate(capsys)
    assert Path("studies/box/models.json").exists()


def test_an_added_test_and_a_renamed_file_run_nothing_again(capsys):
    calibrate(capsys)
    first = read_table(Path("studies/box"), "evaluations", read_settings(Path("studies/box")).quantities)
    shutil.copytree("shear", "press")
    Path("press/in.shear").write_text("include params.in\nprint ${MU}\nprint 2\n")
    pressure = {"pressure": {"unit": "Pa", "log": "torque"}}
    Path("press/model.toml").write_text(
        Path("shear/model.toml").read_text().replace(toml(MODEL["responses"]), toml(pressure))
    )
    text = Path("box.toml").read_text().replace("[parameters]", '[[models]]\nname = "press"\n[parameters]')
    Path("renamed.toml").write_text(f"{text}pressure = {{ value = 0.3, tolerance = 0.01 }}\n")
    before = calls()
    assert main(["calibrate", "renamed.toml"]) in (0, 11)
    settings = read_settings(Path("studies/renamed"))
    runs = read_table(Path("studies/renamed"), "evaluations", settings.quantities)
    shear = runs[runs["torque"].notna() & (runs["phase"] == "sampling")]
    assert set(first["run_id"]) <= set(runs["run_id"])
    new = set(runs["run_id"]) - set(first["run_id"])
    assert calls() - before == len(new)
    assert len(set(shear["run_id"]) - set(first["run_id"])) == 0
