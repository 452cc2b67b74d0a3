"""The report of the next test: what is shipped, and what its page says, is what its tables hold."""

from pathlib import Path

import pandas as pd
import pytest

from calstudy.emulator.emulator import read_emulator
from calstudy.models.find import SHIPPED

HERE = Path(__file__).parent.parent / "reports" / "next_test"


def test_each_emulator_tells_its_runs_without_bias_and_doubts_as_it_should() -> None:
    table = pd.read_csv(HERE / "validation.csv")
    assert (table["left_out_inside"] >= 0.9 * table["left_out_n"]).all()
    assert (table["left_out_bias"].abs() < 3.0 * table["left_out_rmse"] / table["left_out_n"] ** 0.5).all()
    assert (table["left_out_rmse"] < 0.35 * table["range"]).all()


@pytest.mark.parametrize("name", ["outcomes.csv", "real.csv"])
def test_the_widths_that_were_promised_came_out(name: str) -> None:
    outcomes = pd.read_csv(HERE / name)
    assert outcomes["truth"].nunique() == 16
    within = (outcomes["got"] / outcomes["promised"]).between(1 / 1.25, 1.25)
    assert within.mean() > 0.75
    over_truths = outcomes.groupby(["tests", "parameter"])[["promised", "got"]].agg(lambda x: (x**2).mean())
    assert (over_truths["got"] / over_truths["promised"]).pow(0.5).between(0.8, 1.25).all()


def test_whole_calibrations_to_two_hidden_truths_came_out_as_promised_or_narrower() -> None:
    hidden = pd.read_csv(HERE / "hidden.csv")
    assert list(hidden.groupby("truth")["tests"].nunique()) == [3, 3]
    ratio = hidden["got"] / hidden["promised"]
    within = ratio.between(1 / 1.25, 1.25)
    assert f"Of these {len(hidden)} widths {within.sum()} are within 25 %" in (HERE / "README.md").read_text()
    assert within.mean() > 0.75 and (ratio < 1.25).all()


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*/emulators/coarse*")), ids=lambda p: p.parts[-3])
def test_the_runs_of_an_emulator_are_in_the_report(path: Path) -> None:
    runs = pd.read_parquet(HERE / "design" / path.parts[-3] / "runs.parquet")
    assert len(read_emulator(path).runs) == len(runs) >= 24
