"""Responses that are too steep for their runs: intervals hold them, or the emulator says that they do not."""

import json
import runpy
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from calstudy.cli.main import main
from calstudy.emulator.design import Choice, emulator_design
from calstudy.emulator.ensemble import Ensemble
from calstudy.emulator.process import Observations
from calstudy.emulator.validation import Trust, Unexplained, unexplained_of
from calstudy.errors import NOT_DECIDED, NOT_HOLDING
from calstudy.study.directory.store import write_table
from calstudy.study.schema import schema_of
from shipped_model import SIMILARITY, SWEEP
from synthetic_runs import CHEAP, EXPENSIVE, PLAN, synthetic_runs

pytestmark = pytest.mark.slow

STEEP = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "steep.py"), run_name="imported")


@pytest.mark.parametrize(
    ("share", "least", "trust"),
    [
        (0.1, 0.0, Trust.YES),
        (0.5, 0.4, Trust.NO),
        (0.5, 0.1, Trust.UNDECIDED),  # the noise may be that much larger than the repeats show
        (0.5, 0.0, Trust.UNDECIDED),
    ],
)
def test_trust_goes_by_what_left_out_runs_leave_unexplained(share, least, trust):
    found = Unexplained("angle", 40, 3, share, least)
    assert found.trust is trust
    assert (found.in_words == "") == (trust is Trust.YES)


@pytest.mark.parametrize(
    ("name", "count", "noise", "repeats", "seeds"),
    [
        ("ishigami", 30, 0.01, 0, range(4)),
        ("ishigami", 30, 0.3, 3, range(4)),
        ("hartmann", 60, 0.3, 6, range(2)),
        ("smooth", 50, 0.3, 5, range(2)),
    ],
)
def test_intervals_of_the_mean_hold_or_are_not_trusted(name, count, noise, repeats, seeds):
    function, d = STEEP["FUNCTIONS"][name]
    with threadpool_limits(1):
        found = [STEEP["fitted"](function, d, count, noise, repeats, seed) for seed in seeds]
    trusted = [inside for inside, of in found if of.trust is Trust.YES]
    assert all(inside > 0.9 for inside in trusted)
    assert len(trusted) == (len(found) if name == "smooth" else 0)
    if repeats == 0:
        assert {of.trust for _, of in found} == {Trust.UNDECIDED}


def test_nothing_but_noise_is_not_called_steep_and_of_one_expensive_point_nothing_is_told():
    rng = np.random.default_rng(4)
    U = rng.random((40, 3))
    U = np.vstack([U, U[:20]])
    noise = rng.standard_normal(60)
    expensive = np.arange(60) == 59
    with threadpool_limits(1):
        alone = unexplained_of("y", Ensemble.fit(Observations(U, noise, np.zeros(60, int))))
        single = unexplained_of("y", Ensemble.fit(Observations(U, noise + U[:, 0], expensive.astype(int), 2)))
    assert alone.trust is not Trust.NO and (alone.runs, alone.repeats) == (60, 20)
    assert single.trust is Trust.UNDECIDED and single.runs == 1


def pathless(design):
    """Angles that every point has for itself, without noise: no number of runs tells one from the others."""
    runs = synthetic_runs(design)
    number = runs.groupby("label").ngroup()
    runs["angle_of_repose_deg"] = 20.0 + 5.0 * np.random.default_rng(3).random(number.max() + 1)[number]
    return runs[runs["fidelity"] == CHEAP].reset_index(drop=True)


@pytest.mark.parametrize(
    ("repeated", "code", "words"),
    [(True, NOT_HOLDING, "repeats show that this is not noise"), (False, NOT_DECIDED, "no run is repeated")],
)
def test_fit_says_so_and_keeps_the_emulator(repeated, code, words, tmp_path, capsys):
    runs = pathless(emulator_design(PLAN.parameters, Choice(CHEAP, EXPENSIVE, "ring", 1), 40, SIMILARITY))
    if not repeated:
        runs = runs.drop_duplicates("label")
    write_table(tmp_path / "runs.parquet", runs, schema_of(SWEEP, "runs"))
    made = str(tmp_path / "made")
    assert main(["emulator", "fit", str(tmp_path / "runs.parquet"), "--out", made]) == code
    said = capsys.readouterr().out
    assert words in said and "solid_fraction: left-out" not in said
    assert main(["emulator", "validate", made, "--folds", "2", "--json"]) == code
    angle, fraction = json.loads(capsys.readouterr().out)["unexplained"]
    assert angle["share"] > 0.4 and fraction["share"] < 0.15
