import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.calibration.kriging.covariance import Hyperparameters
from calstudy.calibration.kriging.predictor import (
    Contrasts,
    Predictor,
    likelihood_gradient,
    negative_log_restricted_likelihood,
    trend,
)
from calstudy.errors import NumericsError
from stk import (
    CASES,
    DESIGN,
    PREDICTIONS,
    STK,
    TEST,
    example,
    kriging_2d,
    law,
    responses,
    stk_hyperparameters,
    unit,
)

# --- golden numbers of STK (origin in golden/README.md) -----------------------------------------------


@pytest.mark.parametrize("row", CASES)
def test_restricted_likelihood_at_stk_parameters(row):
    value = negative_log_restricted_likelihood(
        Contrasts.of(unit(DESIGN)), responses(row.response, row.rep), stk_hyperparameters(row)
    )
    assert value == pytest.approx(row.neg_log_restricted_likelihood, abs=1e-6)


@pytest.mark.parametrize("row", CASES)
def test_prediction_at_stk_parameters(row):
    predictor = Predictor.of(
        Contrasts.of(unit(DESIGN)), responses(row.response, row.rep), stk_hyperparameters(row)
    )
    stk = PREDICTIONS.loc[(row.response, row.rep)].sort_values("point")
    points = unit(TEST)[stk.point]
    mean, variance = predictor.mean_and_variance(points)
    version = row.stk.replace(".", "")
    sd = np.sqrt(stk[f"var_stk{version}"].to_numpy())
    assert np.abs(mean - stk[f"mean_stk{version}"].to_numpy()).max() <= 1e-6 * sd.min()
    assert np.abs(np.sqrt(variance) - sd).max() <= 1e-6 * sd.min()
    np.testing.assert_allclose(predictor.mean(points), mean, rtol=1e-12)


def test_control_another_smoothness_misses_stk():
    row = STK[0]
    p = stk_hyperparameters(row)
    wrong = Hyperparameters(p.variance, p.smoothness * 1.01, p.ranges, p.noise_variance)
    value = negative_log_restricted_likelihood(Contrasts.of(unit(DESIGN)), responses("AoR", 0), wrong)
    assert abs(value - row.neg_log_restricted_likelihood) > 1e-5


# --- laws at given hyperparameters ------------------------------------------------------------------

either_trend = pytest.mark.parametrize("kind", ["affine", "constant"])

hyperparameters = st.builds(
    Hyperparameters,
    variance=st.floats(0.1, 10.0),
    smoothness=st.floats(0.5, 4.0),
    ranges=st.tuples(st.floats(0.1, 3.0), st.floats(0.1, 3.0)),
    noise_variance=st.floats(1e-4, 1.0),
)


@law
@given(p=hyperparameters, seed=st.integers(0, 1000))
def test_a_linear_function_is_reproduced_exactly(p, seed):
    U, _ = example(seed=seed)
    line = np.array([3.0, -2.0, 0.5])
    far = np.random.default_rng(seed).uniform(-3.0, 4.0, (20, 2))
    predictor = Predictor.of(Contrasts.of(U), line[0] + U @ line[1:], p)
    np.testing.assert_allclose(predictor.mean(far), line[0] + far @ line[1:], atol=1e-9)


@pytest.mark.parametrize(("kind", "q"), [("affine", 3), ("constant", 1)])
def test_contrasts_are_all_that_the_trend_leaves(kind, q):
    U, _ = example()
    c = Contrasts.of(U, kind=kind)
    P = trend(U, kind)
    assert (c.Q.shape, c.T.shape, c.W.shape) == ((15, q), (q, q), (15, 15 - q))
    np.testing.assert_allclose(P, np.hstack([np.ones((15, 1)), U])[:, :q])
    np.testing.assert_allclose(c.Q @ c.T, P, atol=1e-12)
    np.testing.assert_allclose(c.W.T @ P, 0.0, atol=1e-12)
    np.testing.assert_allclose(c.W.T @ c.W, np.eye(15 - q), atol=1e-12)
    np.testing.assert_allclose(c.trend(U[:4]), P[:4])


@pytest.mark.slow
@either_trend
@law
@given(p=hyperparameters, seed=st.integers(0, 1000))
def test_without_noise_the_data_are_interpolated(kind, p, seed):
    U, z = example(seed=seed)
    exact = Hyperparameters(p.variance, p.smoothness, p.ranges, 0.0)
    mean, variance = Predictor.of(Contrasts.of(U, kind=kind), z, exact).mean_and_variance(U)
    np.testing.assert_allclose(mean, z, atol=1e-6)
    np.testing.assert_allclose(variance, 0.0, atol=1e-6 * p.variance)


def test_control_with_noise_the_data_are_not_interpolated():
    U, z = example()
    p = Hyperparameters(1.0, 2.5, (0.5, 0.5), 0.1)
    mean, variance = Predictor.of(Contrasts.of(U), z, p).mean_and_variance(U)
    assert np.abs(mean - z).max() > 1e-2
    assert variance.min() > 1e-3


@pytest.mark.slow
@either_trend
@law
@given(p=hyperparameters, seed=st.integers(0, 1000))
def test_leave_one_out_by_formula_is_refitting(kind, p, seed):
    U, z = example(seed=seed)
    error, variance = Predictor.of(Contrasts.of(U, kind=kind), z, p).leave_one_out()
    for i in range(len(z)):
        others = np.arange(len(z)) != i
        predictor = Predictor.of(Contrasts.of(U[others], kind=kind), z[others], p)
        mean, process = predictor.mean_and_variance(U[[i]])
        assert error[i] == pytest.approx(z[i] - mean[0], rel=1e-6, abs=1e-8)
        assert variance[i] == pytest.approx(process[0] + p.noise_variance, rel=1e-6)


def test_leaving_out_a_point_that_carries_the_trend_alone_is_undetermined():
    U, z = example()
    U[:, 1] = 0.5
    U[4, 1] = 0.9
    error, variance = Predictor.of(Contrasts.of(U), z, Hyperparameters(1.0, 2.5, (1, 1), 0.1)).leave_one_out()
    assert np.flatnonzero(np.isnan(error)).tolist() == [4]
    assert np.flatnonzero(np.isnan(variance)).tolist() == [4]
    assert np.isnan(kriging_2d().fit(U, z).diagnostics_.leave_one_out_rmse)


@law
@given(p=hyperparameters, seed=st.integers(0, 1000))
def test_order_of_the_points_does_not_matter(p, seed):
    U, z = example(seed=seed)
    order = np.random.default_rng(seed).permutation(len(z))
    points = np.random.default_rng(seed).random((5, 2))
    first = Predictor.of(Contrasts.of(U), z, p).mean_and_variance(points)
    second = Predictor.of(Contrasts.of(U[order]), z[order], p).mean_and_variance(points)
    np.testing.assert_allclose(first, second, rtol=1e-7, atol=1e-9)


@law
@given(p=hyperparameters, factor=st.floats(1e-3, 1e3), shift=st.floats(-10.0, 10.0))
def test_units_of_the_response_only_scale_the_answer(p, factor, shift):
    U, z = example()
    points = np.random.default_rng(1).random((5, 2))
    mean, variance = Predictor.of(Contrasts.of(U), z, p).mean_and_variance(points)
    other = Predictor.of(Contrasts.of(U), factor * z + shift, p.scaled(1.0, factor))
    other_mean, other_variance = other.mean_and_variance(points)
    np.testing.assert_allclose(other_mean, factor * mean + shift, rtol=1e-6, atol=1e-7 * factor)
    np.testing.assert_allclose(other_variance, factor**2 * variance, rtol=1e-6)


@either_trend
@law
@given(p=hyperparameters, seed=st.integers(0, 1000))
def test_gradient_is_that_of_the_likelihood(kind, p, seed):
    U, z = example(seed=seed)
    c = Contrasts.of(U, kind=kind)
    theta = np.log([p.variance, p.smoothness, *(1.0 / np.array(p.ranges)), p.noise_variance])
    value, gradient = likelihood_gradient(c, z, theta)
    at = Hyperparameters.of(theta)
    assert value == pytest.approx(negative_log_restricted_likelihood(c, z, at), rel=1e-10)
    for k in range(len(theta)):
        e = 1e-4 * np.eye(len(theta))[k]
        step = likelihood_gradient(c, z, theta + e)[0] - likelihood_gradient(c, z, theta - e)[0]
        assert gradient[k] == pytest.approx(step / 2e-4, rel=1e-5, abs=1e-5)


def test_restricted_likelihood_does_not_see_the_trend():
    U, z = example()
    c = Contrasts.of(U)
    p = Hyperparameters(1.0, 2.5, (0.5, 0.5), 0.1)
    tilted = z + 7.0 - 3.0 * U[:, 0] + 100.0 * U[:, 1]
    assert negative_log_restricted_likelihood(c, tilted, p) == pytest.approx(
        negative_log_restricted_likelihood(c, z, p), rel=1e-9
    )
    bent = z + U[:, 0] ** 2
    assert negative_log_restricted_likelihood(c, bent, p) != pytest.approx(
        negative_log_restricted_likelihood(c, z, p), rel=1e-3
    )


def test_singular_covariance_is_an_error():
    U, z = example()
    U[1] = U[0]
    with pytest.raises(NumericsError, match="singular"):
        Predictor.of(Contrasts.of(U), z, Hyperparameters(1.0, 2.5, (1.0, 1.0), 0.0))
