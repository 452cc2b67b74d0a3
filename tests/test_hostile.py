"""What others left in a directory: links, files that are not ours, leftovers of killed commands."""

import ast
import base64
import json
import os
import re
import shutil
import signal
import struct
import subprocess
import sys
import threading
import time
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import dask.config
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster, Security

from calstudy.cli.main import main
from calstudy.disk import ours
from calstudy.disk.files import append_line, write_atomically
from calstudy.disk.first_use import is_first_use
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.engines.cluster import _is_public
from calstudy.engines.queue import Job, run_job
from calstudy.errors import MISSED, InputError, MeasurementError, SetupError, StoreError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.find import model_folder
from calstudy.models.folder import load_folder
from calstudy.models.photograph.rules import read_beads
from calstudy.models.silhouette import read_picture
from calstudy.models.targets import RepeatedRuns, twin_in, write_twin
from calstudy.plan_file import load_plan
from calstudy.records import Evaluation, Outcome, Phase, Request, Run
from calstudy.study.directory.journal import encode, read_journal
from calstudy.study.directory.session import SESSIONS_FILE, Session
from calstudy.study.directory.store import Store, read_part
from calstudy.study.reading import read_study
from calstudy.study.run.work import Running
from calstudy.study.schema import result_line
from calstudy.study.settings import FORMAT, SETTINGS_FILE, read_settings
from calstudy.study.sweep import DESIGN_COLUMNS, read_design
from calstudy.tomlfile import read_toml
from closed_form import TRUTH, ClosedForm, run_study, study_settings, target_of, task_of, wait_for
from fake_liggghts import COMMAND

SOURCES = Path(__file__).parent.parent / "src" / "calstudy"
FOREIGN = 12345
"""Id of a user that is nobody here."""

Never = threading.Event
"""Nobody says stop."""
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a directory to another user")


@pytest.fixture
def precious(tmp_path):
    """A file of the user's, outside of any study."""
    path = tmp_path / "home" / "precious"
    path.parent.mkdir()
    path.write_text("mine\n")
    return path


# ---- links ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "place", ["analysis/report.html", "analysis/manifest.json", "analysis", "analysis/tables"]
)
def test_analysing_a_study_follows_no_link_in_it(tmp_path, precious, capsys, place):
    study = tmp_path / "study"
    run_study(study, (1,))
    link = study / place
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(precious if link.suffix else precious.parent)
    assert main(["analyse", str(study), "--only", "table2"]) == StoreError.exit_code
    assert f"{link} is a symbolic link" in capsys.readouterr().err
    assert precious.read_text() == "mine\n" and list(precious.parent.iterdir()) == [precious]


@pytest.mark.slow
@pytest.mark.parametrize(
    "place",
    ["lock", "sessions.jsonl", "study.json", "calstudy.log", "journal", "journal/row-01.jsonl", "evaluations",
     "calibrations", "runs", "calibrations/row-01.parquet", "evaluations/row-01.parquet", "pictures"],
)  # fmt: skip
def test_running_in_a_study_follows_no_link_in_it(tmp_path, monkeypatch, capsys, precious, place):
    study = tmp_path / "study"
    link = study / place
    link.parent.mkdir(parents=True)
    target = precious if link.suffix or place == "lock" else precious.parent
    link.symlink_to(target)
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    words = f"plan run --rows 1 --fidelity tiny --budget 2 --workers 1 --study {study}"
    assert main(words.split()) == StoreError.exit_code
    said = capsys.readouterr().err
    read = place.endswith(("study.json", ".parquet"))
    assert f"{link} is a symbolic link" in said or (read and f"{link} is damaged" in said)
    assert precious.read_text() == "mine\n" and list(precious.parent.iterdir()) == [precious]


def test_a_part_that_waits_for_its_name_is_no_way_in(tmp_path, precious):
    (tmp_path / ".table.part").symlink_to(precious)
    write_atomically(tmp_path / "table", b"ours", tmp_path)
    assert precious.read_text() == "mine\n" and (tmp_path / "table").read_bytes() == b"ours"


def test_a_file_that_the_user_named_may_be_a_link_or_a_device(tmp_path, precious):
    (tmp_path / "link").symlink_to(precious)
    write_atomically(tmp_path / "link", b"new")
    assert (tmp_path / "link").is_symlink() and precious.read_bytes() == b"new"
    write_atomically(Path("/dev/null"), b"gone")
    assert Path("/dev/null").is_char_device()


def test_a_study_that_the_user_reaches_through_a_link_is_one(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "near").symlink_to(tmp_path / "far")
    run_study(tmp_path / "near" / "study", (1,))
    assert (tmp_path / "far" / "study" / "calibrations" / "row-01.parquet").is_file()


def test_what_is_appended_to_is_a_file(tmp_path):
    os.mkfifo(tmp_path / "journal")
    with pytest.raises(StoreError, match="is not a regular file"):
        append_line(tmp_path / "journal", b"line\n", tmp_path)


# ---- what is removed -----------------------------------------------------------------------------


def test_leftovers_are_removed_by_our_mark_and_never_through_a_link(tmp_path, precious):
    """A study names a session, whose token matches directories of the user's elsewhere."""
    victim = precious.parent / "thesis.token.2026"
    victim.mkdir()
    (victim / "chapter").write_text("years")
    study = tmp_path / "study"
    study.mkdir()
    (study / SESSIONS_FILE).write_bytes(
        Session("token", "host", 1, "elsewhere", 1, "2026-01-01T00:00:00").line
    )
    (study / "runs").symlink_to(victim.parent)
    with pytest.raises(StoreError, match="runs is a symbolic link"):
        run_study(study, (1,))
    run_study(study, (1,), scratch=victim.parent)  # the user names it: still none of ours
    assert (victim / "chapter").read_text() == "years" and precious.read_text() == "mine\n"
    (victim / ours.MARK).symlink_to(precious)
    run_study(study, (5,), scratch=victim.parent)
    assert (victim / "chapter").exists()
    (victim / ours.MARK).unlink()
    (victim / ours.MARK).touch()
    run_study(study, (9,), scratch=victim.parent)
    assert not victim.exists(), "with our mark it is a leftover"


def test_the_token_of_a_session_leads_nowhere_else(tmp_path):
    scratch, victim = tmp_path / "scratch", tmp_path / "empty"
    (scratch / "calstudy-").mkdir(parents=True)
    victim.mkdir()
    ours.sweep(scratch, {"/../../empty", "..", "x/../../../empty"})
    assert victim.is_dir()


def test_a_link_in_a_directory_that_is_removed_is_removed_alone(tmp_path, precious):
    run = tmp_path / "scratch" / "run.token.1"
    ours.make_marked(run)
    (run / "out").symlink_to(precious.parent)
    ours.sweep(tmp_path / "scratch", {"token"})
    assert list((tmp_path / "scratch").iterdir()) == [] and precious.read_text() == "mine\n"


def test_a_directory_that_has_the_name_of_a_kept_run_stays(tmp_path):
    (tmp_path / "runs" / "run").mkdir(parents=True)
    (tmp_path / "runs" / "run" / "notes").write_text("mine")
    run_job(Job(ClosedForm(writes=True), {**TRUTH}, 1, "run", tmp_path / "runs", "token", keep=True), Never())
    assert (tmp_path / "runs" / "run" / "notes").read_text() == "mine"
    kept = [path for path in (tmp_path / "runs").iterdir() if path.name != "run"]
    assert [(path / "log").is_file() for path in kept] == [True]


# ---- scratch -------------------------------------------------------------------------------------


def test_a_scratch_directory_that_we_make_is_ours_alone(tmp_path):
    before = os.umask(0)
    try:
        assert ours.scratch_of_ours(tmp_path / "a" / "scratch", "token") == tmp_path / "a" / "scratch"
        ours.make_marked(tmp_path / "a" / "scratch" / "run")
    finally:
        os.umask(before)
    for path in (tmp_path / "a" / "scratch", tmp_path / "a" / "scratch" / "run"):
        assert path.stat().st_mode & 0o777 == 0o700


@as_root
def test_a_scratch_directory_of_another_user_is_refused(tmp_path, monkeypatch, capsys):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    scratch.chmod(0o777)
    os.chown(scratch, FOREIGN, FOREIGN)
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    words = f"plan run --rows 1 --fidelity tiny --budget 2 --study {tmp_path / 'study'} --scratch {scratch}"
    assert main(words.split()) == SetupError.exit_code
    assert f"{scratch} belongs to user {FOREIGN}, who could change what runs there" in capsys.readouterr().err
    assert list(scratch.iterdir()) == []


def test_below_a_shared_directory_runs_have_one_that_nobody_knows_before(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    made = [ours.scratch_of_ours(shared, Session.here().token) for _ in range(2)]
    assert made[0] != made[1] and all(path.parent == shared for path in made)
    assert all(path.stat().st_mode & 0o777 == 0o700 for path in made)


@as_root
def test_a_directory_that_somebody_made_in_our_place_is_refused(tmp_path):
    tmp_path.chmod(0o1777)
    (tmp_path / "calstudy-token").mkdir()
    os.chown(tmp_path / "calstudy-token", FOREIGN, FOREIGN)
    with pytest.raises(SetupError, match="somebody else made it"):
        ours.scratch_of_ours(tmp_path, "token")


def test_failed_runs_below_a_shared_directory_are_kept_and_found(tmp_path):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o1777)
    job = Job(ClosedForm(writes=True), {**TRUTH}, 1, "run", shared, "token", keep=True)
    run_job(job, Never())
    assert ours.kept(shared, "run") == shared / "calstudy-token" / "run"
    ours.sweep(shared, {"token"})
    assert (ours.kept(shared, "run") / "log").is_file(), "a session's kept runs outlast it"


def test_the_users_own_link_to_a_scratch_directory_is_followed(tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "near").symlink_to(tmp_path / "far")
    assert Running(scratch=tmp_path / "near").scratch_of(tmp_path) == tmp_path / "far"


# ---- leftovers in the temporary directory --------------------------------------------------------

HOLD = "from calstudy.disk.ours import temporary\nwith temporary() as d: print(d, flush=True); input()"


@pytest.mark.slow
def test_what_a_killed_command_left_is_swept_by_the_next_one_and_nothing_else(tmp_path, monkeypatch):
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    with (
        subprocess.Popen([sys.executable, "-c", HOLD], **pipes) as alive,
        subprocess.Popen([sys.executable, "-c", HOLD], **pipes) as dead,
    ):
        there, left = (Path(one.stdout.readline().strip()) for one in (alive, dead))
        (left / "replication.pickle").write_bytes(b"large")
        (tmp_path / "calstudy-mine").mkdir()
        (tmp_path / "calstudy-mine" / "notes").write_text("mine")
        dead.kill()
        dead.wait()
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        with ours.temporary() as own:
            assert {path.name for path in tmp_path.iterdir()} == {there.name, own.name, "calstudy-mine"}
        alive.communicate("\n")
    assert [path.name for path in tmp_path.iterdir()] == ["calstudy-mine"]


@pytest.mark.slow
def test_a_killed_sweep_leaves_nothing_that_the_next_one_does_not_sweep(tmp_path):
    design = tmp_path / "design.csv"
    environment = os.environ | {"TMPDIR": str(tmp_path / "tmp"), "CALSTUDY_LIGGGHTS": COMMAND}
    (tmp_path / "tmp").mkdir()
    design.write_text(
        "label,fidelity,variant,seed,DENS,MU_PP,MU_PW,RF_PP,RF_PW,YM\na,tiny,ring,1,2500,0.2,0.2,0.05,0.01,5.06e8\n"
    )
    words = [
        sys.executable,
        "-m",
        "calstudy",
        "sweep",
        str(design),
        "--out",
        str(tmp_path / "out"),
        "--workers",
        "1",
    ]
    hanging = subprocess.Popen(words, env=environment | {"FAKE_LIGGGHTS": "hang"}, stderr=subprocess.DEVNULL)
    wait_for(lambda: list((tmp_path / "tmp").glob("calstudy-*/*/child.pid")), 60)
    hanging.send_signal(signal.SIGKILL)
    hanging.wait()
    assert subprocess.run(words, env=environment, capture_output=True, check=True)
    assert list((tmp_path / "tmp").iterdir()) == []


# ---- one module owns this ------------------------------------------------------------------------

CHANGES = {
    "rmtree", "unlink", "remove", "rmdir", "removedirs", "rename", "renames", "symlink", "write_text",
    "write_bytes", "mkdtemp", "mkstemp", "mkdir", "makedirs", "touch", "copytree", "move",
    "TemporaryDirectory", "NamedTemporaryFile", "FileHandler", "truncate",
}  # fmt: skip
"""Calls that change a directory or a file by its path."""
NAMED, RUN, OWN = (
    "the directory that the user named",
    "a run's own directory",
    "a temporary directory of ours",
)
MAY = {
    "cli/measure.py": {"mkdir": NAMED},
    "cli/model.py": {"mkdir": NAMED, "copytree": NAMED},
    "cli/trial.py": {"mkdir": NAMED},
    "emulator/emulator.py": {"mkdir": NAMED},
    "emulator/replicates.py": {"write_bytes": OWN},
    "engines/engine.py": {"mkdir": RUN, "write_bytes": RUN},
    "engines/process.py": {"open": RUN},
    "emulator/benchmark/campaign.py": {"mkdir": NAMED},
    "models/readers.py": {"write_text": RUN},
    "report/advice/tables.py": {"mkdir": NAMED},
    "report/benchmark.py": {"mkdir": NAMED},
    "report/export.py": {"mkdir": NAMED},
    "study/directory/store.py": {"mkdir": NAMED},
    "study/run/project.py": {"mkdir": NAMED, "open": NAMED},  # the log of a command that the page starts
    "study/run/trial.py": {"mkdir": NAMED},
    "study/sweep.py": {"mkdir": NAMED},
}
"""Modules outside ``disk`` that make such calls, and where: nowhere in a study."""


def changing_calls(source: str) -> set[str]:
    """Calls of a source that change directories or files by their paths."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            modes = [
                a.value
                for a in [*node.args, *(k.value for k in node.keywords)]
                if isinstance(a, ast.Constant)
            ]
            if name in CHANGES or (name == "open" and any(set(str(m)) & set("wax+") for m in modes)):
                found.add(name)
    return found


def test_files_of_a_study_are_written_and_removed_in_one_corridor_alone():
    sources = {str(path.relative_to(SOURCES)): path.read_text() for path in SOURCES.rglob("*.py")}
    found = {name: calls for name, text in sources.items() if (calls := changing_calls(text))}
    assert {name: calls for name, calls in found.items() if name.split("/")[0] != "disk"} == {
        name: set(calls) for name, calls in MAY.items()
    }


@pytest.mark.parametrize(
    "line", ["shutil.rmtree(d)", "path.open('ab')", "open(p, mode='w')", "path.unlink()"]
)
def test_such_a_call_is_found(line):
    assert changing_calls(line)


# ---- text ----------------------------------------------------------------------------------------

TOO_MUCH = {
    "an endless whole number": ("seed = " + "1" * 5000, "a number or name of 5000 characters"),
    "a number that no float holds": ("seed = " + "1" * 400, "a number or name of 400 characters"),
    "brackets in brackets": ("x = " + "[" * 100_000, "more than 50 brackets in each other"),
    "tables in tables": ("x = " + "{a=" * 400 + "1" + "}" * 400, "more than 50 brackets in each other"),
    "a key of many parts": (".".join(["a"] * 20_000) + " = 1", "a key of more than 50 parts"),
    "a quoted key of many parts": (".".join(['"a"'] * 20_000) + " = 1", "a key of more than 50 parts"),
    "a key of many parts in a table": ("x = {" + ".".join(["a"] * 20_000) + " = 1}", "a key of more than 50"),
    "a long file": ("# " + "x" * 2_000_000, "is larger than 1 MB"),
    "a control character": ("# \x1b[31m", "holds the control character '\\x1b'"),
    "writing from right to left": ("# \u202e", "holds the control character '\\u202e'"),
}


@pytest.mark.parametrize("what", TOO_MUCH)
def test_a_toml_file_that_would_take_minutes_is_refused_in_one_line_with_its_place(tmp_path, what):
    content, says = TOO_MUCH[what]
    path = tmp_path / "file.toml"
    path.write_text(f"\n{content}\n")
    started = time.monotonic()
    with pytest.raises(InputError, match=re.escape(says)) as refused:
        read_toml(path)
    place = f"{path}: " if "MB" in says else f"{path}, line 2: "
    assert str(refused.value).startswith(place) and "\n" not in str(refused.value)
    assert time.monotonic() - started < 5


def test_what_is_many_in_a_text_or_comment_is_only_text(tmp_path):
    path = tmp_path / "file.toml"
    dots, brackets = "a." * 500, "[" * 500
    path.write_text(
        f'x = "{dots}" # {brackets}\ny = """\n{brackets}"""\nz = \'{brackets}\'\nw = [0.5, 1.5]\n'
    )
    assert read_toml(path).data["x"] == dots


@pytest.mark.parametrize("name", ["/etc", "../..", "..", "a/b", "a\\b", ""])
def test_a_model_is_a_name_and_never_a_path(tmp_path, name):
    with pytest.raises(InputError, match="a model's name is the name of its folder, not a path"):
        model_folder(name, [tmp_path])


def test_a_design_has_no_control_characters_and_seeds_that_a_table_holds(tmp_path):
    def refused(label="a", seed="1", dens="2500"):
        path = tmp_path / "design.csv"
        line = f"{label},tiny,ring,{seed},{dens},0.2,0.2,0.05,0.01,5.06e8"
        path.write_bytes(b"\xef\xbb\xbf" + f"{','.join(DESIGN_COLUMNS)}\n{line}\n".encode())
        try:
            return f"{len(read_design(path))} runs"
        except InputError as error:
            return str(error).partition(": ")[2]

    assert refused() == "1 runs", "a spreadsheet's byte order mark is no fault"
    assert refused(label="a\0b") == "holds the control character '\\x00'; remove it"
    assert refused(seed=str(2**63)) == f"it is {2**63}; give 0 to {2**63 - 1}"
    for number in ("\uff12\uff15\uff10\uff10", "\u0662\u0665\u0660\u0660", "2_500", "nan", "1e999"):
        assert "finite" in refused(dens=number)
    assert "outside the plausible range" in refused(dens="1e-300")


def test_a_twin_has_plain_numbers(tmp_path):
    model = load_model(load_plan().fixed, "tiny", "ring")
    found = RepeatedRuns(
        dict.fromkeys(model_responses(model), 20.0), dict.fromkeys(model_responses(model), 1.0), 2, 0
    )
    parameters = dict(model.reference)
    write_twin(tmp_path / "twins.csv", model, "engine", parameters, found, "command")
    assert twin_in(str(tmp_path / "twins.csv"), model, "engine").values["bulk_density"] == 20.0
    text = (tmp_path / "twins.csv").read_text()
    for number in ("2_0.0", "\u0662\u0660.0", "nan"):
        (tmp_path / "twins.csv").write_text(text.replace(",20.0,", f",{number},"))
        with pytest.raises(InputError, match="is damaged"):
            twin_in(str(tmp_path / "twins.csv"), model, "engine")


def model_responses(model):
    return [response.name for response in model.responses]


@pytest.mark.parametrize(
    "target", ["angle_of_repose_deg=95", "angle_of_repose_deg=1e308", "bulk_density=1e308"]
)
def test_a_target_that_no_heap_has_is_refused(capsys, tmp_path, target):
    values = {"angle_of_repose_deg": "22", "bulk_density": "1500"} | dict([target.split("=")])
    text = ",".join(f"{name}={value}" for name, value in values.items())
    words = f"plan run --rows 1 --fidelity tiny --dry-run --liggghts true --target {text} --study {tmp_path}"
    assert main([*words.split(), "--engine", "emulator", "--fidelity", "full"]) == InputError.exit_code
    assert "outside the plausible range" in capsys.readouterr().err


def changed(path, **values):
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | values))


@pytest.mark.parametrize("text", ["a\nb", "a\x1b[2Jb", "a\x9b31mb", "a\u202eb", "a\x7fb", "a\tb"])
def test_no_name_in_a_study_holds_a_control_character(tmp_path, capsys, text):
    run_study(tmp_path, (1,))
    settings = json.loads((tmp_path / SETTINGS_FILE).read_text())
    changed(tmp_path / SETTINGS_FILE, target=settings["target"] | {"origin": text})
    for words in (["plan", "status", "--study", str(tmp_path)], ["analyse", str(tmp_path)]):
        assert main(words) == StoreError.exit_code
        said = capsys.readouterr()
        assert "a name or text holds the control character" in said.err and text not in said.err + said.out


def test_what_a_picture_would_take_is_read_in_its_header(tmp_path):
    head = b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", struct.pack(">IIBBBBB", 30_000, 30_000, 8, 6, 0, 0, 0))
    (tmp_path / "large.png").write_bytes(head + png_chunk(b"IDAT", b"") + png_chunk(b"IEND", b""))
    started = time.monotonic()
    with pytest.raises(MeasurementError, match="more than 100 million pixels; make it smaller"):
        read_picture(tmp_path / "large.png")
    assert time.monotonic() - started < 2


def png_chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


WRONG_EMULATORS = {
    "a number that no float holds": lambda content: content["inputs"][0].update(lower=10**400),
    "a mapping for a number": lambda content: content["inputs"][0].update(lower={}),
    "a list for the origin": lambda content: content.update(origin=[1]),
    "a mapping for the ranges": lambda content: first(content)["settings"][0].update(ranges={"a": {}}),
    "a huge centre": lambda content: first(content).update(centre=10**400),
}


def first(content):
    return next(iter(content["responses"].values()))


@pytest.mark.parametrize("what", WRONG_EMULATORS)
def test_an_emulator_of_other_content_is_damaged_in_one_line(tmp_path, what):
    shutil.copytree(shipped_emulator("angle_of_repose", "full", "ring"), tmp_path / "emulator")
    path = tmp_path / "emulator" / "emulator.json"
    content = json.loads(path.read_text())
    WRONG_EMULATORS[what](content)
    path.write_text(json.dumps(content))
    with pytest.raises(StoreError, match=r"damaged|not what its version") as refused:
        read_emulator(tmp_path / "emulator")
    assert "\n" not in str(refused.value)


def test_json_that_is_nested_too_deeply_is_damaged(tmp_path):
    (tmp_path / SETTINGS_FILE).write_text("[" * 100_000)
    with pytest.raises(StoreError, match="is damaged"):
        read_settings(tmp_path)


# ---- journals ------------------------------------------------------------------------------------


def line_of(change):
    """A line of a journal with a valid checksum, after a change of what it says."""
    request = Request(1, Phase.SAMPLING, 0, dict(TRUTH), 1)
    data = json.loads(encode(Evaluation(request, "id", Run(Outcome.OK, "", {"a": 1.0}, 1.0, 1.0)))[9:])
    text = json.dumps(change(data)).encode()
    return b"%08x %s\n" % (zlib.crc32(text), text)


def put(data, *path, value):
    at = data
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    return data


UNKNOWN = {
    "a list": lambda data: [data],
    "a text": lambda data: "line",
    "a key that is not known": lambda data: put(data, "run", "temperature", value=1),
    "no request": lambda data: {"run": data["run"]},
    "a phase that is not known": lambda data: put(data, "request", "phase", value="third"),
    "a request that is none": lambda data: put(data, "request", value=7),
    "responses that are none": lambda data: put(data, "run", "responses", value=[1]),
    "a heap that is none": lambda data: put(data, "run", "heap", value="?"),
    "a heap cut short": lambda data: put(data, "run", "heap", value=packed(b"12345")),
}


def packed(content):
    return base64.b64encode(zlib.compress(content, 9)).decode()


def test_a_table_of_sixty_million_equal_lines_is_not_unpacked(tmp_path):
    table = tmp_path / "runs.parquet"
    part = pa.table(dict.fromkeys("xyz", pa.array(np.zeros(10_000_000, np.int8))))
    with pq.ParquetWriter(table, part.schema, compression="zstd") as file:
        for _ in range(6):
            file.write_table(part)
    assert table.stat().st_size < 1_000_000
    with pytest.raises(StoreError, match="has more than 50 million lines"):
        read_part(table, part.schema)
    with pytest.raises(MeasurementError, match="is not a table of beads"):
        read_beads(table)
    (tmp_path / "emulator.json").write_text("{}")
    with pytest.raises(StoreError, match="the emulator is damaged"):
        read_emulator(tmp_path)


@pytest.mark.parametrize("what", UNKNOWN)
def test_a_line_of_valid_checksum_and_other_content_counts_as_damaged(tmp_path, what):
    good = line_of(lambda data: data)
    (tmp_path / "journal").write_bytes(good + line_of(UNKNOWN[what]) + good)
    kept = read_journal(tmp_path / "journal")
    assert (len(kept.evaluations), kept.damaged) == (2, 1)


def test_a_line_that_expands_a_thousand_times_is_not_expanded(tmp_path):
    bomb = packed(bytes(300_000_000))
    assert len(bomb) < 500_000
    (tmp_path / "journal").write_bytes(line_of(lambda data: put(data, "run", "heap", value=bomb)))
    tracemalloc.start()
    kept = read_journal(tmp_path / "journal")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert kept.damaged == 1 and most < 50e6


def test_a_journal_that_is_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "journal")
    with pytest.raises(StoreError, match="is not a regular file"):
        read_journal(tmp_path / "journal")


# ---- belonging -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two_studies(tmp_path_factory):
    """Two studies of other targets, each with two rows."""
    folder = tmp_path_factory.mktemp("studies")
    run_study(folder / "a", (1, 5))
    run_study(folder / "b", (1, 5), target=target_of({**TRUTH, "MU_PP": 0.21}))
    return folder


def copies(two_studies, tmp_path):
    for name in ("a", "b"):
        shutil.copytree(two_studies / name, tmp_path / name)
    return tmp_path / "a", tmp_path / "b"


@pytest.mark.parametrize("table", ["calibrations", "evaluations", "heaps"])
@pytest.mark.parametrize("source", ["b/{}/row-01.parquet", "a/{}/row-05.parquet"])
def test_a_table_of_another_study_or_row_is_never_mixed_in(two_studies, tmp_path, table, source):
    a, _ = copies(two_studies, tmp_path)
    whole = {path: path.read_bytes() for path in a.rglob("row-*.parquet")}
    place = a / table / "row-01.parquet"
    place.write_bytes((tmp_path / source.format(table)).read_bytes())
    with pytest.raises(StoreError, match=re.escape(f"{place} is of ")):
        read_study(a)
    shutil.move(a / "journal", tmp_path / "journal")
    with pytest.raises(StoreError, match=re.escape(f"{place} is of ")):
        run_study(a, (1,))
    shutil.rmtree(a / "journal")
    shutil.move(tmp_path / "journal", a / "journal")
    campaign, _ = run_study(a, (1,))
    assert campaign.progress.runs_done == 0, "it is mended from the journal"
    assert {path: path.read_bytes() for path in whole} == whole


def a_run():
    return Run(Outcome.OK, "", {"angle_of_repose_deg": 20.0, "bulk_density": 1500.0}, 1.0, 1.0)


def test_settings_that_are_not_those_of_their_own_id_are_refused(tmp_path):
    run_study(tmp_path, (1,))
    text = (tmp_path / SETTINGS_FILE).read_text()
    assert json.loads(text)["id"] == read_settings(tmp_path).id
    for was, now in (('"seed": 7', '"seed": 8'), ('"mode": "paper"', '"mode": "papes"')):
        (tmp_path / SETTINGS_FILE).write_text(text.replace(was, now))
        with pytest.raises(StoreError, match=r"is damaged .its settings are not those of the study"):
            read_settings(tmp_path)


def test_settings_from_before_they_had_an_id_are_held_against_the_tables(tmp_path):
    run_study(tmp_path, (1,))
    content = json.loads((tmp_path / SETTINGS_FILE).read_text())
    del content["id"], content["format"]
    (tmp_path / SETTINGS_FILE).write_text(json.dumps(content))
    assert len(read_study(tmp_path).ok) == 1, "a study of calstudy 0.1 or 0.2 is read"
    (tmp_path / SETTINGS_FILE).write_text(json.dumps(content | {"seed": 8}))
    with pytest.raises(StoreError, match=f"was copied here, or {SETTINGS_FILE} was changed"):
        read_study(tmp_path)


def test_a_study_of_a_later_format_is_refused_by_name(tmp_path):
    run_study(tmp_path, (1,))
    changed(tmp_path / SETTINGS_FILE, format=FORMAT + 1, colour="blue")
    with pytest.raises(StoreError, match=f"has format {FORMAT + 1}, of a later version of calstudy"):
        read_study(tmp_path)


def test_a_journal_of_another_study_answers_nothing(two_studies, tmp_path):
    a, b = study_settings(), study_settings(seed=8)
    evaluation = Evaluation(Request(1, Phase.SAMPLING, 0, dict(TRUTH), 1), "id", a_run())
    with Store(tmp_path / "a", a) as store:
        store.record(evaluation)
    with Store(tmp_path / "b", b) as store:
        shutil.copy(tmp_path / "a" / "journal" / "row-01.jsonl", tmp_path / "b" / "journal")
        assert store.journal(1) == [] and "1 line(s) of another study left out" in store.notes[0]


ASKED = 10
"""DEM runs of row 5 that the earlier versions had made when they were interrupted."""


@pytest.mark.parametrize("version", ["0.1.0", "0.2.0"])
def test_a_study_that_an_earlier_version_wrote_is_read_and_goes_on(tmp_path, version):
    study = tmp_path / "study"
    shutil.copytree(Path(__file__).parent / "golden" / f"study-{version}", study)
    settings = read_settings(study)
    assert settings.calstudy == version and "id" not in json.loads((study / SETTINGS_FILE).read_text())
    assert list(read_study(study).ok["row"]) == [53]
    with Store(study, settings) as store:
        assert (len(store.journal(5)), store.notes, store.mended) == (ASKED, [], [])
        store.record(Evaluation(Request(5, Phase.TRIAL, 0, dict(TRUTH), 1), "id", a_run()))
        assert len(store.journal(5)) == ASKED + 1


# ---- trust ---------------------------------------------------------------------------------------


def test_the_first_use_of_a_folder_is_told_once_with_what_would_run(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    folder = tmp_path / "shear"
    folder.mkdir()
    (folder / "in.shear").write_text("include params.in\nprint ${MU}\n")
    (folder / "read.py").write_text("def torque(directory):\n    return 1.0\n")
    (folder / "model.toml").write_text(
        'script = "in.shear"\ninclude = "params.in"\nexpected_seconds = 2\nfinished = "done"\n'
        '[parameters]\nMU = "-"\n[responses.torque]\nunit = "N m"\npython = "read.py:torque"\n'
        'reads = ["post"]\n'
    )
    for times in (1, 1):
        load_folder(folder)
        told = [record.getMessage() for record in caplog.records if "first use" in record.message]
        assert len(told) == times
    assert f"first use of the model shear: in.shear, read.py will run as you; {folder}" in told[0]
    load_folder(model_folder("draw_down"))
    assert len([record for record in caplog.records if "first use" in record.message]) == 1


def test_without_a_home_directory_the_first_use_is_told_each_time(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/nowhere")
    assert is_first_use(tmp_path) and is_first_use(tmp_path)


@pytest.mark.parametrize(
    ("address", "is_public"),
    [
        ("tcp://127.0.0.1:8786", False),
        ("tcp://10.1.2.3:8786", False),
        ("tcp://8.8.8.8:8786", True),
        ("8.8.8.8:8786", True),
        ("tls://8.8.8.8:8786", False),
        ("tcp://[2001:4860:4860::8888]:1", True),
        ("inproc://a/1", False),
    ],
)
def test_an_unencrypted_public_scheduler_is_told_apart(address, is_public):
    assert _is_public(address) is is_public


@pytest.mark.slow
def test_what_a_study_says_reaches_no_report_as_markup(tmp_path):
    """A reason of a failed run and a target's origin, which a stranger may have written."""
    markup, macro = "<img src=x onerror=alert(1)>", r"\input{/etc/passwd}"
    settings = study_settings(target=replace(target_of(), origin=f"{markup} {macro}"))
    with Store(tmp_path, settings) as store:
        line = result_line(task_of(1), None, f"{markup} {macro}", [])
        store.finish(1, line, [Evaluation(Request(1, Phase.SAMPLING, 0, dict(TRUTH), 1), "id", a_run())], [])
    assert main(["analyse", str(tmp_path), "--format", "html,tex,csv"]) == 0
    page = (tmp_path / "analysis" / "report.html").read_text()
    assert markup not in page and "<script" not in page and "&lt;img src=x" in page
    texts = [path.read_text() for path in (tmp_path / "analysis").rglob("*.tex")]
    assert texts and not any(macro in text for text in texts)


@pytest.mark.slow
def test_a_cluster_with_dasks_own_encryption_runs_a_study(tmp_path):
    cert, key = str(tmp_path / "cert.pem"), str(tmp_path / "key.pem")
    made = "openssl req -x509 -newkey rsa:2048 -nodes -subj /CN=calstudy -days 2"
    subprocess.run([*made.split(), "-keyout", key, "-out", cert], check=True, capture_output=True)
    ends = {f"tls_{who}_{what}": path for who in ("client", "scheduler", "worker")
            for what, path in (("cert", cert), ("key", key))}  # fmt: skip
    with LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50, protocol="tls",
        security=Security(require_encryption=True, tls_ca_file=cert, **ends),
    ) as cluster:  # fmt: skip
        tls = {
            "require-encryption": True,
            "tls.ca-file": cert,
            "tls.client.cert": cert,
            "tls.client.key": key,
        }
        with dask.config.set({f"distributed.comm.{name}": value for name, value in tls.items()}):
            words = f"plan run --rows 1 --fidelity tiny --budget 2 --study {tmp_path / 'study'}"
            there = ["--scheduler", cluster.scheduler_address, "--liggghts", COMMAND]
            assert cluster.scheduler_address.startswith("tls://")
            assert main([*words.split(), *there]) in (0, MISSED)


# ---- what is told ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_beads_that_are_gone_are_told_and_those_that_are_kept_have_the_designs_order(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    parameters = "2500,0.2,0.2,0.05,0.01,5.06e8"

    def sweep(out, *seeds, words=("--keep-beads",)):
        lines = [",".join(DESIGN_COLUMNS), *(f"a,tiny,ring,{seed},{parameters}" for seed in seeds)]
        (tmp_path / "design.csv").write_text("\n".join(lines) + "\n")
        assert main(["sweep", str(tmp_path / "design.csv"), "--out", str(tmp_path / out), *words]) == 0
        return capsys.readouterr().err

    sweep("late", 1, 2, words=())
    assert "NOTE 2 run(s) had been made without --keep-beads" in sweep("late", 1, 2)
    assert "NOTE" not in sweep("whole", 1, 2, 3)
    sweep("parts", 3)
    sweep("parts", 1, 2, 3)
    whole, parts = ((tmp_path / name / "heaps.parquet").read_bytes() for name in ("whole", "parts"))
    assert whole == parts


def test_a_twin_on_a_full_disk_leaves_the_table_as_it_was(tmp_path, monkeypatch):
    model = load_model(load_plan().fixed, "tiny", "ring")
    means = dict.fromkeys(model_responses(model), 20.0)
    found = RepeatedRuns(means, means, 2, 0)
    write_twin(tmp_path / "twins.csv", model, "engine", dict(model.reference), found, "command")
    before = (tmp_path / "twins.csv").read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SetupError, match="No space left on device"):
        write_twin(tmp_path / "twins.csv", model, "another", dict(model.reference), found, "command")
    assert (tmp_path / "twins.csv").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["twins.csv"]


# ---- the list ------------------------------------------------------------------------------------

HELD = {
    "H1": (
        "test_analysing_a_study_follows_no_link_in_it",
        "test_no_name_in_a_study_holds_a_control_character",
    ),
    "H2": ("test_leftovers_are_removed_by_our_mark_and_never_through_a_link",),
    "H3": ("test_a_scratch_directory_of_another_user_is_refused",),
    "H4": ("test_running_in_a_study_follows_no_link_in_it",),
    "H5": ("test_no_name_in_a_study_holds_a_control_character",),
    "H6": ("test_a_model_is_a_name_and_never_a_path",),
    "H7": ("test_a_line_that_expands_a_thousand_times_is_not_expanded",),
    "H8": ("test_a_table_of_another_study_or_row_is_never_mixed_in",),
    "H9": ("test_settings_that_are_not_those_of_their_own_id_are_refused",),
    "H10": ("test_beads_that_are_gone_are_told_and_those_that_are_kept_have_the_designs_order",),
    "H11": ("test_a_twin_on_a_full_disk_leaves_the_table_as_it_was",),
    "H12": ("test_a_line_of_valid_checksum_and_other_content_counts_as_damaged",),
    "H13": ("test_a_computation_that_never_ends_does_not_keep_a_signal_from_ending_all",),
    "H14": ("test_a_path_is_never_markup_and_no_escape_code_reaches_a_file",),
    "H15": ("test_a_full_disk_behind_the_output_is_named",),
    "H16": ("test_a_toml_file_that_would_take_minutes_is_refused_in_one_line_with_its_place",),
    "H17": ("test_a_design_has_no_control_characters_and_seeds_that_a_table_holds",),
    "H18": ("test_what_a_picture_would_take_is_read_in_its_header",),
    "H19": ("test_an_emulator_of_other_content_is_damaged_in_one_line",),
    "H20": ("test_a_target_that_no_heap_has_is_refused", "test_a_twin_has_plain_numbers"),
    "H21": ("test_a_design_has_no_control_characters_and_seeds_that_a_table_holds",),
    "H22": ("test_a_launcher_in_the_command_is_refused_since_its_ranks_would_be_in_no_identity",),
    "H23": (
        "test_waiting_for_a_first_worker_says_so_and_has_a_limit",
        "test_dask_takes_the_times_of_the_example",
    ),
    "H24": ("test_what_a_killed_command_left_is_swept_by_the_next_one_and_nothing_else",),
    "Trust": (
        "test_the_first_use_of_a_folder_is_told_once_with_what_would_run",
        "test_what_a_study_says_reaches_no_report_as_markup",
        "test_a_table_of_sixty_million_equal_lines_is_not_unpacked",
        "test_a_kept_run_that_unpacks_without_end_is_no_run",
        "test_a_cluster_with_dasks_own_encryption_runs_a_study",
        "test_an_unencrypted_public_scheduler_is_told_apart",
    ),
    "Belonging": (
        "test_a_journal_of_another_study_answers_nothing",
        "test_a_study_of_a_later_format_is_refused_by_name",
        "test_a_study_that_an_earlier_version_wrote_is_read_and_goes_on",
    ),
    "Never stuck": (
        "test_a_computation_that_never_ends_does_not_outlast_a_time_limit",
        "test_a_thread_that_holds_pythons_lock_outlasts_neither_a_signal_nor_a_time_limit",
        "test_runs_that_wait_for_lost_workers_are_given_up_in_time",
    ),
    "Soak": (
        "test_a_fault_at_any_operation_on_the_disk_loses_and_repeats_no_run",
        "test_a_run_that_counts_before_it_is_on_disk_is_found",
        "test_corrupted_files_are_read_or_refused_in_one_line",
        "test_allocations_that_fail_lose_and_repeat_no_run",
        "test_no_run_begins_after_one_that_could_not_be_stored",
        "test_commands_that_are_killed_go_on_to_the_same_tables",
        "test_a_clock_that_jumps_takes_nobody_for_dead",
        "test_messages_that_nobody_reads_end_neither_the_work_nor_its_results",
        "test_no_locale_and_no_terminal_changes_what_is_written",
        "test_a_table_that_is_too_wide_is_laid_out_in_several",
    ),
    "Clusters": (
        "test_the_example_of_the_page_survives_what_happens_to_jobs",
        "test_a_job_array_survives_what_happens_to_its_elements",
        "test_eight_elements_of_which_one_is_killed_make_the_tables_of_one_process",
        "test_ranks_run_on_what_the_scheduler_was_asked_for",
        "test_a_worker_of_dask_has_processors_for_the_ranks_of_its_runs",
    ),
    "Scale": (
        "test_a_benchmark_runs",
        "test_one_thread_encodes_the_tables_of_all_rows",
        "test_finished_rows_take_no_memory_and_share_their_runs_by_their_journals",
    ),
}  # fmt: skip
"""Hostile inputs that were taken wrongly once, by their number in the list, and the tests that hold each.

Then what holds whatever the input, by its subject.
"""
PAGE = Path(__file__).parent.parent / "docs" / "appendix" / "soak.md"


def test_each_of_the_list_has_a_test_that_is_there():
    tests = "\n".join(path.read_text() for path in Path(__file__).parent.glob("test_*.py"))
    assert list(HELD)[:24] == [f"H{k}" for k in range(1, 25)]
    told = dict(re.findall(r"^\| (H\d+|[A-Z][a-z ]+) \|.*\| ([^|]*) \|$", PAGE.read_text(), re.MULTILINE))
    assert {name: tuple(re.findall(r"`(\w+)`", tests)) for name, tests in told.items()} == HELD
    assert [name for names in HELD.values() for name in names if f"def {name}(" not in tests] == []
