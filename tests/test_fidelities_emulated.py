"""Runs of several fidelities in one process, offsets of known shape, and more runs than a search can take."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from calstudy.cli.emulator import _read_runs
from calstudy.emulator import cokriging, ensemble
from calstudy.emulator.cokriging import CoKriging, posterior_mode, standardised
from calstudy.emulator.design import Choice, emulator_design, space_filling
from calstudy.emulator.emulator import fit_emulator, read_emulator, write_emulator
from calstudy.emulator.ensemble import Ensemble, posterior_sample
from calstudy.emulator.process import Observations, Overlap, Prior, Settings, negative_log_posterior
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import load_model
from calstudy.records import Response
from calstudy.study.schema import Quantities
from shipped_model import SIMILARITY
from synthetic_runs import CHEAP, EXPENSIVE, PLAN, solid_fraction, synthetic_runs

REPORTS = Path(__file__).parents[1] / "reports"
DESIGN = emulator_design(PLAN.parameters, Choice(CHEAP, EXPENSIVE, "ring", 1), 60, SIMILARITY)
OVERLAP = Overlap(1.0, 1.7)
SOMEWHERE = np.random.default_rng(5).random((300, 5))


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    with threadpool_limits(1):
        yield


def softened(overlap, counts=(80, 16, 6), noise=1e-4):
    """Solid fractions of fidelities that overlaps tell apart: the stiffer, the fewer runs."""
    rng = np.random.default_rng(1)
    level = np.repeat(np.arange(len(counts)), counts)
    U = np.vstack([space_filling(count, 5, 3 + k) for k, count in enumerate(counts)])
    y = solid_fraction(U) + 0.009 * np.array([1.0, 0.25, 0.0])[level] * OVERLAP.shape(U)
    return Observations(U, y + noise * rng.standard_normal(len(U)), level, len(counts), overlap)


def test_an_offset_s_shape_is_one_in_the_middle_and_a_power_of_the_quotient():
    at = np.full((3, 5), 0.5)
    at[:, -1] = 0.0, 0.5, 1.0
    np.testing.assert_allclose(OVERLAP.shape(at), [1.35 ** (2 / 3), 1.0, (1.7 / 1.35) ** (-2 / 3)])


def test_an_offset_of_known_shape_is_learned_from_fewer_runs():
    def error(overlap):
        fitted = CoKriging.fit(softened(overlap))
        return np.sqrt(np.mean((fitted.mean(SOMEWHERE) - solid_fraction(SOMEWHERE)) ** 2))

    assert error(OVERLAP) < 2e-4
    assert error(None) > 2.0 * error(OVERLAP)


def test_each_fidelity_has_its_noise():
    data = softened(OVERLAP, (80, 60, 40))
    noise = np.array([0.0, 2e-4, 4e-4])[data.level] * np.random.default_rng(2).standard_normal(len(data.y))
    fitted = CoKriging.fit(data.with_responses(data.y + noise))
    first, second = fitted.settings.noise_steps[1:] / 2.0  # of the standard deviations' logarithms
    assert first == pytest.approx(0.5 * np.log(5.0), abs=0.35)
    assert second == pytest.approx(0.5 * np.log(17.0), abs=0.35)


def test_of_many_runs_the_search_begins_among_some_and_ends_among_all(monkeypatch):
    data, *_ = standardised(softened(OVERLAP, (150, 30, 10)))
    prior = Prior.of(5, 3)
    among_all = negative_log_posterior(data, prior, posterior_mode(data, prior))[0]
    monkeypatch.setattr(cokriging, "SEARCHED", 40)
    assert np.bincount(data.thinned(40).level).tolist() == [40, 30, 10]
    assert negative_log_posterior(data, prior, posterior_mode(data, prior))[0] == pytest.approx(
        among_all, abs=0.05
    )


def test_of_many_runs_some_tell_the_hyperparameters_and_all_are_conditioned_on(monkeypatch):
    data = softened(OVERLAP, (150, 30, 10))
    monkeypatch.setattr(ensemble, "TELLING", 40)
    fitted = Ensemble.fit(data)
    assert len(fitted.data.y) == 190
    scaled, *_ = standardised(data)
    prior, some = Prior.of(5, 3), scaled.thinned(40)
    mode = posterior_mode(some, prior)
    drawn = posterior_sample(some, prior, mode, np.random.default_rng(0))
    assert [m.settings for m in fitted.members] == [Settings.of(theta, 5) for theta in drawn]


def three_fidelities():
    """Runs at two fidelities, and eight at a third that is like the expensive one."""
    runs = synthetic_runs(DESIGN)
    last = runs[runs["fidelity"] == EXPENSIVE].head(8).copy()
    last["fidelity"], last["model_hash"] = "soft", load_model(PLAN.fixed, "soft").hash
    last["run_id"], last["cpu_time"] = [f"{k:016x}" for k in range(len(last))], 30.0
    return pd.concat([runs, last], ignore_index=True)


def test_an_emulator_of_three_fidelities_is_read_as_it_was_written(tmp_path):
    emulator = fit_emulator(three_fidelities(), PLAN.parameters, SIMILARITY)
    assert emulator.origin.fidelities == (CHEAP, EXPENSIVE, "soft")
    write_emulator(tmp_path, emulator)
    again = read_emulator(tmp_path)
    assert again.version == emulator.version
    for one, other in zip(emulator.responses, again.responses, strict=True):
        assert (one.process.data.overlap is None) == (one.name == "angle_of_repose_deg")
        for a, b in zip(
            one.process.mean_and_sd(SOMEWHERE), other.process.mean_and_sd(SOMEWHERE), strict=True
        ):
            np.testing.assert_allclose(b, a, rtol=1e-12)


def test_of_a_study_the_samples_are_taken():
    quantities = Quantities.of(load_model(PLAN.fixed, "soft"))
    runs = _read_runs(REPORTS / "soft" / "robust", quantities)
    told = pd.read_parquet(REPORTS / "soft" / "robust" / "evaluations" / "row-01.parquet")
    assert set(told.loc[told["phase"] == "sampling", "run_id"]) < set(runs["run_id"])
    assert set(told.loc[told["phase"] != "sampling", "run_id"]).isdisjoint(runs["run_id"])
    assert runs["label"].iloc[0] == "row 1, sample 0"
    other = Quantities(quantities.parameters, (Response("torque", "N m"),), ("torque",))
    with pytest.raises(InputError, match="is a study of another model: torque is missing"):
        _read_runs(REPORTS / "soft" / "robust", other)
