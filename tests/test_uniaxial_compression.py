"""The uniaxial compression: moduli of curves, and what real runs obey."""

import math

import numpy as np
import pytest

from material_runs import measures, proof, tiny_run

COMPRESSION = measures("uniaxial_compression")


def test_the_modulus_is_the_slope_over_a_part_of_the_stress():
    strains = np.linspace(0, 0.02, 400)
    stress = 4e6 * strains + 1e8 * strains**2
    upper = stress[stress >= 0.5 * stress.max()]
    found = COMPRESSION.modulus(strains, stress, (0.5, 1.0))
    secant = (upper[-1] - upper[0]) / (strains[-1] - strains[-len(upper)])
    assert found == pytest.approx(secant, rel=0.01)
    assert COMPRESSION.modulus(strains, 4e6 * strains, (0.7, 1.0)) == pytest.approx(4e6)


def test_a_curve_of_two_points_has_no_modulus():
    with pytest.raises(ValueError, match="too few points"):
        COMPRESSION.modulus(np.array([0.0, 0.01]), np.array([0.0, 1e5]), (0.5, 1.0))


def test_strain_is_counted_from_the_seated_lid():
    assert COMPRESSION.strain(np.array([0.06, 0.057]), 0.06) == pytest.approx([0.0, 0.05])


@pytest.mark.liggghts
def test_compression_keeps_its_beads_and_ends_where_it_began():
    run, marks, directory = tiny_run("uniaxial_compression")
    assert marks["beads_end"] == marks["beads_filled"]
    loading, unloading = (np.loadtxt(directory / f"{name}.txt") for name in ("loading", "unloading"))
    assert loading[-1, 1] == pytest.approx(float(marks["largest_stress"]), rel=0.02)
    assert unloading[0, 0] == pytest.approx(loading[-1, 0], abs=1e-5)
    of = run.responses
    assert 0 < of["remaining_strain"] < of["largest_strain"] < 0.2
    assert of["unloading_modulus"] > of["loading_modulus"] > 0
    assert of["bulk_density_loaded"] / of["bulk_density"] == pytest.approx(
        1 / (1 - of["largest_strain"]), rel=1e-3
    )


@pytest.mark.liggghts
def test_a_column_of_beads_is_compressed_as_hertz_s_law_says():
    """In a cell hardly wider than a bead: F = 4/3 E* sqrt(R*) overlap^1.5 in each contact, there and back.

    Two beads have R* = d/4, bead and wall d/2. E* = E / (2 (1 - nu^2)) for both; the wall is as the beads.
    """
    diameter, width, modulus, poissons_ratio = 0.01, 0.0102, 5.06e8, 0.22
    smooth = {"MU_PP": 0.0, "MU_PW": 0.0, "RF_PP": 0.0, "RF_PW": 0.0}
    _, marks, directory = tiny_run("uniaxial_compression", cell_diameter=width, **smooth)
    beads = int(marks["beads_filled"])
    assert beads >= 5
    (height, stress), (back, falling) = (
        np.loadtxt(directory / f"{name}.txt").T for name in ("loading", "unloading")
    )
    weight = beads * 2500 * math.pi / 6 * diameter**3 * 9.81
    force = stress * math.pi / 4 * width**2 + weight / 2
    effective = modulus / (2 * (1 - poissons_ratio**2))

    def overlap(radius):
        return (3 * force / (4 * effective * math.sqrt(radius))) ** (2 / 3)

    shortened = (beads - 1) * overlap(diameter / 4) + 2 * overlap(diameter / 2)
    assert height[0] - height == pytest.approx(shortened - shortened[0], abs=0.025 * np.ptp(shortened))
    half = 0.5 * stress[-1]
    there, again = np.interp(half, stress, height), np.interp(half, falling[::-1], back[::-1])
    assert there == pytest.approx(again, abs=0.005 * np.ptp(height))


@pytest.mark.liggghts
def test_where_no_contact_is_made_the_modulus_grows_as_the_cube_root_of_the_stress():
    """In the same column: d(stress)/d(strain) ~ p^(1/3), unlike in a poured bed, which makes contacts."""
    smooth = {"MU_PP": 0.0, "MU_PW": 0.0, "RF_PP": 0.0, "RF_PW": 0.0}
    _, _, directory = tiny_run("uniaxial_compression", cell_diameter=0.0102, **smooth)
    height, stress = np.loadtxt(directory / "loading.txt").T
    strains = COMPRESSION.strain(height, height[0])
    levels, moduli = [], []
    for low, high in ((0.1, 0.2), (0.2, 0.4), (0.4, 0.7), (0.7, 1.0)):
        part = (stress >= low * stress[-1]) & (stress <= high * stress[-1])
        moduli.append(np.polyfit(strains[part], stress[part], 1)[0])
        levels.append(stress[part].mean())
    exponent = np.polyfit(np.log(levels), np.log(moduli), 1)[0]
    assert exponent == pytest.approx(1 / 3, abs=0.03)


@pytest.mark.liggghts
def test_a_tall_column_bears_no_more_than_janssen_s_law_says():
    """Its wall drawn upwards: friction is mobilised, and the stress ends at rho g D / (4 mu K)."""
    janssen = proof("janssen")
    found = janssen.summary(janssen.run(0.2, 1, diameter=0.04, height=0.2), 0.04)
    assert found["base"] < 0.4
    assert found["mobilised"] == pytest.approx(0.2, rel=0.1)
    assert found["stress"] == pytest.approx(found["law_stress"], rel=0.2)
