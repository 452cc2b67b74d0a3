"""Linear constraints between parameters: read as written, and kept by designs, searches and solutions."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import calstudy as cs
from calstudy.calibration.constraints import LEAST_SHARE, Allowed, Constraint, parse
from calstudy.calibration.optimise import SequentialQuadratic, sequential_quadratic
from calstudy.calibration.solutions import constraints_in_the_way
from calstudy.errors import InputError
from calstudy.parameters import Array, Grid, Parameter, Space
from calstudy.study.reading import Result

NAMES = ("A", "B", "C")
SPACE = Space(
    (
        Parameter("A", "-", 0.0, 1.0, None),
        Parameter("B", "-", 0.2, 0.6, None),
        Parameter("C", "-", 0.3, 0.3, 0.3),
    ),
    ("A", "B"),
)


def of(*texts: str, space: Space = SPACE) -> Allowed:
    return Allowed.of([one for text in texts for one in parse(text, NAMES)], space)


# ---- what is read ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "factors", "bound"),
    [
        ("A >= B", {"A": -1.0, "B": 1.0}, 0.0),
        ("A < B", {"A": 1.0, "B": -1.0}, 0.0),
        ("A + 2 * B <= 0.5", {"A": 1.0, "B": 2.0}, 0.5),
        ("0.1 + A <= -(B - C) / 4 + 2e0", {"A": 1.0, "B": 0.25, "C": -0.25}, 1.9),
        ("(1 - 3) * A * 2 >= 1", {"A": 4.0}, -1.0),
        ("A - A + B <= 1", {"B": 1.0}, 1.0),
    ],
)
def test_a_comparison_is_read_as_a_sum_of_multiples(
    text: str, factors: Mapping[str, float], bound: float
) -> None:
    assert parse(text, NAMES) == [Constraint(text, pytest.approx(factors), pytest.approx(bound))]


def test_a_chain_is_each_of_its_comparisons() -> None:
    assert [one.factors for one in parse("A >= B >= C", NAMES)] == [
        {"A": -1.0, "B": 1.0},
        {"B": -1.0, "C": 1.0},
    ]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("A >=", "is not a comparison; write for example 'A >= B'"),
        ("A + B", "compares nothing; write"),
        ("A == B", "by neither <= nor >=; .* in the model's script"),
        ("A in B", "by neither"),
        ("A * B <= 1", "is not linear"),
        ("1 / A <= 1", "is not linear"),
        ("A / 0 <= 1", "is not linear"),
        ("A ** 2 <= 1", "is not linear"),
        ("abs(A) <= 1", "is not linear"),
        ("A <= True", "is not linear"),
        ("A <= 1e999", "is not linear"),
        ("A.real <= 1", "is not linear"),
        ("__import__('os').system('true') <= 1", "is not linear"),
        ("MU <= 1", "MU is not a parameter; there are A, B, C"),
        ("-" * 400 + "A <= 1", "is not a comparison|is not linear|A"),
        ("A+" * 300 + "A <= 1", "is not a comparison"),
    ],
)
def test_what_is_not_linear_is_refused_in_one_line_and_never_evaluated(text: str, says: str) -> None:
    if text.startswith("---"):
        assert parse(text, NAMES)[0].factors == {"A": 1.0}
        return
    with pytest.raises(InputError, match=says) as refused:
        parse(text, NAMES)
    assert "\n" not in str(refused.value)


@given(st.text(max_size=40))
@settings(deadline=None)
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(InputError):
        parse(text, NAMES)


def test_what_leaves_nothing_or_binds_nothing_is_refused() -> None:
    with pytest.raises(InputError, match=r"'A >= 2' leave 0 of the intervals' box, .*; correct them"):
        of("A >= 2")
    with pytest.raises(InputError, match=r"'C >= 0.1' has no calibrated parameter; remove it"):
        of("C >= 0.1")
    assert of("A - 0.995 >= 0").centre[0] > 0.995 > 1 - 10 * LEAST_SHARE


# ---- what is kept ------------------------------------------------------------------------------------


def test_constants_count_at_their_value() -> None:
    allowed = of("A >= B + C")
    assert allowed.holds(np.array([[0.8, 0.4], [0.8, 0.6], [0.7, 0.4]])).tolist() == [True, False, True]


@pytest.mark.parametrize("texts", [("A >= B",), ("A >= 2 * B", "A <= 0.9"), ("A <= 0.02",)])
def test_designs_keep_the_constraints_and_are_spread(texts: tuple[str, ...]) -> None:
    allowed = of(*texts)
    design = allowed.design(10, np.random.default_rng(1))
    assert design.shape == (10, 2) and allowed.holds(SPACE.box.from_unit(design)).all()
    random = allowed.spread(10, np.random.default_rng(1))

    def closest(points: Array) -> float:
        scaled = (points - points.min(axis=0)) / np.ptp(points, axis=0)
        distances = np.linalg.norm(scaled[:, None] - scaled, axis=2)
        return float(distances[np.triu_indices(10, 1)].min())

    assert closest(design) > closest(random)


@pytest.mark.parametrize("whole", [(), (True, False)])
def test_points_of_the_grid_keep_the_constraints(whole: tuple[bool, ...]) -> None:
    wide = Space((Parameter("A", "-", 0.0, 9.0, None), Parameter("B", "-", 0.0, 9.0, None)), ("A", "B"))
    allowed, grid = of("A >= B + 0.3", space=wide), Grid(wide.box, 9 if not whole else 1000, whole)
    points = wide.box.from_unit(allowed.spread(300, np.random.default_rng(2)))
    near = allowed.nearest(points, grid)
    assert (near[:, 0] >= near[:, 1] + 0.3).all()
    assert np.array_equal(near, grid.nearest(near))
    assert np.abs(near - points).max() <= 1.0
    assert not allowed.holds(grid.nearest(points)).all()  # rounding alone would break it


def test_the_search_ends_on_a_constraint_that_is_in_its_way() -> None:
    """The nearest point to (0.2, 0.6) with A >= B is (0.4, 0.4)."""
    goal = np.array([0.2, 0.6])
    for settled in (False, True):
        how = SequentialQuadratic(difference=1e-3, settled=settled)
        for start in ([0.9, 0.3], [0.2, 0.5]):
            found = sequential_quadratic(lambda at: at - goal, np.array(start), SPACE.box, how, of("A >= B"))
            assert found.best == pytest.approx([0.4, 0.4], abs=1e-3)
            assert of("A >= B").slack(found.best).min() >= -1e-12


def test_a_constraint_that_is_not_in_the_way_changes_nothing() -> None:
    goal = np.array([0.7, 0.3])
    ends = [
        sequential_quadratic(
            lambda at: at - goal, np.array([0.9, 0.3]), SPACE.box, SequentialQuadratic(settled=True), allowed
        ).best
        for allowed in (None, of("A >= B"))
    ]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


# ---- a calibration -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kept() -> tuple[Result, list[tuple[float, float]]]:
    """A calibration whose target is nearest at MU_PP < MU_PW, which is not allowed."""
    asked: list[tuple[float, float]] = []

    def heap(MU_PP: float, MU_PW: float) -> dict[str, float]:
        asked.append((MU_PP, MU_PW))
        return {"angle": 20 + 30 * MU_PP, "wall": 10 + 40 * MU_PW}

    found = cs.calibrate(
        heap,
        {"MU_PP": (0.1, 0.9), "MU_PW": (0.1, 0.5)},
        {"angle": 26.0, "wall": 22.0},  # 0.2 and 0.3
        constraints=["MU_PP >= MU_PW"],
    )
    return found, asked


def test_every_run_keeps_the_constraints(kept: tuple[Result, list[tuple[float, float]]]) -> None:
    found, asked = kept
    assert len(asked) >= 7 and all(pp >= pw for pp, pw in asked)
    assert found.optimum["MU_PP"] == pytest.approx(found.optimum["MU_PW"], abs=1e-3)
    assert 0.2 < found.optimum["MU_PP"] < 0.3


def test_the_solution_space_and_the_forecast_know_the_constraints(
    kept: tuple[Result, list[tuple[float, float]]],
) -> None:
    found, _ = kept
    task = found.definition.task
    assert (found.solutions.points[:, 0] >= found.solutions.points[:, 1] - 1e-9).all()
    at = np.array([*found.optimum.values()])
    lines = constraints_in_the_way(task, found.surrogates, at)
    assert lines == ["the constraint MU_PP >= MU_PW is in the way of the targets"]
    assert constraints_in_the_way(task, found.surrogates, task.centre) == []
