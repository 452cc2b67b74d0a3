"""Latin hypercube designs and the MAXIMIN criterion (section 2.3.1), and Sobol's points, on the unit cube."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from calstudy.errors import InputError, SetupError
from calstudy.parameters import Array

BLOCK = 200_000
"""Coordinates that a search holds at once. A few arrays of this size fit into a processor's cache."""

HOT, COLD = 0.03, 0.0003
"""First and last temperature of the annealing, as shares of the energy."""
LEAST_SPREAD = 0.25
"""Points that span less than this share of an interval are nearly the same there."""


def latin_hypercube(n: int, dimension: int, rng: np.random.Generator) -> Array:
    """One random Latin hypercube (Eq. 2-3): n points jittered inside their strata, shape (n,dimension).

    In each column, each of the n strata [(i-1)/n, i/n) holds one point. InputError for n or dimension
    below 1.
    """
    _check(n, dimension)
    return _random_designs(1, n, dimension, rng)[0].T.copy()


def sobol(n: int, dimension: int, scramble: bool = True, seed: int | np.random.Generator = 0) -> Array:
    """First n points of Sobol's sequence, scrambled by the seed, shape (n,dimension).

    SetupError where SciPy has no table of directions: it drops the error if it cannot read that, for want of
    memory or of open files, and gives equal points.
    """
    whole = 1 << (n - 1).bit_length()
    points: Array = qmc.Sobol(dimension, scramble=scramble, seed=seed).random(whole)
    strata = np.sort((whole * points).astype(int), axis=0)
    if (strata != np.arange(whole)[:, None]).any():
        raise SetupError(
            "SciPy's points are not spread evenly: it could not read their table, for want of memory or of "
            "open files perhaps; run the same command again"
        )
    return points[:n]


def minimum_distance(designs: Array) -> Array:
    """Smallest Euclidean distance between two points (Eq. 4) of designs (…,n,d), shape (…).

    Infinite for designs of one point.
    """
    designs = np.asarray(designs, float)
    n = designs.shape[-2]
    if n < 2:
        return np.full(designs.shape[:-2], np.inf)
    i, j = np.triu_indices(n, 1)
    squared = np.zeros((*designs.shape[:-2], len(i)))
    for k in range(designs.shape[-1]):
        x = designs[..., k]
        squared += (x[..., i] - x[..., j]) ** 2
    return np.sqrt(squared.min(axis=-1))


def maximin_search(
    n: int, dimension: int, rng: np.random.Generator, designs_per_dimension: int = 5000
) -> Array:
    """Best of designs_per_dimension × dimension random Latin hypercubes by MAXIMIN (Eq. 5); mode `paper`.

    Returns the design, shape (n,dimension). The first of equally good designs is taken, so a design of one
    point is a random one. InputError for n, dimension or designs_per_dimension below 1.
    """
    _check(n, dimension)
    if designs_per_dimension < 1:
        raise InputError(f"{designs_per_dimension} designs per dimension; at least 1 is needed")
    best, best_squared = np.empty((dimension, n)), -1.0
    remaining = designs_per_dimension * dimension
    block = max(1, BLOCK // (n * dimension))
    while remaining > 0:
        drawn = min(block, remaining)
        designs, squared = _better_than(best_squared, _random_designs(drawn, n, dimension, rng))
        if len(designs) and squared.max() > best_squared:
            winner = int(squared.argmax())
            best, best_squared = designs[winner], float(squared[winner])
        remaining -= drawn
    return best.T.copy()


def _better_than(squared: float, designs: Array) -> tuple[Array, Array]:
    """Those of the designs (m,d,n) whose smallest squared distance is above ``squared``, and that distance.

    Shapes (k,d,n) and (k,). A design is dropped as soon as one of its pairs is too close. Most are dropped
    after a few points, which makes the search fast.
    """
    smallest = np.full(len(designs), np.inf)
    for i in range(designs.shape[2] - 1):
        steps = designs[:, :, i + 1 :] - designs[:, :, i, None]
        np.minimum(smallest, np.einsum("mkj,mkj->mj", steps, steps).min(axis=1), out=smallest)
        alive = smallest > squared
        designs, smallest = designs[alive], smallest[alive]
    return designs, smallest


def maximin_optimised(n: int, dimension: int, rng: np.random.Generator, steps: int = 3000) -> Array:
    """Latin hypercube whose smallest distance is maximised directly, shape (n,dimension); mode `robust`.

    Annealed swaps (Morris and Mitchell, J. Stat. Plan. Inference 43, 1995) arrange the points among the
    cells; then the points are jittered inside their cells wherever that does not lower the smallest
    distance. The work grows as steps × n^2. InputError for n, dimension or steps below 1.
    """
    _check(n, dimension)
    if steps < 1:
        raise InputError(f"{steps} annealing steps; at least 1 is needed")
    if n == 1:
        return latin_hypercube(n, dimension, rng)
    return _jittered(_annealed_strata(n, dimension, rng, steps), rng)


def _annealed_strata(n: int, dimension: int, rng: np.random.Generator, steps: int) -> Array:
    """Strata 0 … n-1 of each point in each column, shape (n,dimension): the best arrangement found.

    The energy is Morris and Mitchell's phi_p^p, the sum over pairs of distance^-16: smooth, but ruled by the
    closest pairs. Each step draws a column, and a point i by its share of the energy. Then it draws
    the point j that i swaps with (or none) with Boltzmann probabilities. The temperature is a share of the
    energy that falls geometrically.
    """
    strata = rng.permuted(np.broadcast_to(np.arange(n, dtype=float), (dimension, n)), axis=1)
    steps_between = strata[:, :, None] - strata[:, None, :]
    squared = np.einsum("kij,kij->ij", steps_between, steps_between)
    np.fill_diagonal(squared, np.inf)
    energy = _repulsion(squared)
    best, best_squared = strata.copy(), squared.min()
    columns = rng.integers(dimension, size=steps)
    which_point, which_partner = rng.random((2, steps))
    points = np.arange(n)

    for step, temperature in enumerate(np.geomspace(HOT, COLD, steps)):
        share = energy.sum(axis=1)
        total = 0.5 * share.sum()
        i = _draw(share, which_point[step])
        x = strata[columns[step]]

        # Squared distances from i and from j to all m, after i and j have exchanged their strata.
        from_i = (x - x[i]) ** 2
        from_j = (x[:, None] - x) ** 2
        i_moved = squared[i] - from_i + from_j
        j_moved = squared - from_j + from_i
        i_moved[:, i] = i_moved[points, points] = np.inf  # the pair (i,j) itself does not change
        j_moved[:, i] = np.inf
        change = (_repulsion(i_moved) + _repulsion(j_moved)).sum(axis=1)
        change -= share[i] + share - 2.0 * energy[i]
        change[i] = 0.0  # no swap
        scaled = change / (temperature * total)
        j = _draw(np.exp(scaled.min() - scaled), which_partner[step])
        if j == i:
            continue

        i_moved[j, j] = j_moved[j, i] = squared[i, j]
        for row, moved in ((i, i_moved[j]), (j, j_moved[j])):
            squared[row] = squared[:, row] = moved
            energy[row] = energy[:, row] = _repulsion(moved)
        x[i], x[j] = x[j], x[i]
        if squared.min() > best_squared:
            best, best_squared = strata.copy(), squared.min()
    return best.T.copy()


def _repulsion(squared: Array) -> Array:
    """Energies of pairs at squared distances of any shape, distance^-16."""
    inverse = 1.0 / squared
    for _ in range(3):  # repeated squaring is far faster than a power
        inverse *= inverse
    return inverse


def _draw(odds: Array, uniform: float) -> int:
    """Index drawn with the given odds (n,), by a uniform random number."""
    cumulated = odds.cumsum()
    return min(int(np.searchsorted(cumulated, uniform * cumulated[-1])), len(odds) - 1)


def places_taken(n: int, there: Array) -> int:
    """Number of a design's n points in whose places points (k,d) of the unit cube stand.

    Where these are nearly the same in a coordinate, a parameter that was not calibrated before, say, they
    stand for half of the design at most: they tell nothing of that parameter.
    """
    taken = min(n, len(there))
    is_flat = taken > 0 and float(np.ptp(there, axis=0).min()) < LEAST_SPREAD
    return min(taken, n // 2) if is_flat else taken


def beyond(design: Array, there: Array) -> Array:
    """Points of a design (n,d) that are left when points (k,d) are there already, shape (n - k or 0,d).

    Each point that is there takes the place of the design's point nearest to it, the closest pair first, so
    that what is left fills the gaps; see `places_taken`.
    """
    left = np.asarray(design, float)
    distances = np.linalg.norm(left[:, None, :] - np.asarray(there, float), axis=2)
    for _ in range(places_taken(len(left), there)):
        i, k = np.unravel_index(np.argmin(distances), distances.shape)
        left = np.delete(left, i, axis=0)
        distances = np.delete(np.delete(distances, i, axis=0), k, axis=1)
    return left


def _jittered(strata: Array, rng: np.random.Generator, rounds: int = 30) -> Array:
    """Points (n,d) at random in their cells; their smallest distance is not below that of the centres."""
    n, dimension = strata.shape
    design = (strata + 0.5) / n
    squared = ((design[:, None, :] - design) ** 2).sum(axis=2)
    np.fill_diagonal(squared, np.inf)
    for _ in range(rounds):
        proposals = (strata + rng.random((n, dimension))) / n
        shares = rng.random((n,))
        for i in range(n):
            moved = design[i] + shares[i] * (proposals[i] - design[i])
            distances = ((design - moved) ** 2).sum(axis=1)
            distances[i] = np.inf
            if distances.min() >= squared.min():
                design[i] = moved
                squared[i] = squared[:, i] = distances
    return design


def _random_designs(count: int, n: int, dimension: int, rng: np.random.Generator) -> Array:
    """Random Latin hypercubes (count,dimension,n) (Eq. 2-3)."""
    strata = np.broadcast_to(np.arange(n, dtype=float), (count, dimension, n))
    shuffled = rng.permuted(strata, axis=2)
    return (shuffled + rng.random(shuffled.shape)) / n


def _check(n: int, dimension: int) -> None:
    for value, what in ((n, "points"), (dimension, "dimensions")):
        if isinstance(value, bool) or int(value) != value or value < 1:
            raise InputError(f"a design cannot have {value} {what}; use a whole number from 1")
