"""``calstudy calibrate`` as its users meet it, and several models in one cost."""

from __future__ import annotations

import json
import re
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.calibration.cost import Cost
from calstudy.calibration.task import Task
from calstudy.cli.main import main
from calstudy.engines.queue import LocalExecutor
from calstudy.errors import MISSED, Stopped
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, PARAMETER_UNITS
from calstudy.plan import PARAMETERS
from calstudy.rayleigh import Particles
from calstudy.records import RAYLEIGH_TIME_STEP, Target
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign
from calstudy.study.definition import example
from calstudy.study.directory.store import Store, read_table
from calstudy.study.run.taking import settings_of
from calstudy.study.schema import VARYING
from calstudy.study.settings import Case, read_settings
from closed_form import PAPER, PLAN, TRUTH, ClosedForm, responses, study_settings
from fake_liggghts import COMMAND

TINY = (('fidelity = "soft"', 'fidelity = "tiny"'), ("YM = [4.175e8, 6.5e8]", "YM = 5.06e8"))
NEAR = (
    ("value = 22.0, tolerance = 2.0", "value = 26.0, tolerance = 1.5"),
    ("tolerance = 15.0", "tolerance = 40.0"),
)


@pytest.fixture(autouse=True)
def fake_liggghts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, coarse_profiles: None) -> None:
    monkeypatch.setenv("CALSTUDY_LIGGGHTS", COMMAND)
    monkeypatch.setenv("FAKE_LIGGGHTS_LOG", str(tmp_path / "called"))
    monkeypatch.chdir(tmp_path)


def written(*changes: tuple[str, str], name: str = "beads.toml") -> str:
    text = example()
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    Path(name).write_text(text)
    return name


def said(capsys: pytest.CaptureFixture[str], *argv: str, code: int = 0) -> tuple[str, str]:
    capsys.readouterr()
    assert main(["calibrate", *argv]) == code
    return capsys.readouterr()


def calls() -> int:
    return len(Path("called").read_text().split()) if Path("called").exists() else 0


# ---- the command ------------------------------------------------------------------------------------


def test_init_writes_an_example_once(capsys: pytest.CaptureFixture[str]) -> None:
    out, _ = said(capsys, "--init")
    assert Path("calibration.toml").read_text() == example() and "calibration.toml written" in out
    _, err = said(capsys, "--init", code=2)
    assert "calibration.toml is there already; name another file" in err
    said(capsys, "--init", "other.toml")
    assert Path("other.toml").read_text() == example()


def test_without_a_file_the_way_to_one_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    _, err = said(capsys, code=2)
    assert "write one with --init" in err


def test_a_wrong_file_is_refused_before_any_run(capsys: pytest.CaptureFixture[str]) -> None:
    _, err = said(capsys, written(("[0.1, 0.3]", "[0.3, 0.1]")), code=2)
    assert re.search(r"beads\.toml, line \d+: the interval of MU_PP goes from 0.3 to 0.1", err)
    assert calls() == 0 and not Path("studies").exists()


def test_a_dry_run_says_the_cost_and_runs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    out, _ = said(capsys, written(), "--dry-run", "--json")
    assert json.loads(out)["runs_sampling"] == 7  # robust, four parameters
    assert calls() == 0


def test_a_dry_run_counts_runs_that_follow_one_another(capsys: pytest.CaptureFixture[str]) -> None:
    one, many = (
        json.loads(said(capsys, written(), "--dry-run", "--json", "--workers", str(workers))[0])
        for workers in (1, 100)
    )
    middle = TRUTH | {"DENS": 2500.0, "YM": 0.5 * (4.175e8 + 6.5e8)}
    each = load_model(PLAN.fixed, "soft").expected_seconds_at(middle)
    assert one["elapsed_seconds_expected"] == round((7 + 4 + 4) * each)
    assert many["elapsed_seconds_expected"] == round(6 * each)  # the samples, four, and the confirmation


@pytest.mark.slow
def test_the_commands_for_a_plan_say_what_a_calibration_of_ones_own_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    out, _ = said(capsys, written(*TINY, *NEAR))
    assert "the second optimisation ended: all responses are within their tolerances" in out
    assert main(["plan", "status", "--study", "studies/beads"]) == 0
    assert "studies/beads: a calibration, tiny fidelity" in capsys.readouterr().out
    assert main(["analyse", "studies/beads"]) == 2
    assert "its results are in studies/beads/report/report.html" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("no_report")
def test_what_has_changed_since_is_said_in_words_by_the_dry_run_too_and_the_remedy_works(
    capsys: pytest.CaptureFixture[str],
) -> None:
    said(capsys, written(*TINY, *NEAR))
    before = calls()
    assert json.loads(said(capsys, "beads.toml", "--dry-run", "--json")[0])["runs_sampling"] == 0  # finished
    written(*TINY, NEAR[1], (NEAR[0][0], "value = 27.0, tolerance = 1.5"), ("[0.1, 0.3]", "[0.1, 0.35]"))
    says = "the target of angle_of_repose_deg: 26 → 27; the interval of MU_PP: [0.1, 0.3] → [0.1, 0.35]"
    out, err = said(capsys, "beads.toml", "--dry-run", code=6)
    assert "8 sampling runs" in out or "7 sampling runs" in out
    assert says in err and "{" not in err
    assert says in said(capsys, "beads.toml", code=6)[1] and calls() == before
    remedy = re.search(r"add (--study) (\S+):", err)
    assert remedy and remedy.groups() == ("--study", "studies/beads-2")
    said(capsys, "beads.toml", *remedy.groups())
    assert calls() > before


DENSITY_ALONE = ("angle_of_repose_deg = { value = 22.0, tolerance = 2.0 }", "")


@pytest.mark.slow
def test_a_run_counts_if_it_gives_what_is_calibrated_to(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FAKE_LIGGGHTS", "flat")  # no heap stands, so no angle; a bulk density is there
    out, _ = said(capsys, written(*TINY, DENSITY_ALONE), "--json", "--workers", "2", code=MISSED)
    result = json.loads(out)
    runs = read_table(Path("studies/beads"), "evaluations", read_settings(Path("studies/beads")).quantities)
    assert set(runs["outcome"]) == {"no_heap"} and runs[BULK_DENSITY].notna().all()
    assert (result["runs_failed"], result["samples_left_out"]) == (0, 0)
    assert abs(result[f"dem_{BULK_DENSITY}"] - 1500.0) < 50


@pytest.mark.slow
def test_the_lines_to_paste_are_those_of_the_walls_that_were_run(capsys: pytest.CaptureFixture[str]) -> None:
    said(capsys, written(*TINY, *NEAR, ('variant = "ring"', 'variant = "steel_walls"')), "--workers", "2")
    lines = Path("studies/beads/report/parameters.in").read_text()
    assert re.search(r"youngsModulus peratomtype 506000000.0 210000000000.0$", lines, re.MULTILINE)
    assert re.search(r"poissonsRatio peratomtype 0.22 0.3$", lines, re.MULTILINE)


def test_a_calibration_answers_with_all_that_comes_out(capsys: pytest.CaptureFixture[str]) -> None:
    out, err = said(capsys, written(*TINY, *NEAR), "--json", "--workers", "2")
    result = json.loads(out)
    assert "is within reach; the surrogates expect" in err
    by_name = {line["response"]: line for line in result["responses"]}
    assert by_name[ANGLE_OF_REPOSE]["tolerance"] == 1.5 and by_name[ANGLE_OF_REPOSE]["noise_is"] == "known"
    met = all(line["verdict"] == "within tolerance" for line in result["responses"])
    assert met  # so the exit code was 0
    assert met == (result["dem_stop"] == "tolerance")
    errors = result["solutions"]["errors"]
    assert errors[ANGLE_OF_REPOSE] == max(by_name[ANGLE_OF_REPOSE]["noise"], 0.75)
    table = pd.read_parquet("studies/beads/report/solutions.parquet")
    off = (table[ANGLE_OF_REPOSE] - 26.0) / np.hypot(
        errors[ANGLE_OF_REPOSE], table[f"doubt_{ANGLE_OF_REPOSE}"]
    )
    assert off.abs().mean() < 1.2
    assert len(table) == result["solutions"]["found"] and table["weight"].sum() == pytest.approx(1.0)
    assert len(result["solutions"]["narrowed"]) == 2 and "made_up_for" in result["solutions"]

    page = Path("studies/beads/report/report.html").read_text()
    for title in (
        "Responses at the optimum",
        "Solution space",
        "Profiles",
        "The heap at the optimum",
        "DEM runs",
    ):
        assert title in page
    assert page.count("data:image/svg+xml") == 4 and "http" not in re.sub(r"base64,[^\"]*", "", page)

    lines = Path("studies/beads/report/parameters.in").read_text()
    for name in PARAMETERS:
        assert float(re.search(rf"variable {name} equal (\S+)", lines)[1]) == result[f"dem_{name}"]
    (block,) = re.findall(r"<pre>(.*?)</pre>", page, re.DOTALL)
    for name in PARAMETERS:
        shown = re.search(rf"variable {name} equal (\S+)", block)[1]
        assert float(f"{float(shown):.6g}") == float(shown), "the noise supports no more digits"
        assert float(shown) == pytest.approx(result[f"dem_{name}"], rel=0.05)
    assert "has all digits" in page and "Noise as fitted" in page

    # The same command runs nothing again.
    before = calls()
    again, _ = said(capsys, "beads.toml", "--json")
    assert json.loads(again) == result and calls() == before

    _, refused = said(capsys, written(*TINY, *NEAR, ("WRL = 0.1", "WRL = 0.2")), code=6)
    assert "other settings: WRL: 0.1 → 0.2. Its result and" in refused
    main(["plan", "status", "--study", "studies/beads"])
    assert "1 finished" in capsys.readouterr().out


@pytest.mark.slow
def test_a_target_out_of_reach_is_said_before_the_second_phase(capsys: pytest.CaptureFixture[str]) -> None:
    far = ("value = 22.0, tolerance = 2.0", "value = 45.0, tolerance = 1.0")
    out, err = said(
        capsys, written(*TINY, far, ("# budget = 6 ", "budget = 1 ")), "--workers", "2", code=MISSED
    )
    warned = err.index("WARNING angle_of_repose_deg: 45 deg is OUT OF REACH")
    assert warned < err.index("row 1: ")
    assert "its upper bound is in the way" in out and "OUT OF REACH inside the intervals" in out


@pytest.mark.slow
def test_two_bead_sizes_enter_one_cost(capsys: pytest.CaptureFixture[str]) -> None:
    models = (
        'fidelity = "soft"',
        'fidelity = "tiny"\nlabel = "big"\n[[models]]\nname = "angle_of_repose"\n'
        'label = "small"\nfidelity = "coarse"',
    )
    targets = (
        ("angle_of_repose_deg = { value = 22.0, tolerance = 2.0 }", "big_angle_of_repose_deg = 26.0"),
        ("bulk_density = { value = 1500.0, tolerance = 15.0 }", "small_bulk_density = 1510.0"),
    )
    # No run is likely within twice the noise of 1510 kg/m3 at both sizes of bead.
    out, _ = said(capsys, written(models, *targets, TINY[1]), "--json", "--workers", "2", code=MISSED)
    result = json.loads(out)
    quantities = read_settings(Path("studies/beads")).quantities
    runs = read_table(Path("studies/beads"), "evaluations", quantities)
    assert set(runs["fidelity"]) == {"tiny", "coarse"} and runs["run_id"].is_unique
    for _, both in runs.groupby(["phase", "index"]):
        assert sorted(both["fidelity"]) == ["coarse", "tiny"]
        assert both["DENS"].nunique() == both["seed"].nunique() == 1 and both["model_hash"].nunique() == 2
        assert both["big_angle_of_repose_deg"].notna().sum() == both["small_bulk_density"].notna().sum() == 1
    assert result["runs_total"] == len(runs)
    optimum = runs[runs["run_id"].isin(result["dem_run_id"].split("+"))]
    assert set(optimum["fidelity"]) == {"tiny", "coarse"}
    assert optimum["small_bulk_density"].max() == result["dem_small_bulk_density"]
    heaps = read_table(Path("studies/beads"), "heaps", quantities)
    assert set(heaps["particle_diameter"]) == {0.010, 0.0075}


# ---- several models in a campaign ------------------------------------------------------------------------


class Torque(ClosedForm):
    """A second material test, which knows nothing of the walls' friction."""

    model_hash = "torque"
    particle_diameter = 0.002

    def run(self, parameters, seed, directory, stop):  # type: ignore[no-untyped-def]
        assert set(parameters) == {"DENS", "MU_PP", "YM"}
        run = super().run(TRUTH | parameters, seed, directory, stop)
        torque = 3.0 * parameters["MU_PP"] * parameters["DENS"] / 2500 if run.usable else np.nan
        return replace(run, responses={"torque": torque, RAYLEIGH_TIME_STEP: 1e-6}, positions=None)


TWO_TESTS = Target(
    {
        ANGLE_OF_REPOSE: responses(TRUTH)[ANGLE_OF_REPOSE],
        BULK_DENSITY: responses(TRUTH)[BULK_DENSITY],
        "torque": 3.0 * TRUTH["MU_PP"] * TRUTH["DENS"] / 2500,
    },
    "set",
    "two tests",
)


def run_two(
    directory: Path, first: ClosedForm, second: ClosedForm, stop: threading.Event | None = None
) -> None:
    stop = stop or threading.Event()
    case = Case(
        dict(PARAMETER_UNITS), {ANGLE_OF_REPOSE: "deg", BULK_DENSITY: "kg/m3", "torque": "N m"},
        {"closed-form": {"model": "heap"}, "torque": {"model": "cell"}}, {},
    )  # fmt: skip
    cost = Cost(PLAN.space(PLAN.row(4)), TWO_TESTS, 0.0, (PLAN.fixed.particles, Particles(0.001, 0.3)))
    task = Task(1, cost.space, 12, cost, PAPER, 7, 1)
    with Store(directory, study_settings(target=TWO_TESTS, case=case)) as store:
        tests = [MaterialTest(first, PARAMETERS), MaterialTest(second, ("DENS", "MU_PP", "YM"))]
        scratch = directory / "runs"
        Campaign({1: task}, tests, store, LocalExecutor(2, stop), scratch=scratch, stop=stop).run([1])


def tables(directory: Path) -> dict[str, pd.DataFrame]:
    quantities = read_settings(directory).quantities
    return {
        name: read_table(directory, name, quantities).drop(columns=list(VARYING), errors="ignore")
        for name in ("evaluations", "calibrations", "heaps")
    }


def test_each_parameter_set_runs_through_all_models_and_the_optimum_is_theirs(tmp_path: Path) -> None:
    run_two(tmp_path / "two", ClosedForm(), Torque())
    found = tables(tmp_path / "two")
    line = found["calibrations"].to_dict("records")[0]
    assert line["outcome"] == "ok" and line["dem_sum_of_squares"] < 1e-3
    assert line["dem_MU_PP"] == pytest.approx(TRUTH["MU_PP"], rel=0.02)
    assert line["dem_torque"] == pytest.approx(TWO_TESTS.values["torque"], rel=0.02)
    assert set(found["evaluations"]["model"]) == {"heap", "cell"}
    assert line["runs_total"] == len(found["evaluations"])


def test_what_a_model_does_not_take_does_not_run_it_again(tmp_path: Path) -> None:
    first, second = ClosedForm(), Torque()
    run_two(tmp_path / "two", first, second)
    assert max(second.calls.values()) == max(first.calls.values()) == 1
    assert second.calls.total() < first.calls.total()


@pytest.mark.slow
@pytest.mark.parametrize("calls", [1, 15, 40])
def test_two_models_go_on_where_they_were_interrupted(tmp_path: Path, calls: int) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    run_two(whole, ClosedForm(noise=0.01), Torque(noise=0.01))
    stop = threading.Event()
    first = ClosedForm(noise=0.01, on_call=lambda number: stop.set() if number == calls else None)
    second = Torque(noise=0.01)
    with pytest.raises(Stopped):
        run_two(broken, first, second, stop)
    lines = (broken / "journal" / "row-01.jsonl").read_bytes().splitlines()
    kept = {json.loads(line.partition(b" ")[2])["run_id"] for line in lines}
    again = ClosedForm(noise=0.01), Torque(noise=0.01)
    run_two(broken, *again)
    assert not kept & {*again[0].calls, *again[1].calls}
    for name, expected in tables(whole).items():
        pd.testing.assert_frame_equal(tables(broken)[name], expected, check_exact=True)


def test_a_set_of_which_one_model_fails_is_not_used(tmp_path: Path) -> None:
    from calstudy.records import Outcome

    run_two(
        tmp_path / "two",
        ClosedForm(),
        Torque(fails=lambda number, _: Outcome.FAILED if number == 2 else None),
    )
    line = tables(tmp_path / "two")["calibrations"].to_dict("records")[0]
    assert (line["outcome"], line["samples_left_out"], line["runs_failed"]) == ("ok", 1, 1)
    assert np.isfinite(line["dem_torque"])


def test_a_calibration_s_identity_follows_from_its_file() -> None:
    from calstudy.study.definition import read_definition

    one = read_definition(Path(written(name="one.toml")))
    same = read_definition(Path(written(name="one.toml")))
    other = read_definition(Path(written(("MU_PW = 0.2", "MU_PW = 0.3"), name="one.toml")))
    assert settings_of(one, "L").id == settings_of(same, "L").id != settings_of(other, "L").id
