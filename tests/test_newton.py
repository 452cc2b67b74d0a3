"""Where a search comes to rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calstudy.calibration.kriging.newton import at_rest

law = settings(max_examples=40, deadline=None)
seeds = st.integers(0, 2**32 - 1)
WIDE = 100.0


def bowl(rng, d):
    """Convex function that is no quadratic, and where it is least."""
    A, centre = rng.normal(size=(d + 1, d)), rng.uniform(-1.0, 1.0, d)

    def function(t):
        r = A @ (t - centre)
        return float(r @ r + np.sum(r**4)), A.T @ (2.0 * r + 4.0 * r**3)

    return function, centre


@law
@given(seed=seeds, d=st.integers(1, 5))
def test_ends_that_lie_apart_come_to_rest_at_one_point(seed, d):
    rng = np.random.default_rng(seed)
    function, centre = bowl(rng, d)
    bounds = np.full(d, -WIDE), np.full(d, WIDE)
    for _ in range(2):
        end = centre + 1e-3 * rng.normal(size=d)
        assert at_rest(function, end, *bounds) == pytest.approx(centre, abs=1e-9)


def test_a_bound_that_the_gradient_pushes_against_is_kept_exactly():
    def function(t):
        return float(np.sum((t + 1.0) ** 2) + t[0] * t[1]), 2.0 * (t + 1.0) + t[::-1]

    lower, upper = np.array([0.1, -3.0]), np.array([1.0, 3.0])
    found = at_rest(function, np.array([0.1 + 1e-12, -1.01]), lower, upper)
    assert found[0] == 0.1 and found[1] == pytest.approx(-1.05, abs=1e-9)


def test_a_direction_that_is_flat_is_left_where_it_is():
    function, _ = bowl(np.random.default_rng(1), 2)

    def flat(t):
        value, gradient = function(t[:2])
        return value + 1e-9 * t[2] ** 2, np.append(gradient, 2e-9 * t[2])

    found = at_rest(flat, np.array([0.2, -0.1, 7.0]), np.full(3, -WIDE), np.full(3, WIDE))
    assert found[2] == pytest.approx(7.0, abs=1e-6)


def test_nothing_is_moved_uphill():
    def saddle(t):
        return float(t[0] ** 2 - t[1] ** 2), np.array([2.0 * t[0], -2.0 * t[1]])

    found = at_rest(saddle, np.array([0.01, 0.3]), np.full(2, -1.0), np.full(2, 1.0))
    assert found == pytest.approx([0.0, 0.3], abs=1e-9)
