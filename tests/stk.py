"""STK's golden numbers (origin in golden/README.md) and a small example, for the tests of the numerics."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import settings

from calstudy.calibration.kriging.covariance import Hyperparameters
from calstudy.calibration.kriging.universal import UniversalKriging
from calstudy.calibration.sampling import latin_hypercube

GOLDEN = Path(__file__).parent / "golden"
NAMES = ["DENS", "MU_PP", "RF_PP", "YM"]
INTERVALS = pd.read_csv(GOLDEN / "kriging_intervals.csv").set_index("bound")[NAMES]
LOWER, UPPER = INTERVALS.loc["lower"].to_numpy(float), INTERVALS.loc["upper"].to_numpy(float)
DESIGN = pd.read_csv(GOLDEN / "kriging_design.csv")[NAMES].to_numpy()
TEST = pd.read_csv(GOLDEN / "kriging_test_points.csv")[NAMES].to_numpy()
TRUTH = pd.read_csv(GOLDEN / "kriging_test_truth.csv")
RESPONSES = pd.read_csv(GOLDEN / "kriging_responses.csv")
PREDICTIONS = pd.read_csv(GOLDEN / "kriging_stk_predictions.csv").set_index(["response", "rep"])
STK = [row for _, row in pd.read_csv(GOLDEN / "kriging_stk_parameters.csv").iterrows()]

CASES = [pytest.param(row, id=f"{row.response}-{row.rep}-stk{row.stk}") for row in STK]
CASES_234 = [case for case, row in zip(CASES, STK, strict=True) if row.stk == "2.3.4"]

law = settings(max_examples=20, deadline=None)


def unit(points):
    return (points - LOWER) / (UPPER - LOWER)


def responses(response, rep):
    chosen = RESPONSES[(RESPONSES.response == response) & (RESPONSES.rep == rep)]
    return chosen.sort_values("point").value.to_numpy()


def stk_hyperparameters(row):
    inverse_ranges = np.exp([row[f"loginvrho_{name}"] for name in NAMES]) * (UPPER - LOWER)
    return Hyperparameters(
        np.exp(row.log_sigma2),
        np.exp(row.log_nu),
        tuple(1.0 / inverse_ranges),
        np.exp(row.log_noise_variance),
    )


def example(n=15, d=2, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    U = latin_hypercube(n, d, rng)
    return U, np.sin(4.0 * U[:, 0]) + U[:, -1] ** 2 + noise * rng.normal(size=n)


def kriging_2d(mode="paper"):
    return UniversalKriging([0.0, 0.0], [1.0, 1.0], parameter_names=["MU_PP", "RF_PP"], mode=mode)
