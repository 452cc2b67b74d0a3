"""Forks of LIGGGHTS are run like LIGGGHTS-PUBLIC, and recorded as what they are."""

import json
import shlex
import sys

import pytest

from calstudy.cli.main import main
from calstudy.engines.choose import program_that_made
from calstudy.engines.profiles import LIGGGHTS
from calstudy.errors import SetupError, StoreError
from calstudy.study.settings import read_settings
from fake_liggghts import BANNER, COMMAND


def command(tmp_path, banner):
    """A LIGGGHTS with this banner, which is otherwise the tests' own."""
    (tmp_path / "fork.py").write_text(
        f"import os, sys\nif sys.argv[1:] == ['-help']:\n    print({banner!r})\n    raise SystemExit\n"
        f"words = {shlex.split(COMMAND)!r} + sys.argv[1:]\nos.execv(words[0], words)\n"
    )
    return shlex.join([sys.executable, "-S", str(tmp_path / "fork.py")])


@pytest.mark.parametrize(
    ("banner", "identity"),
    [
        (BANNER.format("3.8.0"), "LIGGGHTS 3.8.0"),
        (BANNER.format("3.8.0-fibres"), "LIGGGHTS 3.8.0-fibres"),
        ("LIGGGHTS (Version LIGGGHTS-PFM 24.01, compiled 2024-02-01-10:00:00 by x)", "LIGGGHTS PFM 24.01"),
        ("LIGGGHTS-INL (Version LIGGGHTS-INL 4.0.0)", "LIGGGHTS INL 4.0.0"),
        ("LIGGGHTS (Version 2.3.2plusplus, compiled long ago)", "LIGGGHTS 2.3.2plusplus"),
    ],
)
def test_a_fork_is_known_by_its_own_name(tmp_path, banner, identity):
    assert LIGGGHTS.find(command(tmp_path, banner)).identity == identity
    assert program_that_made(identity) == "liggghts"


@pytest.mark.parametrize("banner", ["LAMMPS (2 Aug 2023)", "LIGGGHTS", "LIGGGHTS (Version )"])
def test_what_does_not_say_its_version_is_not_taken(tmp_path, banner):
    with pytest.raises(SetupError, match="does not answer as LIGGGHTS"):
        LIGGGHTS.find(command(tmp_path, banner))


def test_a_study_by_a_fork_says_so_and_is_not_taken_for_liggghts(tmp_path, capsys, monkeypatch):
    argv = ["plan", "run", "--rows", "1", "--fidelity", "tiny", "--study", str(tmp_path / "study"), "--json"]
    fork = command(tmp_path, "LIGGGHTS (Version LIGGGHTS-PFM 24.01, compiled 2024-02-01-10:00:00 by x)")
    assert main([*argv, "--liggghts", fork]) in (0, 11)
    assert json.loads(capsys.readouterr().out)[0]["engine"] == "LIGGGHTS PFM 24.01"
    assert read_settings(tmp_path / "study").engine == "LIGGGHTS PFM 24.01"
    monkeypatch.setenv(LIGGGHTS.variable, COMMAND)
    assert main(argv) == StoreError.exit_code
    assert "the engine: LIGGGHTS PFM 24.01 → LIGGGHTS 3.8.0" in capsys.readouterr().err
