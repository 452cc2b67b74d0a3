"""Solutions with parameters held: what the others must do, against the normal distribution's closed form."""

import numpy as np

from calstudy.calibration.narrowing import KERNEL, held, weighted_quantiles

N, SD, CORRELATION = 20_000, 0.1, -0.8
COVARIANCE = SD**2 * np.array([[1.0, CORRELATION], [CORRELATION, 1.0]])
UNIT = np.random.default_rng(1).multivariate_normal([0.5, 0.5], COVARIANCE, N)
EQUAL = np.full(N, 1 / N)


def test_the_others_follow_as_a_normal_distribution_given_one_value():
    weights, left = held(UNIT, EQUAL, {0: 0.6})
    # The kernel draws the value towards the middle by KERNEL^2 / (KERNEL^2 + SD^2).
    at = 0.1 * SD**2 / (SD**2 + KERNEL**2)
    low, middle, high = weighted_quantiles(UNIT[:, 1], weights, [0.05, 0.5, 0.95])
    assert abs(middle - (0.5 + CORRELATION * at)) < 0.005
    spread = SD * np.sqrt(1 - CORRELATION**2 * SD**2 / (SD**2 + KERNEL**2))
    assert abs((high - low) / (2 * 1.6449) - spread) < 0.005
    assert 500 < left < N


def test_nothing_held_leaves_all_solutions_as_they_are():
    weights, left = held(UNIT, EQUAL, {})
    assert np.allclose(weights, EQUAL)
    assert round(left) == N


def test_where_no_solution_is_none_counts():
    assert held(UNIT, EQUAL, {0: 2.0})[1] < 1e-6
    assert held(UNIT, EQUAL, {0: 0.75, 1: 0.75})[1] < 30


def test_weights_of_the_solutions_count():
    half = np.where(UNIT[:, 0] < 0.5, 2.0, 0.0) / N
    assert abs(held(UNIT, half / half.sum(), {})[1] - N / 2) < 0.02 * N
