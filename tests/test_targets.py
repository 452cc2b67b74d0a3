import csv
import math
from dataclasses import replace

import numpy as np
import pytest

from calstudy.cli.options.choices import parse_target
from calstudy.errors import InputError, RunError, SetupError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, REFERENCE
from calstudy.models.targets import repeated_runs, twin_columns, write_twin
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Run

PLAN = load_plan()
MODEL = load_model(PLAN.fixed, "coarse")
ENGINE = "LIGGGHTS 3.8.0"
COMMAND = "calstudy twin --fidelity coarse --out twins.csv"


def a_run(angle, density, outcome=Outcome.OK):
    responses = {ANGLE_OF_REPOSE: angle, BULK_DENSITY: density, RAYLEIGH_TIME_STEP: 3e-5}
    return Run(outcome, "", responses, wall_time=1.0, cpu_time=1.0)


FOUND = repeated_runs([a_run(28.0, 1500.1), a_run(29.0, 1502.0)], MEASURED)


def refusal(text, model=MODEL, engine=ENGINE):
    with pytest.raises(InputError) as caught:
        parse_target(text, PLAN, model, engine)
    message = str(caught.value)
    assert message.startswith("--target ")
    assert "\n" not in message
    return message


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "twins.csv"
    write_twin(path, MODEL, ENGINE, REFERENCE, FOUND, COMMAND)
    return path


def lines_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


# ---- paper and set ------------------------------------------------------------------------------------


def test_the_papers_target():
    target = parse_target("paper", PLAN, MODEL, ENGINE)
    assert target.values == {ANGLE_OF_REPOSE: 22.0, BULK_DENSITY: 1500.0}
    assert target.kind == "paper"
    assert target.truth is None
    assert "the paper's 22 deg and 1500 kg/m3" in target.origin


@pytest.mark.parametrize(
    "text",
    [
        "angle_of_repose_deg=25.5,bulk_density=1480",
        "bulk_density=1480,angle_of_repose_deg=25.5",
        " bulk_density = 1480 , angle_of_repose_deg = 2.55e1 ",
    ],
)
def test_a_target_set_by_hand(text):
    target = parse_target(text, PLAN, MODEL, ENGINE)
    assert target.values == {ANGLE_OF_REPOSE: 25.5, BULK_DENSITY: 1480.0}
    assert tuple(target.values) == MEASURED
    assert target.kind == "set"
    assert target.truth is None
    assert "set by hand: 25.5 deg and 1480 kg/m3" in target.origin


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is not response=number"),
        ("papers", "is not response=number"),
        ("angle_of_repose_deg", "'angle_of_repose_deg' is not response=number"),
        ("angle_of_repose_deg=x,bulk_density=1500", "angle_of_repose_deg: 'x' is not a finite number"),
        ("angle_of_repose_deg=22,bulk_density=", "bulk_density: '' is not a finite number"),
        ("angle_of_repose_deg=22", "give exactly angle_of_repose_deg and bulk_density"),
        ("angle_of_repose_deg=22,density=1500", "no response density; did you mean bulk_density?"),
        (
            "angle_of_repose_deg=22,bulk_density=1500,rayleigh_time_step=3e-5",
            "no response rayleigh_time_step",
        ),
        ("angle_of_repose_deg=22,5,bulk_density=1500", "decimals have a point, not a comma"),
        ("angle_of_repose_deg=22,bulk_density=1500,bulk_density=1400", "each once"),
        ("angle_of_repose_deg=0,bulk_density=1500", "angle_of_repose_deg must be a positive number"),
        ("angle_of_repose_deg=22,bulk_density=-1", "bulk_density must be a positive number"),
        ("angle_of_repose_deg=nan,bulk_density=1500", "'nan' is not a finite number"),
        ("angle_of_repose_deg=22,bulk_density=inf", "'inf' is not a finite number"),
    ],
)
def test_a_target_that_is_none_is_refused_in_one_line(text, words):
    assert words in refusal(text)


# ---- twins --------------------------------------------------------------------------------------------


def test_a_twin_is_read_with_all_digits_and_its_truth(table):
    target = parse_target(f"twin:{table}", PLAN, MODEL, ENGINE)
    assert target.values == FOUND.mean
    assert target.truth == REFERENCE
    assert target.kind == "twin"
    assert "twin: mean of 2 runs" in target.origin
    assert "known parameters" in target.origin


@pytest.mark.parametrize(
    "model",
    [
        load_model(PLAN.fixed, "tiny"),
        load_model(PLAN.fixed, "coarse", "wide"),
        replace(MODEL, scripts={name: text + "# later version\n" for name, text in MODEL.scripts.items()}),
    ],
    ids=["fidelity", "variant", "version"],
)
def test_a_twin_of_another_model_is_refused_with_the_command_that_makes_it(table, model):
    message = refusal(f"twin:{table}", model)
    wanted = f"calstudy twin --fidelity {model.fidelity.name} --variant {model.variant.name} --out FILE"
    assert wanted in message
    assert "twin:FILE" in message


def test_a_twin_of_another_engine_is_refused(table):
    assert "with LIGGGHTS 3.7.0" in refusal(f"twin:{table}", engine="LIGGGHTS 3.7.0")


def test_a_table_that_is_not_there_is_refused_with_the_command_that_makes_it(tmp_path):
    message = refusal(f"twin:{tmp_path}/no.csv")
    assert f"{tmp_path}/no.csv: cannot be read (No such file or directory)" in message
    assert "calstudy twin --out FILE" in message


@pytest.mark.parametrize("cell", ["", "much", "nan", "inf"])
@pytest.mark.parametrize("column", [BULK_DENSITY, "MU_PP"])
def test_a_damaged_twin_is_refused(table, column, cell):
    lines = lines_of(table)
    with table.open("w") as file:
        writer = csv.DictWriter(file, twin_columns(tuple(REFERENCE), MEASURED), lineterminator="\n")
        writer.writeheader()
        writer.writerow({**lines[0], column: cell})
    assert "make it anew with 'calstudy twin'" in refusal(f"twin:{table}")


def test_the_reference_point_lies_inside_the_box_and_on_every_constant():
    for parameter in PLAN.parameters:
        value = REFERENCE[parameter.name]
        assert parameter.lower < value < parameter.upper
        assert parameter.constant in (None, value)
    assert len(REFERENCE) == len(PLAN.parameters)


def test_writing_a_twin_again_replaces_it_and_keeps_the_others(table):
    tiny = load_model(PLAN.fixed, "tiny")
    wide = load_model(PLAN.fixed, "coarse", "wide")
    for model in (tiny, wide):
        write_twin(table, model, ENGINE, REFERENCE, FOUND, COMMAND)
    before = {(line["fidelity"], line["variant"]): line for line in lines_of(table)}
    assert set(before) == {("coarse", "ring"), ("coarse", "wide"), ("tiny", "ring")}

    later = repeated_runs([a_run(25.0, 1490.0), a_run(26.0, 1491.0), a_run(27.0, 1492.0)], MEASURED)
    newer = replace(MODEL, deck=MODEL.deck + 1)
    write_twin(table, newer, ENGINE, {**REFERENCE, "MU_PP": 0.15}, later, COMMAND)
    after = {(line["fidelity"], line["variant"]): line for line in lines_of(table)}
    assert len(lines_of(table)) == 3
    assert {key for key in after if after[key] != before[key]} == {("coarse", "ring")}
    assert after["coarse", "ring"]["replicates"] == "3"
    assert after["coarse", "ring"]["model_hash"] == newer.hash
    assert parse_target(f"twin:{table}", PLAN, newer, ENGINE).values[ANGLE_OF_REPOSE] == 26.0
    assert parse_target(f"twin:{table}", PLAN, tiny, ENGINE).values == FOUND.mean
    refusal(f"twin:{table}", MODEL)


def test_writing_the_same_twin_twice_changes_nothing(table):
    before = table.read_bytes()
    write_twin(table, MODEL, ENGINE, REFERENCE, FOUND, COMMAND)
    assert table.read_bytes() == before


def test_the_order_of_writing_does_not_matter(tmp_path):
    models = [load_model(PLAN.fixed, f, v) for f in ("tiny", "coarse") for v in ("wide", "ring")]
    for name, order in (("a", models), ("b", models[::-1])):
        for model in order:
            write_twin(tmp_path / name, model, ENGINE, REFERENCE, FOUND, COMMAND)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_command_that_made_it_is_stored(table):
    assert lines_of(table)[0]["command"] == COMMAND


@pytest.mark.parametrize(
    "text",
    ["", "notes\nof somebody\n", ",".join(twin_columns(tuple(REFERENCE), MEASURED)) + "\ncoarse,ring\n"],
)
def test_a_file_that_is_no_table_of_twins_is_refused_and_left_alone(tmp_path, text):
    path = tmp_path / "notes.md"
    path.write_text(text)
    with pytest.raises(InputError, match=r"is no table of twins; choose another --out"):
        write_twin(path, MODEL, ENGINE, REFERENCE, FOUND, COMMAND)
    assert path.read_text() == text


def test_a_place_that_cannot_be_written_is_a_matter_of_set_up(tmp_path):
    with pytest.raises(SetupError, match="cannot be written"):
        write_twin(tmp_path / "no" / "twins.csv", MODEL, ENGINE, REFERENCE, FOUND, COMMAND)


def test_without_a_usable_run_there_is_no_twin(tmp_path):
    nothing = repeated_runs([a_run(math.nan, 1500.0, Outcome.NO_HEAP)], MEASURED)
    with pytest.raises(RunError, match="there is no twin"):
        write_twin(tmp_path / "twins.csv", MODEL, ENGINE, REFERENCE, nothing, COMMAND)
    assert list(tmp_path.iterdir()) == []


# ---- replicates ---------------------------------------------------------------------------------------


def test_replicates_give_mean_and_standard_deviation():
    found = repeated_runs([a_run(20.0, 1500.0), a_run(22.0, 1500.0), a_run(27.0, 1503.0)], MEASURED)
    assert found.mean == pytest.approx({ANGLE_OF_REPOSE: 23.0, BULK_DENSITY: 1501.0})
    # Squares of the deviations: 9 + 1 + 16 = 26 and 1 + 1 + 4 = 6, over n - 1 = 2.
    assert found.sd == pytest.approx({ANGLE_OF_REPOSE: math.sqrt(13), BULK_DENSITY: math.sqrt(3)})
    assert (found.used, found.failed) == (3, 0)


@pytest.mark.parametrize("outcome", [o for o in Outcome if o is not Outcome.OK])
def test_runs_that_gave_no_response_are_counted_and_left_out(outcome):
    good = [a_run(20.0, 1500.0), a_run(22.0, 1504.0)]
    found = repeated_runs([good[0], a_run(math.nan, 1.0, outcome), good[1]], MEASURED)
    assert (found.mean, found.sd) == (repeated_runs(good, MEASURED).mean, repeated_runs(good, MEASURED).sd)
    assert (found.used, found.failed) == (2, 1)


def test_one_run_has_no_standard_deviation():
    found = repeated_runs([a_run(20.0, 1500.0)], MEASURED)
    assert found.mean == {ANGLE_OF_REPOSE: 20.0, BULK_DENSITY: 1500.0}
    assert np.isnan(list(found.sd.values())).all()


def test_no_run_has_no_mean():
    found = repeated_runs([], MEASURED)
    assert np.isnan([*found.mean.values(), *found.sd.values()]).all()
    assert (found.used, found.failed) == (0, 0)


@pytest.mark.parametrize("fidelity", ["coarse", "soft", "tiny"])
def test_the_shipped_twins_are_of_the_shipped_models(fidelity):
    target = parse_target("twin", PLAN, load_model(PLAN.fixed, fidelity), ENGINE)
    assert target.truth == REFERENCE
    assert 20 < target.values[ANGLE_OF_REPOSE] < 35
    assert 1400 < target.values[BULK_DENSITY] < 1600
