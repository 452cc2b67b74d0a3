"""Print whether an emulator's 95 % intervals hold steep responses, and whether it says so where they do not.

    python benchmarks/steep.py [--designs N]

Ishigami's and Hartmann's functions, which ten runs a parameter do not follow, and a smooth one; little noise
and much; a tenth of the runs repeated or none. Each line is one fit: the share of 500 points whose true value
lies in the interval of the mean, and what ``calstudy emulator fit`` says of it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from threadpoolctl import threadpool_limits

from calstudy.emulator.design import space_filling
from calstudy.emulator.ensemble import Ensemble
from calstudy.emulator.process import Observations
from calstudy.emulator.validation import HALF_WIDTH, Unexplained, unexplained_of
from calstudy.parameters import Array

PEAKS = 1e-4 * np.array(
    [
        [1312, 1696, 5569, 124, 8283, 5886],
        [2329, 4135, 8307, 3736, 1004, 9991],
        [2348, 1451, 3522, 2883, 3047, 6650],
        [4047, 8828, 8732, 5743, 1091, 381],
    ]
)
RATES = np.array(
    [
        [10, 3, 17, 3.5, 1.7, 8],
        [0.05, 10, 17, 0.1, 8, 14],
        [3, 3.5, 1.7, 10, 17, 8],
        [17, 8, 0.05, 10, 0.1, 14],
    ]
)
HEIGHTS = np.array([1.0, 1.2, 3.0, 3.2])


def ishigami(U: Array) -> Array:
    """Ishigami's function at points (m,3) of the unit cube, (m,)."""
    x, y, z = np.pi * (2.0 * U.T - 1.0)
    return np.asarray(np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x), float)


def hartmann(U: Array) -> Array:
    """Hartmann's function of six inputs at points (m,6), (m,)."""
    squared = (RATES * (U[:, None, :] - PEAKS) ** 2).sum(axis=2)
    return np.asarray(-np.exp(-squared) @ HEIGHTS, float)


def smooth(U: Array) -> Array:
    """A smooth function at points (m,d), (m,)."""
    return np.asarray(U @ np.arange(1.0, U.shape[1] + 1.0) + 0.8 * np.sin(3.0 * U[:, 0]) * U[:, 1], float)


FUNCTIONS = {"ishigami": (ishigami, 3), "hartmann": (hartmann, 6), "smooth": (smooth, 5)}


def fitted(
    function: Callable[[Array], Array], d: int, count: int, noise: float, repeats: int, seed: int
) -> tuple[float, Unexplained]:
    """Share of points that the intervals of the mean hold, and what left-out runs leave unexplained.

    ``noise`` is in standard deviations of the function.
    """
    rng = np.random.default_rng(seed)
    U = space_filling(count, d, seed)
    U = np.vstack([U, U[:repeats]])
    somewhere = rng.random((500, d))
    true = function(somewhere)
    y = function(U) + noise * true.std() * rng.standard_normal(len(U))
    process = Ensemble.fit(Observations(U, y, np.zeros(len(U), np.int64)))
    mean, sd = process.mean_and_sd(somewhere)
    inside = np.abs(true - mean) <= HALF_WIDTH * sd
    return float(inside.mean()), unexplained_of("response", process)


def main() -> None:
    """Fit and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--designs", type=int, default=4)
    designs = parser.parse_args().designs
    print("function  points  noise  repeats  inside  unexplained  at least  trust")
    with threadpool_limits(1):
        for name, (function, d) in FUNCTIONS.items():
            for count in (10 * d, 30 * d):
                for noise in (0.01, 0.3, 1.0):
                    for repeats in (0, count // 10):
                        for seed in range(designs):
                            inside, found = fitted(function, d, count, noise, repeats, seed)
                            case = f"{name:9s} {count:6d} {noise:6.2f} {repeats:8d} {inside:7.2f}"
                            said = f"{found.share:12.2f} {found.least:9.2f}  {found.trust}"
                            print(f"{case} {said}", flush=True)


if __name__ == "__main__":
    main()
