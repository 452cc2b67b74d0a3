"""Draws the pictures of modes.md.

python docs/pictures/modes.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from style import STYLE, save

from calstudy.calibration.kriging.universal import UniversalKriging
from calstudy.calibration.modes import MODES
from calstudy.calibration.optimise import (
    LevenbergMarquardt,
    SequentialQuadratic,
    levenberg_marquardt,
    sequential_quadratic,
)
from calstudy.calibration.sampling import minimum_distance
from calstudy.parameters import Array, Box

PAPER, ROBUST, TRUE = "tab:orange", "tab:blue", "0.3"


def designs() -> None:
    """Write designs.png: one design of each mode, and their smallest distances over 30 seeds."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(9, 3))
    for axes, name, colour in ((left, "paper", PAPER), (middle, "robust", ROBUST)):
        search = MODES[name].design
        points = search(12, 2, np.random.default_rng(1))
        axes.plot(*points.T, "o", color=colour)
        axes.set(title=f"{name}: {minimum_distance(points):.3f}", xlim=(0, 1), ylim=(0, 1), aspect="equal")
        axes.set_xticks(np.arange(13) / 12, labels=[])
        axes.set_yticks(np.arange(13) / 12, labels=[])
        axes.grid(alpha=0.3)
        found = [float(minimum_distance(search(12, 2, np.random.default_rng(seed)))) for seed in range(30)]
        right.hist(found, np.arange(0.15, 0.36, 0.01), color=colour, alpha=0.7, label=name)
    right.set(xlabel="smallest distance, 12 points in the square", ylabel="designs of 30")
    right.legend(frameon=False)
    save(figure, "modes-designs.png")


def differences() -> None:
    """Write differences.png: what a difference quotient sees of a slope, by the size of its step."""
    rng = np.random.default_rng(2)
    slope, noise = 5.6, 1.0  # deg over the interval of MU_PP, deg from seed to seed
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3))
    u = np.linspace(0, 1, 41)
    left.plot(u, 21.9 + slope * u, color=TRUE, label="noise-free")
    left.plot(u, 21.9 + slope * u + noise * rng.standard_normal(41), ".", color=ROBUST, label="runs")
    left.axvspan(0.499, 0.501, color=PAPER, label="0.1 % of the parameter, both ways")
    left.set(xlabel="share of the interval of MU_PP", ylabel="angle of repose, deg")
    left.legend(frameon=False)
    share = np.geomspace(1e-3, 0.5, 60)
    spread = noise / (np.sqrt(2.0) * share)  # of (f(+h) - f(-h)) / 2h with independent noise
    right.fill_between(
        share, slope - spread, slope + spread, color=ROBUST, alpha=0.3, label="slope seen, one sd"
    )
    right.axhline(slope, color=TRUE, label="slope")
    right.axvline(0.001, color=PAPER, label="paper")
    right.set(xscale="log", xlabel="difference step, share of the interval", ylabel="deg", ylim=(-100, 110))
    right.legend(frameon=False)
    save(figure, "modes-differences.png")


def surrogates() -> None:
    """Write surrogates.png: both modes' Kriging of ten noisy points of one parameter's response."""
    figure, axes = plt.subplots(1, 3, figsize=(9, 3), sharey=True)
    u = np.linspace(0, 1, 200)
    for seed, panel in enumerate(axes):
        rng = np.random.default_rng(seed + 2)
        points = (np.arange(10) + rng.random(10)) / 10
        values = 22 + 5.6 * points + rng.standard_normal(10)
        panel.plot(u, 22 + 5.6 * u, color=TRUE, label="noise-free")
        panel.plot(points, values, "k.", label="runs")
        for mode, trend, noise, colour in (
            ("paper", "affine", None, PAPER),
            ("robust", "constant", 1.0, ROBUST),
        ):
            model = UniversalKriging([0.0], [1.0], mode=mode, trend=trend, noise_sd=noise)
            mean, sd = model.fit(points[:, None], values).predict(u[:, None], return_std=True)
            panel.plot(u, mean, color=colour, label=mode)
            panel.fill_between(u, mean - sd, mean + sd, color=colour, alpha=0.15, lw=0)
        panel.set(xlabel="share of the interval")
    axes[0].set(ylabel="angle of repose, deg")
    axes[0].legend(frameon=False)
    save(figure, "modes-surrogates.png")


def residuals(effect: float, points: Array) -> Array:
    """Residuals (k, 3) of a heap's closed form at points (k, 5) of the unit cube, time-step weighted with 1.

    Columns: DENS, MU_PP, RF_PP, RF_PW, YM; RF_PW has an ``effect`` in deg on the angle of repose.
    """
    density, sliding, rolling, wall, stiffness = points.T
    angle = 21.9 + 5.6 * sliding + 3.5 * rolling + effect * (0.5 + 0.5 * density - wall + 0.3 * stiffness)
    bulk = (2400 + 200 * density) * (0.6175 - 0.03 * sliding - 0.005 * rolling**2)
    step = np.sqrt((2400 + 200 * density) / (4.175 + 2.325 * stiffness))
    fastest, slowest = np.sqrt(2600 / 4.175), np.sqrt(2400 / 6.5)
    return np.column_stack([angle / 26.4 - 1, bulk / 1500 - 1, (fastest - step) / (fastest - slowest)])


def bounds() -> None:
    """Write bounds.png: where both modes' first optimisation ends when one parameter hardly acts."""
    names = ("DENS", "MU_PP", "RF_PP", "RF_PW", "YM")
    box = Box(names, (0.0,) * 5, (1.0,) * 5)
    effects = np.geomspace(1e-3, 3, 25)
    authors, ours = [], []
    for effect in effects:

        def at(points: Array, effect: float = effect) -> Array:
            return residuals(effect, points)

        run = levenberg_marquardt(lambda _, p: at(p), box.centre, box, LevenbergMarquardt())
        authors.append(run.sum_of_squares)
        ours.append(sequential_quadratic(at, box.centre, box, SequentialQuadratic()).sum_of_squares)
    octave = pd.read_csv(Path(__file__).parents[2] / "tests" / "golden" / "octave_optim.csv")
    same = octave[(octave.calibrated == " ".join(names)) & (octave.WRL == 1) & (octave.tolerance == 0.02)]
    figure, axes = plt.subplots(figsize=(5, 3))
    axes.loglog(effects, authors, "o-", ms=3, color=PAPER, label="paper")
    axes.loglog(effects, ours, "o-", ms=3, color=ROBUST, label="robust")
    shown = same[same.effect >= effects[0]]
    axes.loglog(shown.effect, shown.sum_of_squares, "kx", label="Octave's nonlin_residmin")
    axes.set(xlabel="effect of RF_PW over its interval, deg", ylabel="sum of squares at the end")
    axes.legend(frameon=False)
    save(figure, "modes-bounds.png")


if __name__ == "__main__":
    with mpl.rc_context(STYLE):
        designs()
        differences()
        surrogates()
        bounds()
