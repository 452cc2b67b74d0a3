"""Kriging averaged over plausible hyperparameters."""

from __future__ import annotations

import numpy as np
import pytest

from calstudy.calibration.kriging.averaged import MEMBERS, AveragedKriging
from calstudy.calibration.kriging.covariance import Hyperparameters, covariance
from calstudy.calibration.kriging.surrogates import Kriging, Surrogates
from calstudy.calibration.kriging.universal import UniversalKriging
from calstudy.calibration.sampling import maximin_optimised
from calstudy.parameters import Array, Parameter, Space


def fitted(points: Array, responses: Array, noise_sd: float | None = None) -> UniversalKriging:
    d = points.shape[1]
    model = UniversalKriging(
        np.zeros(d), np.ones(d), mode="robust", trend="constant", noise_sd=noise_sd, settled=True
    )
    return model.fit(points, responses)


def made_up(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    """Points (n, 3) and a draw (n,) of a process whose hyperparameters are drawn from the prior's middle."""
    points = np.vstack([maximin_optimised(12, 3, rng, 200), rng.random((n - 12, 3))])
    ranges = tuple(float(r) for r in 4.0 * np.sqrt(3.0) * np.exp(rng.normal(0.0, 1.0, 3)))
    K = covariance(points, Hyperparameters(10.0, 2.5, ranges, 1e-9))
    return points, np.linalg.cholesky(K + 1e-8 * np.eye(n)) @ rng.standard_normal(n)


def test_doubts_of_the_average_hold_the_truth_more_often() -> None:
    rng = np.random.default_rng(1)
    held: dict[str, list[float]] = {"most probable": [], "averaged": []}
    for seed in range(25):
        points, exact = made_up(rng, 60)
        noise = 0.1 * float(exact[:12].std())
        model = fitted(points[:12], exact[:12] + rng.normal(0.0, noise, 12), noise)
        for name, one in (("most probable", model), ("averaged", AveragedKriging.of(model, seed))):
            mean, sd = one.predict(points[12:], return_std=True)
            held[name].append(float(np.mean(np.abs(exact[12:] - mean) < 1.645 * sd)))
    shares = {name: np.mean(found) for name, found in held.items()}
    assert shares["most probable"] < shares["averaged"]
    assert 0.86 < shares["averaged"] < 0.97


def test_the_same_seed_gives_the_same_members() -> None:
    rng = np.random.default_rng(2)
    points = rng.random((12, 2))
    model = fitted(points, np.sin(3 * points[:, 0]) + rng.normal(0, 0.1, 12), 0.1)
    elsewhere = rng.random((5, 2))
    one, same, other = (AveragedKriging.of(model, seed).predict(elsewhere) for seed in (1, 1, 2))
    assert np.array_equal(one, same) and not np.array_equal(one, other)
    assert len(AveragedKriging.of(model, 1).members) == MEMBERS


def test_where_the_trend_explains_all_there_is_nothing_to_average() -> None:
    points = np.random.default_rng(3).random((8, 2))
    model = UniversalKriging(np.zeros(2), np.ones(2), mode="robust").fit(points, 2.0 + points @ [1.0, -3.0])
    averaged = AveragedKriging.of(model, 1)
    mean, sd = averaged.predict(points, return_std=True)
    assert averaged.members == () and mean == pytest.approx(2.0 + points @ [1.0, -3.0])
    assert (sd == 0).all() and np.array_equal(averaged.predict(points), mean)


def test_many_runs_leave_little_to_average() -> None:
    rng = np.random.default_rng(4)
    points = rng.random((80, 2))
    model = fitted(points, np.sin(6 * points[:, 0]) + points[:, 1] + rng.normal(0, 0.05, 80), 0.05)
    mean, sd = model.predict(points, return_std=True)
    averaged, wider = AveragedKriging.of(model, 1).predict(points, return_std=True)
    assert averaged == pytest.approx(mean, abs=0.03) and wider.mean() == pytest.approx(sd.mean(), rel=0.2)


def test_averaged_surrogates_keep_factors_and_units() -> None:
    rng = np.random.default_rng(5)
    space = Space(
        (Parameter("DENS", "kg/m3", 2400.0, 2600.0, None), Parameter("MU", "-", 0.1, 0.3, None)),
        ("DENS", "MU"),
    )
    points = space.box.from_unit(rng.random((14, 2)))
    density = points[:, 0] * (0.6 + 0.05 * points[:, 1]) + rng.normal(0, 2.0, 14)
    kriging = Kriging(hyperparameters="robust", trend="constant", divisors={"density": "DENS"})
    surrogates = Surrogates.fit(kriging, space, ["density"], points, density[:, None], {"density": 2.0})
    mean, sd = surrogates.averaged(1).predict_with_deviations(points)
    assert mean[:, 0] == pytest.approx(density, abs=8.0) and (sd < 8.0).all()
