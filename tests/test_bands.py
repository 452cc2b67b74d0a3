"""Bands over replicates: their arithmetic, and what ``analyse`` makes of a study that has some."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.analysis import (
    bands,
    bands_beside,
    bands_claims,
    half_fraction,
    table3,
    table4,
    table5,
    table6,
)
from calstudy.analysis.contents import Of, names
from calstudy.analysis.ledger.before import BEFORE
from calstudy.analysis.ledger.claims import claims, requirements
from calstudy.analysis.replicates.bands_figure import bands_figure
from calstudy.analysis.replicates.bands_figure import notes as notes_on_figure
from calstudy.analysis.replicates.entries import (
    ALL_ROWS,
    CHANGED,
    GIVEN_OTHERS,
    TABLES,
    entries,
    half_of,
    value_of,
)
from calstudy.analysis.statistics.estimates import Estimate, band, percentile
from calstudy.analysis.statistics.verdicts import Requirement, exact
from calstudy.cli.main import main
from calstudy.plan import FULL_FACTORIAL
from calstudy.plan_file import load_plan
from calstudy.report.replicated import replicate_study, with_replicates
from calstudy.study.reading import read_study
from calstudy.study.schema import REPLICATED as FILES
from closed_form import PLAN, run_study
from made_up_replicates import COUNT, ENGINE, made_up, study_with

pytestmark = pytest.mark.slow

FULL = load_plan(FULL_FACTORIAL)
values = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30)


# ---- arithmetic ----------------------------------------------------------------------------------------


@given(values)
def test_a_band_is_ordered_and_inside_the_values(x):
    b = band(x)
    assert min(x) <= b.low <= b.median <= b.high <= max(x)
    assert (b.n, b.undefined) == (len(x), 0)


def test_a_band_holds_nine_tenths_of_the_replicates():
    b = band(np.arange(101.0))
    assert (b.low, b.median, b.high, b.width) == (5.0, 50.0, 95.0, 90.0)


def test_what_is_undefined_is_counted_and_moves_no_band():
    b = band([1.0, np.nan, 3.0, np.nan, np.nan])
    assert (b.median, b.n, b.undefined) == (2.0, 2, 3)
    nothing = band([np.nan, np.nan])
    assert np.isnan(nothing.median) and (nothing.n, nothing.undefined) == (0, 2)


def test_the_percentile_is_the_share_below_with_equals_half():
    x = [1.0, 2.0, 2.0, 3.0, np.nan]
    assert [percentile(v, x) for v in (0.0, 1.0, 2.0, 2.5, 9.0)] == [0.0, 12.5, 50.0, 75.0, 100.0]
    assert np.isnan(percentile(1.0, [np.nan])) and np.isnan(percentile(np.nan, x))


# ---- a study with replicates ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    return study_with(tmp_path_factory.mktemp("half") / "study", PLAN)


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    return study_with(tmp_path_factory.mktemp("full") / "study", FULL)


@pytest.fixture(scope="module")
def study(half):
    return with_replicates(half, read_study(half), 1)


@pytest.fixture(scope="module")
def whole(full):
    return with_replicates(full, read_study(full), 1)


def replicate(study, number):
    return replicate_study(study, made_up(study, number))


def test_entries_are_the_numbers_of_the_tables_and_the_ledger(study):
    one = replicate(study, 2)
    found = entries(one).set_index(["where", "entry"])
    assert found.index.is_unique
    assert (
        found.loc[("Table 3", "MU_PP"), "value"]
        == table3(one).set_index("parameter").loc["MU_PP", "correlation"]
    )
    over_all = table6(one).set_index("pair").loc["MU_PP:RF_PP", "correlation_all_rows"]
    assert found.loc[("Table 6", ALL_ROWS.format("MU_PP:RF_PP")), "value"] == over_all
    assert found.loc[("Table 4", "bulk density"), "value"] == table4(one)["correlation"][1]
    p = table5(one).query("data == 'DEM'").set_index("term").loc["DENS:YM", ["p", "p_published"]]
    assert list(found.loc[("Table 5", "DEM: DENS:YM"), ["value", "published"]]) == list(p)
    given = table5(one).query("data == 'Kriging'").set_index("term").loc["MU_PW", "p_given_all_others"]
    assert found.loc[(GIVEN_OTHERS, "Kriging: MU_PW"), "value"] == given
    assert found.loc[GIVEN_OTHERS, "published"].isna().all()
    assert len(found.loc[list(TABLES)]) == 2 * 6 + 3 + 4 * 21 + 2 * 6
    ledger = claims(one).set_index("claim")
    verdicts = found[~found.index.get_level_values("where").isin(TABLES)]["verdict"].groupby("where").first()
    # A claim whose rule was changed is there by the rule before, too, under its own number.
    changed = ledger[ledger["verdict_before"] != ""]
    assert len(changed) == 11
    assert verdicts.to_dict() == {
        **ledger["verdict"],
        **changed["verdict_before"],
        **changed["verdict"].rename(CHANGED.format),
    }
    low, high = found.loc[("Table 3", "MU_PP"), ["low", "high"]]
    assert low < found.loc[("Table 3", "MU_PP"), "value"] < high
    assert found.loc[("C17", "mean"), "published"] == 51.0


def test_a_value_is_what_a_reader_without_intervals_compares():
    assert value_of(Requirement("x", Estimate(0.4, 0.1, 0.7, 9), 0.0, 0.5)) == 0.4
    assert value_of(Requirement("an end", Estimate(-0.4, 0.1, 0.1, 9), 0.0)) == 0.1
    assert value_of(Requirement("counted", exact(3.0, 9))) == 3.0


def p_values_of(study):
    """Entries of Table 5 of each replicate."""
    lines = study.replicated[study.replicated["where"] == "Table 5"]
    return [of.set_index("entry") for _, of in lines.groupby("replicate")]


def test_bands_are_those_of_the_replicates_own_tables(study):
    frame = bands(study).set_index(["where", "entry"])
    each = [table3(replicate(study, n)).set_index("parameter")["correlation"] for n in range(2, COUNT + 1)]
    line = frame.loc[("Table 3", "MU_PW")]
    b = band([of["MU_PW"] for of in each])
    assert (line["median"], line["low"], line["high"]) == pytest.approx((b.median, b.low, b.high))
    assert (line["n"], line["undefined"]) == (COUNT - 1, 1), "constant in the first replicate"
    assert frame.loc[("Table 3", "DENS"), ["n", "undefined"]].tolist() == [COUNT, 0]
    assert line["published"] == table3(study).set_index("parameter").loc["MU_PW", "published"]
    dem = frame.loc[("Table 5", "DEM: DENS")]
    p = [of.loc["DEM: DENS", "value"] for of in p_values_of(study)]
    assert dem["significant"] == np.mean([value < 0.05 for value in p])
    assert dem["median"] == np.median(p)


def test_a_statement_is_made_as_often_as_the_replicates_make_it(study):
    frame = bands_claims(study)
    shares = frame.dropna(subset="holds").set_index("where")
    claimed = (f"C{k:02d}" for k in range(1, 24))
    # One whose rule was changed is there by either rule.
    assert list(shares.index) == [
        where for c in claimed for where in ([c, CHANGED.format(c)] if c in BEFORE else [c])
    ]
    np.testing.assert_allclose(shares[["holds", "open", "fails"]].sum(axis=1), 1.0)
    # C19 is on the plan alone; C20 asks for DEM runs, of which an emulator has none.
    assert shares.loc["C19", "holds"] == shares.loc["C19", "met"] == 1.0
    means = [replicate(study, n).ok["runs_total"].mean() for n in range(1, COUNT + 1)]
    assert shares.loc["C17", "met"] == np.mean([45.9 <= mean <= 56.1 for mean in means])
    assert shares.loc["C17", ["median", "n"]].tolist() == pytest.approx([np.median(means), COUNT])


def test_an_emulator_says_nothing_of_the_cost_of_dem_runs(study):
    settings = replace(study.settings, engine=f"{ENGINE}, draw 3", fidelity="full")
    one = replace(replicate(study, 2), settings=settings)
    assert all(
        np.isnan(r.figure.value) and "no DEM model" in r.figure.why_not for r in requirements(one)["C20"]
    )


# ---- the full factorial ----------------------------------------------------------------------------------


def test_the_papers_half_of_a_full_factorial_is_the_study_of_its_rows(whole):
    one = replicate(whole, 3)
    half = half_of(one)
    assert half.plan == PLAN and half.planned == 72 and set(half.calibrations["row"]) == set(range(1, 73))
    assert set(half.evaluations["row"]) == set(range(1, 73))
    assert list(table3(half)["n"]) == [72, 36, 36, 72, 36, 36]
    assert list(table3(one)["n"]) == [144, 72, 72, 144, 72, 72]
    assert set(table5(one)["n"]) == {144} and (table5(one)["why_not"] == "").all()


def test_both_halves_stand_beside_one(whole):
    frame = half_fraction(whole).set_index(["where", "entry"])
    half = bands(replace(whole, plan=PLAN)).set_index(["where", "entry"])
    all_rows = bands(whole).set_index(["where", "entry"])
    for entry in (("Table 3", "RF_PP"), ("Table 5", "DEM: DENS"), ("Table 6", "RF_PP:RF_PW")):
        line = frame.loc[entry]
        assert line["median_half"] == half.loc[entry, "median"] != all_rows.loc[entry, "median"]
        assert line["median_full"] == all_rows.loc[entry, "median"]
        if entry[0] == "Table 5":  # the width of a p-value's band says nothing
            assert np.isnan(line["width_ratio"])
            continue
        width = half.loc[entry, "high"] - half.loc[entry, "low"]
        ratio = (all_rows.loc[entry, "high"] - all_rows.loc[entry, "low"]) / width
        assert line["width_ratio"] == pytest.approx(ratio)
    assert frame.loc[("C19", "values alone hold"), ["share_half", "share_full"]].tolist() == [1.0, 0.0]


def test_without_bands_the_figure_says_so(study):
    for replicated in (None, study.replicated.assign(value=np.nan), study.replicated.iloc[:0]):
        without = replace(study, replicated=replicated)
        (said,) = (text.get_text() for text in bands_figure(without).texts)
        assert said.startswith("Nothing to draw: "), replicated
    assert notes_on_figure(replace(study, replicated=None))


# ---- the command -----------------------------------------------------------------------------------------


def test_analyse_makes_everything_of_replicates_in_one_command(full, tmp_path, capsys):
    out = tmp_path / "out"
    only = ",".join([*names(Of.REPLICATES, Of.HALVES), "claims"])
    assert main(["analyse", str(full), "--only", only, "--out", str(out), "--json"]) == 0
    manifest = json.loads(capsys.readouterr().out)
    made = {p.relative_to(out).as_posix() for p in out.rglob("*.*")}
    tables = {
        f"tables/{n}.{f}"
        for n in ("bands", "bands_claims", "coverage", "half_fraction", "claims")
        for f in ("csv", "tex")
    }
    assert made == tables | {
        "figures/bands_figure.png",
        "figures/bands_figure.svg",
        "report.html",
        "manifest.json",
        "replicates.parquet",
    }
    assert "replicates.parquet" in manifest["files"]
    assert {f"{name}/r-{n:03d}.parquet" for name in FILES for n in range(1, COUNT + 1)} <= set(
        manifest["data"]
    )
    page = (out / "report.html").read_text()
    assert f"{COUNT} replicates of 144 of the plan" in page
    assert f"on its own draw of {ENGINE}" in page


def test_the_numbers_of_every_replicate_are_written_with_what_was_made_of_them(half, study, tmp_path):
    assert main(["analyse", str(half), "--only", "bands", "--format", "csv", "--out", str(tmp_path)]) == 0
    numbers = pd.read_parquet(tmp_path / "replicates.parquet")
    pd.testing.assert_frame_equal(numbers.convert_dtypes(), study.replicated.convert_dtypes())
    again = bands(replace(study, replicated=numbers))
    written = pd.read_csv(tmp_path / "tables" / "bands.csv")
    assert again["median"].to_numpy(float) == pytest.approx(written["median"].to_numpy(float), nan_ok=True)


def test_without_names_a_report_has_the_bands_where_there_are_replicates(half, tmp_path, capsys):
    assert main(["analyse", str(half), "--format", "csv", "--out", str(tmp_path / "out")]) == 0
    made = {path.stem for path in (tmp_path / "out" / "tables").iterdir()}
    assert {"bands", "bands_claims", "table3"} <= made and "half_fraction" not in made
    capsys.readouterr()
    assert main(["analyse", str(half), "--only", "half_fraction"]) == 2
    assert "--plan full-factorial" in capsys.readouterr().err


def test_a_number_whose_bands_have_nothing_in_common_is_told(study):
    shifted = study.replicated.copy()
    strong = (shifted["where"] == "Table 6") & (shifted["entry"] == "MU_PP:RF_PP")
    shifted.loc[strong, "value"] = -0.9 + 0.01 * np.arange(strong.sum())
    frame = bands_beside(replace(study, beside=replace(study, replicated=shifted)))
    frame = frame.set_index(["where", "entry"])
    assert frame.index[frame["apart"] == "apart"].tolist() == [("Table 6", "MU_PP:RF_PP")]
    line = frame.loc[("Table 6", "MU_PP:RF_PP")]
    assert line["high_beside"] < line["low_here"] and line["median_beside"] == pytest.approx(-0.89)
    assert (
        frame.loc[("C17", "values alone hold"), "share_here"]
        == frame.loc[("C17", "values alone hold"), "share_beside"]
    )


def test_two_studies_stand_beside_each_other(half, full, tmp_path, capsys):
    arguments = ["analyse", str(half), "--only", "bands_beside", "--format", "csv", "--out", str(tmp_path)]
    assert main([*arguments, "--beside", str(full)]) == 0
    frame = pd.read_csv(tmp_path / "tables" / "bands_beside.csv")
    assert set(frame["apart"].dropna()) <= {"apart", "overlapping"} and len(frame) == 111 + 23 + len(BEFORE)
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    assert manifest["beside"]["study"] == read_study(full).settings.id != manifest["study"]
    capsys.readouterr()
    assert main(arguments) == 2
    assert "name the second one with --beside" in capsys.readouterr().err


def test_without_replicates_there_are_no_bands(tmp_path, capsys):
    run_study(tmp_path / "study", (1,))
    assert main(["analyse", str(tmp_path / "study"), "--format", "csv"]) == 0
    assert not (tmp_path / "study" / "analysis" / "tables" / "bands.csv").exists()
    capsys.readouterr()
    assert main(["analyse", str(tmp_path / "study"), "--only", "bands,table3"]) == 2
    assert "--only: bands is made from replicates" in capsys.readouterr().err
    assert main(["analyse", str(tmp_path / "study"), "--beside", str(tmp_path / "study")]) == 2
    assert "has none; name a study with some" in capsys.readouterr().err


def test_further_processes_change_nothing(half, study, monkeypatch):
    monkeypatch.setattr("calstudy.report.replicated.MANY", 2)
    again = with_replicates(half, read_study(half), 2)
    pd.testing.assert_frame_equal(again.replicated, study.replicated)
