"""The shipped results are what the program reads, and agree with themselves."""

from __future__ import annotations

import json
import math
import re
import runpy
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calstudy.calibration.task import Stored, cost_of
from calstudy.cli.main import main
from calstudy.engines.engine import ProgramEngine
from calstudy.models.heap import ANGLE_OF_REPOSE, MEASURED
from calstudy.models.measurement import measure_heap
from calstudy.models.noise import known_noise
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import OF_EVERY_CALIBRATION, Phase
from calstudy.study.definition import example, read_definition
from calstudy.study.directory.begun import begun_with, version_there
from calstudy.study.directory.store import read_table
from calstudy.study.reading import read_study
from calstudy.study.run.definition import settings_of
from calstudy.study.settings import read_settings
from calstudy.study.stored import evaluations_of

pytestmark = pytest.mark.slow

REPORTS = Path(__file__).parent.parent / "reports"
OWN = REPORTS / "glass_beads" / "study"
SOFT = REPORTS / "soft"
ANALYSED = sorted(path.parent for path in REPORTS.rglob("analysis"))
OF_TESTS = sorted((REPORTS / "material_tests").rglob("study.json"))
"""Calibrations of material tests, whose file lies beside the study."""
STUDIES = sorted(
    path.parent
    for path in REPORTS.rglob("study.json")
    if "case" not in json.loads(path.read_text()) and any((path.parent / "calibrations").glob("*"))
)
"""Studies of a plan's rows, of which some are finished; those of a calibration file have a case."""
PLAN = load_plan()
table_of, study_of = cache(read_table), cache(read_study)
"""Read once: the heaps of 72 rows take seconds."""


@pytest.fixture(params=STUDIES, ids=lambda p: p.name)
def study(request: pytest.FixtureRequest) -> Path:
    return request.param


def test_there_are_studies() -> None:
    assert STUDIES
    assert ANALYSED


def test_every_line_belongs_to_the_study(study: Path) -> None:
    settings = read_settings(study)
    models = {settings.model_hash, *(settings.tests or ()), *(settings.cheap or ())}
    for table in ("evaluations", "calibrations", "heaps"):
        lines = table_of(study, table)
        # Some come without their heaps.
        assert set(lines["study"]) == ({settings.id} if len(lines) or table != "heaps" else set())
        assert set(lines["model_hash"]) <= models


def test_counts_by_phase_are_the_evaluations(study: Path) -> None:
    evaluations, whole = table_of(study, "evaluations"), study_of(study)
    for line in whole.calibrations.to_dict("records"):
        runs = evaluations[evaluations["row"] == line["row"]]
        assert len(runs) == line["runs_total"]
        assert all((runs["phase"] == phase).sum() == line[f"runs_{phase}"] for phase in OF_EVERY_CALIBRATION)
        # A parameter set is run once for each material test.
        phases = whole.evaluations.loc[whole.evaluations["row"] == line["row"], "phase"]
        samples = whole.plan.row(line["row"]).samples
        if whole.settings.cheap:
            assert (phases == Phase.CHEAP).sum() >= samples and Phase.SAMPLING not in set(phases)
        else:
            assert (phases == Phase.SAMPLING).sum() == samples


def test_the_dem_optimum_is_a_run_of_the_second_optimisation_and_in_mode_paper_the_best(study: Path) -> None:
    whole = study_of(study)
    for line in whole.calibrations.to_dict("records"):
        row = whole.plan.row(line["row"])
        cost = cost_of(whole.plan, row, whole.settings.target)
        of_row = whole.evaluations[whole.evaluations["row"] == line["row"]]
        runs = of_row[~of_row["phase"].isin([Phase.SAMPLING, Phase.CHEAP])]
        points = runs[list(whole.plan.space(row).box.names)].to_numpy(float)
        totals = np.sum(cost.residuals(points, runs[list(cost.responses)].to_numpy(float)) ** 2, axis=1)
        # A point may be asked for more than once; its run is the same. The first test's run comes first.
        at = np.flatnonzero(runs["run_id"] == line["dem_run_id"].partition("+")[0])
        assert len(at)
        assert totals[at] == pytest.approx(line["dem_sum_of_squares"], rel=1e-12)
        if whole.settings.mode == "paper":
            assert totals.argmin() == at[0]


def test_a_shipped_heap_measures_as_it_was_measured(study: Path) -> None:
    evaluations = table_of(study, "evaluations").drop_duplicates("run_id").set_index("run_id")
    for run_id, heap in table_of(study, "heaps").groupby("run_id"):
        found = measure_heap(heap[["x", "y", "z"]].to_numpy(float), float(heap["particle_diameter"].iloc[0]))
        assert found.angle_of_repose_deg == evaluations.loc[run_id, ANGLE_OF_REPOSE]
        assert found.radius == evaluations.loc[run_id, "heap_radius"]


@pytest.mark.parametrize("analysed", ANALYSED, ids=lambda p: f"{p.parent.name}-{p.name}")
def test_the_shipped_tables_come_out_again(analysed: Path, tmp_path: Path) -> None:
    assert main(("analyse", str(analysed), "--out", str(tmp_path), "--format", "csv")) == 0
    shipped = {path.name: path for path in (analysed / "analysis" / "tables").glob("*.csv")}
    # What was added since is not among the shipped ones.
    assert {"claims.csv", "table5.csv"} <= shipped.keys() <= {p.name for p in (tmp_path / "tables").iterdir()}
    for name, path in shipped.items():
        pd.testing.assert_frame_equal(
            pd.read_csv(tmp_path / "tables" / name), pd.read_csv(path), rtol=1e-7, atol=1e-12, obj=name
        )


def test_all_rows_of_the_plan_are_there_at_soft() -> None:
    assert set(read_table(SOFT / "paper", "calibrations")["row"]) == {row.run for row in PLAN.rows}
    assert not list((SOFT / "paper").glob("journal/*"))


def test_the_page_on_the_study_at_soft_says_what_its_ledger_says() -> None:
    ledger = pd.read_csv(SOFT / "paper" / "analysis" / "tables" / "claims.csv").set_index("claim")["verdict"]
    lines = re.findall(r"^\| (C\d\d) \| [^|]+ \| ([a-z ]+) \|", (SOFT / "README.md").read_text(), re.M)
    assert dict(lines) == ledger.to_dict()


def test_the_page_on_readings_says_what_its_scripts_find_in_what_is_shipped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    here = REPORTS / "readings"
    monkeypatch.syspath_prepend(here)
    script, page = (
        runpy.run_path(str(here / name), run_name="imported") for name in ("readings.py", "page.py")
    )
    found = pd.read_csv(here / "likelihoods.csv")
    assert set(found["reading"]) == {reading.name for reading in script["READINGS"]}
    for reading, shipped in zip(script["READINGS"], found["log_likelihood"], strict=True):
        again = script["log_likelihood"](script["replicated"](reading), script["paper"]())
        assert again == pytest.approx(shipped, rel=1e-3, nan_ok=True)
    assert set(page["lines"]()) <= set((here / "README.md").read_text().splitlines())


def test_the_study_at_soft_stands_beside_its_emulator_as_shipped(tmp_path: Path) -> None:
    command = ["analyse", str(SOFT / "paper"), "--beside", str(REPORTS / "emulated" / "soft-ring")]
    assert main([*command, "--only", "numbers_beside", "--format", "csv", "--out", str(tmp_path)]) == 0
    written, shipped = (
        pd.read_csv(folder / "tables" / "numbers_beside.csv") for folder in (tmp_path, SOFT / "beside")
    )
    pd.testing.assert_frame_equal(written, shipped, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize(
    ("shipped", "options"),
    [
        (SOFT / "paper", "--fidelity soft"),
        (SOFT / "robust", "--fidelity soft --mode robust"),
        (REPORTS / "coarse-rows" / "robust", "--fidelity coarse --mode robust --target twin"),
        (REPORTS / "fast" / "paper", "--fidelity fast"),
    ],
)
def test_a_shipped_study_of_an_earlier_version_goes_on(shipped: Path, options: str, tmp_path: Path) -> None:
    assert read_settings(shipped).calstudy == "0.1.0"
    copy = tmp_path / "study"
    copy.mkdir()
    (copy / "study.json").write_bytes((shipped / "study.json").read_bytes())
    assert main(("plan", "run", "--dry-run", *options.split(), "--study", str(copy))) == 0


def test_the_shipped_example_is_what_init_writes(tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(example())
    there = read_settings(OWN)
    # It goes on with the study as it was begun, before there was a grid and a confirmation.
    definition = read_definition(tmp_path / "calibration.toml", (), False, *begun_with(OWN))
    assert settings_of(definition, there.engine, version_there(OWN)).id == there.id


@pytest.mark.parametrize("file", OF_TESTS, ids=lambda p: p.parent.parent.name)
def test_a_shipped_calibration_of_material_tests_is_that_of_its_file(file: Path) -> None:
    study = file.parent
    (written,) = study.parent.glob("*.toml")
    there = read_settings(study)
    assert there.case is not None
    taken = tuple(Stored(point, seed) for point, seed in there.case.definition.get("stored", []))
    definition = read_definition(written, (), False, *begun_with(study)).taking_over(taken)
    assert settings_of(definition, there.engine, version_there(study)).id == there.id
    line = read_table(study, "calibrations", there.quantities).iloc[0]
    assert line["outcome"] == "ok" and line["runs_failed"] < line["runs_total"] / 4


def test_the_shipped_example_ends_within_its_tolerances() -> None:
    settings = read_settings(OWN)
    assert settings.case is not None
    line = read_table(OWN, "calibrations", settings.quantities).iloc[0]
    assert line["dem_stop"] == "tolerance"
    for name, tolerance in settings.case.definition["tolerances"].items():
        assert abs(line[f"dem_{name}"] - settings.target.values[name]) <= tolerance


def asked(parameters: Mapping[str, float], seed: int) -> tuple[float, ...]:
    return (seed, *(parameters[name] for name in PARAMETERS))


@pytest.mark.liggghts
def test_a_shipped_row_comes_out_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Optimum and first sample are simulated, every step is computed; the other runs answer as they did."""
    monkeypatch.chdir(tmp_path)
    shipped = REPORTS / "coarse-rows" / "robust"
    optimum = read_table(shipped, "calibrations").set_index("row").loc[1, "dem_run_id"]
    there = [e for e in evaluations_of(shipped, read_settings(shipped)) if e.request.row == 1]
    known = {asked(e.request.parameters, e.request.seed): e.run for e in there[1:] if e.run_id != optimum}
    assert len(known) == len(there) - 2
    simulate = ProgramEngine.run
    monkeypatch.setattr(
        ProgramEngine, "run", lambda engine, *of: known.get(asked(*of[:2])) or simulate(engine, *of)
    )
    code = main(("plan", "rerun", str(shipped), "--rows", "1", "--json"))
    (found,) = json.loads(capsys.readouterr().out)
    assert code == (0 if found["same"] else 10)
    samples = PLAN.row(1).samples
    # Where a sample has another last digit, another processor made it; elsewhere all must be the same.
    assert found["same"] or found["equal"] < samples
    noise = known_noise("angle_of_repose", read_settings(shipped).model_hash)
    assert noise is not None
    # Largest of six differences of two runs, each with that scatter: beyond six of its deviations by 1e-7.
    assert all(found["largest"][name] < 6 * math.sqrt(2) * noise[name] for name in MEASURED)
    again = Path("studies") / f"rerun-{read_settings(shipped).id}"
    names = list(PLAN.space(PLAN.row(1)).box.names)
    made, there = (
        runs[(runs["row"] == 1) & (runs["phase"] == Phase.SAMPLING)][names].to_numpy(float)
        for runs in (read_table(study, "evaluations") for study in (again, shipped))
    )
    assert made.shape == there.shape == (samples, len(names))
    np.testing.assert_allclose(made, there, rtol=1e-12)
