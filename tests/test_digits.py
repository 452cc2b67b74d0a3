"""Same seed, same digits: what other linear algebra makes of a study, with the grid and without."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from calstudy.parameters import GRID
from emulated_rows import GOLDEN, ROWS, as_golden, replicate

pytestmark = pytest.mark.slow

PROGRAM = Path(__file__).parent / "emulated_rows.py"
KERNELS = ("Haswell", "SkylakeX", "Prescott")
"""Of OpenBLAS; each adds up in an order of its own."""


def elsewhere(kernel: str, threads: int, mode: str, grid: int) -> dict:
    """A replicate under another kernel of OpenBLAS."""
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel, "OPENBLAS_NUM_THREADS": str(threads)}
    asked = [mode, str(grid), ",".join(map(str, ROWS[mode]))]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", str(PROGRAM), *asked],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def golden() -> pd.DataFrame:
    return pd.read_csv(GOLDEN, dtype=str, keep_default_na=False)


@pytest.mark.parametrize("mode", ROWS)
def test_a_replicate_on_the_grid_comes_out_again_to_the_last_digit(golden: pd.DataFrame, mode: str) -> None:
    calibrations, runs = replicate(mode, GRID, ROWS[mode])
    assert list(calibrations["outcome"]) == ["ok"] * len(ROWS[mode])
    there = golden[golden["mode"] == mode].reset_index(drop=True)
    pd.testing.assert_frame_equal(as_golden(runs, mode).reset_index(drop=True), there)


@pytest.mark.parametrize("mode", ROWS)
def test_other_linear_algebra_changes_no_digit_on_the_grid_and_some_without(
    golden: pd.DataFrame, mode: str
) -> None:
    one, *others = (elsewhere(kernel, k % 2 + 1, mode, GRID) for k, kernel in enumerate(KERNELS))
    others = [other for other in others if other["kernels"] != one["kernels"]]
    if not others:
        pytest.skip(f"this machine's linear algebra has no other kernel than {one['kernels']}")
    there = golden[golden["mode"] == mode].to_numpy().tolist()
    for found in (one, *others):
        assert found["rows"] == len(ROWS[mode])
        assert found["runs"] == there, found["kernels"]
    # Without the grid, last digits reach the DEM model.
    free = [elsewhere(kernel, 1, mode, 0) for kernel in KERNELS]
    assert any(found["runs"] != free[0]["runs"] for found in free[1:])
