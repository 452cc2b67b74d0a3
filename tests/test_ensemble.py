"""Hyperparameters drawn from their posterior, against responses and noises that are known."""

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from calstudy.emulator.cokriging import CoKriging, posterior_mode, standardised
from calstudy.emulator.design import space_filling
from calstudy.emulator.ensemble import MEMBERS, Ensemble, posterior_sample
from calstudy.emulator.process import Observations, Overlap, Prior
from synthetic_runs import angle, angle_noise

pytestmark = pytest.mark.slow

SOMEWHERE = np.random.default_rng(5).random((400, 5))
SEEDS = range(1, 9)


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    with threadpool_limits(1):
        yield


def few(seed, count=40):
    rng = np.random.default_rng(seed)
    U = space_filling(count, 5, seed)
    return Observations(U, angle(U) + angle_noise(U) * rng.standard_normal(count), np.zeros(count, int))


@pytest.fixture(scope="module")
def fitted():
    with threadpool_limits(1):
        return [(CoKriging.fit(few(seed)), Ensemble.fit(few(seed))) for seed in SEEDS]


def share_inside(process):
    mean, sd = process.mean_and_sd(SOMEWHERE)
    return np.mean(np.abs(mean - angle(SOMEWHERE)) < 1.96 * sd)


def test_with_few_runs_its_intervals_hold_more_nearly_what_they_say(fitted):
    single, ensemble = (np.mean([share_inside(pair[k]) for pair in fitted]) for k in (0, 1))
    assert single < ensemble - 0.05
    assert 0.85 < ensemble < 0.995


def test_its_mean_is_no_worse(fitted):
    single, ensemble = (
        np.sqrt(np.mean([(pair[k].mean(SOMEWHERE) - angle(SOMEWHERE)) ** 2 for pair in fitted]))
        for k in (0, 1)
    )
    assert ensemble < 1.05 * single


def test_the_same_runs_make_the_same_members():
    one, again = Ensemble.fit(few(3)), Ensemble.fit(few(3))
    assert [m.settings for m in one.members] == [m.settings for m in again.members]
    assert len(one.members) == MEMBERS
    assert len({m.settings for m in one.members}) > MEMBERS / 2


def test_a_prediction_is_the_mixture_of_the_members():
    ensemble = Ensemble.fit(few(1))
    parts = [m.mean_and_sd(SOMEWHERE[:20]) for m in ensemble.members]
    rng = np.random.default_rng(0)
    drawn = np.concatenate([mean + sd * rng.standard_normal((4000, 20)) for mean, sd in parts])
    mean, sd = ensemble.mean_and_sd(SOMEWHERE[:20])
    np.testing.assert_allclose(mean, drawn.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(sd, drawn.std(axis=0), rtol=0.03)


@pytest.mark.parametrize("fidelities", [1, 2, 3])
def test_all_members_at_once_say_what_each_says(fidelities):
    data = few(1, 60)
    data = Observations(data.U, data.y, np.arange(60) % fidelities, fidelities, Overlap(1.0, 1.7))
    ensemble = Ensemble.fit(data)
    one_by_one = np.mean([member.mean(SOMEWHERE) for member in ensemble.members], axis=0)
    np.testing.assert_allclose(ensemble.mean(SOMEWHERE), one_by_one, rtol=1e-9)
    np.testing.assert_allclose(ensemble.mean(SOMEWHERE[:1]), one_by_one[:1], rtol=1e-9)


def test_draws_have_the_mixture_s_mean_and_spread():
    ensemble = Ensemble.fit(few(2))
    mean, sd = ensemble.mean_and_sd(SOMEWHERE[:30])
    drawn = np.array([ensemble.draw(np.random.default_rng(k))[0](SOMEWHERE[:30]) for k in range(400)])
    assert np.abs((drawn.mean(axis=0) - mean) / sd).max() < 0.25
    ratio = drawn.std(axis=0) / sd
    assert ratio.min() > 0.8 and ratio.max() < 1.2


def test_a_draw_has_the_noise_of_its_member():
    ensemble = Ensemble.fit(few(2))
    noises = {float(ensemble.draw(np.random.default_rng(k))[1](SOMEWHERE[:1])[0]) for k in range(100)}
    assert noises <= {float(m.noise_sd(SOMEWHERE[:1])[0]) for m in ensemble.members}
    assert len(noises) > MEMBERS / 3


def test_the_noise_is_that_of_runs_of_which_each_member_has_its_share(fitted):
    ensemble = fitted[2][1]
    each = np.array([member.noise_sd(SOMEWHERE[:9]) for member in ensemble.members])
    assert (each.max(axis=0) > 1.3 * each.min(axis=0)).all(), "members that say the same tell nothing"
    runs = np.concatenate(np.multiply.outer([1.0, -1.0], each))
    np.testing.assert_allclose(ensemble.noise_sd(SOMEWHERE[:9]), runs.std(axis=0), rtol=1e-12)


def test_the_sample_is_that_of_the_posterior():
    """Of a response that is all noise, the posterior of the noise's variance is known."""
    n = 60
    U = space_filling(n, 2, 1)
    data, *_ = standardised(Observations(U, np.random.default_rng(1).standard_normal(n), np.zeros(n, int)))
    prior = Prior.of(2, 1)
    mode = posterior_mode(data, prior)
    noises = np.concatenate(
        [[t[3] for t in posterior_sample(data, prior, mode, np.random.default_rng(k))] for k in range(40)]
    )
    # The log of a variance known from n - 3 errors scatters by sqrt(2 / (n - 3)).
    assert noises.std() == pytest.approx(np.sqrt(2.0 / (n - 3)), rel=0.35)
    assert abs(noises.mean()) < 0.15
