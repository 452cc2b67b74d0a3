"""Runs that left the branch of a response which is emulated, and the region where runs do so.

On a wide plate the angle of repose jumps by ten degrees where the layer of beads that rolled out loses its
hold; a smooth process fitted through a jump is wrong on both sides of it. So a run is held against what the
runs at all other points say of it. Those that are many standard deviations off are set aside, the others
fitted anew, until nothing changes; where runs left the branch, nothing is emulated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from calstudy.emulator.cokriging import CoKriging
from calstudy.emulator.process import Mask, Numbers, Observations
from calstudy.errors import NumericsError
from calstudy.parameters import Array

FAR = 5.0
"""Standard deviations, estimated by the median of the absolute errors, from which a run is off the branch.

Among a thousand normal errors none is."""
GAP = 3.0
"""Standard deviations between the errors of those off the branch and of those on it, at least."""
SUSPICIOUS = 4.0
"""The same for the first guess, which a plane makes; what only the plane fits badly comes back later."""
CORE = 0.4
"""Share of the runs that the plane must fit; less than half, so that it need not join two equal branches."""
STARTS = 200
"""Random subsets from which the plane's search begins; with a third of the runs off, one of ten has none."""
ROUNDS = 10
FEWEST_OF_CORE = 3
"""Runs that the plane must fit for each of its coefficients; on fewer it fits chance, and most look odd."""
LARGEST_SHARE = 1 / 3
"""Largest share of runs off a branch; with more, the runs do not lie on one branch."""
FEWEST = 3
"""Runs off the branch from which a region is told; one or two are strays that are reported by themselves."""
FLAGGED = 0.2
"""Probability of leaving the branch from which on nothing is emulated."""
RIDGE = 0.05
"""Precision of the prior of the region's coefficients, for inputs from -1 to 1."""


def off_branch(data: Observations, points: Numbers) -> Mask:
    """Which runs are off the branch that most lie on, (n,) bool.

    ``points`` (n,) numbers the points that runs share. NumericsError where a third of the runs is off.
    """
    # A process that has seen a jump bends to it and finds nothing odd, so the first guess must not be one.
    off = _far_from_a_plane(data)
    for _ in range(ROUNDS):
        fitted = CoKriging.fit(data.without(off))
        z = _standard_errors(fitted, data, points, off)
        before, off = off, _beyond_a_gap(np.abs(z) / (1.4826 * np.median(np.abs(z[~off]))))
        if off.mean() > LARGEST_SHARE:
            raise NumericsError(
                f"{off.sum()} of {len(off)} runs lie far from what the others say: there is no one smooth "
                "response here; emulate a smaller box, or run more"
            )
        if np.array_equal(off, before):
            return off
    raise NumericsError(f"{off.sum()} run(s) lie now on one side of a jump, now on the other; run more")


def _beyond_a_gap(errors: Array) -> Mask:
    """Errors (n,) above `FAR` that a gap parts from the smaller ones, (n,) bool.

    A steep but smooth response, too, can leave a fit of half of its runs with large errors; but they grow by
    degrees, while nothing lies between two branches.
    """
    ordered = np.sort(errors)
    ends = np.flatnonzero((ordered[1:] >= FAR) & (np.diff(ordered) >= GAP))
    return np.asarray(errors > (ordered[ends[0]] if len(ends) else np.inf))


def _far_from_a_plane(data: Observations) -> Mask:
    """Runs far from the plane that fits `CORE` of them best, (n,) bool: least trimmed squares.

    The others may be anything at all (Rousseeuw and Van Driessen, Data Min. Knowl. Discov. 12, 2006). The
    plane has a step from each fidelity to the next.
    """
    n = len(data.y)
    steps = [(data.level >= k).astype(float) for k in range(1, data.levels)]
    X = np.column_stack([np.ones(n), data.U - 0.5, *steps])
    core = min(max(round(CORE * n), FEWEST_OF_CORE * X.shape[1]), n)

    def concentrated(chosen: Numbers, times: int) -> Numbers:
        for _ in range(times):
            beta = np.linalg.lstsq(X[chosen], data.y[chosen], rcond=None)[0]
            chosen = np.argsort(np.abs(data.y - X @ beta), kind="stable")[:core]
        return chosen

    def trimmed(chosen: Numbers) -> tuple[float, Array]:
        beta = np.linalg.lstsq(X[chosen], data.y[chosen], rcond=None)[0]
        residuals = data.y - X @ beta
        return float(np.sort(residuals**2)[:core].sum()), residuals

    rng = np.random.default_rng(0)
    first = [concentrated(rng.permutation(n)[: X.shape[1] + 1], 2) for _ in range(STARTS)]
    first.sort(key=lambda chosen: trimmed(chosen)[0])
    squares, residuals = min((trimmed(concentrated(chosen, 50)) for chosen in first[:10]), key=lambda t: t[0])
    # What the smallest of normal errors' squares add up to, less the plane's degrees of freedom.
    share = core / n
    q = float(norm.ppf(0.5 + 0.5 * share))
    kept = share - 2.0 * q * float(norm.pdf(q))
    scale = np.sqrt(squares / (kept * max(n - X.shape[1], 1)))
    return np.asarray(np.abs(residuals) > SUSPICIOUS * scale)


def _standard_errors(fitted: CoKriging, data: Observations, points: Numbers, off: Mask) -> Array:
    """Errors of all runs in standard deviations, each without its point; (n,)."""
    z = np.empty(len(off))
    error, sd = fitted.left_out(points[~off])
    z[~off] = error / sd
    if off.any():
        error, sd = fitted.errors_elsewhere(data, off)
        z[off] = error / sd
    return z


@dataclass(frozen=True, slots=True)
class Region:
    """Where runs leave the branch: logistic in a quadratic form of the inputs."""

    coefficients: tuple[float, ...]
    """Of 1, the inputs, and their products, for inputs from -1 to 1."""

    @classmethod
    def of(cls, U: Array, off: Mask) -> Region | None:
        """Estimate from runs at ``U`` (n,d); None where fewer than `FEWEST` are off the branch.

        Ridge-penalised likelihood, by Newton's method; the constant is not penalised.
        """
        if off.sum() < FEWEST:
            return None
        X = _quadratic(U)
        penalty = np.full(X.shape[1], RIDGE)
        penalty[0] = 0.0
        beta = np.zeros(X.shape[1])
        beta[0] = np.log(off.mean() / (1.0 - off.mean()))
        for _ in range(100):
            p = _logistic(X @ beta)
            step = np.linalg.solve(
                (X * (p * (1.0 - p))[:, None]).T @ X + np.diag(penalty + 1e-9),
                X.T @ (off - p) - penalty * beta,
            )
            longest = float(np.abs(step).max())
            beta = beta + step * min(1.0, 2.0 / max(longest, 1e-300))  # a full step may overshoot
            if longest < 1e-8:
                break
        else:
            raise NumericsError("the region of the jump could not be estimated; run more points near it")
        return cls(tuple(map(float, beta)))

    def probability(self, U: Array) -> Array:
        """Probability that a run at ``U`` (m,d) leaves the branch, (m,)."""
        return _logistic(_quadratic(U) @ np.array(self.coefficients))

    def contains(self, U: Array) -> Mask:
        """Whether nothing is to be emulated at ``U`` (m,d), (m,) bool."""
        return np.asarray(self.probability(U) >= FLAGGED)


def _quadratic(U: Array) -> Array:
    """Constant, inputs and their products at points (m,d), inputs taken from -1 to 1."""
    V = 2.0 * U - 1.0
    i, j = np.triu_indices(V.shape[1])
    return np.column_stack([np.ones(len(V)), V, V[:, i] * V[:, j]])


def _logistic(x: Array) -> Array:
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * x)), float)
