"""What others left in a directory: links, files that are not ours, leftovers of killed commands."""

import ast
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from calstudy.cli.main import main
from calstudy.disk import ours
from calstudy.disk.files import append_line, write_atomically
from calstudy.engines.queue import Job, run_job
from calstudy.errors import SetupError, StoreError
from calstudy.study.directory.session import SESSIONS_FILE, Session
from calstudy.study.run.work import Running
from closed_form import TRUTH, ClosedForm, run_study, wait_for
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
    "cli/model.py": {"mkdir": NAMED, "copytree": NAMED},
    "cli/trial.py": {"mkdir": NAMED},
    "emulator/emulator.py": {"mkdir": NAMED},
    "emulator/replicates.py": {"write_bytes": OWN},
    "engines/engine.py": {"mkdir": RUN, "write_bytes": RUN},
    "engines/process.py": {"open": RUN},
    "report/export.py": {"mkdir": NAMED},
    "study/directory/store.py": {"mkdir": NAMED},
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
