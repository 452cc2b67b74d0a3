"""Pre-posterior analysis is the closed form of a linear model, and nested Monte Carlo of any other."""

import numpy as np
import pytest

from calstudy.emulator.advice.preposterior import after, hypothetical, log_likelihoods, spread

RNG = np.random.default_rng(1)


def test_a_linear_model_gives_the_closed_form():
    d, n, j = 3, 8_000, 150
    L = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, -0.1, 0.25]])
    prior = L @ L.T
    A, doubts, errors = RNG.standard_normal((2, d)), np.array([0.05, 0.02]), np.array([0.08, 0.12])
    unit = RNG.standard_normal((n, d)) @ L.T
    means = unit @ A.T
    truths = RNG.integers(n, size=j)
    values = np.vstack([hypothetical(means[t], doubts, errors, 1, RNG) for t in truths])
    found = after(
        unit,
        sum(log_likelihoods(values[:, k], means[:, k], np.full(n, doubts[k]), errors[k]) for k in range(2)),
    )
    noise = np.diag(errors**2 + doubts**2)
    exact = np.linalg.inv(np.linalg.inv(prior) + A.T @ np.linalg.inv(noise) @ A)
    assert found.covariance.mean(axis=0) == pytest.approx(exact, abs=0.03 * exact.max())
    nats = 0.5 * np.linalg.slogdet(prior @ np.linalg.inv(exact))[1]
    assert found.information.mean() == pytest.approx(nats, abs=0.15)


def test_a_bent_model_gives_what_nested_monte_carlo_does():
    grid = np.linspace(0.0, 1.0, 4001)
    response, doubt, error = (lambda x: (x - 0.4) ** 2), (lambda x: 0.01 + 0.03 * x), 0.02
    brute = []
    for truth in RNG.random(800):
        y = response(truth) + np.hypot(error, doubt(truth)) * RNG.standard_normal()
        sd = np.hypot(error, doubt(grid))
        p = np.exp(-0.5 * ((y - response(grid)) / sd) ** 2) / sd
        p /= p.sum()
        brute.append(p @ grid**2 - (p @ grid) ** 2)
    unit = RNG.random((3000, 1))
    means, doubts = response(unit[:, 0]), doubt(unit[:, 0])
    truths = RNG.integers(3000, size=800)
    values = [hypothetical(means[[t]], doubts[[t]], np.array([error]), 1, RNG)[0, 0] for t in truths]
    found = after(unit, log_likelihoods(np.array(values), means, doubts, error))
    se = np.hypot(np.std(brute), found.covariance.std()) / np.sqrt(800)
    assert found.covariance.mean() == pytest.approx(np.mean(brute), abs=4 * se)


def test_points_with_weights_count_as_so_many_points():
    unit, values = RNG.random((40, 2)), -RNG.random((3, 40))
    counts = RNG.integers(1, 5, 40)
    many, few = (
        after(np.repeat(unit, counts, axis=0), np.repeat(values, counts, axis=1)),
        after(unit, values, np.log(counts)),
    )
    corrected = [of.covariance * (1.0 - 1.0 / of.effective)[:, None, None] for of in (few, many)]
    assert corrected[0] == pytest.approx(corrected[1])
    assert few.information == pytest.approx(many.information)


def test_a_measurement_that_says_nothing_leaves_everything():
    unit = RNG.random((500, 2))
    found = after(unit, np.zeros((1, 500)))
    assert found.covariance[0] == pytest.approx(np.cov(unit, rowvar=False))
    assert found.information[0] == pytest.approx(0.0, abs=1e-12) and found.effective[0] == pytest.approx(500)


def test_few_points_do_not_make_a_width_small():
    unit = RNG.random((4000, 1))
    drawn = [after(unit[k : k + 4], np.zeros((1, 4))).covariance[0, 0, 0] for k in range(0, 4000, 4)]
    assert np.mean(drawn) == pytest.approx(1.0 / 12.0, rel=0.06)


def test_the_spread_along_an_axis_is_its_standard_deviation():
    covariance = np.array([[0.04, 0.01], [0.01, 0.09]])
    directions = np.array([[2.0, 0.0], [0.0, -1.0], [1.0, 1.0]])
    assert spread(covariance, directions) == pytest.approx([0.2, 0.3, np.sqrt(0.075)])
