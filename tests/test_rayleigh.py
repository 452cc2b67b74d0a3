import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.rayleigh import rayleigh_time_step

densities = st.floats(1e2, 1e5)
moduli = st.floats(1e5, 1e12)
radii = st.floats(1e-6, 1.0)
ratios = st.floats(0.0, 0.49)
factors = st.floats(0.01, 100.0)


def test_without_lateral_strain_eq_1_is_pi_over_0_8766():
    # G = 4 / 2 = 2, so sqrt(2 / G) = 1, and 0.1631 nu vanishes.
    found = rayleigh_time_step(2.0, 4.0, radius=1.0, poissons_ratio=0.0)
    assert found == pytest.approx(3.58384, abs=5e-6)


def test_eq_1_by_hand_for_the_papers_beads():
    # G = 5.06e8 / 2.44 = 2.07377e8 Pa; sqrt(2500 / G) = 3.47208e-3 s/m; pi 0.0025 m of it: 2.72697e-5 s;
    # 0.1631 x 0.22 + 0.8766 = 0.912482.
    found = rayleigh_time_step(2500.0, 5.06e8, radius=0.0025, poissons_ratio=0.22)
    assert found == pytest.approx(2.98852e-5, rel=5e-6)


def test_young_is_not_taken_for_the_shear_modulus():
    found = rayleigh_time_step(2500.0, 5.06e8, radius=0.0025, poissons_ratio=0.22)
    mistaken = math.pi * 0.0025 * math.sqrt(2500.0 / 5.06e8) / (0.1631 * 0.22 + 0.8766)
    assert found == pytest.approx(mistaken * math.sqrt(2.44))
    assert found != pytest.approx(mistaken, rel=0.1)


@given(densities, moduli, radii, ratios, factors)
def test_grows_with_radius_root_of_density_and_inverse_root_of_stiffness(rho, ym, r, nu, k):
    step = rayleigh_time_step(rho, ym, radius=r, poissons_ratio=nu)
    assert rayleigh_time_step(rho, ym, radius=k * r, poissons_ratio=nu) == pytest.approx(k * step)
    assert rayleigh_time_step(k * rho, ym, radius=r, poissons_ratio=nu) == pytest.approx(math.sqrt(k) * step)
    assert rayleigh_time_step(rho, k * ym, radius=r, poissons_ratio=nu) == pytest.approx(step / math.sqrt(k))


@given(densities, moduli, radii, ratios, factors)
def test_only_the_ratio_of_density_and_stiffness_counts(rho, ym, r, nu, k):
    one = rayleigh_time_step(rho, ym, radius=r, poissons_ratio=nu)
    other = rayleigh_time_step(k * rho, k * ym, radius=r, poissons_ratio=nu)
    assert other == pytest.approx(one)


def test_arrays_give_what_their_elements_give():
    rho, ym = np.array([2400.0, 2500.0, 2600.0])[:, None], np.array([1e8, 1e9])
    steps = rayleigh_time_step(rho, ym, radius=0.0025, poissons_ratio=0.22)
    assert steps.shape == (3, 2)
    single = rayleigh_time_step(2600.0, 1e8, radius=0.0025, poissons_ratio=0.22)
    assert steps[2, 0] == pytest.approx(float(single), rel=1e-14)
