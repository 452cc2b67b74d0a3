"""Principal components of sampled curves: a few scores stand for all points of a curve."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calstudy.parameters import Array

EXPLAINED = 0.999
"""Share of the sampled curves' variance that their components explain together, if `MOST` are enough."""
MOST = 4


@dataclass(frozen=True, slots=True)
class Components:
    """n curves of m points as mean + scores @ vectors, but for what is left."""

    mean: Array
    """Mean curve (m,)."""
    vectors: Array
    """Principal components (k, m), of length 1 and orthogonal; the first explains the most."""
    scores: Array
    """Of each curve, (n, k)."""
    left: Array
    """Root mean square of what the components leave at each point, (m,), in the curve's unit."""


def principal(curves: Array) -> Components:
    """Components of curves (n, m) by singular value decomposition.

    So many that they explain `EXPLAINED` of the variance, from one to `MOST`. A component's largest entry is
    positive, so that its sign is the same on every machine.
    """
    mean = curves.mean(axis=0)
    left, sizes, right = np.linalg.svd(curves - mean, full_matrices=False)
    share = np.cumsum(sizes**2) / max(float(np.sum(sizes**2)), np.finfo(float).tiny)
    k = min(1 + int(np.searchsorted(share, EXPLAINED)), MOST, len(sizes))
    vectors = right[:k]
    signs = np.sign(vectors[np.arange(k), np.abs(vectors).argmax(axis=1)])
    signs[signs == 0] = 1.0
    vectors, scores = vectors * signs[:, None], left[:, :k] * sizes[:k] * signs
    rest = curves - mean - scores @ vectors
    return Components(mean, vectors, scores, np.sqrt(np.mean(rest**2, axis=0)))
