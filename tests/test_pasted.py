"""Calibrated values rounded to what the noise of a run supports, and why one lies outside its range."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from calstudy.parameters import Parameter, Space
from calstudy.report.pasted import rounded
from calstudy.report.solution_space import outside


class Plane:
    """Surrogates of two responses, linear in three parameters, of which the last acts on nothing."""

    names = ("angle", "density")
    slopes = np.array([[30.0, 0.0], [0.0, 0.5], [0.0, 0.0]])

    space = Space(
        (
            Parameter("MU", "-", 0.1, 0.9, None),
            Parameter("DENS", "kg/m3", 2400.0, 2600.0, None),
            Parameter("YM", "Pa", 5e6, 5e8, None),
        ),
        ("MU", "DENS", "YM"),
    )

    def predict(self, points):
        return points @ self.slopes


OPTIMUM = np.array([0.4567891234, 2512.3456789, 123456789.123])


def test_the_last_place_is_a_tenth_of_what_the_noise_hides():
    found = rounded(Plane(), {"angle": 1.0, "density": 3.0}, OPTIMUM)
    # 1 deg is 0.033 of MU and 3 kg/m3 are 6 of DENS. YM acts on nothing: its interval is the limit.
    assert found == {"MU": 0.457, "DENS": 2512.3, "YM": 120000000.0}


def test_rounding_moves_no_response_by_as_much_as_its_noise():
    noise = {"angle": 1.0, "density": 3.0}
    rng = np.random.default_rng(1)
    for optimum in Plane.space.box.from_unit(rng.uniform(size=(100, 3))):
        moved = Plane().predict(np.array([*rounded(Plane(), noise, optimum).values()])) - Plane().predict(
            optimum
        )
        assert (np.abs(moved) <= 0.05 * np.array([1.0, 3.0]) + 1e-9).all()


def test_without_noise_every_digit_counts_where_a_parameter_acts():
    found = rounded(Plane(), {"angle": 0.0, "density": 0.0}, OPTIMUM)
    assert (found["MU"], found["DENS"]) == (OPTIMUM[0], OPTIMUM[1])


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_a_value_on_a_bound_stays_inside(end):
    box = Plane.space.box
    optimum = box.from_unit(np.full(3, end))
    found = rounded(Plane(), {"angle": 1.0, "density": 3.0}, optimum)
    assert all(low <= found[n] <= high for n, low, high in zip(box.names, box.lower, box.upper, strict=True))


@pytest.mark.parametrize(
    ("mu", "targets", "drawn", "said"),
    [
        (0.5, (15.0, 1250.0), (15.0, 1250.0), ""),
        (
            0.8,
            (24.0, 1250.0),
            (24.0, 1250.0),
            "outside the 90 %: one of the other 10 %, as good by the sur",
        ),
        (
            0.9,
            (27.0, 1250.0),
            (27.0, 1250.0),
            "outside the 90 %: on its upper bound, and as good by the sur",
        ),
        (0.8, (15.0, 1250.0), (15.5, 1250.0), "outside the 90 %: by the surrogates angle would miss there"),
        (
            0.8,
            (28.0, 1250.0),
            (22.0, 1250.0),
            "outside the 90 %: angle is hardly reached, and comes nearest",
        ),
    ],
)
def test_an_optimum_outside_the_range_of_the_solutions_says_why(mu, targets, drawn, said):
    result = SimpleNamespace(
        surrogates=Plane(),
        optimum_point=np.array([mu, 2500.0, 1e8]),
        settings=SimpleNamespace(target=SimpleNamespace(values=dict(zip(Plane.names, targets, strict=True)))),
        solutions=SimpleNamespace(errors={"angle": 0.5, "density": 1.5}, responses=np.array([drawn])),
    )
    found = outside(result, "MU", 0.4, 0.6)
    assert found.startswith(said) and bool(found) == bool(said)


def test_a_logarithmic_value_is_rounded_by_its_ratios_and_a_listed_one_not_at_all():
    names, slopes = ("angle",), np.array([[30.0], [1.0]])
    parameters = (
        Parameter("YM", "Pa", 1e6, 1e9, None, is_log=True),
        Parameter("N", "-", 0.123, 4.567, None, values=(0.123, 4.567)),
    )
    space = Space(parameters, ("YM", "N"))
    plane = SimpleNamespace(names=names, space=space, predict=lambda points: points @ slopes)
    found = rounded(plane, {"angle": 3.0}, space.point({"YM": 12345678.0, "N": 0.123}))
    assert found == {"YM": 12300000.0, "N": 0.123}  # 3 deg are a tenth of a decade: 26 %
