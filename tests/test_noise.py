import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import REFERENCE
from calstudy.models.noise import known_noise, noise_freedom, noise_table, pooled_sd
from calstudy.plan_file import load_plan
from shipped_model import DECLARED

ROOT = Path(__file__).parent.parent


def runs(values, fidelity="soft", label="reference", outcome="ok", variant="ring"):
    """Lines of a sweep: angles given, bulk density 60 times them."""
    return pd.DataFrame(
        {
            **REFERENCE,
            "MU_PP": 0.1 if label == "low" else REFERENCE["MU_PP"],
            "label": label,
            "fidelity": fidelity,
            "variant": variant,
            "model_hash": f"hash of {fidelity}",
            "angle_of_repose_deg": values,
            "bulk_density": [60 * v for v in values],
            "outcome": outcome,
            "cpu_time": 2.0,
        }
    )


def test_mean_sd_and_bias_are_those_of_the_runs_at_a_point():
    soft, full = [25.0, 26.0, 28.0], [27.0, 29.0]
    table = noise_table(
        pd.concat([runs(soft), runs(full, "full"), runs([20.0, 21.0], label="low")]), DECLARED
    )
    assert list(zip(table["fidelity"], table["label"], table["n"], strict=True)) == [
        ("soft", "reference", 3),
        ("full", "reference", 2),
        ("soft", "low", 2),
    ]
    first = table.iloc[0]
    assert first["angle_of_repose_deg"] == pytest.approx(79 / 3)
    assert first["angle_of_repose_deg_sd"] == pytest.approx(math.sqrt(7 / 3))
    assert first["angle_of_repose_deg_bias"] == pytest.approx(79 / 3 - 28)
    assert first["bulk_density_bias"] == pytest.approx(60 * (79 / 3 - 28))
    # Welch's interval written out.
    parts = [(7 / 3) / 3, 2.0 / 2]
    freedom = sum(parts) ** 2 / (parts[0] ** 2 / 2 + parts[1] ** 2 / 1)
    half = stats.t.ppf(0.95, freedom) * math.sqrt(sum(parts))
    assert first["angle_of_repose_deg_bias_half_width"] == pytest.approx(half)
    assert table.iloc[1:][["angle_of_repose_deg_bias", "bulk_density_bias"]].isna().all(axis=None)


def test_the_bias_is_against_the_truth_of_the_same_variant_and_point():
    ring = [runs([25.0, 26.0]), runs([27.0, 29.0], "full")]
    wide = [runs([v - 4 for v in (25.0, 26.0)], variant="wide"), runs([17.0, 19.0], "full", variant="wide")]
    low = [runs([22.0, 23.0], label="low"), runs([12.0, 13.0], "full", label="low")]
    table = noise_table(pd.concat([*ring, *wide, *low]).assign(label="any"), DECLARED)
    found = table[table["fidelity"] == "soft"].set_index(["variant", "MU_PP"])["angle_of_repose_deg_bias"]
    assert found.to_dict() == {("ring", 0.2): -2.5, ("wide", 0.2): 3.5, ("ring", 0.1): 10.0}


def test_failed_runs_are_counted_and_left_out():
    table = noise_table(pd.concat([runs([25.0, 26.0]), runs([math.nan], outcome="failed")]), DECLARED)
    assert (table["n"].item(), table["failed"].item()) == (2, 1)
    assert table["angle_of_repose_deg"].item() == 25.5


def test_a_single_run_has_no_scatter():
    table = noise_table(runs([25.0]), DECLARED)
    assert math.isnan(table["angle_of_repose_deg_sd"].item())
    assert math.isnan(pooled_sd(table)["angle_of_repose_deg"])


def test_pooling_weighs_by_degrees_of_freedom():
    one, other, single = [25.0, 26.0, 28.0], [20.0, 21.0], [30.0]
    parts = [runs(one), runs(other, label="low"), runs(single, label="high")]
    squares = sum(((np.array(v) - np.mean(v)) ** 2).sum() for v in (one, other))
    found = pooled_sd(noise_table(pd.concat(parts), DECLARED))
    assert found["angle_of_repose_deg"] == pytest.approx(math.sqrt(squares / 3))
    assert found["bulk_density"] == pytest.approx(60 * math.sqrt(squares / 3))


def test_a_model_that_was_not_measured_has_no_known_noise():
    assert known_noise("angle_of_repose", "0" * 64) is None
    assert known_noise("no_such_model", load_model(load_plan().fixed, "soft").hash) is None
    assert noise_freedom("angle_of_repose", "0" * 64) == noise_freedom("no_such_model", "0" * 64) == 0


def test_eight_runs_at_each_of_five_points_leave_35_degrees_of_freedom():
    assert noise_freedom("angle_of_repose", load_model(load_plan().fixed, "soft").hash) == 35


def test_the_shipped_noise_is_that_of_the_shipped_runs():
    runs = pd.read_parquet(ROOT / "reports" / "angle_of_repose" / "noise" / "runs.parquet")
    shipped = pd.read_csv(ROOT / "liggghts_models" / "angle_of_repose" / "noise.csv")
    pd.testing.assert_frame_equal(noise_table(runs, DECLARED), shipped, rtol=1e-5, check_dtype=False)


@pytest.mark.parametrize("fidelity", ["tiny", "coarse", "soft"])
def test_the_noise_of_the_shipped_model_is_known(fidelity):
    found = known_noise("angle_of_repose", load_model(load_plan().fixed, fidelity).hash)
    assert 0.3 < found["angle_of_repose_deg"] < 3.0
    assert 1.0 < found["bulk_density"] < 15.0
