"""Numbers and names as people write them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.errors import InputError
from calstudy.records import STOPPED, Stop
from calstudy.written import choice, number_in, printable, whole_number_in


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_finite_number_is_read_as_it_was_printed(number):
    assert number_in(repr(number)) == number


@pytest.mark.parametrize(
    "text", ["", "x", "nan", "inf", "1e999", "2_500", "２５００", "٢٥", "0x10", "1 2", "1e", "0.3.1"]
)
def test_what_is_not_a_finite_number_is_refused(text):
    with pytest.raises(InputError, match="finite number"):
        number_in(text)


@pytest.mark.parametrize(("text", "point"), [("0,3", "0.3"), (" -12,5e3 ", "-12.5e3")])
def test_a_decimal_comma_is_said_to_be_one(text, point):
    with pytest.raises(InputError, match=f"has a decimal comma; write {point}"):
        number_in(text)


@pytest.mark.parametrize("text", ["", "1.0", "1_0", "２", "1,5", "9" * 5000])
def test_what_is_not_a_whole_number_is_refused(text):
    with pytest.raises(InputError, match="is not a whole number"):
        whole_number_in(text)


def test_a_name_is_answered_with_the_one_that_it_resembles_or_with_all():
    names = ["full", "fast", "coarse"]
    assert choice("corse", names) == "did you mean coarse?"
    assert choice("FAST", names) == "did you mean fast?"
    assert choice("lammps", names) == "choose one of full, fast, coarse"


def test_control_characters_are_shown_and_not_obeyed():
    assert printable("a\x1b[31m\x07\x9bµ – 面\tb\n") == "a\\x1b[31m\\x07\\x9bµ – 面\tb\n"


def test_every_reason_to_stop_has_its_words():
    assert set(STOPPED) == set(Stop)
