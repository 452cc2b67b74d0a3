"""Boxes of parameters for laws that hold in any of them."""

import numpy as np
from hypothesis import strategies as st

from calstudy.parameters import Box


@st.composite
def boxes_and_unit_points(draw):
    """A box of 1 to 6 intervals that a double can resolve, and points (n, d) of the unit cube."""
    d = draw(st.integers(1, 6))
    lower = draw(st.lists(st.floats(-1e9, 1e9), min_size=d, max_size=d))
    share = draw(st.lists(st.floats(1e-3, 1e3), min_size=d, max_size=d))
    upper = [a + s * max(abs(a), 1e-3) for a, s in zip(lower, share, strict=True)]
    box = Box(tuple(f"p{k}" for k in range(d)), tuple(lower), tuple(upper))
    n = draw(st.integers(1, 4))
    cell = st.floats(0.0, 1.0)
    return box, np.array(draw(st.lists(st.lists(cell, min_size=d, max_size=d), min_size=n, max_size=n)))
