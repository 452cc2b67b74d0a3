"""What scripts/setup and .ci/run do on machines of all kinds, with stand-ins for the machine's programs."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
TOOLS = ("bash", "dirname", "env", "head", "mktemp", "rm", "tail", "cat", "mkdir", "cp", "chmod")
PYTHON = """#!/bin/bash
echo "$0 $*" >>calls
case "$*" in
    *"< (3, 11)"*) [ {late} = yes ] ;;
    *print*) echo 3.{minor} ;;
    --version) echo Python 3.{minor}.1 ;;
    "-m venv --clear .venv") rm -rf .venv; mkdir -p .venv/bin; cp "$0" .venv/bin/python ;;
    "-m pip --version") echo "pip 25.1 from /somewhere (python 3.{minor})" ;;
    "-m pip "*install*) {install} ;;
esac
"""


class Machine:
    """A clone below a directory with a space in its name, and the programs of a machine."""

    def __init__(self, folder: Path) -> None:
        self.clone, self.bin = folder / "my clone", folder / "bin"
        (self.clone / "scripts").mkdir(parents=True)
        self.bin.mkdir()
        shutil.copy(ROOT / "scripts" / "setup", self.clone / "scripts")
        for name in TOOLS:
            (self.bin / name).symlink_to(shutil.which(name) or name)
        self.has("liggghts", "")
        self.has("id", "echo 1000")
        self.has("python3", PYTHON.format(late="yes", minor=11, install="true"))

    def has(self, name: str, script: str) -> Path:
        path = self.bin / name
        path.write_text(script if script.startswith("#!") else f"#!/bin/bash\n{script}\n")
        path.chmod(0o755)
        return path

    def lacks(self, name: str) -> None:
        (self.bin / name).unlink()

    def sets_up(self, **environment: str) -> tuple[int, list[str], str]:
        """Exit code, lines of standard error, and the calls of Python."""
        done = subprocess.run(
            ["bash", "-c", ". scripts/setup '[test]'"],
            cwd=self.clone,
            env={"PATH": str(self.bin), **environment},
            capture_output=True,
            text=True,
        )
        calls = self.clone / "calls"
        return done.returncode, done.stderr.splitlines(), calls.read_text() if calls.exists() else ""


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_a_second_time_it_makes_nothing_anew(machine: Machine) -> None:
    for _ in range(2):
        code, errors, calls = machine.sets_up()
        assert (code, errors) == (0, [])
    assert calls.count("-m venv") == 1 and calls.count("install --quiet --editable .[test]") == 2


def test_a_python_that_is_not_there_is_named(machine: Machine) -> None:
    code, errors, calls = machine.sets_up(PYTHON="/nosuch")
    assert (code, calls, len(errors)) == (3, "", 1) and "PYTHON=/nosuch is not a program" in errors[0]


def test_a_python_that_is_too_old_is_named_before_anything_is_installed(machine: Machine) -> None:
    machine.lacks("liggghts")
    machine.has("python3", PYTHON.format(late="no", minor=10, install="true"))
    code, errors, _ = machine.sets_up()
    assert (code, len(errors)) == (3, 1) and "python3 is Python 3.10.1" in errors[0]


def test_who_is_not_root_and_has_no_sudo_is_told_what_to_run(machine: Machine) -> None:
    machine.lacks("liggghts")
    machine.has("apt-get", "touch called")
    code, errors, _ = machine.sets_up()
    assert (code, len(errors)) == (3, 1) and "run as root: apt-get install liggghts" in errors[0]
    assert not (machine.clone / "called").exists()


def test_without_a_network_the_packages_that_are_missing_are_named(machine: Machine) -> None:
    machine.lacks("liggghts")
    machine.has("sudo", 'exec "$@"')
    machine.has("apt-get", "echo E: Unable to locate package liggghts; exit 100")
    code, errors, _ = machine.sets_up()
    assert code == 3 and errors[0].startswith("E: Unable to locate")
    assert "could not be installed: liggghts; is there a network?" in errors[-1]


def test_a_liggghts_of_ones_own_needs_no_package(machine: Machine) -> None:
    machine.lacks("liggghts")
    assert machine.sets_up(CALSTUDY_LIGGGHTS="/opt/liggghts")[:2] == (0, [])


def test_pip_that_fails_is_an_error_with_a_remedy(machine: Machine) -> None:
    machine.has("python3", PYTHON.format(late="yes", minor=11, install="echo no route to host >&2; exit 1"))
    code, errors, _ = machine.sets_up()
    assert code == 3 and errors[0] == "no route to host" and "the same command goes on" in errors[-1]


@pytest.mark.parametrize("broken", ["none", "unfinished", "dangling", "other"])
def test_an_environment_that_cannot_be_used_is_made_anew(machine: Machine, broken: str) -> None:
    inside = machine.clone / ".venv" / "bin" / "python"
    if broken != "none":
        inside.parent.mkdir(parents=True)
    if broken == "unfinished":
        shutil.copy(machine.has("half", "exit 1"), inside)
    elif broken == "dangling":
        inside.symlink_to("/nosuch/python3.11")
    elif broken == "other":
        other = machine.has("python3.12", PYTHON.format(late="yes", minor=12, install="true"))
        shutil.copy(other, inside)
    code, errors, calls = machine.sets_up()
    assert (code, errors) == (0, []) and calls.count("-m venv --clear .venv") == 1


def test_ci_runs_tests_and_site_in_the_environment_of_a_fresh_machine(tmp_path: Path) -> None:
    for name in (".ci", "scripts"):
        (tmp_path / name).mkdir()
    shutil.copy(ROOT / ".ci" / "run", tmp_path / ".ci")
    for name, program in {"test": "env", "docs": "echo site=$1"}.items():
        (tmp_path / "scripts" / name).write_text(f"#!/usr/bin/env bash\n{program}\n")
        (tmp_path / "scripts" / name).chmod(0o755)
    hiding = {
        "PYTHONUNBUFFERED": "1",
        "PYTHONPATH": "/ours",
        "COLUMNS": "200",
        "CI": "true",
        "MPLBACKEND": "agg",
    }
    reaching = {
        "PIP_CERT": "/a b.crt",
        "SSL_CERT_FILE": "/c.crt",
        "https_proxy": "p",
        "REQUESTS_CA_BUNDLE": "/d.crt",
    }
    done = subprocess.run(
        ["bash", ".ci/run"],
        cwd=tmp_path,
        env={"PATH": "/ours:/usr/bin:/bin", "HOME": "/h", **hiding, **reaching},
        capture_output=True,
        text=True,
        check=True,
    )
    there = dict(line.split("=", 1) for line in done.stdout.splitlines())
    assert there.pop("site") == "--quick"
    assert reaching.items() <= there.items() and "/ours" not in there["PATH"]
    assert set(there) - set(reaching) <= {"HOME", "LANG", "PATH", "PWD", "SHLVL", "_", "OLDPWD"}
