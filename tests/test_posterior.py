"""Drawing from a posterior, and what is read off it, where the answers are known in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2, norm, qmc

from calstudy.calibration.narrowing import in_words, made_up_for, narrowed, profiles
from calstudy.calibration.posterior import draw, log_likelihood
from calstudy.parameters import Array

ROOT = Path(__file__).parent.parent
FIRST = qmc.Sobol(6, seed=0).random(2**13)


def flat(u: Array) -> Array:
    return np.zeros(len(u))


def half(u: Array) -> Array:
    """A prior that allows u0 >= u5 alone."""
    return np.where(u[:, 0] >= u[:, 5], 0.0, -np.inf)


def ridge(u: Array) -> Array:
    """u0 and u1 make up for each other, u3 follows the square of u4, u2 is determined, u5 is not."""
    z = (u - 0.4) / [0.3, 0.05, 0.02, 0.2, 1.0, 1.0]
    return -0.5 * (((z[:, 0] + z[:, 1]) / 0.1) ** 2 + z[:, 2] ** 2 + ((z[:, 3] - z[:, 4] ** 2) / 0.1) ** 2)


def test_means_and_evidence_are_those_of_the_integral() -> None:
    """Under the ridge the density of u0 is u0 (what u5 leaves of the prior), so that its mean is 2/3."""
    found = [draw(half, ridge, FIRST, seed) for seed in range(6)]
    means = np.array([one.unit.mean(axis=0) for one in found])
    assert means.mean(axis=0) == pytest.approx(
        [2 / 3, 0.4 - (2 / 3 - 0.4) / 6, 0.4, 0.419, 0.5, 1 / 3], abs=0.012
    )
    assert all((one.unit[:, 0] >= one.unit[:, 5]).all() for one in found)
    # The likelihood's mean under the prior: ridges of widths 0.005 and 0.02, and a normal of 0.02.
    expected = np.log((2 * np.pi) ** 1.5 * 0.005 * 0.02 * 0.02)
    assert np.mean([one.log_evidence for one in found]) == pytest.approx(expected, abs=0.2)


def test_points_that_leave_the_cube_come_back_nowhere() -> None:
    """Along a correlated ridge in a corner, a reflection at the faces would not be reversible."""

    def corner(u: Array) -> Array:
        return -0.5 * ((u[:, 0] - u[:, 1]) / 0.02) ** 2

    u = np.concatenate([draw(flat, corner, FIRST[:, :2], seed).unit for seed in range(4)])
    counts = np.histogram(0.5 * (u[:, 0] + u[:, 1]), bins=10, range=(0, 1))[0]
    assert np.abs(counts / len(u) - 0.1).max() < 0.02


def test_the_same_seed_draws_the_same_points() -> None:
    one, same, other = (draw(flat, ridge, FIRST, seed).unit for seed in (1, 1, 2))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_without_information_the_prior_is_left() -> None:
    found = draw(half, flat, FIRST, 1)
    assert found.information == pytest.approx(0.0, abs=1e-9)
    assert found.unit[:, 0].mean() == pytest.approx(2 / 3, abs=0.01)


@pytest.mark.parametrize(("error", "spread"), [(1e-3, 0.15), (1e-6, 0.15), (1e-12, 0.0)])
def test_the_tempering_ends_however_sharp_the_likelihood(error: float, spread: float) -> None:
    found = draw(flat, lambda u: -0.5 * ((u[:, 0] - 0.3) / error) ** 2, FIRST[:1024, :2], 1, n=200)
    assert found.unit[:, 0] == pytest.approx(0.3, abs=max(5 * error, 1e-3))
    assert found.unit[:, 1].std() >= spread


def test_the_likelihood_is_that_of_a_normal_with_error_and_doubt() -> None:
    deviations, doubts = np.array([[0.3, -1.0], [2.0, 0.0]]), np.array([[0.1, 2.0], [0.0, 0.5]])
    errors = np.array([0.4, 1.5])
    sd = np.hypot(errors, doubts)
    exact = norm.logpdf(deviations, 0.0, sd).sum(axis=1) - norm.logpdf(0.0, 0.0, errors).sum()
    assert log_likelihood(deviations, doubts, errors) == pytest.approx(exact)


def test_ranks_of_true_values_are_uniform_and_those_of_a_wrong_error_are_not() -> None:
    """Simulation-based calibration of the sampler, with a response whose doubt grows across the box."""
    rng = np.random.default_rng(11)

    def ranks(assumed: float) -> float:
        found = []
        for case in range(200):
            truth = rng.random(2)
            measured = response(truth[None]) + rng.normal(0, np.hypot(0.1, doubt(truth[None])))

            def likelihood(u: Array, y: Array = measured) -> Array:
                return log_likelihood((response(u) - y)[:, None], doubt(u)[:, None], np.array([assumed]))

            drawn = draw(flat, likelihood, FIRST[:1024, :2], case, n=200).unit
            found.append(int((response(drawn) < response(truth[None])).sum()))
        counts = np.bincount(np.array(found) * 10 // 201, minlength=10)
        return float(chi2.sf(((counts - 20) ** 2 / 20).sum(), 9))

    def response(u: Array) -> Array:
        return np.asarray(u[:, 0] + 0.5 * u[:, 1] ** 2)

    def doubt(u: Array) -> Array:
        return np.asarray(0.02 + 0.2 * u[:, 0])

    assert ranks(0.1) > 0.01
    assert ranks(0.01) < 1e-3


def test_what_makes_up_for_what_is_said_in_the_parameters_units() -> None:
    unit = draw(flat, ridge, FIRST, 1).unit
    (direction,) = made_up_for(unit[:, :3])
    assert direction[0] / direction[1] == pytest.approx(-6.0, rel=0.05) and direction[2] == 0
    said = in_words(np.array([0.25, -0.12, 0.0]), np.array([0.2, 0.1, 1.0]), ("MU_PP", "RF_PP", "YM"))
    assert said == "MU_PP up 0.05 is made up for by RF_PP down 0.012"


def test_nothing_makes_up_for_anything_where_each_is_determined_or_free() -> None:
    rng = np.random.default_rng(1)
    assert made_up_for(rng.random((2000, 3))) == []
    assert made_up_for(np.column_stack([rng.normal(0.5, 0.01, 2000), rng.random(2000)])) == []


def test_a_profile_is_the_best_that_the_others_can_do() -> None:
    drawn = draw(flat, ridge, FIRST, 1).unit
    found = profiles(ridge, drawn, FIRST, 1)
    grid = found[0].unit
    assert found[2].likelihood == pytest.approx(np.exp(-0.5 * ((grid - 0.4) / 0.02) ** 2), abs=0.02)
    assert found[0].likelihood.min() > 0.98 and found[5].likelihood.min() > 0.98
    assert found[3].likelihood[grid < 0.3].max() < 1e-3  # u3 cannot be below 0.4 by more than its error


def test_halving_an_error_narrows_what_the_response_decides() -> None:
    """Of a normal posterior the standard deviation falls by half; what the response does not move stays."""
    rng = np.random.default_rng(2)
    unit = np.column_stack([rng.normal(0.5, 0.1, 4000), rng.random(4000)])
    left = narrowed(unit, unit[:, :1], np.zeros((4000, 1)), np.array([0.1]), seed=1)
    assert left[0] == pytest.approx([0.5, 1.0], abs=0.03)
    doubtful = narrowed(unit, unit[:, :1], np.full((4000, 1), 10.0), np.array([0.1]), seed=1)
    assert doubtful[0] == pytest.approx([1.0, 1.0], abs=0.01)  # it is the surrogate that does not know


def test_the_stored_ranks_of_whole_calibrations_are_uniform() -> None:
    """Made by benchmarks/posterior.py on the emulator; too small a doubt would show as ranks at the ends."""
    ranks = pd.read_csv(ROOT / "reports" / "solution_space" / "ranks.csv")
    assert len(ranks) >= 200 and ranks["case"].is_unique and ranks["failure"].isna().all()
    quantities = [name for name in ranks if name.startswith("rank_")]
    for name in quantities:
        counts = np.bincount(ranks[name].astype(int) // 10, minlength=20)
        expected = len(ranks) / 20
        assert chi2.sf(((counts - expected) ** 2 / expected).sum(), 19) > 0.05 / len(quantities), name
        assert counts[[0, -1]].sum() < 0.16 * len(ranks), name  # a tenth is expected
