import numpy as np
import pytest

from calstudy.calibration.kriging.surrogates import Kriging, Surrogates
from calstudy.calibration.sampling import latin_hypercube
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED
from closed_form import PLAN, responses

SPACE = PLAN.space(PLAN.row(1))
"""DENS and RF_PP are calibrated, MU_PP is constant."""


@pytest.mark.parametrize("divisor", ["DENS", "MU_PP"], ids=["calibrated", "constant"])
def test_a_quotient_that_is_modelled_is_predicted_in_the_units_of_the_response(divisor):
    rng = np.random.default_rng(4)
    points = SPACE.box.from_unit(latin_hypercube(8, 2, rng))
    exact = np.array([[responses(SPACE.complete(p))[name] for name in MEASURED] for p in points])
    noisy = exact * (1 + 0.01 * rng.standard_normal(exact.shape))
    settings = Kriging("robust", "constant", {BULK_DENSITY: divisor})
    model = Surrogates.fit(settings, SPACE, MEASURED, points, noisy)

    at = SPACE.box.from_unit([[0.0, 0.3], [0.5, 0.9], [1.0, 0.3], [1.0, 1.0]])
    means, deviations = model.predict_with_deviations(at)
    by = np.array([SPACE.complete(p)[divisor] for p in at])
    factors = {ANGLE_OF_REPOSE: np.ones(4), BULK_DENSITY: by}
    for k, (name, single) in enumerate(zip(MEASURED, model.models, strict=True)):
        mean, sd = single.predict(at, return_std=True)
        assert means[:, k] == pytest.approx(mean * factors[name], rel=1e-12)
        assert deviations[:, k] == pytest.approx(sd * factors[name], rel=1e-12)
    assert model.predict(at) == pytest.approx(means, rel=1e-9)
    assert means == pytest.approx(
        np.array([[responses(SPACE.complete(p))[n] for n in MEASURED] for p in at]), rel=0.03
    )
    # Kriging itself saw the quotient.
    quotients = noisy[:, 1] / [SPACE.complete(p)[divisor] for p in points]
    assert model.models[1].diagnostics_.data_range == pytest.approx((quotients.min(), quotients.max()))
    assert model.diagnostics[BULK_DENSITY].data_range == pytest.approx((noisy[:, 1].min(), noisy[:, 1].max()))
