"""The shipped bands are made of the shipped numbers, and those of the shipped emulators."""

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from calstudy.analysis.replicates.bands import bands_of
from calstudy.analysis.replicates.bands_claims import bands_claims_of
from calstudy.analysis.replicates.entries import entries
from calstudy.analysis.replicates.rows_beside import rows_beside
from calstudy.calibration.modes import mode_of
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.emulator.replicates import Replication
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import PROPORTIONAL
from calstudy.plan import FULL_FACTORIAL
from calstudy.plan_file import load_plan
from calstudy.report.replicated import replicate_study
from calstudy.study.reading import Study, read_study
from calstudy.study.settings import read_settings

pytestmark = pytest.mark.slow

EMULATED = Path(__file__).parent.parent / "reports" / "emulated"
FOLDERS = sorted(path.parent for path in EMULATED.glob("*/manifest.json"))
ROWS = sorted(path.parent for path in EMULATED.glob("rows/*/manifest.json"))
DEM_STUDIES = sorted(EMULATED.parent.glob("*/paper"))
PLAN = load_plan()
WHOLE = load_plan(FULL_FACTORIAL)
PLANS = {plan.hash: plan for plan in (PLAN, WHOLE)}
REPLICATES = {PLAN.hash: 100, WHOLE.hash: 50}
REPEATED = [path for path in FOLDERS if path.name != "full-ring"]
"""Of which a replicate is made again; that of `full-ring` is half of the one of `full-factorial`."""
KEY = ["where", "entry"]


@pytest.fixture(params=FOLDERS, ids=lambda p: p.name)
def folder(request):
    return request.param


def settings_of(manifest, directory):
    (directory / "study.json").write_text(json.dumps(manifest["settings"]))
    found = read_settings(directory)
    assert found.id == manifest["study"]
    return found


@pytest.fixture
def settings(folder, tmp_path):
    return settings_of(json.loads((folder / "manifest.json").read_text()), tmp_path)


def replication(settings, rows):
    plan = PLANS[settings.plan_hash]
    emulator = read_emulator(shipped_emulator(settings.model, settings.fidelity, settings.variant))
    model = load_model(plan.fixed, settings.fidelity, settings.variant)
    assert settings.engine == EmulatorEngine(model, emulator).identity
    assert settings.model_hash == model.hash
    return Replication(
        settings,
        plan,
        rows,
        mode_of(settings.mode, settings.budget, settings.grid, settings.procedure).knowing(PROPORTIONAL),
        model,
        emulator,
    )


def replicate(of, number):
    with threadpool_limits(1):
        return of.replicate(number, threading.Event(), lambda: None)


def test_all_replicates_are_there_and_of_the_shipped_emulator(folder, settings):
    assert replication(settings, ()).emulator.version in settings.engine
    lines = pd.read_parquet(folder / "replicates.parquet")
    assert sorted(lines["replicate"].unique()) == list(range(1, REPLICATES[settings.plan_hash] + 1))
    assert set(lines["rows"]) == {len(PLAN.rows), len(PLANS[settings.plan_hash].rows)}
    assert set(lines["calibrations"]) == set(lines["rows"])


@pytest.mark.parametrize(("name", "made"), [("bands", bands_of), ("bands_claims", bands_claims_of)])
def test_the_bands_are_those_of_the_numbers(folder, settings, name, made):
    lines = pd.read_parquet(folder / "replicates.parquet")
    again = made(lines[lines["rows"] == len(PLANS[settings.plan_hash].rows)])
    there = pd.read_csv(folder / "tables" / f"{name}.csv")
    assert list(again["entry"]) == list(there["entry"])
    for column in there.select_dtypes("number"):
        np.testing.assert_allclose(again[column].to_numpy(float), there[column], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("folder", REPEATED, ids=lambda p: p.name)
def test_a_replicate_comes_out_again_with_its_intervals(folder, settings):
    number = 1 + FOLDERS.index(folder)
    plan = PLANS[settings.plan_hash]
    tables = replicate(replication(settings, tuple(row.run for row in plan.rows)), number)
    sampled = tables["replicate_runs"].query("phase == 'sampling'").groupby("row").size()
    assert sampled.to_dict() == {row.run: row.samples for row in plan.rows}
    none = pd.DataFrame()
    study = replicate_study(Study(settings, plan, none, none, none), tables)
    again = entries(study).set_index(KEY)
    lines = pd.read_parquet(folder / "replicates.parquet")
    stored = lines[(lines["rows"] == len(plan.rows)) & (lines["replicate"] == number)]
    assert (stored["calibrations"] == len(study.calibrations)).all()
    there = stored.set_index(KEY)
    assert list(again.index) == list(there.index)
    # The runs are on a grid, so another processor's last digits are in what is made of them alone.
    np.testing.assert_allclose(again["value"], there["value"], rtol=1e-4, atol=1e-12)
    intervals = [[n for n in again.index if n[0] in ("Table 3", "Table 4", "Table 6")], ["low", "high"]]
    np.testing.assert_allclose(again.loc[*intervals], there.loc[*intervals], rtol=1e-4, atol=1e-12)


def test_the_papers_half_of_the_full_factorial_is_the_study_of_its_rows():
    whole, half = (
        pd.read_parquet(EMULATED / name / "replicates.parquet") for name in ("full-factorial", "full-ring")
    )
    of_whole = whole[whole["rows"] == len(PLAN.rows)].reset_index(drop=True)
    same = half[half["replicate"].isin(of_whole["replicate"])].reset_index(drop=True)
    pd.testing.assert_frame_equal(of_whole, same, rtol=1e-6)


@pytest.mark.parametrize("folder", ROWS, ids=lambda p: p.name)
def test_rows_on_liggghts_stand_among_replicates_of_the_shipped_emulator(folder, tmp_path):
    manifest = json.loads((folder / "manifest.json").read_text())
    settings = settings_of(manifest["beside"], tmp_path)
    study = next(s for s in map(read_study, DEM_STUDIES) if s.settings.id == manifest["study"])
    there = pd.read_csv(folder / "tables" / "rows_beside.csv")
    rows = tuple(int(row) for row in there["row"].unique())
    of = replication(settings, rows)
    lines = pd.concat([replicate(of, number)["replicates"] for number in range(1, 11)])
    other = replace(study, replicated_rows=lines)
    again = rows_beside(replace(study, beside=other))
    key = ["row", "of", "quantity"]
    pd.testing.assert_frame_equal(again[[*key, "value"]], there[[*key, "value"]])
    # The median of ten draws lies far inside the band of a hundred.
    margin = 1e-6 * there["value"].abs()
    assert ((there["low"] - margin <= again["median"]) & (again["median"] <= there["high"] + margin)).all()
