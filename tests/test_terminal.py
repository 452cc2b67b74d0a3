"""What goes to the terminal, and what happens when nobody is there any more."""

import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from calstudy.cli import main as cli
from calstudy.errors import MISSED
from calstudy.report.progress import fitting, shown
from calstudy.study.directory.session import Activity, Look, activity_in_words
from fake_liggghts import COMMAND as FAKE
from same_tables import assert_same, tables

COMMAND = f"{shlex.quote(sys.executable)} -m calstudy"


def shell(command: str, cwd: Path) -> tuple[int, str, str]:
    """Exit code of ``calstudy`` in a command line of bash, and what is shown around it."""
    command = f"{command.replace('calstudy', COMMAND, 1)}; echo ${{PIPESTATUS[0]}} >code"
    done = subprocess.run(["bash", "-c", command], cwd=cwd, capture_output=True, text=True, timeout=120)
    return int((cwd / "code").read_text()), done.stdout, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        "plan show | head -1",
        "plan show --json | true",
        "plan check >&-",
        "plan show --json <&- >&-",
        "plan export | true",
        "--help | true",
    ],
)
def test_a_reader_that_has_seen_enough_is_no_failure(tmp_path: Path, command: str) -> None:
    code, _, errors = shell(f"calstudy {command}", tmp_path)
    assert (code, errors) == (0, "")


def test_a_reader_that_has_gone_does_not_change_a_bad_exit_code(tmp_path: Path) -> None:
    ways = ("", "2>&1 | true", ">&- 2>&-")
    assert [shell(f"calstudy plan nosuch {way}", tmp_path)[0] for way in ways] == [2, 2, 2]


@pytest.mark.slow
@pytest.mark.parametrize("way", ["2> >(true)", "2>/dev/full", "<&- 2>&-"])
def test_messages_that_nobody_reads_end_neither_the_work_nor_its_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """As in ``calstudy ... 2>&1 | tee log``, where Ctrl-C ends tee, too."""
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", FAKE)
    command = "twin --set MU_PP=0.2 --fidelity tiny --replicates 2 --out t.csv --json"
    code, shown, errors = shell(f"calstudy {command} {way}", tmp_path)
    assert (code, errors) == (0, "") and "bulk_density" in shown and (tmp_path / "t.csv").is_file()


STRANGE = {
    **{"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "TZ": "Pacific/Kiritimati"},
    **{"TERM": "dumb", "COLUMNS": "1", "LINES": "1"},
}
"""A machine that knows ASCII alone, is a day ahead and has a terminal of one column."""


@pytest.mark.slow
def test_no_locale_and_no_terminal_changes_what_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", FAKE)
    (tmp_path / "plain").mkdir()
    (tmp_path / "strange").mkdir()
    words = "plan run --rows 1 --fidelity tiny --budget 2 --study study"
    with monkeypatch.context() as patch:
        patch.chdir(tmp_path / "plain")
        assert cli.main(words.split()) in (0, MISSED)
    for name, value in STRANGE.items():
        monkeypatch.setenv(name, value)
    code, _, errors = shell(f"calstudy {words}", tmp_path / "strange")
    assert code in (0, MISSED) and "Traceback" not in errors and "row 1: " in errors
    plain, strange = (tables(tmp_path / name / "study") for name in ("plain", "strange"))
    assert_same(strange, plain)


def test_messages_without_end_are_dropped_once_their_reader_has_gone() -> None:
    talk = """
from calstudy.cli.main import open_streams
from calstudy.cli.terminal import messages_console
open_streams()
for _ in range(2000):
    messages_console().print("x" * 100)
print("result")
"""
    read, write = os.pipe()
    process = subprocess.Popen([sys.executable, "-c", talk], stdout=subprocess.PIPE, stderr=write, text=True)
    os.close(write)
    os.close(read)
    out, _ = process.communicate(timeout=120)
    assert (process.returncode, out) == (0, "result\n")


def test_a_name_that_is_not_utf_8_is_refused_before_any_work(tmp_path: Path) -> None:
    code, _, errors = shell("calstudy simulate --fidelity tiny --out $'st\\xff'", tmp_path)
    assert (code, errors.count("\n")) == (2, 1) and "is not UTF-8; rename" in errors
    assert [path.name for path in tmp_path.iterdir()] == ["code"]


@pytest.mark.parametrize("command", ["plan show", "plan show --json"])
def test_a_full_disk_behind_the_output_is_named(tmp_path: Path, command: str) -> None:
    code, _, errors = shell(f"calstudy {command} >/dev/full", tmp_path)
    assert (code, errors.count("\n")) == (3, 1) and "No space left on device" in errors


def test_a_file_opened_while_standard_output_is_closed_gets_none_of_it(tmp_path: Path) -> None:
    write = "from calstudy.cli.main import open_streams; open_streams(); f = open('f', 'w'); print('shown')"
    subprocess.run(
        ["bash", "-c", f"{shlex.quote(sys.executable)} -c {shlex.quote(write)} >&-"], cwd=tmp_path, check=True
    )
    assert (tmp_path / "f").read_text() == ""


def test_without_a_worker_no_time_left_is_made_up():
    words = activity_in_words(Activity(slots=0, runs_waiting=3, runs_left=3, seconds_left=60.0))
    assert words.endswith("waiting for the cluster's workers")
    assert activity_in_words(Activity(slots=1, runs_left=3, seconds_left=60.0)).endswith(
        "about 1 min 00 s left"
    )


@pytest.mark.slow
def test_a_path_is_never_markup_and_no_escape_code_reaches_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor does one that was asked for by the environment: it is a terminal that colours are for."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    for study in ("x[/b]y", "x[red]y:smile:", "x\x1b[31my"):
        command = f"plan run --rows 1 --engine emulator --fidelity coarse --study {shlex.quote(study)}"
        code, shown, errors = shell(f"calstudy {command}", tmp_path)
        log = (tmp_path / study / "calstudy.log").read_text()
        name = study.replace("\x1b", "\\x1b")
        assert (
            code in (0, MISSED) and f"Study {name}: 1 row(s)" in errors and f"  {name}/calibrations" in shown
        )
        assert name in log and "\x1b" not in shown + errors + log
    assert "\x1b" not in shell("calstudy plan check", tmp_path)[1]
    assert "x\\x1b[31m: cannot be read" in shell("calstudy sweep $'x\\e[31m' --out o", tmp_path)[2]


# ---- progress -------------------------------------------------------------------------------------

PARTS = (
    "rows 12/72 (3 failed)",
    "DEM runs 1234 of about 5678, 12 failed",
    "8 running, 98% used",
    "1 h left",
)


@pytest.mark.parametrize(("width", "kept"), [(120, (0, 1, 2, 3)), (79, (0, 1, 3)), (40, (0, 3)), (25, (0,))])
def test_a_narrow_line_keeps_what_is_done_and_what_is_left(width: int, kept: tuple[int, ...]) -> None:
    assert fitting(PARTS, width) == " · ".join(PARTS[k] for k in kept)


@pytest.mark.parametrize("width", [80, 40, None])
def test_every_row_is_told_once_and_the_progress_never_wraps(
    width: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calstudy.report.progress.LIVE_INTERVAL", 0.01)
    sink = io.StringIO()
    console = Console(file=sink, width=width, force_terminal=width is not None)
    told: list[str] = []

    def look() -> Look:
        # Several rows may end between two looks, and one before the last.
        told.extend(f"row {len(told) + k}: 25.01 deg after 34 DEM runs" for k in (1, 2))
        return Look(0.5, PARTS, tuple(told))

    with shown(look, console):
        while len(told) < 6:
            pass
    text = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", sink.getvalue()).replace("\r", "\n")
    assert [line for line in text.splitlines() if line.startswith("row ")] == told
    if width:
        bars = [line for line in text.splitlines() if "━" in line]
        assert bars and all("\n" not in line and len(line) <= width for line in bars)
        assert (
            sink.getvalue().count("\x1b[1A") <= 1
        )  # one line up, where the bar itself is removed at the end
    else:
        assert text.splitlines()[-1] in (*told, " · ".join(PARTS))


@pytest.mark.slow
def test_a_pipe_cuts_and_wraps_nothing(tmp_path: Path) -> None:
    code, out, told = shell(
        "calstudy plan run --engine emulator --rows 1,4,10-12 --study 'a b' | cat", tmp_path
    )
    rows = [line.split() for line in out.splitlines() if re.match(r" +\d", line)]
    assert [line[0] for line in rows] == ["1", "4", "10", "11", "12"]
    assert all(re.search(r" \d\.\d{1,3}e-5 ", line) for line in out.splitlines() if re.match(r" +\d", line))
    assert "DENS MU_PW RF_PP RF_PW YM" in out
    assert sorted(re.findall(r"^row (\d+): ", told, re.MULTILINE)) == ["1", "10", "11", "12", "4"]
    assert "a b/calibrations" in out and "heaps" not in out and "calstudy analyse 'a b'" in out
    assert code == MISSED and "WARNING row 1: the target angle_of_repose_deg = 22 is OUT OF REACH" in out
    assert "row 10: the target" not in out, "the optimum is near the target, though no sample was"
