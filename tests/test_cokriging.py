"""The two-fidelity process, against functions and noises that are known."""

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from calstudy.calibration.kriging.covariance import matern, matern_derivatives, matern_five_halves
from calstudy.emulator.cokriging import CoKriging
from calstudy.emulator.design import space_filling
from calstudy.emulator.process import (
    Observations,
    Offset,
    Overlap,
    Prior,
    Settings,
    negative_log_posterior,
)
from calstudy.errors import NumericsError
from synthetic_runs import angle, angle_noise

pytestmark = pytest.mark.slow

CHEAP, EXPENSIVE, REPEATS = 100, 20, 10
SOMEWHERE = np.random.default_rng(5).random((400, 5))


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    with threadpool_limits(1):
        yield


def observations(seed, noise=angle_noise):
    rng = np.random.default_rng(seed)
    U = space_filling(CHEAP, 5, seed)
    U = np.vstack([U, U[:REPEATS], U[:EXPENSIVE]])
    is_expensive = np.arange(len(U)) >= CHEAP + REPEATS
    mean = np.where(is_expensive, angle(U), (angle(U) - 2.0) / 1.1)
    return Observations(U, mean + noise(U) * rng.standard_normal(len(U)), is_expensive.astype(int), 2)


def points(data):
    return np.unique(data.U, axis=0, return_inverse=True)[1].reshape(-1)


@pytest.fixture(scope="module")
def several():
    with threadpool_limits(1):
        return [CoKriging.fit(observations(seed)) for seed in range(1, 6)]


@pytest.fixture(scope="module")
def fitted(several):
    return several[0]


def test_a_search_that_tries_a_singular_corner_turns_back():
    U = space_filling(164, 5, 7)
    is_expensive = np.arange(164) % 7 == 0
    bowl = 22.0 + 24.0 * (U[:, 0] - 0.5) ** 2 + 3.0 * np.sin(3.0 * U[:, 2])
    noise = 0.5 * np.exp(0.8 * (U[:, 0] - 0.5)) * np.random.default_rng(7).standard_normal(164)
    fitted = CoKriging.fit(Observations(U, bowl + noise - 1.2 * ~is_expensive, is_expensive.astype(int), 2))
    there = 22.0 + 24.0 * (SOMEWHERE[:, 0] - 0.5) ** 2 + 3.0 * np.sin(3.0 * SOMEWHERE[:, 2])
    assert np.sqrt(np.mean((fitted.mean(SOMEWHERE) - there) ** 2)) < 0.5


def test_the_closed_form_of_the_correlation_is_the_correlation():
    h2 = np.array([0.0, 1e-6, 0.01, 0.3, 1.0, 7.0, 60.0])
    R, by_h2 = matern_five_halves(h2)
    np.testing.assert_allclose(R, matern(h2, 2.5), rtol=1e-11, atol=1e-15)
    np.testing.assert_allclose(by_h2[1:], matern_derivatives(h2, 2.5)[1][1:], rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("overlap", [None, Overlap(1.0, 1.7)])
@pytest.mark.parametrize("fidelities", [1, 2, 3, 4])
def test_the_gradient_is_that_of_the_density(fidelities, overlap):
    data = observations(2)
    y = (data.y - data.y.mean()) / data.y.std()
    data = Observations(data.U, y, np.arange(len(y)) % fidelities, fidelities, overlap)
    prior = Prior.of(5, fidelities)
    rng = np.random.default_rng(3)
    theta = prior.centre + 0.5 * prior.sd * rng.standard_normal(len(prior.sd))
    _, gradient = negative_log_posterior(data, prior, theta)
    for k, step in enumerate(1e-5 * np.eye(len(theta))):
        higher, lower = (negative_log_posterior(data, prior, theta + s * step)[0] for s in (1, -1))
        assert gradient[k] == pytest.approx((higher - lower) / 2e-5, abs=2e-5 * np.abs(gradient).max())


def test_the_mean_is_found_to_a_fraction_of_the_noise(several):
    errors = [process.mean(SOMEWHERE) - angle(SOMEWHERE) for process in several]
    assert np.sqrt(np.mean(np.square(errors))) < 0.6 * angle_noise(SOMEWHERE).mean()


def test_the_bias_of_the_cheap_fidelity_is_taken_off(fitted):
    data = fitted.data
    cheap_alone = CoKriging.fit(Observations(data.U[:CHEAP], data.y[:CHEAP], np.zeros(CHEAP, int)))
    assert np.mean(cheap_alone.mean(SOMEWHERE) - angle(SOMEWHERE)) < -3.0
    assert abs(np.mean(fitted.mean(SOMEWHERE) - angle(SOMEWHERE))) < 0.3


def test_intervals_hold_what_they_say(several):
    inside, runs = [], []
    for process in several:
        mean, sd = process.mean_and_sd(SOMEWHERE)
        inside.append(np.mean(np.abs(mean - angle(SOMEWHERE)) < 1.96 * sd))
        error, sd = process.left_out(points(process.data))
        runs.append(np.mean(np.abs(error) < 1.96 * sd))
    assert 0.85 < np.mean(inside) <= 1.0
    assert 0.91 < np.mean(runs) < 0.985


def test_the_noise_follows_the_parameters(several):
    ends = np.full((2, 5), 0.5)
    ends[:, 0] = 0.1, 0.9
    low, high = np.mean([process.noise_sd(ends) for process in several], axis=0)
    assert low == pytest.approx(angle_noise(ends[:1])[0], rel=0.2)
    assert high == pytest.approx(angle_noise(ends[1:])[0], rel=0.2)


def test_the_noise_is_that_of_the_reference_and_not_of_the_cheap_fidelity():
    data = observations(1)
    # The cheap noise has an sd of 0.1 at the middle, grows by a factor e over the first input's interval,
    # and is doubled at the reference; all in units of the scale, 3 deg.
    noise = {"noise": np.log(0.1**2), "noise_slopes": (2.0, 0.0, 0.0, 0.0, 0.0)}
    offset = Offset(1.1, 0.03, 2.0, np.log(4))
    settings = Settings(1.0, (2.0,) * 5, **noise, offsets=(offset,))
    noisy = CoKriging(data, settings, 22.0, 3.0)
    doubled = 2 * 3.0 * 0.1 * np.exp(SOMEWHERE[:, 0] - 0.5)
    np.testing.assert_allclose(noisy.noise_sd(SOMEWHERE), doubled, rtol=1e-12)


def test_a_run_left_out_is_predicted_as_by_a_fit_without_its_point(fitted):
    numbers = points(fitted.data)
    error, sd = fitted.left_out(numbers)
    for point in (0, 7):
        here = numbers == point
        without = replace(fitted, data=fitted.data.without(here))
        expected, deviation = without.errors_elsewhere(fitted.data, here)
        np.testing.assert_allclose(error[here], expected, rtol=1e-6)
        np.testing.assert_allclose(sd[here], deviation, rtol=1e-6)


def test_draws_have_the_posterior_s_mean_and_spread(fitted):
    mean, sd = fitted.mean_and_sd(SOMEWHERE[:30])
    drawn = np.array([fitted.draw(np.random.default_rng(k))(SOMEWHERE[:30]) for k in range(200)])
    assert np.abs((drawn.mean(axis=0) - mean) / sd).max() < 0.3
    ratio = drawn.std(axis=0) / sd
    assert ratio.min() > 0.85 and ratio.max() < 1.15


def test_a_draw_is_smooth_and_carries_no_noise(fitted):
    path = fitted.draw(np.random.default_rng(1))
    close = SOMEWHERE + 1e-4
    assert np.abs(path(close) - path(SOMEWHERE)).max() < 0.01


def test_a_draw_is_one_function_wherever_it_is_asked(fitted):
    one, again = (fitted.draw(np.random.default_rng(9)) for _ in range(2))
    together = one(SOMEWHERE[:50])
    one_by_one = np.array([again(u[None, :])[0] for u in SOMEWHERE[:50][::-1]])[::-1]
    np.testing.assert_allclose(one_by_one, together, rtol=1e-11)
    assert np.abs(fitted.draw(np.random.default_rng(8))(SOMEWHERE[:50]) - together).max() > 0.01


def test_of_one_fidelity_nothing_is_said_of_another():
    data = observations(1)
    single = CoKriging.fit(Observations(data.U[:CHEAP], data.y[:CHEAP], np.zeros(CHEAP, int)))
    assert single.settings.offsets == ()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda U, y, r: (U[:7], y[:7], r[:7]), "7 runs are too few"),
        (lambda U, y, r: (U, y, 0 * r), "no run has the reference fidelity"),
        (lambda U, y, r: (U, np.ones(len(y)), r), "the same in all runs"),
    ],
)
def test_runs_that_tell_nothing_are_refused(change, complaint):
    data = observations(1)
    with pytest.raises(NumericsError, match=complaint):
        Observations(*change(data.U, data.y, data.level), data.levels)
