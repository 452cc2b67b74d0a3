"""Designs of an emulator: spread out, useful at any length, and the same for the same seed."""

from collections import Counter

import numpy as np
import pytest
from scipy.stats import qmc

from calstudy.emulator.design import Choice, emulator_design, fresh_design, space_filling
from calstudy.emulator.similarity import inputs, inputs_box
from calstudy.errors import InputError
from calstudy.study.sweep import read_design, write_design
from shipped_model import SIMILARITY
from synthetic_runs import PLAN

CHOICE = Choice("fast", "full", "ring", 1)
PARAMETERS = PLAN.parameters


def unit(lines):
    box = inputs_box(PARAMETERS, SIMILARITY)
    return np.array([box.to_unit(inputs(line.parameters, SIMILARITY)) for line in lines])


def of(lines, fidelity):
    """First runs of the points of one fidelity, and runs of points that had one."""
    first, again, seen = [], [], set()
    for line in lines:
        if line.fidelity == fidelity:
            (again if line.label in seen else first).append(line)
            seen.add(line.label)
    return first, again


def test_the_numbers_of_the_issue_are_kept():
    lines = emulator_design(PARAMETERS, CHOICE, 128, SIMILARITY)
    fast, fast_again = of(lines, "fast")
    full, full_again = of(lines, "full")
    assert len(fast) == 128 and len(fast_again) == 12
    assert len(full) >= 20 and len(full_again) == len(full) // 10
    assert {line.label for line in full} <= {line.label for line in fast}


def test_every_beginning_is_spread_out():
    lines = emulator_design(PARAMETERS, CHOICE, 128, SIMILARITY)
    rng = np.random.default_rng(0)
    for length in (20, 50, 90, len(lines)):
        first, _ = of(lines[:length], "fast")
        count = len(first)
        inner = np.clip((space_filling(count, 6, 1)[:, :5] - 0.5) / 1.2 + 0.5, 0, 1)
        random = [qmc.discrepancy(rng.random((count, 5)), method="L2-star") for _ in range(20)]
        assert qmc.discrepancy(inner, method="L2-star") < np.median(random)
        full, _ = of(lines[:length], "full")
        assert len(full) == pytest.approx(count / 6, abs=1), "the fidelities keep step"


def test_a_longer_design_begins_like_a_shorter_one():
    short, long = (emulator_design(PARAMETERS, CHOICE, n, SIMILARITY) for n in (40, 128))
    assert long[: len(short)] == short


def test_the_ends_of_every_interval_are_among_the_points():
    points = unit(of(emulator_design(PARAMETERS, CHOICE, 128, SIMILARITY), "fast")[0])[:, :4]
    assert ((points < 1e-9).sum(axis=0) >= 6).all()
    assert ((points > 1 - 1e-9).sum(axis=0) >= 6).all()
    assert (np.abs(points - 0.5) <= 0.5 + 1e-12).all()


def test_all_parameters_stay_in_their_intervals():
    for lines in (
        emulator_design(PARAMETERS, CHOICE, 128, SIMILARITY),
        fresh_design(PARAMETERS, CHOICE, 12, SIMILARITY),
    ):
        for line in lines:
            for p in PARAMETERS:
                assert p.lower <= line.parameters[p.name] <= p.upper


def test_no_two_runs_share_a_seed():
    lines = [
        *emulator_design(PARAMETERS, CHOICE, 128, SIMILARITY),
        *fresh_design(PARAMETERS, CHOICE, 12, SIMILARITY),
    ]
    assert max(Counter(line.seed for line in lines).values()) == 1


def test_another_seed_is_another_design():
    other = Choice("fast", "full", "ring", 2)
    one, two = (unit(emulator_design(PARAMETERS, c, 32, SIMILARITY)) for c in (CHOICE, other))
    assert np.abs(one - two).max() > 0.1


def test_a_design_of_one_fidelity_has_that_alone():
    lines = emulator_design(PARAMETERS, Choice("soft", "soft", "wide", 1), 20, SIMILARITY)
    assert {(line.fidelity, line.variant) for line in lines} == {("soft", "wide")}
    assert len(lines) == 22


def test_half_of_the_fresh_points_have_three_seeds_and_those_come_last():
    lines = fresh_design(PARAMETERS, CHOICE, 12, SIMILARITY)
    counts = Counter(line.label for line in lines)
    assert sorted(counts.values()) == [1] * 6 + [3] * 6
    assert len({line.label for line in lines[:12]}) == 12
    assert {line.fidelity for line in lines} == {"full"}


def test_a_design_written_is_the_design_read(tmp_path):
    lines = emulator_design(PARAMETERS, CHOICE, 10, SIMILARITY)
    write_design(tmp_path / "new" / "design.csv", lines)
    assert read_design(tmp_path / "new" / "design.csv") == lines


@pytest.mark.parametrize("make", [emulator_design, fresh_design])
def test_a_design_without_points_is_refused(make):
    with pytest.raises(InputError, match="cannot have 0 points"):
        make(PARAMETERS, CHOICE, 0, SIMILARITY)
