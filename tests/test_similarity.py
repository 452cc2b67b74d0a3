"""The inputs of the emulator, and the check that they are all that matters."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.emulator.similarity import (
    inputs,
    inputs_box,
    inputs_of,
    parameter_set,
    similarity_design,
    similarity_table,
)
from shipped_model import SIMILARITY
from synthetic_runs import PLAN, synthetic_runs

PARAMETERS = PLAN.parameters
BOX = inputs_box(PARAMETERS, SIMILARITY)
SHARES = st.floats(0.0, 1.0)


@given(st.lists(SHARES, min_size=5, max_size=5), SHARES)
def test_a_parameter_set_has_the_inputs_asked_for_and_stays_in_the_box(unit, share):
    point = BOX.from_unit(unit)
    values = parameter_set(point, share, PARAMETERS, SIMILARITY)
    np.testing.assert_allclose(inputs(values, SIMILARITY), point, rtol=1e-12)
    for p in PARAMETERS:
        assert p.lower <= values[p.name] <= p.upper


def test_a_table_s_inputs_are_those_of_its_lines():
    lines = similarity_design(PARAMETERS, SIMILARITY, 1, 2, "coarse", "ring")
    frame = pd.DataFrame([dict(line.parameters) for line in lines])
    np.testing.assert_array_equal(
        inputs_of(frame, SIMILARITY), [inputs(line.parameters, SIMILARITY) for line in lines]
    )


def test_runs_of_one_point_have_the_same_inputs():
    lines = similarity_design(PARAMETERS, SIMILARITY, 1, 3, "coarse", "ring")
    for label in {line.label for line in lines}:
        here = np.array([inputs(line.parameters, SIMILARITY) for line in lines if line.label == label])
        assert len(here) == 7
        np.testing.assert_allclose(here, here[:1].repeat(7, axis=0), rtol=1e-12)
    densities = {line.parameters["DENS"] for line in lines}
    assert densities == {2400.0, 2600.0, 4800.0}
    assert SIMILARITY.inputs[-1] == "YM/DENS"


def runs(spoil=lambda density: 0.0 * density):
    table = synthetic_runs(similarity_design(PARAMETERS, SIMILARITY, 1, 4, "coarse", "ring"))
    # A doubled run is the very run that it doubles.
    double = table["DENS"] > 4000
    light = table[(table["DENS"] == 2400) & (table["seed"] == 1)].set_index("label")
    table.loc[double, "angle_of_repose_deg"] = light.loc[
        table.loc[double, "label"], "angle_of_repose_deg"
    ].to_numpy()
    table["angle_of_repose_deg"] += spoil(table["DENS"])
    return table


def test_similar_runs_show_no_difference_beyond_noise():
    angle = similarity_table(runs(), SIMILARITY).iloc[0]
    assert (angle["response"], angle["doubled"], angle["doubled_pairs"]) == ("angle_of_repose_deg", 0.0, 5)
    assert abs(angle["difference"]) < 2 * angle["half_width"]
    assert angle["noise"] == pytest.approx(0.5, rel=0.4)


def test_the_interval_is_student_s_of_the_five_points_differences():
    table = runs()
    seeds = [of.to_numpy() for _, of in table.groupby(["label", "DENS"])["angle_of_repose_deg"]]
    assert [len(of) for of in seeds] == [4, 4, 1] * 5
    light, heavy = seeds[::3], seeds[1::3]
    d = np.array([b.mean() - a.mean() for a, b in zip(light, heavy, strict=True)])
    angle = similarity_table(table, SIMILARITY).iloc[0]
    assert angle["points"] == 5
    assert angle["difference"] == pytest.approx(d.sum() / 5)
    sd = np.sqrt(((d - d.sum() / 5) ** 2).sum() / 4)
    # Of Student's t with four degrees of freedom, 5 % lie above 2.131847.
    assert angle["half_width"] == pytest.approx(2.131847 * sd / np.sqrt(5), rel=1e-6)
    within = [((of - of.mean()) ** 2).sum() / 3 for of in light + heavy]
    assert angle["noise"] == pytest.approx(np.sqrt(sum(within) / 10))


def test_an_effect_of_density_is_found():
    angle = similarity_table(runs(lambda density: 0.01 * (density - 2400.0)), SIMILARITY).iloc[0]
    assert angle["doubled"] == pytest.approx(24.0)
    assert angle["difference"] - angle["half_width"] > 1.0
    assert angle["difference"] == pytest.approx(2.0, abs=0.6)
