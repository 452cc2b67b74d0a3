"""The emulators that come with the package: small, of the frozen deck, and made of the shipped runs."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from calstudy.cli.main import main
from calstudy.emulator.benchmark.emulated import KEPT
from calstudy.emulator.emulator import read_emulator, shipped_emulators
from calstudy.emulator.similarity import inputs_of
from calstudy.emulator.validation import fresh_points, fresh_summary
from calstudy.errors import MISSED, NOT_DECIDED
from calstudy.models.angle_of_repose import load_model
from calstudy.models.find import DEFAULT_MODEL
from calstudy.models.find import SHIPPED as MODELS
from calstudy.models.folder import load_folder
from calstudy.models.heap import REFERENCE
from calstudy.study.reading import read_study
from calstudy.study.settings import read_settings
from shipped_model import SIMILARITY
from synthetic_runs import BOX, PLAN

pytestmark = pytest.mark.slow

HERE = BOX.to_unit(inputs_of(pd.DataFrame([REFERENCE]), SIMILARITY))
SHIPPED = MODELS / DEFAULT_MODEL / "emulators"
REPORTS = Path(__file__).parent.parent / "reports"
DESIGNED = {
    SHIPPED / "coarse-ring": ("coarse", ("next_test/design/angle_of_repose",)),
    SHIPPED / "soft-wide": ("soft", ("angle_of_repose/plate", "emulator/soft-wide")),
    KEPT / DEFAULT_MODEL / "full-ring": ("fast,full", ("emulator/full-ring", "angle_of_repose/noise")),
    KEPT / DEFAULT_MODEL / "soft-ring": (
        "soft",
        ("angle_of_repose/plate", "angle_of_repose/noise", "emulator/soft-ring"),
    ),
}
"""Emulators of designed runs alone: fidelities and folders that each is made of."""
OF_ALL_RUNS = {
    "soft-ring": ("soft",),
    "fast-ring": ("soft", "fast"),
    "full-ring": ("soft", "fast", "full"),
}
"""Emulators of all runs on the ring, with the fidelities that each is made of."""
WIDE = {
    "DENS": (2300, 2700),
    "MU_PP": (0.05, 0.6),
    "MU_PW": (0.05, 0.6),
    "RF_PP": (0.001, 0.2),
    "RF_PW": (0.001, 0.2),
    "YM": (4.2e8, 1.25e9),
}
"""Box of the emulators that are advised by."""
OTHERS = sorted(path.parent.parent.name for path in MODELS.glob("*/emulators/coarse"))


def test_what_is_shipped_is_small_and_known():
    designed = {path.name for path in DESIGNED if path.parent == SHIPPED}
    assert {path.name for path in shipped_emulators(DEFAULT_MODEL)} == designed | set(OF_ALL_RUNS)
    assert sum(path.stat().st_size for path in SHIPPED.rglob("*") if path.is_file()) < 2e6


@pytest.mark.parametrize("path", DESIGNED, ids=lambda path: path.name)
def test_a_shipped_emulator_is_of_the_deck_and_made_of_the_shipped_runs(path, tmp_path, capsys):
    fidelity, variant = path.name.split("-")
    there = read_emulator(path)
    assert (there.origin.fidelity, there.origin.variant) == (fidelity, variant)
    assert there.origin.model_hash == load_model(PLAN.fixed, fidelity, variant).hash
    fidelities, folders = DESIGNED[path]
    runs = [str(REPORTS / folder) for folder in folders]
    chosen = ["--fidelity", fidelities, "--variant", variant]
    if path.name == "coarse-ring":
        chosen += [w for n, (low, high) in WIDE.items() for w in ("--interval", f"{n}={low}:{high}")]
    # No run of `coarse-ring` is repeated, and of the scatter of its angles more is unexplained than may be.
    code = NOT_DECIDED if path.name == "coarse-ring" else 0
    assert main(["emulator", "fit", *runs, *chosen, "--out", str(tmp_path / "again")]) == code
    again = read_emulator(tmp_path / "again")
    assert list(again.runs["run_id"]) == list(there.runs["run_id"])
    for one, other in zip(again.responses, there.responses, strict=True):
        assert one.off == other.off
        assert one.process.mean(HERE)[0] == pytest.approx(other.process.mean(HERE)[0], rel=1e-4)


@pytest.mark.parametrize("name", OF_ALL_RUNS)
def test_an_emulator_of_all_runs_has_the_designed_ones_and_the_samples_of_the_study_at_soft(name):
    content = json.loads((SHIPPED / name / "emulator.json").read_text())
    fidelity, variant = name.split("-")
    assert content["origin"]["model_hash"] == load_model(PLAN.fixed, fidelity, variant).hash
    samples = read_study(REPORTS / "soft" / "paper").evaluations.query("phase == 'sampling'")
    designed = pd.concat(
        pd.read_parquet(KEPT / DEFAULT_MODEL / f"{of}-ring" / "runs.parquet") for of in ("soft", "full")
    )
    designed = designed[designed["fidelity"].isin(OF_ALL_RUNS[name])]
    there = pd.read_parquet(SHIPPED / name / "runs.parquet")
    assert set(there["run_id"]) == {*samples["run_id"], *designed["run_id"]}
    assert set(there["fidelity"]) == set(OF_ALL_RUNS[name])


def test_the_validation_of_an_emulator_of_all_runs_comes_out_again():
    made = read_emulator(SHIPPED / "soft-ring")
    points = fresh_points(made, pd.read_parquet(REPORTS / "soft" / "confirmed" / "runs.parquet"))
    table = pd.read_csv(REPORTS / "emulator" / "validation.csv").query("held_against == 'optima run again'")
    lines = table[table["version"] == made.version].set_index("response")
    for response, of in points.groupby("response"):
        error = of["measured"] - of["predicted"]
        assert error.mean() == pytest.approx(lines.loc[response, "bias"], rel=1e-3)
        assert of["inside"].sum() == lines.loc[response, "inside"] > 0.85 * len(of)
    # The samples have 2.3 deg with a standard error of 0.4.
    angle = lines.loc["angle_of_repose_deg"]
    assert 1.5 < angle["MU_PP:RF_PP"] < angle["high"] and angle["low"] > 0.8


@pytest.mark.parametrize("test", OTHERS)
def test_an_emulator_that_is_advised_by_is_of_the_test_and_made_of_the_shipped_runs(test):
    there, model = read_emulator(MODELS / test / "emulators" / "coarse"), load_folder(MODELS / test)
    assert there.origin.model_hash == model.hash and there.origin.fidelity == model.labels["fidelity"]
    runs = pd.read_parquet(REPORTS / "next_test" / "design" / test / "runs.parquet")
    assert list(there.runs["run_id"]) == list(runs["run_id"])
    ends = zip(there.box.lower, there.box.upper, strict=True)
    for name, (low, high) in zip(there.box.names, ends, strict=True):
        assert "/" in name or (low, high) == WIDE[name]


DIGEST = """
import hashlib, numpy as np
from calstudy.emulator.emulator import read_emulator, shipped_emulator
made = read_emulator(shipped_emulator("angle_of_repose", "full", "ring"))
members = [r.process.members[0] for r in made.responses]
print(hashlib.sha256(b"".join(m.alpha.tobytes() for m in members)).hexdigest())
"""


def test_an_emulator_is_the_same_on_any_number_of_threads():
    digests = {
        subprocess.run(
            [sys.executable, "-c", DIGEST],
            env={**os.environ, "OPENBLAS_NUM_THREADS": threads},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for threads in ("1", "2")
    }
    assert len(digests) == 1


def test_the_full_model_is_met_at_points_drawn_after_the_fit():
    runs = pd.read_parquet(REPORTS / "emulator" / "full-ring-fresh" / "runs.parquet")
    points = fresh_points(read_emulator(SHIPPED / "full-ring"), runs)
    assert sorted(points["seeds"]) == 12 * [1] + 12 * [3]  # six points of twelve, for each response
    for found in fresh_summary(points):
        assert found.points == 12 and found.inside >= 10
        assert found.error < found.noise


@pytest.mark.parametrize(("said", "name"), [([], "full-ring"), (["--fidelity", "soft"], "soft-ring")])
def test_without_a_directory_the_shipped_one_answers(said, name, tmp_path, capsys):
    study = tmp_path / "study"
    code = main(["plan", "run", "--engine", "emulator", *said, "--rows", "1", "--study", str(study)])
    assert code in (0, MISSED)
    assert read_settings(study).engine == f"emulator {read_emulator(SHIPPED / name).version}"
