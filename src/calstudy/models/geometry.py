"""The model's meshes, made by the program: round walls as triangles in STL."""

from __future__ import annotations

import math

import numpy as np

from calstudy.parameters import Array


def tube(radius: float, bottom: float, top: float, facets: int) -> Array:
    """Triangles, shape (2 facets, 3, 3) in m, of an upright round wall around the z axis.

    The polygon's area equals the circle's, so that the fill volume is pi r^2 h whatever ``facets`` is.
    """
    angles = 2.0 * np.pi * np.arange(facets + 1) / facets
    corner_radius = radius * math.sqrt(2.0 * math.pi / facets / math.sin(2.0 * math.pi / facets))
    x, y = corner_radius * np.cos(angles), corner_radius * np.sin(angles)
    low = np.column_stack([x, y, np.full_like(x, bottom)])
    high = np.column_stack([x, y, np.full_like(x, top)])
    lower_halves = np.stack([low[:-1], low[1:], high[1:]], axis=1)
    upper_halves = np.stack([low[:-1], high[1:], high[:-1]], axis=1)
    return np.concatenate([lower_halves, upper_halves])


def stl(name: str, triangles: Array) -> str:
    """ASCII STL of triangles (n, 3, 3)."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lines = [f"solid {name}"]
    for normal, corners in zip(normals, triangles, strict=True):
        lines += [f"facet normal {_numbers(normal)}", " outer loop"]
        lines += [f"  vertex {_numbers(corner)}" for corner in corners]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, f"endsolid {name}", ""])


def _numbers(vector: Array) -> str:
    return " ".join(f"{value:.9g}" for value in vector + 0.0)
