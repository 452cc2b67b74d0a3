"""The command as its users meet it: results, JSON, refusals in one line, documented exit codes."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import EntryPoint
from pathlib import Path

import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.errors import MISSED, SetupError
from calstudy.models.heap import RESPONSES
from calstudy.models.noise import known_noise
from calstudy.study.definition import example
from calstudy.study.directory.session import holder
from calstudy.study.directory.store import read_table
from calstudy.study.schema import TABLES, VARYING
from calstudy.study.settings import read_settings
from closed_form import wait_for
from fake_liggghts import COMMAND


@pytest.fixture(autouse=True)
def fake_liggghts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.chdir(tmp_path)


def refusal(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str]:
    """Exit code and the one line that a refused command prints."""
    capsys.readouterr()
    try:
        code = main(argv)
    except SystemExit as ended:
        code = int(ended.code or 0)
    out, err = capsys.readouterr()
    assert out == ""
    lines = err.splitlines()
    assert len(lines) == 1, err
    return code, lines[0]


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    """What a command prints that ends well; a missed target is warned of, and its exit code says so."""
    capsys.readouterr()
    code = main(argv)
    out = capsys.readouterr().out
    assert code == (MISSED if "WARNING" in out else 0)
    return out


# ---- plan -------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "variant", "said"),
    [
        ("robust", "ring", "Noise: angle_of_repose_deg 1.71, bulk_density 8.4 from seed to seed"),
        ("robust", "wide", "Noise: never measured for this model; each row estimates it"),
        ("paper", "ring", ""),
    ],
)
def test_the_noise_that_was_measured_for_the_model_is_taken_where_the_mode_takes_it(
    capsys: pytest.CaptureFixture[str], mode: str, variant: str, said: str
) -> None:
    fast = ("--rows", "1", "--fidelity", "tiny", "--variant", variant, "--study", "here")
    assert main(("plan", "run", *fast, "--mode", mode, "--budget", "1")) in (0, MISSED)
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("Noise")]
    assert [line.startswith(said) for line in lines] == ([True] if said else [])
    settings = read_settings(Path("here"))
    found = read_table(Path("here"), "calibrations").iloc[0]
    if variant == "ring" and mode == "robust":
        assert settings.noise == known_noise("angle_of_repose", settings.model_hash)
        # A narrow prior: the estimate stays near what is known.
        assert found["kriging_noise_bulk_density"] == pytest.approx(settings.noise["bulk_density"], rel=0.3)
    else:
        assert settings.noise is None


def test_the_installed_command_is_the_program() -> None:
    settings = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())
    for name, value in settings["project"]["scripts"].items():
        assert callable(EntryPoint(name, value, "console_scripts").load())


def test_export_writes_the_header_of_the_plan(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    text = run(capsys, "plan", "export")
    assert text.splitlines()[0] == "run,WRL,SPP,MU_PP,MU_PW,YM,RF_PW"
    run(capsys, "plan", "export", "--format", "parquet", "--out", "plan.parquet")
    run(capsys, "plan", "export", "--format", "json", "--out", "plan.json")
    table = pd.read_csv(io.StringIO(text)).astype(float)
    pd.testing.assert_frame_equal(pd.read_parquet("plan.parquet").astype(float), table)
    pd.testing.assert_frame_equal(
        pd.DataFrame(json.loads(Path("plan.json").read_text())).astype(float), table
    )


def test_an_exported_plan_passes_the_check(capsys: pytest.CaptureFixture[str]) -> None:
    run(capsys, "plan", "export", "--out", "plan.csv")
    result = json.loads(run(capsys, "plan", "check", "--plan", "plan.csv", "--json"))
    assert result["ok"]
    assert sum(result["samples"]) == 1728
    assert [round(a, 2) for a in result["word_lengths"][2:5]] == [0.0, 0.27, 0.49]


def test_a_plan_with_one_wrong_cell_is_refused_by_row_and_column(capsys: pytest.CaptureFixture[str]) -> None:
    text = run(capsys, "plan", "export")
    lines = text.splitlines()
    assert lines[5] == "5,0,9,1,0,0,0"
    lines[5] = "5,0,9,1,1,0,0"
    Path("wrong.csv").write_text("\n".join(lines) + "\n")
    capsys.readouterr()
    assert main(["plan", "check", "--plan", "wrong.csv"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "row 5" in message
    assert "MU_PW" in message


def test_show_tells_intervals_and_samples(capsys: pytest.CaptureFixture[str]) -> None:
    text = run(capsys, "plan", "show")
    assert "4.175e+08" in text
    assert "1728 samples" in text
    assert json.loads(run(capsys, "plan", "show", "--json"))["rows"][3]["samples"] == 15


# ---- single runs ---------------------------------------------------------------------------------


def test_simulate_prints_the_responses_by_their_column_names(capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(run(capsys, "simulate", "--set", "MU_PP=0.25", "--set", "DENS=2450", "--json"))
    assert set(RESPONSES) <= set(found)
    assert found["MU_PP"] == 0.25
    assert found["beads_filled"] > found["beads_heap"] > 0
    table = run(capsys, "simulate", "--set", "MU_PP=0.25", "--set", "DENS=2450")
    assert f"{found['angle_of_repose_deg']:.6g}" in table


def test_what_simulate_keeps_measures_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(run(capsys, "simulate", "--out", "kept", "--json"))
    names = {p.name for p in Path("kept").iterdir()}
    assert {
        "in.angle_of_repose",
        "parameters.in",
        "log.liggghts",
        "top.png",
        "side.png",
        "heap.parquet",
    } <= names
    pictures = ("kept/top.png", "kept/side.png")
    measured = json.loads(run(capsys, "measure", *pictures, "--particle-diameter-mm", "7.5", "--json"))
    for name in ("angle_of_repose_deg", "heap_radius", "heap_height"):
        assert measured[name] == pytest.approx(found[name], abs=1e-9)
    assert len(pd.read_parquet("kept/heap.parquet")) == found["beads_heap"]


def test_replicates_give_mean_and_standard_deviation(capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(run(capsys, "simulate", "--seeds", "3", "--seed", "5", "--json"))
    angles = pd.Series([r["angle_of_repose_deg"] for r in found["runs"]])
    assert angles.nunique() == 3
    assert found["angle_of_repose_deg"] == pytest.approx(angles.mean())
    assert found["angle_of_repose_deg_sd"] == pytest.approx(angles.std())


def test_doctor_says_what_it_found(capsys: pytest.CaptureFixture[str]) -> None:
    state = json.loads(run(capsys, "doctor", "--json"))
    assert state["self_test"] == "passed"
    assert COMMAND in state["liggghts"]
    assert COMMAND in state["engines"]["liggghts"] and "full-ring" in state["engines"]["emulator"]


def test_a_failed_run_ends_with_the_program_s_own_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_LIGGGHTS", "error")
    capsys.readouterr()
    assert main(["simulate"]) == 4
    assert "ERROR" in capsys.readouterr().err


# ---- refusals ---------------------------------------------------------------------------------------

REFUSED = [
    (("plan", "run", "--rows", "0"), 2, "rows: 0"),
    (("plan", "run", "--rows", "9-4"), 2, "9-4"),
    (("plan", "run", "--fidelity", "finest"), 2, "full, fast, soft, coarse, tiny"),
    (("plan", "run", "--variant", "narrow"), 2, "choose one of ring, "),
    (("plan", "run", "--mode", "best"), 2, "robust"),
    (("plan", "run", "--workers", "0"), 2, "positive"),
    (("plan", "run", "--budget", "-1"), 2, "positive"),
    (("plan", "run", "--workers", "1_0"), 2, "argument --workers: '1_0' is not a positive whole number"),
    (("plan", "run", "--fidelity", "corse"), 2, "did you mean coarse?"),
    (("plan", "run", "--engine", "emulater"), 2, "did you mean emulator?"),
    (
        ("plan", "run", "--fidelty", "soft"),
        2,
        "calstudy plan run: there is no option --fidelty; did you mean --fid",
    ),
    (
        ("plan", "run", "--target", "angle_of_repose=22,bulk_density=1500"),
        2,
        "did you mean angle_of_repose_deg?",
    ),
    (("simulate", "--model", "angle_of_repos", "--set", "DENS=2500"), 2, "did you mean angle_of_repose?"),
    (("plan", "rnu"), 2, "calstudy plan: there is no command 'rnu'; did you mean run?"),
    (("simulat",), 2, "there is no command 'simulat'; did you mean simulate?"),
    (("sweep", "nowhere.csv", "--out", "x"), 2, "nowhere.csv: cannot be read (No such file or directory)"),
    (("sweep", "nowhere.csv", "--ou", "x"), 2, "there is no option --ou; did you mean --out?"),
    (("simulate", "--set", "mu_pp=0.2"), 2, "did you mean MU_PP?"),
    (("simulate", "--set", "MU_PP=0,2"), 2, "'0,2' has a decimal comma; write 0.2"),
    (
        ("simulate", "--set", "DENS=2.5"),
        2,
        "--set DENS is 2.5 kg/m3, outside the plausible range of 25 to 25000; it looks like g/cm3",
    ),
    (("simulate", "--set", "YM=5"), 2, "it looks like GPa: write 5e+09"),
    (("twin", "--set", "RF_PP=20", "--out", "t.csv"), 2, "an angle of friction in degrees: write 0.364"),
    (
        ("plan", "run", "--target", "angle_of_repose_deg=0.384,bulk_density=1500"),
        2,
        "looks like radians: write 22",
    ),
    (("simulate", "--set", "DENS=2_500"), 2, "'2_500' is not a finite number"),
    (("simulate", "--set", "DENS=２５００"), 2, "'２５００' is not a finite number"),
    (("simulate", "--seed", "9223372036854775808"), 2, "not a whole number that is not negative"),
    (("measure", "a.png", "b.png", "--sphere-diameter-mm", "5,5"), 2, "decimal comma; write 5.5"),
    (("measure", "a.png", "b.png", "--sphere-diameter-mm", "0"), 2, "give a length in mm"),
    *[(("plan", "run", "--time-limit", t), 2, "3h30m") for t in ("soon", "", "0s", "30", "1m2h")],
    (("plan", "run", "--target", "angle_of_repose_deg=0,bulk_density=1500"), 2, "positive"),
    (("plan", "run", "--target", "bulk_density=1500"), 2, "angle_of_repose_deg"),
    (("plan", "run", "--target", "steep"), 2, "--target"),
    (("plan", "run", "--target", "twin:nowhere.csv"), 2, "calstudy twin"),
    (("plan", "run", "--plan", "nowhere.csv"), 2, "nowhere.csv"),
    (("plan", "export", "--out", "no/such/folder/x.csv"), 3, "no/such/folder"),
    (("plan", "status", "--study", "nowhere"), 6, "no study"),
    (("plan", "export", "--form", "csv"), 2, "--form"),
    (("simulate", "--set", "MU=0.2"), 2, "MU_PP"),
    (("simulate", "--set", "MU_PP=rough"), 2, "rough"),
    (("simulate", "--set", "MU_PP=-0.1"), 2, "negative"),
    (("simulate", "--set", "DENS=0"), 2, "positive"),
    (("simulate", "--set", "YM=nan"), 2, "finite"),
    (("simulate", "--liggghts", "/nowhere/liggghts"), 3, "apt-get install liggghts"),
    (("measure", "a.png", "b.png"), 5, "top picture"),
    (("frobnicate",), 2, "frobnicate"),
]


@pytest.mark.parametrize(("argv", "code", "said"), REFUSED, ids=[" ".join(r[0]) for r in REFUSED])
def test_bad_input_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], argv: tuple[str, ...], code: int, said: str
) -> None:
    got, line = refusal(capsys, *argv)
    assert got == code
    assert said in line
    assert "?;" not in line


@pytest.mark.parametrize("argv", [("simulate",), ("plan", "run", "--rows", "1"), ("twin", "--out", "t.csv")])
def test_without_liggghts_a_command_says_how_to_get_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, argv: tuple[str, ...]
) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", "")
    monkeypatch.setenv("PATH", "/nowhere")
    code, line = refusal(capsys, *argv)
    assert code == 3
    assert all(word in line for word in ("apt-get install liggghts", "--liggghts", "CALSTUDY_LIGGGHTS"))


def test_debug_shows_the_traceback_and_keeps_the_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--liggghts", "/nowhere/liggghts", "--debug"]) == SetupError.exit_code
    assert "Traceback" in capsys.readouterr().err


RUN = """label,fidelity,variant,seed,DENS,MU_PP,MU_PW,RF_PP,RF_PW,YM
a,tiny,ring,1,2500,0.2,0.2,0.05,0.01,5.06e8
"""


@pytest.mark.parametrize(
    "command",
    [
        "doctor",
        "simulate --fidelity tiny",
        "plan run --rows 1 --fidelity tiny --dry-run",
        "calibrate mine.toml --dry-run",
        "sweep runs.csv --out made",
        "twin --set MU_PP=0.2 --fidelity tiny --seeds 2 --out made",
        "plan show",
    ],
)
def test_a_command_writes_nothing_that_it_was_not_told_to_where_it_was_started(
    command: str, tmp_path: Path
) -> None:
    there = {"log.liggghts": "of the user's own run", "mine.toml": example(), "runs.csv": RUN}
    for name, content in there.items():
        (tmp_path / name).write_text(content)
    assert main(command.split()) == 0
    assert {path.name: path.read_text() for path in tmp_path.iterdir() if path.name != "made"} == there


def test_the_plan_as_json_has_all_that_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "show", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["targets"]["bulk_density"] == 1500 and found["fixed"]["restitution_pp"] == 0.89
    assert {p["name"]: p["constant"] for p in found["parameters"]}["MU_PW"] == 0.2


@pytest.mark.parametrize(
    ("command", "code", "says"),
    [
        ("simulate --out {file}", 2, "is no directory; name a new one"),
        ("simulate --out {file}/below", 3, "cannot be made: Not a directory"),
        ("twin --set MU_PP=0.2 --out {file}/below.csv", 2, "its directory does not exist"),
        ("twin --set MU_PP=0.2 --out /proc/twins.csv", 3, "/proc/twins.csv: cannot be written"),
    ],
)
def test_an_out_that_cannot_be_is_refused_before_any_run(
    capsys: pytest.CaptureFixture[str], command: str, code: int, says: str
) -> None:
    Path("file").write_text("")
    argv = command.format(file="file").split()
    assert main(argv) == code
    err = capsys.readouterr().err
    assert says in err and "DEM run(s)" not in err


def test_each_of_several_runs_has_its_seed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--fidelity", "tiny", "--seed", "4", "--seeds", "2", "--json"]) == 0
    assert [run["seed"] for run in json.loads(capsys.readouterr().out)["runs"]] == [4, 5]


def test_out_does_not_touch_a_directory_that_holds_something(capsys: pytest.CaptureFixture[str]) -> None:
    Path("precious").mkdir()
    Path("precious/thesis.tex").write_text("all of it")
    code, line = refusal(capsys, "simulate", "--out", "precious")
    assert code == 2
    assert "precious" in line
    assert Path("precious/thesis.tex").read_text() == "all of it"


# ---- plan run --------------------------------------------------------------------------------------------


STUDY = ("plan", "run", "--rows", "1,4", "--fidelity", "coarse", "--budget", "8", "--study")


def study(capsys: pytest.CaptureFixture[str], name: str, *more: str) -> str:
    return run(capsys, *STUDY, name, *more)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with a study that is finished, `mine`."""
    directory = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as here:
        here.setenv("CALSTUDY_LIGGGHTS", COMMAND)
        here.chdir(directory)
        assert main([*STUDY, "mine"]) in (0, MISSED)
    return directory


@pytest.fixture
def mine(finished: Path, tmp_path: Path) -> None:
    """That study, in the working directory."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)


@pytest.mark.slow
def test_a_study_comes_out_the_same_with_one_worker_and_two(capsys: pytest.CaptureFixture[str]) -> None:
    study(capsys, "one", "--workers", "1")
    study(capsys, "two", "--workers", "2")
    for table in TABLES:
        one, two = (
            read_table(Path(name), table).drop(columns=list(VARYING), errors="ignore")
            for name in ("one", "two")
        )
        assert len(one)
        pd.testing.assert_frame_equal(one, two)


@pytest.mark.slow
def test_another_seed_gives_another_study(mine: None, capsys: pytest.CaptureFixture[str]) -> None:
    study(capsys, "other", "--seed", "2")
    one, other = (read_table(Path(name), "evaluations")["DENS"] for name in ("mine", "other"))
    assert not set(one) & set(other)


@pytest.mark.slow
def test_a_study_is_shown_and_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    text = study(capsys, "mine")
    for name in ("row-01-heap.png", "row-04-runs.png"):
        assert (Path("mine/pictures") / name).stat().st_size > 10_000
    calibrations = pd.read_parquet(Path("mine") / "calibrations")
    assert list(calibrations["row"]) == [1, 4]
    assert list(calibrations["runs_sampling"]) == [6, 15]
    assert (calibrations["runs_optimisation"] <= 8).all()
    for value in calibrations["dem_bulk_density"]:
        assert f"{value:.5g}" in text
    status = json.loads(run(capsys, "plan", "status", "--study", "mine", "--json"))
    assert status["rows_finished"] == [1, 4]
    assert status["runs"] == calibrations["runs_total"].sum()
    assert (status["rows_underway"], status["rows_waiting"], status["runs_left"]) == ({}, [], 0)
    assert status["at_work"] is None and status["failures"] == []
    (session,) = status["sessions"]
    assert 0 < status["utilisation"] == session["utilisation"] <= 1
    assert session["did"]["runs_done"] == status["runs"] and session["state"] == "finished"
    log = Path("mine/calstudy.log").read_text()
    assert log.count(": DEM run ") == status["runs"] and "row 4: " in log
    assert "2 finished, 0 failed, 0 under way, 0 waiting" in run(capsys, "plan", "status", "--study", "mine")


@pytest.mark.slow
def test_status_tells_of_a_study_at_work_from_another_shell(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calstudy.study.directory.lock.BEAT_SECONDS", 0.05)
    begun, first, others = (Path(name).absolute() for name in ("begun", "first", "others"))
    monkeypatch.setenv("FAKE_LIGGGHTS_LOG", str(begun))
    monkeypatch.setenv("FAKE_LIGGGHTS_UNTIL", str(first))

    def one_is_done() -> bool:
        session = holder(Path("mine"))
        return session is not None and session.did.runs_done == 1

    def look() -> str:
        command = [sys.executable, "-m", "calstudy", "plan", "status", "--study", "mine", "--json"]
        try:
            wait_for(begun.exists, 60)
            monkeypatch.setenv("FAKE_LIGGGHTS_UNTIL", str(others))  # the second run lasts until it was looked
            first.touch()
            wait_for(one_is_done, 60)
            return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout
        finally:
            first.touch()
            others.touch()

    with ThreadPoolExecutor(1) as pool:
        looking = pool.submit(look)
        study(capsys, "mine", "--workers", "1")
    seen = json.loads(looking.result())
    at_work = seen["at_work"]
    assert at_work["process"] == os.getpid() and at_work["did"]["rows"] == [1, 4]
    assert set(seen["rows_finished"]) | {int(row) for row in seen["rows_underway"]} >= {1}
    assert seen["runs"] == at_work["did"]["runs_done"] == 1
    assert seen["runs_left"] > 0 and seen["seconds_left"] > 0


@pytest.mark.slow
def test_a_finished_study_is_not_run_again(capsys: pytest.CaptureFixture[str]) -> None:
    first = study(capsys, "mine")
    before = {p: p.stat().st_mtime_ns for p in Path("mine").rglob("row-*.parquet")}
    assert study(capsys, "mine") == first
    assert {p: p.stat().st_mtime_ns for p in Path("mine").rglob("row-*.parquet")} == before


@pytest.mark.slow
def test_a_study_of_other_settings_is_refused(mine: None, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["plan", "run", "--rows", "1", "--fidelity", "coarse", "--seed", "2", "--study", "mine"]) == 6
    assert "the seed: 1 → 2" in capsys.readouterr().err


def test_a_row_that_cannot_be_calibrated_is_in_the_tables_and_the_exit_code(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_LIGGGHTS", "truncated")
    capsys.readouterr()
    assert main(["plan", "run", "--rows", "1", "--fidelity", "coarse", "--study", "mine"]) == 8
    said = capsys.readouterr().out
    assert "Row 1 failed" in said
    evaluations = read_table(Path("mine"), "evaluations")
    where = Path("mine/runs") / evaluations["run_id"].iloc[-1]
    assert f"{len(evaluations)} DEM run(s) failed" in said
    assert any(str(Path("mine/runs") / run_id) in said for run_id in evaluations["run_id"])
    assert (where / "log.liggghts").exists() and "mine/calstudy.log" in said
    (failure,) = json.loads(run(capsys, "plan", "status", "--study", "mine", "--json"))["failures"]
    assert (failure["outcome"], failure["runs"], failure["row"]) == ("failed", len(evaluations), 1)
    evaluations = read_table(Path("mine"), "evaluations")
    assert set(evaluations["outcome"]) == {"failed"}
    assert evaluations["reason"].str.contains("heap.dump").all()
    assert not evaluations["reason"].str.contains("\n").any()


def test_a_time_limit_has_an_exit_code_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    argv = ("plan", "run", "--rows", "1", "--fidelity", "coarse", "--study", "mine", "--time-limit", "1s")
    assert main(argv) == 9
    assert "all are saved in mine, and the same command goes on" in capsys.readouterr().err.splitlines()[-1]


def test_shared_samples_are_counted_once_in_the_estimate(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("plan", "run", "--dry-run", "--share-samples", "--json")
    assert json.loads(run(capsys, *argv))["runs_sampling"] == 1152


def test_a_dry_run_runs_nothing_and_counts_the_samples(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("plan", "run", "--dry-run", "--study", "mine", "--json")
    estimate = json.loads(run(capsys, *argv))
    assert estimate["runs_sampling"] == 1728
    assert estimate["core_hours_expected"] > 1
    assert not Path("mine").exists()


def test_a_dry_run_counts_what_is_left(mine: None, capsys: pytest.CaptureFixture[str]) -> None:
    same = ("--fidelity", "coarse", "--budget", "8", "--study", "mine")
    argv = ("plan", "run", "--dry-run", *same, "--rows", "1,2", "--json")
    left = json.loads(run(capsys, *argv))
    assert (left["rows"], left["rows_finished"]) == (1, 1), "rows 1 and 4 are there"
    alone = json.loads(run(capsys, *argv[:-3], "--rows", "2", "--json"))
    assert left["runs_sampling"] == alone["runs_sampling"]
    assert "1 more are finished" in run(capsys, *argv[:-1])


@pytest.mark.slow
def test_a_twin_is_a_target_whose_truth_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    run(capsys, "twin", "--fidelity", "coarse", "--replicates", "3", "--out", "twins.csv")
    text = study(capsys, "mine", "--target", "twin:twins.csv")
    assert "twin's" in text
    assert "twin: mean of 3 runs" in text
    calibrations = read_table(Path("mine"), "calibrations")
    assert set(calibrations["target_kind"]) == {"twin"}
    assert calibrations["target_origin"].str.contains("known parameters").all()


@pytest.mark.slow
def test_a_target_out_of_reach_is_said_loudly(capsys: pytest.CaptureFixture[str]) -> None:
    far, near = "angle_of_repose_deg=60,bulk_density=1500", "angle_of_repose_deg=27,bulk_density=1500"
    assert "OUT OF REACH" in study(capsys, "far", "--target", far)
    assert not read_table(Path("far"), "calibrations")["reachable_angle_of_repose_deg"].any()
    near_text = study(capsys, "near", "--target", near)
    reachable = read_table(Path("near"), "calibrations")["reachable_angle_of_repose_deg"]
    assert ("OUT OF REACH" in near_text) == (not reachable.all())
    assert reachable.any()
