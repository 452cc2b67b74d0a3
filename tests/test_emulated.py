"""The shipped bands are made of the shipped numbers, and those of the shipped emulators."""

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from calstudy.analysis.bands import bands_of
from calstudy.analysis.bands_claims import bands_claims_of
from calstudy.analysis.entries import entries
from calstudy.emulator import read_emulator
from calstudy.emulator_choice import shipped_emulator
from calstudy.emulator_engine import EmulatorEngine
from calstudy.model import load_model
from calstudy.modes import mode_of
from calstudy.plan import load_plan
from calstudy.replicated import replicate_study
from calstudy.replicates import Replication
from calstudy.store import read_settings
from calstudy.study import Study

EMULATED = Path(__file__).parent.parent / "reports" / "emulated"
FOLDERS = sorted(path.parent for path in EMULATED.glob("*/manifest.json"))
PLAN = load_plan()
KEY = ["where", "entry"]


@pytest.fixture(params=FOLDERS, ids=lambda p: p.name)
def folder(request):
    return request.param


@pytest.fixture
def settings(folder, tmp_path):
    manifest = json.loads((folder / "manifest.json").read_text())
    (tmp_path / "study.json").write_text(json.dumps(manifest["settings"]))
    found = read_settings(tmp_path)
    assert found.id == manifest["study"]
    return found


def test_there_are_a_hundred_replicates_of_the_shipped_emulator(folder, settings):
    emulator = read_emulator(shipped_emulator(settings.fidelity, settings.variant))
    model = load_model(PLAN.fixed, settings.fidelity, settings.variant)
    assert settings.engine == EmulatorEngine(model, emulator).identity
    assert settings.model_hash == model.hash
    assert settings.plan_hash == PLAN.hash
    lines = pd.read_parquet(folder / "replicates.parquet")
    assert sorted(lines["replicate"].unique()) == list(range(1, 101))
    assert set(lines["rows"]) == {len(PLAN.rows)}


@pytest.mark.parametrize(("name", "made"), [("bands", bands_of), ("bands_claims", bands_claims_of)])
def test_the_bands_are_those_of_the_numbers(folder, name, made):
    again = made(pd.read_parquet(folder / "replicates.parquet"))
    there = pd.read_csv(folder / "tables" / f"{name}.csv")
    assert list(again["entry"]) == list(there["entry"])
    for column in there.select_dtypes("number"):
        np.testing.assert_allclose(again[column].to_numpy(float), there[column], rtol=1e-7, atol=1e-12)


def test_a_replicate_comes_out_again(folder, settings):
    number = 1 + FOLDERS.index(folder)
    emulator = read_emulator(shipped_emulator(settings.fidelity, settings.variant))
    model = load_model(PLAN.fixed, settings.fidelity, settings.variant)
    rows = tuple(row.run for row in PLAN.rows)
    of = Replication(settings, PLAN, rows, mode_of(settings.mode, settings.budget), model, emulator)
    with threadpool_limits(1):
        tables = of.replicate(number, threading.Event(), lambda: None)
    none = pd.DataFrame()
    study = replicate_study(Study(settings, PLAN, none, none, none), tables)
    again = entries(replace(study, replicated=None)).set_index(KEY)["value"]
    lines = pd.read_parquet(folder / "replicates.parquet")
    there = lines[lines["replicate"] == number].set_index(KEY)["value"]
    assert list(again.index) == list(there.index)
    if np.allclose(again, there, rtol=1e-6, equal_nan=True):
        return
    # Another processor's last digits lead to other draws of the noise: one more replicate, among the others.
    spread = lines.groupby(KEY, sort=False)["value"].agg(["min", "max"]).loc[list(again.index)]
    outside = (again < spread["min"]) | (again > spread["max"])
    assert outside.mean() < 0.1
