"""DEM optima that were run again: what is read of the runs beside a study, and what is made of them."""

from __future__ import annotations

import shutil
from importlib import import_module

import numpy as np
import pandas as pd
import pytest

from calstudy.analysis import confirmed
from calstudy.analysis.figures.figure3 import figure3
from calstudy.analysis.fresh_runs import confirmed_label, in_words, runs_beside, with_confirmed
from calstudy.analysis.tables.confirmed import luck
from calstudy.cli.main import main
from calstudy.errors import StoreError
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.plan import PARAMETERS
from calstudy.study.directory.store import write_table
from calstudy.study.reading import read_study
from calstudy.study.schema import schema_of
from closed_form import run_study
from shipped_model import SWEEP

ROWS = (1, 28)
SEEDS = (5, 6, 7)
# Of a module of that name there is a function, too.
ledger = import_module("calstudy.analysis.ledger.claims")


def fresh(directory):
    """Three runs at the optimum of each row, 1, 2 and 6 deg steeper than reported."""
    study = read_study(directory)
    lines = []
    for line in study.ok.to_dict("records"):
        for seed, steeper in zip(SEEDS, (1.0, 2.0, 6.0), strict=True):
            run = dict.fromkeys(column.name for column in SWEEP)
            run |= {name: line[f"dem_{name}"] for name in PARAMETERS}
            run |= {
                name: line[name] for name in ("model", "deck", "model_hash", "fidelity", "variant", "engine")
            }
            run |= {"label": confirmed_label(directory, line["row"]), "seed": seed, "outcome": "ok"}
            run |= {ANGLE_OF_REPOSE: line[f"dem_{ANGLE_OF_REPOSE}"] + steeper}
            run |= {BULK_DENSITY: line[f"dem_{BULK_DENSITY}"]}
            lines.append(run)
    return pd.DataFrame(lines)


def write(directory, runs):
    path = runs_beside(directory)
    path.parent.mkdir(exist_ok=True)
    write_table(path, runs, schema_of(SWEEP, "sweep"))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    directory = tmp_path_factory.mktemp("folder") / "paper"
    run_study(directory, ROWS)
    return directory


@pytest.fixture
def directory(made, tmp_path):
    shutil.copytree(made, tmp_path / "paper")
    return tmp_path / "paper"


def test_without_runs_a_study_is_as_it_was(directory):
    study = read_study(directory)
    assert with_confirmed(directory, study) is study
    runs = fresh(directory)
    write(directory, runs.assign(label="robust 1"))
    assert with_confirmed(directory, study) is study
    required = ledger.requirements(study)
    assert required["C01"][1].figure.why_not == "no optimum was run again"


def test_what_was_run_again_stands_in_columns_beside_what_was_reported(directory):
    runs = fresh(directory)
    runs.loc[0, [ANGLE_OF_REPOSE, BULK_DENSITY]] = np.nan  # it gave no heap
    write(directory, runs)
    study = with_confirmed(directory, read_study(directory))
    c = study.calibrations.set_index("row")
    steeper = c[f"confirmed_{ANGLE_OF_REPOSE}"] - c[f"dem_{ANGLE_OF_REPOSE}"]
    assert steeper.to_dict() == pytest.approx({1: (2 + 6) / 2, 28: (1 + 2 + 6) / 3})
    assert c["confirmed_runs"].to_dict() == {1: 2, 28: 3}
    of_row = study.confirmed[study.confirmed["row"] == 28]
    each = np.sum(study.residuals(28, of_row) ** 2, axis=1)
    assert c.loc[28, "confirmed_sum_of_squares"] == pytest.approx(each.mean())
    assert list(read_study(directory).calibrations.columns) == [
        name for name in study.calibrations.columns if not name.startswith("confirmed_")
    ]
    table = confirmed(study).set_index("row")
    assert list(table["runs"]) == [2, 3]
    assert luck(study)[ANGLE_OF_REPOSE].value == pytest.approx(-(4 + 3) / 2)
    assert in_words(study) == (
        "Run again: 6 runs with fresh seeds at the DEM optima of 2 of 2 rows, 3 a row, of which 1 gave no "
        "response."
    )


def test_the_ledger_counts_runs_within_by_row_and_one_without_a_response_as_outside(directory):
    runs = fresh(directory)
    target = read_study(directory).settings.target.values[ANGLE_OF_REPOSE]
    runs[ANGLE_OF_REPOSE] = target * np.array([1.1, 1.2, np.nan, 1.14, 0.86, 1.0])
    write(directory, runs)
    study = with_confirmed(directory, read_study(directory))
    _, again = ledger.requirements(study)["C01"]
    assert (again.figure.value, again.figure.n) == (pytest.approx((1 / 3 + 1) / 2), 2)
    assert again.figure.low >= 0 and again.figure.high <= 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda runs: runs.assign(model_hash="0" * 64), "of another model"),
        (lambda runs: runs.assign(DENS=runs["DENS"] + 1.0), "'paper 1' is not at that row's DEM optimum"),
    ],
)
def test_runs_that_are_not_those_of_the_optima_are_refused(directory, change, said):
    write(directory, change(fresh(directory)))
    with pytest.raises(StoreError, match=said):
        with_confirmed(directory, read_study(directory))


def test_figure_3_has_both_side_by_side(directory):
    write(directory, fresh(directory))
    study = with_confirmed(directory, read_study(directory))
    for figure, labels in (
        (figure3(read_study(directory)), ["AoR\nn = 2"]),
        (figure3(study), ["AoR\nas reported\nn = 2", "AoR\nrun again\nn = 6"]),
    ):
        assert [text.get_text() for text in figure.axes[0].get_xticklabels()] == labels


def test_the_report_says_how_often_the_optima_were_run_again(directory, tmp_path, capsys):
    command = ["analyse", str(directory), "--format", "csv,html", "--out", str(tmp_path / "out")]
    assert main([*command, "--only", "confirmed"]) == 2
    assert "benchmarks/confirmed.py design" in capsys.readouterr().err
    write(directory, fresh(directory))
    assert main([*command, "--only", "claims,confirmed"]) == 0
    assert "6 runs with fresh seeds" in (tmp_path / "out" / "report.html").read_text()
    table = pd.read_csv(tmp_path / "out" / "tables" / "confirmed.csv")
    assert list(table["row"]) == [*ROWS]
