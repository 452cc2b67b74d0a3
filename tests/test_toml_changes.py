"""A value of a user's TOML file is changed, added or removed, and everything else stays."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calstudy.errors import InputError
from calstudy.study.definition import example
from calstudy.tomlfile import toml_of, with_value

TEXT = """\
mode = "robust"            # robust # [ "
seed = 1

[[models]]
name = "angle_of_repose"
[models.fixed]
poissons_ratio = 0.22

# [lower, upper]
[parameters]
DENS = [2400.0,
  2600.0]    # density
MU_PP = 0.2

[targets]
bulk_density = { value = 1500.0, sd = 5.0 }
[targets.angle]
value = 3"""


@pytest.mark.parametrize(
    ("keys", "value", "was", "now"),
    [
        (("seed",), "2", "seed = 1\n", "seed = 2\n"),
        (("mode",), '"paper"', 'mode = "robust" ', 'mode = "paper" '),
        (("budget",), "6", "seed = 1\n", "seed = 1\nbudget = 6\n"),
        (("models", 0, "label"), '"x"', '"angle_of_repose"\n', '"angle_of_repose"\nlabel = "x"\n'),
        (("models", 0, "fixed", "e"), "0.5", "= 0.22\n", "= 0.22\ne = 0.5\n"),
        (("parameters", "DENS"), "2500.0", "[2400.0,\n  2600.0]    # density", "2500.0    # density"),
        (("parameters", "DENS"), None, "DENS = [2400.0,\n  2600.0]    # density\n", ""),
        (("targets", "bulk_density"), "1.0", "{ value = 1500.0, sd = 5.0 }", "1.0"),
        (("targets", "angle", "sd"), "1.0", "value = 3", "value = 3\nsd = 1.0\n"),
        (("holdout", "x"), "1.0", "value = 3", "value = 3\n[holdout]\nx = 1.0\n"),
        (("budget",), None, "", ""),
    ],
)
def test_one_value_is_changed_and_nothing_else(keys, value, was, now):
    assert with_value(TEXT, keys, value) == TEXT.replace(was, now, 1)


def test_a_section_in_the_place_of_a_value_is_refused():
    with pytest.raises(InputError, match=r"targets\.angle is a section"):
        with_value(TEXT, ("targets", "angle"), "1.0")


PLAIN = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(),
)
VALUES = st.recursive(
    PLAIN, lambda one: st.lists(one, max_size=3) | st.dictionaries(st.text(), one, max_size=3)
)


@settings(max_examples=40)
@given(VALUES)
def test_what_was_written_is_read(value):
    text = with_value(example(), ("parameters", "DENS"), toml_of(value))
    read = tomllib.loads(text)
    assert read["parameters"]["DENS"] == value
    before = tomllib.loads(example())
    read["parameters"]["DENS"] = before["parameters"]["DENS"]
    assert read == before
    back = with_value(text, ("parameters", "DENS"), "[2400.0, 2600.0]")
    assert back == example()
