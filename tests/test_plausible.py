"""Plausible ranges: they hold what ships, and leave out what is in another unit."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.errors import InputError
from calstudy.models.heap import PARAMETER_UNITS, REFERENCE
from calstudy.plan_file import load_plan
from calstudy.plausible import RANGES, require_plausible
from calstudy.study.definition import example, read_definition


def test_what_the_plan_and_the_shipped_example_hold_is_plausible(tmp_path):
    plan = load_plan()
    ends = [{p.name: end} for p in plan.parameters for end in (p.lower, p.upper)]
    targets = {
        **plan.targets,
    }
    weights = [{"WRL": level} for level in plan.factors[0].levels]
    for values in [*ends, *weights, targets, REFERENCE, {"radius": plan.fixed.particle_radius}]:
        require_plausible(values, insist=False)
    (tmp_path / "example.toml").write_text(example())
    assert read_definition(tmp_path / "example.toml").task


def test_units_are_those_of_the_tables():
    assert {name: RANGES[name].unit for name in PARAMETER_UNITS} == PARAMETER_UNITS


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, of in RANGES.items() if of.mistakes])
def test_the_remedy_of_a_likely_mistake_is_plausible(name):
    of = RANGES[name]

    @given(st.sampled_from(of.mistakes).flatmap(lambda m: st.tuples(st.just(m), st.floats(m.low, m.high))))
    def holds(drawn):
        mistake, value = drawn
        assert of.low <= mistake.convert(value) <= of.high
        assert of.low <= value <= of.high or "it looks like" in of.objection("x", value)

    holds()


def test_who_insists_gets_what_is_outside():
    require_plausible({"DENS": 2.5}, insist=True)
    with pytest.raises(InputError, match=r"here: DENS is 2\.5 kg/m3"):
        require_plausible({"DENS": 2.5}, insist=False, where="here: ")
