"""A command loads what it works with, and nothing else: the answer to a short question does not wait."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from calstudy.cli.main import COMMANDS
from closed_form import run_study

HEAVY = ("cv2", "joblib", "matplotlib", "pandas", "pyarrow", "scipy", "sklearn", "statsmodels")
LOADED = """
import json, sys
from calstudy.cli.main import main
try:
    code = main(sys.argv[1:])
except SystemExit as end:
    code = end.code
loaded = sorted(sys.modules)
print(json.dumps([code, loaded]), file=sys.stderr)
"""


def loaded_after(*arguments, code=0):
    """Modules that a fresh process has loaded when the command has ended."""
    ended = subprocess.run([sys.executable, "-c", LOADED, *arguments], capture_output=True, text=True)
    ended_with, loaded = json.loads(ended.stderr.splitlines()[-1])
    assert ended_with == code, ended.stderr
    return set(loaded)


def heavy_after(*arguments, code=0):
    """Heavy libraries among them."""
    return loaded_after(*arguments, code=code) & {*HEAVY}


@pytest.mark.parametrize(("words", "command"), [line[:2] for line in COMMANDS])
def test_the_help_of_a_command_loads_its_options_and_nothing_that_it_works_with(words, command):
    loaded = loaded_after(*words.split(), "--help")
    assert not loaded & {"numpy", "rich", *HEAVY}
    room = f"options.{command.rpartition('.')[0]}"
    corridors = {room.rpartition(".")[0], "options"}
    rooms = {name for name in loaded if name.startswith("calstudy.cli.")}
    assert rooms == {f"calstudy.cli.{name}" for name in ("main", "options.shared", room, *corridors)}


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["plan", "--help"], ["plan", "show"], ["plan", "show", "--json"], ["plan", "check"]],
    ids=" ".join,
)
def test_what_answers_from_the_plan_loads_no_heavy_library(arguments):
    assert heavy_after(*arguments) == set()


@pytest.mark.parametrize("words", ["plan show", "plan run"])
def test_a_mistyped_option_loads_no_heavy_library(words):
    assert heavy_after(*words.split(), "--no-such-option", code=2) == set()


def test_the_plan_is_exported_with_what_writes_parquet_alone():
    assert heavy_after("plan", "export") == {"pyarrow"}


@pytest.mark.parametrize("arguments", [[], ["--json"]], ids=["table", "json"])
def test_the_status_of_a_study_loads_what_reads_its_tables_alone(tmp_path, arguments):
    run_study(tmp_path / "study", (1, 2))
    assert heavy_after("plan", "status", "--study", str(tmp_path / "study"), *arguments) == {"pyarrow"}


def test_one_dem_run_loads_what_measures_and_keeps_it_alone():
    program = f"{sys.executable} {Path(__file__).parent / 'fake_liggghts.py'}"
    assert heavy_after("simulate", "--liggghts", program) == {"cv2", "joblib", "pyarrow"}


@pytest.mark.slow
def test_a_library_that_is_loaded_is_found():
    assert "pandas" in heavy_after("analyse", "nosuch", code=6)


def test_importing_the_package_loads_nothing_but_its_version():
    program = "import sys; before = set(sys.modules); import calstudy; print(*set(sys.modules) - before)"
    loaded = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    ours = {name for name in loaded.stdout.split() if name.startswith("calstudy")}
    assert ours == {"calstudy"}
    assert not {"numpy", *HEAVY} & {name.partition(".")[0] for name in loaded.stdout.split()}


def test_the_help_of_a_group_imports_no_command():
    program = (
        "import sys; from calstudy.cli.main import main\n"
        "try: main(['plan', '--help'])\n"
        "finally: print(*sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    rooms = {name for name in ended.stdout.split() if name.startswith("calstudy.cli.")}
    assert rooms == {"calstudy.cli.main"}
