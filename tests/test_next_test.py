"""The report of the next test: what is shipped, and what its page says, is what its tables hold."""

from pathlib import Path

import pandas as pd
import pytest

from calstudy.emulator.emulator import read_emulator
from calstudy.models.find import SHIPPED

HERE = Path(__file__).parent.parent / "reports" / "next_test"


def test_each_emulator_is_as_good_as_the_noise_lets_it() -> None:
    table = pd.read_csv(HERE / "validation.csv")
    assert (table["left_out_inside"] >= 0.9 * table["left_out_n"]).all()
    assert (table["left_out_bias"].abs() < 0.2).all() and (table["left_out_rmse"] < 2.0).all()
    assert (table["left_out_rmse"] < 0.5 * table["range"]).all()


def test_the_widths_that_were_promised_came_out() -> None:
    outcomes = pd.read_csv(HERE / "outcomes.csv")
    assert outcomes["truth"].nunique() >= 6
    within = (outcomes["got"] / outcomes["promised"]).between(1 / 1.25, 1.25)
    assert within.mean() > 0.75
    over_truths = outcomes.groupby(["tests", "parameter"])[["promised", "got"]].agg(lambda x: (x**2).mean())
    assert (over_truths["got"] / over_truths["promised"]).pow(0.5).between(0.8, 1.25).all()


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*/emulators/coarse*")), ids=lambda p: p.parts[-3])
def test_the_runs_of_an_emulator_are_in_the_report(path: Path) -> None:
    runs = pd.read_parquet(HERE / "runs" / path.parts[-3] / "runs.parquet")
    assert len(read_emulator(path).runs) == len(runs) >= 24
