"""The generalised word length pattern as mathematics (Xu & Wu 2001)."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calstudy.errors import InputError
from calstudy.plan import FACTORS
from calstudy.plan_check import check, word_length_pattern
from calstudy.plan_file import load_plan

PLAN = load_plan()
LEVELS = {factor.name: factor.levels for factor in PLAN.factors}
CELLS = np.array([row.levels for row in PLAN.rows])

law = settings(max_examples=30, deadline=None)  # a busy machine breaks no law


def pattern_from_pairs_of_rows(table, levels):
    """Compute the same pattern without any contrast: from where each two rows agree (Xu & Wu 2001)."""
    table = np.asarray(table, float)
    coefficients = np.zeros(len(levels) + 1)
    for a, b in itertools.product(table, table):
        polynomial = np.ones(1)
        for x, y, of in zip(a, b, levels, strict=True):
            polynomial = np.convolve(polynomial, [1, len(of) * (x == y) - 1])
        coefficients += polynomial
    return coefficients[1:] / len(table) ** 2


designs = st.lists(st.integers(2, 4), min_size=1, max_size=4).flatmap(
    lambda sizes: st.tuples(
        st.just([tuple(range(s)) for s in sizes]),
        st.lists(st.tuples(*(st.integers(0, s - 1) for s in sizes)), min_size=1, max_size=12),
    )
)


@law
@given(designs)
def test_contrasts_and_agreements_give_the_same_pattern(design):
    levels, table = design
    expected = pattern_from_pairs_of_rows(table, levels)
    np.testing.assert_allclose(word_length_pattern(table, levels), expected, atol=1e-10)


@law
@given(st.lists(st.integers(2, 4), min_size=1, max_size=4))
def test_a_full_factorial_has_no_words(sizes):
    levels = [tuple(range(s)) for s in sizes]
    pattern = word_length_pattern(list(itertools.product(*levels)), levels)
    np.testing.assert_allclose(pattern, 0, atol=1e-12)


def test_a_half_fraction_has_one_word_of_full_length():
    full = np.array(list(itertools.product((-1, 1), repeat=3)))
    table = np.c_[full, full.prod(axis=1)]
    np.testing.assert_allclose(word_length_pattern(table, [(-1, 1)] * 4), [0, 0, 0, 1], atol=1e-12)


def test_the_pattern_of_distinct_rows_sums_to_the_share_of_the_full_factorial():
    assert 1 + sum(check(PLAN).word_lengths) == pytest.approx(144 / 72)


@law
@given(st.permutations(range(72)), st.permutations(range(6)), st.randoms())
def test_order_of_rows_columns_and_levels_does_not_change_the_pattern(rows, columns, random):
    levels = [random.sample(LEVELS[FACTORS[j]], len(LEVELS[FACTORS[j]])) for j in columns]
    pattern = word_length_pattern(CELLS[np.ix_(rows, columns)], levels)
    np.testing.assert_allclose(pattern, check(PLAN, PLAN).word_lengths, atol=1e-12)


def test_a_table_that_is_no_design_is_refused():
    with pytest.raises(InputError, match="needs a table"):
        word_length_pattern(np.empty((0, 2)), [(0, 1), (0, 1)])
    with pytest.raises(InputError, match="needs a table"):
        word_length_pattern([[0, 1]], [(0, 1)])
    with pytest.raises(InputError, match="2 is not one of the levels"):
        word_length_pattern([[2]], [(0, 1)])
