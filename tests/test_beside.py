"""Rows on a DEM model beside the same rows on its emulator, and the paper's numbers of both."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calstudy.analysis import numbers_beside, rows_beside, table3
from calstudy.analysis.replicates.entries import TABLES
from calstudy.analysis.replicates.numbers_beside import common_rows
from calstudy.analysis.replicates.numbers_beside import notes as numbers_beside_notes
from calstudy.analysis.replicates.rows_beside import among, expected
from calstudy.cli.main import main
from calstudy.errors import InputError, StoreError
from calstudy.plan import PARAMETERS
from calstudy.report.replicated import read_entries, replicate_study, with_replicated_rows, with_replicates
from calstudy.study.reading import read_study
from closed_form import PLAN, TRUTH, run_study, target_of
from made_up_replicates import COUNT, ENGINE, made_up, study_with

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    return study_with(tmp_path_factory.mktemp("half") / "study", PLAN)


# ---- rows on the DEM model among their replicates -----------------------------------------------------


@pytest.fixture(scope="module")
def on_dem(tmp_path_factory):
    """Two rows, one of which is not replicated in the study beside it."""
    directory = tmp_path_factory.mktemp("on_dem") / "study"
    run_study(directory, (1, 31), plan=PLAN)
    return directory


def replicated_rows(half, like):
    study = with_replicated_rows(half, read_study(half), like)
    return replace(study, replicated_rows=study.replicated_rows.query("row == 31"))


def test_a_row_of_the_dem_model_stands_among_its_replicates(half, on_dem):
    like = read_study(on_dem)
    frame = rows_beside(replace(like, beside=replicated_rows(half, like)))
    assert set(frame["row"]) == {31}
    frame = frame.set_index(["of", "quantity"])
    row = like.ok.query("row == 31").iloc[0]
    free = [p for p in PARAMETERS if row[f"calibrated_{p}"]]
    there = [made_up(like, n)["replicates"].query("row == 31").iloc[0] for n in range(1, COUNT + 1)]
    for name in free:
        line = frame.loc["DEM"].filter(regex=f"^{name}(,|$)", axis=0).iloc[0]
        assert line["value"] == row[f"dem_{name}"]
        if name != "MU_PW":  # constant in the first replicate
            assert line["median"] == pytest.approx(np.median([of[f"dem_{name}"] for of in there]))
    assert len(frame.loc["DEM"]) == len(free) + 5
    runs = frame.loc[("DEM", "DEM runs of the second optimisation")]
    assert (runs["inside"] == "yes") == (runs["low"] <= row["runs_optimisation"] <= runs["high"])
    assert frame.loc[("samples", "smallest angle of repose, deg"), "inside"] == "", "made-up ones have none"


def test_a_value_at_the_bound_of_all_replicates_is_inside(half, on_dem):
    like = read_study(on_dem)
    other = replicated_rows(half, like)
    at_bound = other.replicated_rows.assign(dem_DENS=2600.0)
    like = replace(like, calibrations=like.calibrations.assign(dem_DENS=2600.0 * (1 + 1e-12)))
    frame = rows_beside(replace(like, beside=replace(other, replicated_rows=at_bound)))
    line = frame.set_index(["of", "quantity"]).loc[("DEM", "DENS, kg/m3")]
    assert line[["inside", "low", "high"]].tolist() == ["yes", 2600.0, 2600.0]


def test_rows_stand_beside_replicates_by_one_command(half, on_dem, tmp_path, capsys):
    assert main(["analyse", str(on_dem), "--beside", str(half), "--out", str(tmp_path)]) == 0
    frame = pd.read_csv(tmp_path / "tables" / "rows_beside.csv")
    assert set(frame["row"]) == {1, 31} and set(frame["n"]) <= {0, COUNT}
    assert (tmp_path / "figures" / "rows_beside_figure.svg").exists()
    page = (tmp_path / "report.html").read_text()
    assert f"{COUNT} replicates" in page and f"own draw of {ENGINE}" in page
    assert not (tmp_path / "tables" / "bands_beside.csv").exists()


def test_what_cannot_be_compared_is_refused(half, on_dem, tmp_path, capsys):
    assert main(["analyse", str(on_dem), "--only", "rows_beside"]) == 2
    assert "rows_beside compares two studies; name the second one with --beside" in capsys.readouterr().err
    assert main(["analyse", str(half), "--only", "rows_beside", "--beside", str(half)]) == 2
    assert "is on an emulator; ask for bands_beside" in capsys.readouterr().err
    other = tmp_path / "other"
    run_study(other, (1,), plan=PLAN, target=target_of(TRUTH | {"RF_PP": 0.02}))
    assert main(["analyse", str(other), "--only", "rows_beside", "--beside", str(half)]) == 2
    assert "its target is {'angle_of_repose_deg': " in capsys.readouterr().err


# ---- the paper's numbers on the DEM model among those of the replicates --------------------------------


def on_dem_as(directory, rows):
    """A study on the DEM model of some rows, which is the second replicate."""
    run_study(directory, (1,), plan=PLAN)
    study = read_study(directory)
    tables = {name: table[table["row"].isin(rows)] for name, table in made_up(study, 2).items()}
    columns = {"calibrations": "replicates", "evaluations": "replicate_runs"}
    tables["replicate_runs"]["wall_time"] = 60.0
    return replace(study, **{name: tables[made].reset_index(drop=True) for name, made in columns.items()})


@pytest.fixture(scope="module")
def many_on_dem(tmp_path_factory):
    return on_dem_as(tmp_path_factory.mktemp("many") / "study", [2, 9, 14, 22, 26, 28, 38, 41])


@pytest.fixture(scope="module")
def all_on_dem(tmp_path_factory):
    return on_dem_as(tmp_path_factory.mktemp("all") / "study", [row.run for row in PLAN.rows])


@pytest.fixture(scope="module")
def numbers(half, tmp_path_factory):
    """Where `analyse` wrote the numbers of the replicates."""
    out = tmp_path_factory.mktemp("numbers")
    assert main(["analyse", str(half), "--only", "bands", "--format", "csv", "--out", str(out)]) == 0
    return out


def beside_half(half, like):
    other = with_replicated_rows(half, read_study(half), like)
    rows = common_rows(replace(like, beside=other))
    return replace(like, beside=with_replicates(half, other, 1, rows))


@pytest.fixture(scope="module")
def many_beside(half, many_on_dem):
    return beside_half(half, many_on_dem)


def test_numbers_of_a_study_are_those_of_the_replicate_that_it_is(many_beside):
    frame = numbers_beside(many_beside).set_index(["where", "entry"])
    own = many_beside.beside.replicated.query("replicate == 2").set_index(["where", "entry"])["value"]
    assert set(frame.index) <= set(own.index)
    of_tables = frame[frame.index.get_level_values("where").isin(TABLES)]
    assert len(of_tables) > 20
    np.testing.assert_allclose(of_tables["value"], own[of_tables.index], rtol=1e-9)
    # Of three replicates, one is the study: it lies at one of three places.
    assert set(of_tables["percentile"].round()) <= {17.0, 25.0, 50.0, 75.0, 83.0}


def test_replicates_are_compared_in_the_same_rows_alone(half, many_on_dem, many_beside):
    of_all = with_replicates(half, read_study(half), 1).replicated.set_index(["where", "entry", "replicate"])[
        "value"
    ]
    of_some = many_beside.beside.replicated.set_index(["where", "entry", "replicate"])
    key = ("Table 3", "DENS", 2)
    assert of_some.loc[key, "value"] != of_all[key]
    alone = replicate_study(many_on_dem, made_up(many_on_dem, 2)).only(set(many_on_dem.calibrations["row"]))
    assert of_some.loc[key, "value"] == pytest.approx(
        table3(alone).set_index("parameter")["correlation"]["DENS"]
    )


def test_one_more_replicate_lies_in_bands_of_n_as_often_as_is_said():
    rng = np.random.default_rng(4)
    inside = []
    for _ in range(3000):
        *values, one_more = rng.standard_normal(21)
        inside.append(among(one_more, pd.Series(values)))
    table = pd.DataFrame(inside)
    share = (table["inside"] == "yes").mean()
    assert expected(table) == pytest.approx(0.9 * 19 / 21)
    assert share == pytest.approx(expected(table), abs=4 * np.sqrt(0.15 / 3000))


def test_a_number_that_stands_in_two_places_counts_once(many_beside):
    frame = numbers_beside(many_beside)
    varied = frame[frame["low"] < frame["high"]]
    (said, *_) = numbers_beside_notes(many_beside)
    counted = int(re.match(r"\d+ of (\d+) different numbers", said)[1])
    assert counted == len(varied.drop_duplicates(["value", "median", "low", "high"])) < len(varied)


def test_a_number_that_no_replicate_has_is_seen(half, many_on_dem):
    calibrations = many_on_dem.calibrations.copy()
    calibrations["dem_DENS"] = 5000.0 - calibrations["dem_DENS"]
    study = beside_half(half, replace(many_on_dem, calibrations=calibrations))
    line = numbers_beside(study).set_index(["where", "entry"]).loc[("Table 3", "DENS")]
    assert line["value"] < 0 < line["low"] and (line["inside"], line["percentile"]) == ("no", 0.0)


def test_numbers_stand_beside_replicates_by_one_command(half, on_dem, tmp_path, capsys):
    only = "numbers_beside,numbers_beside_figure"
    command = ("analyse", str(on_dem), "--beside", str(half), "--only", only, "--out", str(tmp_path))
    assert main([*command, "--format", "csv,png"]) == 0
    frame = pd.read_csv(tmp_path / "tables" / "numbers_beside.csv")
    assert {"C03", "C17", "C19"} <= set(frame["where"]) and (frame["n"] <= COUNT).all()
    assert (tmp_path / "figures" / "numbers_beside_figure.png").stat().st_size > 10_000


# ---- the numbers of replicates as `analyse` wrote them, in place of the replicates ----------------------


def test_numbers_of_replicates_stand_for_the_replicates_of_a_whole_plan(half, numbers, all_on_dem):
    of_numbers = replace(all_on_dem, beside=read_entries(numbers, all_on_dem))
    of_replicates = beside_half(half, all_on_dem)
    pd.testing.assert_frame_equal(numbers_beside(of_numbers), numbers_beside(of_replicates))
    assert numbers_beside_notes(of_numbers) == numbers_beside_notes(of_replicates)


def test_bands_stand_beside_written_ones(half, numbers, tmp_path):
    for name, other in (("replicates", half), ("numbers", numbers)):
        command = ["analyse", str(half), "--only", "bands_beside", "--format", "csv", "--beside", str(other)]
        assert main([*command, "--out", str(tmp_path / name)]) == 0
    written = [tmp_path / name / "tables" / "bands_beside.csv" for name in ("replicates", "numbers")]
    assert written[0].read_text() == written[1].read_text()


def test_numbers_alone_do_not_say_what_some_rows_gave(numbers, many_on_dem, on_dem, capsys):
    with pytest.raises(InputError, match="for fewer rows name the study with the replicates themselves"):
        read_entries(numbers, many_on_dem)
    command = ["analyse", str(on_dem), "--beside", str(numbers), "--only"]
    assert main([*command, "rows_beside"]) == 2
    assert f"{numbers} has only their numbers" in capsys.readouterr().err
    assert main([*command, "numbers_beside"]) == 2
    assert "which are for all rows of the plan" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("replicates.parquet", lambda content: content[:-1], "is not the one that"),
        ("manifest.json", lambda content: content[:-9], "is damaged"),
        ("manifest.json", lambda content: b"{}", "is damaged"),
        ("manifest.json", None, "cannot be read: No such file"),
    ],
)
def test_numbers_that_are_not_what_was_written_are_refused(numbers, tmp_path, name, change, said):
    for path in (numbers / "replicates.parquet", numbers / "manifest.json"):
        shutil.copy(path, tmp_path)
    if change is None:
        (tmp_path / name).unlink()
    else:
        (tmp_path / name).write_bytes(change((tmp_path / name).read_bytes()))
    with pytest.raises(StoreError, match=said):
        read_entries(tmp_path)
