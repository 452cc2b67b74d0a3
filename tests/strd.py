"""Five problems of the NIST Statistical Reference Datasets, nonlinear regression, with certified values.

https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml: data, both starts, parameters and residual sum of
squares as certified there.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Problem:
    """Model y = f(x, b), data, the two starts and the certified least squares."""

    model: Callable
    x: np.ndarray
    y: np.ndarray
    starts: tuple[tuple[float, ...], tuple[float, ...]]
    certified: np.ndarray
    sum_of_squares: float

    def residuals(self, b):
        return self.model(self.x, b) - self.y


STRD = {
    "Misra1a": Problem(
        lambda x, b: b[0] * (1 - np.exp(-b[1] * x)),
        np.array(
            [77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1, 689.1, 760.0]
        ),
        np.array(
            [10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.4, 75.47, 81.78]
        ),
        ((500, 1e-4), (250, 5e-4)),
        np.array([2.3894212918e02, 5.5015643181e-04]),
        1.2455138894e-01,
    ),
    "DanWood": Problem(
        lambda x, b: b[0] * x ** b[1],
        np.array([1.309, 1.471, 1.490, 1.565, 1.611, 1.680]),
        np.array([2.138, 3.421, 3.597, 4.340, 4.882, 5.660]),
        ((1, 5), (0.7, 4)),
        np.array([7.6886226176e-01, 3.8604055871e00]),
        4.3173084083e-03,
    ),
    "MGH09": Problem(
        lambda x, b: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
        np.array([4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625]),
        np.array([0.1957, 0.1947, 0.1735, 0.16, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246]),
        ((25, 39, 41.5, 39), (0.25, 0.39, 0.415, 0.39)),
        np.array([1.9280693458e-01, 1.9128232873e-01, 1.2305650693e-01, 1.3606233068e-01]),
        3.0750560385e-04,
    ),
    "BoxBOD": Problem(
        lambda x, b: b[0] * (1 - np.exp(-b[1] * x)),
        np.array([1.0, 2.0, 3.0, 5.0, 7.0, 10.0]),
        np.array([109.0, 149.0, 149.0, 191.0, 213.0, 224.0]),
        ((1, 1), (100, 0.75)),
        np.array([2.1380940889e02, 5.4723748542e-01]),
        1.1680088766e03,
    ),
    "Rat42": Problem(
        lambda x, b: b[0] / (1 + np.exp(b[1] - b[2] * x)),
        np.array([9.0, 14.0, 21.0, 28.0, 42.0, 57.0, 63.0, 70.0, 79.0]),
        np.array([8.93, 10.80, 18.59, 22.33, 39.35, 56.11, 61.73, 64.62, 67.08]),
        ((100, 1, 0.1), (75, 2.5, 0.07)),
        np.array([7.2462237576e01, 2.6180768402e00, 6.7359200066e-02]),
        8.0565229338e00,
    ),
}
