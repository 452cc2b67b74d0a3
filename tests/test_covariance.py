import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import gammaln, kv

from calstudy.calibration.kriging.covariance import (
    Hyperparameters,
    covariance,
    matern,
    matern_derivatives,
    matern_tabulated,
)
from stk import example, law


@pytest.mark.parametrize("nu", [0.5, 0.7, 1.0, 1.5, 2.44, 4.3, 10.0, 40.0])
def test_matern_is_the_bessel_formula(nu):
    h = np.geomspace(1e-2, 8.0, 200)
    t = 2.0 * np.sqrt(nu) * h
    bessel = np.exp((1.0 - nu) * np.log(2.0) - gammaln(nu) + nu * np.log(t)) * kv(nu, t)
    np.testing.assert_allclose(matern(h**2, nu), bessel, rtol=0, atol=1e-13)
    np.testing.assert_allclose(matern_tabulated(h**2, nu), bessel, rtol=0, atol=1e-13)


def test_matern_has_its_closed_forms_and_limits():
    h2 = np.array([0.0, 1e-250, 1e-12, 0.3, 2.0, 50.0, 1e6])
    t = 2.0 * np.sqrt(0.5 * h2)
    np.testing.assert_allclose(matern(h2, 0.5), np.exp(-t), rtol=0, atol=1e-14)
    t = 2.0 * np.sqrt(2.5 * h2)
    np.testing.assert_allclose(matern(h2, 2.5), (1 + t + t * t / 3) * np.exp(-t), rtol=0, atol=1e-14)
    np.testing.assert_allclose(matern(h2, 1e5), np.exp(-h2), rtol=0, atol=1e-4)
    assert matern_tabulated(np.zeros(3), 2.5) == pytest.approx([1.0, 1.0, 1.0])
    assert matern_tabulated(np.full(3, 0.3), 2.5) == pytest.approx(matern(np.full(3, 0.3), 2.5))


@law
@given(log_h2=st.floats(-12.0, 4.0), log_nu=st.floats(np.log(0.5), np.log(50.0)))
def test_matern_derivatives_are_those_of_the_correlation(log_h2, log_nu):
    def five_point(f, x, e=1e-3):
        return (8.0 * (f(x + e) - f(x - e)) - (f(x + 2 * e) - f(x - 2 * e))) / (12.0 * e)

    h2, nu = np.array([np.exp(log_h2)]), np.exp(log_nu)
    R, by_h2, by_log_nu = matern_derivatives(h2, nu)
    assert matern(h2, nu) == pytest.approx(R, abs=1e-15)
    assert h2 * by_h2 == pytest.approx(five_point(lambda x: matern(np.exp([x]), nu), log_h2), abs=1e-9)
    assert by_log_nu == pytest.approx(five_point(lambda x: matern(h2, np.exp(x)), log_nu), abs=1e-9)


def test_covariance_is_symmetric_with_the_noise_on_its_diagonal():
    U, _ = example()
    p = Hyperparameters(2.0, 1.3, (0.5, 0.7), 0.3)
    K = covariance(U, p)
    np.testing.assert_array_equal(K, K.T)
    np.testing.assert_allclose(np.diag(K), 2.3)
    assert np.linalg.eigvalsh(K).min() > 0.3


@law
@given(st.lists(st.floats(-5.0, 5.0), min_size=4, max_size=7))
def test_theta_and_hyperparameters_are_each_others_inverse(numbers):
    theta = np.array(numbers)
    np.testing.assert_allclose(Hyperparameters.of(theta).theta, theta, atol=1e-6)
