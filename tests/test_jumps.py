"""A jump is found and told, and a smooth response is not taken for one."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from threadpoolctl import threadpool_limits

from calstudy.emulator.branches import Region, off_branch
from calstudy.emulator.cokriging import CoKriging
from calstudy.emulator.design import space_filling
from calstudy.emulator.emulator import fit_emulator
from calstudy.emulator.process import Observations
from calstudy.errors import NumericsError
from shipped_model import SIMILARITY
from synthetic_runs import PLAN, angle

pytestmark = pytest.mark.slow

SOMEWHERE = np.random.default_rng(5).random((3000, 5))
JUMPS = {
    # As on the wide plate: little friction on the wall, and the layer of beads rolls away.
    "a sliver": lambda u: u[:, 3] < 0.04,
    "a slope": lambda u: u[:, 3] < 0.15 * u[:, 0],
    "a corner": lambda u: (u[:, 3] < 0.3) & (u[:, 2] < 0.3),
}


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    with threadpool_limits(1):
        yield


def observations(response, count=128, seed=1, noise=0.6):
    U = space_filling(count, 5, seed)
    y = response(U) + noise * np.random.default_rng(seed).standard_normal(count)
    return Observations(U, y, np.zeros(count, int)), np.arange(count)


@pytest.mark.parametrize("name", JUMPS)
def test_a_jump_is_found_and_its_region_told(name):
    jumps = JUMPS[name]
    data, points = observations(lambda u: angle(u) + 10.0 * jumps(u))
    off = off_branch(data, points)
    process = CoKriging.fit(data.without(off))
    np.testing.assert_array_equal(off, jumps(data.U))
    error = np.abs(process.mean(SOMEWHERE) - angle(SOMEWHERE))
    assert error.max() < 1.5, "the branch is not bent by the jump"
    region = Region.of(data.U, off)
    flagged, there = region.contains(SOMEWHERE), jumps(SOMEWHERE)
    assert flagged[there].mean() > 0.85
    assert flagged[~there].mean() < 0.1


def test_two_branches_of_one_size_are_refused():
    data, points = observations(lambda u: angle(u) + 10.0 * (u[:, 3] + 0.2 * u[:, 0] < 0.6))
    with pytest.raises(NumericsError, match=r"of 128 runs lie far .* no one smooth response"):
        off_branch(data, points)


@pytest.mark.parametrize("count", [40, 100])
def test_a_steep_response_is_no_jump(count):
    data, points = observations(lambda u: angle(u) - 3.0 * np.log(0.02 + u[:, 3]), count)
    off = off_branch(data, points)
    assert not off.any()


def test_a_jump_is_told_from_noise_alone():
    for seed in range(5):
        data, points = observations(lambda u: 0.0 * u[:, 0], 60, seed)
        assert not off_branch(data, points).any()


def test_of_normal_errors_about_a_plane_the_first_guess_suspects_hardly_any(monkeypatch):
    def look(data):
        raise NumericsError(f"{len(data.y)} runs")

    monkeypatch.setattr(CoKriging, "fit", look)
    data, points = observations(lambda u: 6.0 * u[:, 0], 200)
    with pytest.raises(NumericsError) as fitted:
        off_branch(data, points)
    assert int(str(fitted.value).split()[0]) > 190


@pytest.mark.parametrize("count", [24, 30])
def test_few_runs_of_a_smooth_response_are_one_branch(count):
    """A plane through a dozen runs fits chance, and would take most of the others for another branch."""
    for seed in range(5):
        data, points = observations(angle, count, seed)
        off = off_branch(data, points)
        assert off.sum() <= 1 and Region.of(data.U, off) is None


RUNS = pd.read_parquet(
    Path(__file__).parent.parent / "reports" / "angle_of_repose" / "plate" / "runs.parquet"
)


@pytest.mark.parametrize(
    ("variant", "beyond"),
    [
        ("ring", []),
        ("plate_60", []),
        # Where the angle is near 20 deg or above, the layer holds at 61 mm from the axis or less.
        ("wide", ["point-06", "point-09", "point-17"]),
    ],
)
def test_on_real_runs_the_wide_plates_jump_is_found_and_no_other(variant, beyond):
    runs = RUNS[RUNS["variant"] == variant].reset_index(drop=True)
    emulator = fit_emulator(runs, PLAN.parameters, SIMILARITY)
    angles, fractions = emulator.responses
    labels = dict(zip(runs["run_id"], runs["label"], strict=True))
    assert sorted(labels[run] for run in angles.off) == beyond
    assert (angles.region is not None) == bool(beyond)
    assert fractions.off == (), "the packing is poured into the ring, whatever the plate"
    assert set(runs.loc[runs["heap_radius"] < 0.07, "label"]) == set(beyond) or variant != "wide"


def test_one_stray_run_makes_no_region():
    data, points = observations(angle)
    y = data.y.copy()
    y[17] += 12.0
    off = off_branch(data.with_responses(y), points)
    assert list(np.flatnonzero(off)) == [17]
    assert Region.of(data.U, off) is None
