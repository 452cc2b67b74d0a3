"""One module asks the operating system. Without /proc, as on macOS, work goes on; Windows is refused."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import calstudy
from calstudy import machine
from calstudy.cli.main import main
from calstudy.engines import guardian
from calstudy.engines.process import run_process
from calstudy.study.directory.session import Session

SOURCES = Path(machine.__file__).parent
ASKS = re.compile(r"/proc\b|\bfcntl\b|\bkillpg\b|\bsched_getaffinity\b|\bposix_spawn\b|\bboot_id\b")


def asking(contents):
    return sorted(name for name, text in contents.items() if ASKS.search(text))


def test_one_module_alone_asks_the_operating_system():
    rooms = {path.relative_to(SOURCES).as_posix(): path.read_text() for path in SOURCES.rglob("*.py")}
    assert asking(rooms) == ["machine.py"]
    assert asking({"a.py": "Path('/proc/self')", "b.py": "import fcntl", "c.py": "processor"}) == [
        "a.py",
        "b.py",
    ]


@pytest.fixture
def no_proc(tmp_path, monkeypatch):
    """A system without /proc and without affinities; a guardian that was begun there."""
    monkeypatch.setattr(machine, "PROC", tmp_path / "no_proc")
    monkeypatch.delattr(os, "sched_getaffinity")
    guardian._guarded.cache_clear()
    yield
    guardian._guarded.cache_clear()


def test_without_proc_only_signs_of_life_tell_who_is_alive(no_proc):
    session = Session.here()
    assert session.process == os.getpid() and session.born == 0
    assert not session.ended_here  # nobody can see that
    assert session.place != machine.place()
    assert re.fullmatch(r"\S+, \d+ core\(s\)", session.machine)
    assert not machine.tells_of_processes() and list(machine.marked("x")) == []


def test_without_proc_programs_run_and_time_out(no_proc, tmp_path):
    def run(code, time_limit):
        return run_process(
            [sys.executable, "-S", "-c", code],
            directory=tmp_path,
            output=tmp_path / "output",
            time_limit=time_limit,
            stop=threading.Event(),
        )

    assert run("print(1)", 60.0).exit_code == 0
    slow = run("import time; time.sleep(60)", 0.3)
    assert slow.timed_out and slow.exit_code == -signal.SIGKILL


def test_what_was_begun_and_has_not_ended_is_left():
    assert machine.left("+12\n+34\n-12\n+5") == {34}
    assert machine.left("") == set()


PARENT = """
import os, sys, threading
from pathlib import Path
from calstudy import machine
from calstudy.engines.process import run_process
machine.PROC = Path({proc!r})
code = "import os, time; open('pid', 'w').write(str(os.getpid())); time.sleep(600)"
run_process([sys.executable, "-S", "-c", code], directory=Path({place!r}), output=Path({place!r}) / "output",
            time_limit=600.0, stop=threading.Event())
"""


def alive(process):
    """Whether a process still does something; one that has ended may be waiting for its parent."""
    fields = subprocess.run(
        ["ps", "-o", "stat=", "-p", str(process)], capture_output=True, text=True, check=False
    )
    return fields.stdout.strip()[:1] not in ("", "Z")


@pytest.mark.parametrize("proc", ["/proc", "/no_proc"])
def test_a_killed_calstudy_leaves_no_program_behind_with_proc_and_without(tmp_path, proc):
    code = PARENT.format(proc=proc, place=str(tmp_path))
    with subprocess.Popen([sys.executable, "-c", code]) as parent:
        end = time.monotonic() + 60
        while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
            assert time.monotonic() < end
            time.sleep(0.05)
        program = int((tmp_path / "pid").read_text())
        assert alive(program)
        parent.kill()
    end = time.monotonic() + 60
    while alive(program):
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize("system", ["win32", "cygwin"])
def test_windows_is_refused_with_the_remedy(monkeypatch, capsys, system):
    monkeypatch.setattr(machine.refusal, "__defaults__", (system,))
    assert main(["doctor"]) == 3
    assert "run it in WSL, the Windows Subsystem for Linux: type 'wsl --install'" in capsys.readouterr().err
    with pytest.raises(ImportError, match="run it in WSL"):
        calstudy.load_plan  # noqa: B018
    monkeypatch.setattr(machine.refusal, "__defaults__", ("darwin",))
    assert machine.refusal() is None
