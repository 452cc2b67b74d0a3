import csv
import io
import itertools
import json
from dataclasses import FrozenInstanceError, replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calstudy.calibration.modes import MODES
from calstudy.calibration.task import tasks_of
from calstudy.cli.options.choices import parse_rows_option
from calstudy.errors import InputError
from calstudy.plan import FACTORS, FULL_FACTORIAL, HEADER, PARAMETERS
from calstudy.plan_check import check, word_length_pattern
from calstudy.plan_export import export
from calstudy.plan_file import load_plan, read_plan
from calstudy.records import Target
from calstudy.study.directory.store import read_table
from calstudy.study.reading import read_study
from closed_form import run_study

PLAN = load_plan()
TEXT = Path(PLAN.origin).read_text(encoding="utf-8")
TABLE = [line.split(",") for line in TEXT.splitlines()]
LEVELS = {factor.name: factor.levels for factor in PLAN.factors}
CELLS = np.array([row.levels for row in PLAN.rows])
TOML = Path(PLAN.origin).with_suffix(".toml").read_text(encoding="utf-8")

law = settings(max_examples=30, deadline=None)  # a busy machine breaks no law
columns = st.integers(1, len(FACTORS))
lines = st.integers(1, len(PLAN.rows))


def with_cell(line, column, cell):
    table = [list(cells) for cells in TABLE]
    table[line][column] = cell
    sink = io.StringIO(newline="")
    csv.writer(sink).writerows(table)
    return sink.getvalue()


def without_lines(*numbers):
    return "".join(line for k, line in enumerate(TEXT.splitlines(keepends=True)) if k not in numbers)


@pytest.fixture(scope="module")
def refusal(tmp_path_factory):
    file = tmp_path_factory.mktemp("plan") / "plan.csv"

    def of(content):
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
        with pytest.raises(InputError) as caught:
            check(load_plan(file), PLAN).refuse_if_wrong()
        message = str(caught.value)
        assert len(message.splitlines()) == 1
        assert message.startswith(f"{file}: ")
        return message.removeprefix(f"{file}: ")

    return of


# What the paper says


def test_the_published_plan_passes_every_check():
    result = check(PLAN)
    assert result.ok, [finding for finding in result.findings if not finding.ok]
    result.refuse_if_wrong()


def test_word_lengths_are_the_published_ones():
    pattern = word_length_pattern(CELLS, list(LEVELS.values()))
    assert [f"{abs(a):.2f}" for a in pattern[2:5]] == ["0.00", "0.27", "0.49"]
    # Exact values: products of contrasts over 72 rows of 2- and 3-level factors are 81sts.
    np.testing.assert_allclose(pattern, np.array([0, 0, 0, 22, 40, 19]) / 81, atol=1e-12)
    np.testing.assert_array_equal(check(PLAN).word_lengths, pattern)


def test_samples_follow_equation_11_and_add_up_to_1728():
    by_hand = [(sum(map(int, cells[3:])) + 2) * int(cells[2]) for cells in TABLE[1:]]
    assert [row.samples for row in PLAN.rows] == by_hand
    assert check(PLAN).samples == tuple(by_hand)
    assert PLAN.total_samples == 1728


def test_every_pair_and_triple_of_factors_is_balanced():
    for size, share in ((1, 72), (2, 72), (3, 72)):
        for chosen in itertools.combinations(range(6), size):
            _, counts = np.unique(CELLS[:, chosen], axis=0, return_counts=True)
            combinations = np.prod([len(LEVELS[FACTORS[j]]) for j in chosen])
            assert counts.tolist() == [share / combinations] * combinations


def test_intervals_and_constants_are_those_of_table_2():
    assert [(p.name, p.lower, p.upper, p.constant) for p in PLAN.parameters] == [
        ("DENS", 2400, 2600, None),
        ("MU_PP", 0.1, 0.3, 0.2),
        ("MU_PW", 0.1, 0.3, 0.2),
        ("RF_PP", 0.001, 0.1, None),
        ("RF_PW", 0.001, 0.1, 0.01),
        ("YM", 4.175e8, 6.5e8, 5.06e8),
    ]


def test_fixed_inputs_and_targets_are_those_of_table_1_and_section_2_2():
    fixed = PLAN.fixed
    assert (fixed.poissons_ratio, fixed.restitution_pp, fixed.restitution_pw) == (0.22, 0.89, 0.60)
    assert (fixed.rolling_viscous_damping_pp, fixed.rolling_viscous_damping_pw) == (0.25, 0.25)
    assert (fixed.gravity, fixed.particle_radius) == (9.81, 0.0025)
    assert PLAN.targets == {"angle_of_repose_deg": 22, "bulk_density": 1500}


def test_a_row_calibrates_its_switches_and_always_density_and_rolling_friction():
    assert PLAN.row(1).calibrated == ("DENS", "RF_PP")
    assert PLAN.row(4).calibrated == ("DENS", "MU_PW", "RF_PP", "RF_PW", "YM")
    space = PLAN.space(PLAN.row(2))
    assert space.box.names == ("DENS", "MU_PP", "RF_PP", "RF_PW")
    assert space.complete(space.box.centre)["MU_PW"] == 0.2


# Identity


def test_identity_of_the_plan_is_golden():
    # Printed by `load_plan().hash` when the files were first checked against the paper.
    assert PLAN.hash == "589554dcd3e581fd5bc3db18cd820c422eeb193c4e8afe4d370d9385f0375d9a"


def test_identity_ignores_number_types_words_and_order_in_the_file(tmp_path):
    integers = replace(
        PLAN, rows=tuple(replace(r, WRL=int(r.WRL) if r.WRL != 0.5 else 0.5) for r in PLAN.rows)
    )
    assert integers.hash == PLAN.hash
    assert replace(PLAN, source=replace(PLAN.source, citation="")).hash == PLAN.hash
    shuffled = tmp_path / "shuffled.csv"
    shuffled.write_text("\n".join([TEXT.splitlines()[0], *reversed(TEXT.splitlines()[1:])]), encoding="utf-8")
    assert load_plan(shuffled) == PLAN
    assert load_plan(shuffled).hash == PLAN.hash


@law
@given(lines, st.data())
def test_identity_changes_with_any_cell(line, data):
    name = data.draw(st.sampled_from(FACTORS))
    level = data.draw(
        st.sampled_from(LEVELS[name]).filter(lambda x: x != float(TABLE[line][HEADER.index(name)]))
    )
    rows = tuple(replace(r, **{name: level}) if r.run == line else r for r in PLAN.rows)
    assert replace(PLAN, rows=rows).hash != PLAN.hash


def test_identity_changes_with_targets_fixed_inputs_and_parameters():
    others = [
        replace(PLAN, targets=PLAN.targets | {"bulk_density": 1501.0}),
        replace(PLAN, fixed=replace(PLAN.fixed, gravity=9.8)),
        replace(PLAN, parameters=(replace(PLAN.parameters[0], lower=2300.0), *PLAN.parameters[1:])),
    ]
    assert len({plan.hash for plan in (PLAN, *others)}) == 4


def test_a_plan_cannot_be_changed_in_place():
    with pytest.raises(FrozenInstanceError):
        PLAN.rows[0].SPP = 9


# Negative controls: a plan that is wrong is refused, by row and column


@pytest.mark.slow
@pytest.mark.parametrize("name", FACTORS)
def test_every_single_cell_at_another_level_is_found(name):
    for row in PLAN.rows:
        for level in set(LEVELS[name]) - {getattr(row, name)}:
            rows = tuple(replace(r, **{name: level}) if r is row else r for r in PLAN.rows)
            result = check(replace(PLAN, rows=rows), PLAN)
            with pytest.raises(InputError, match=f": row {row.run}, column {name} has {level:g} where"):
                result.refuse_if_wrong()
            assert {"cells", "balance", "pairs", "triples"} <= {f.name for f in result.findings if not f.ok}


@law
@given(lines, columns, st.data())
def test_a_file_with_a_cell_at_another_level_is_refused(refusal, line, column, data):
    name = HEADER[column]
    others = [f"{level:g}" for level in LEVELS[name] if f"{level:g}" != TABLE[line][column]]
    message = refusal(with_cell(line, column, data.draw(st.sampled_from(others))))
    assert message.startswith(f"row {line}, column {name} has ")
    assert "Table B-1" in message


def is_a_level(cell):
    try:
        return float(cell) in {level for levels in LEVELS.values() for level in levels}
    except ValueError:
        return False


cells_that_are_no_level = st.one_of(
    st.text(
        st.characters(exclude_categories=("C", "Zl", "Zp"))
    ),  # control characters are refused by their line
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from(["", " ", "O", "1_0", "½", "1\n"]),
).filter(lambda cell: not is_a_level(cell))


@pytest.mark.slow
@law
@given(lines, columns, cells_that_are_no_level)
def test_a_cell_that_is_no_level_is_refused(refusal, line, column, cell):
    message = refusal(with_cell(line, column, cell))
    assert message.startswith(f"row {line} (line ")
    assert f"column {HEADER[column]}: " in message
    assert f"use {', '.join(f'{level:g}' for level in LEVELS[HEADER[column]])}" in message


@pytest.mark.parametrize("cell", ["", "a", "1.5", "-1", "0", "73", "9" * 5000, "1e1"])
def test_a_run_number_that_is_none_is_refused(refusal, cell):
    message = refusal(with_cell(17, 0, cell))
    assert "line 18" in message
    assert "column run: " in message


@law
@given(lines)
def test_a_missing_row_is_refused(refusal, line):
    assert refusal(without_lines(line)).startswith(f"row {line}, column run: missing;")


def test_several_missing_rows_are_counted(refusal):
    assert refusal(without_lines(3, 4, 72)).startswith("row 3, column run: missing, like 2 more;")


@law
@given(lines)
def test_a_row_that_is_there_twice_is_refused(refusal, line):
    message = refusal(TEXT + TEXT.splitlines()[line])
    assert message.startswith(f"row {line}, column run: stands at lines {line + 1} and 74;")


def test_a_run_number_given_to_two_rows_is_refused(refusal):
    message = refusal(with_cell(5, 0, "6"))
    assert message.startswith(
        "row 6, column run: stands at lines 6 and 7; row 5, column run: missing; every run number"
    )


def test_a_row_with_the_levels_of_another_is_refused(refusal):
    copied = TEXT.replace("\n9,0.5,3,1,0,1,1\n", "\n9,0,3,0,0,0,0\n")
    message = refusal(copied)
    assert message.startswith("row 9, column WRL has 0 where Table B-1 has 0.5, which makes it repeat row 1;")
    assert "distinct rows" in message


def test_a_row_too_many_is_refused(refusal):
    assert refusal(TEXT + "73,0,3,0,0,0,0\n").startswith("row 73 (line 74), column run: ")


@pytest.mark.parametrize(
    ("header", "named"),
    [
        ("run,WRL,SPP,MU_PP,MU_PW,RF_PW,YM", "column YM has 'RF_PW'"),
        ("no.,WRL,SPP,MU_PP,MU_PW,YM,RF_PW", "column run has 'no.'"),
        ("run,WRL,SPP,MU_PP,MU_PW,YM", "column RF_PW is missing"),
        ("run,WRL,SPP,MU_PP,MU_PW,YM,RF_PW,DENS", "column 8 has 'DENS'"),
        ("run;WRL;SPP;MU_PP;MU_PW;YM;RF_PW", "column run has "),
        ("1,0,3,0,0,0,0", "column run has '1'"),
    ],
)
def test_another_header_is_refused(refusal, header, named):
    message = refusal("\n".join([header, *TEXT.splitlines()[1:]]))
    assert message.startswith(f"header row (line 1), {named}")
    assert ",".join(HEADER) in message


@pytest.mark.parametrize("content", ["", "\n", " \r\n\n", b"\xef\xbb\xbf"])
def test_an_empty_file_is_refused(refusal, content):
    assert "the file is empty" in refusal(content)


def test_a_header_without_rows_is_refused(refusal):
    assert refusal(TEXT.splitlines()[0]).startswith("row 1, column run: missing, like 71 more;")


def test_a_line_that_is_too_short_or_too_long_is_refused(refusal):
    assert refusal(TEXT.replace("\n5,0,9,1,0,0,0\n", "\n5,0,9,1\n")).startswith(
        "row 5 (line 6), column MU_PW:"
    )
    assert refusal(TEXT.replace("\n5,0,9,1,", "\n5,0,9,1,1,")).startswith("row 5 (line 6), column 8:")


def test_what_is_no_text_or_no_csv_is_refused(refusal):
    assert "UTF-8" in refusal(export(PLAN, "parquet"))
    assert refusal(TEXT.replace("0.5", '"0.5')).startswith("row at line 8: ")


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    for file in (tmp_path, tmp_path / "none.csv"):
        with pytest.raises(InputError, match="cannot be read"):
            load_plan(file)


def test_what_a_spreadsheet_makes_of_the_file_is_read(tmp_path):
    file = tmp_path / "plan.csv"
    text = TEXT.replace("0.5", " .50 ").replace("\n", "\r\n") + "\r\n,,,,,,\r\n"
    file.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load_plan(file) == PLAN


def test_balance_names_the_column_when_there_is_nothing_to_compare_with():
    rows = (replace(PLAN.rows[0], SPP=6), *PLAN.rows[1:])
    with pytest.raises(InputError, match="column SPP: SPP=3 comes 23 times"):
        check(replace(PLAN, name="another", rows=rows)).refuse_if_wrong()


def test_swapping_two_cells_keeps_the_balance_and_is_found_all_the_same():
    first, second, *rest = PLAN.rows
    rows = (replace(first, MU_PP=second.MU_PP), replace(second, MU_PP=first.MU_PP), *rest)
    result = check(replace(PLAN, rows=rows))
    wrong = [finding.name for finding in result.findings if not finding.ok]
    assert "balance" not in wrong
    assert {"cells", "triples"} <= set(wrong)


def test_rows_changed_in_memory_are_checked_too():
    assert not check(replace(PLAN, rows=())).ok
    assert not check(replace(PLAN, rows=PLAN.rows[1:])).ok
    assert not check(replace(PLAN, rows=(*PLAN.rows, replace(PLAN.rows[0], run=73)))).ok
    off = check(replace(PLAN, name="another", rows=(replace(PLAN.rows[0], SPP=4), *PLAN.rows[1:])))
    assert off.word_lengths == ()
    with pytest.raises(InputError, match="row 1, column SPP has 4, which is not a level"):
        off.refuse_if_wrong()


def test_a_total_or_word_length_that_was_not_published_is_found():
    for change in ({"total_samples": 1727}, {"A4": 0.28}, {"A3": 0.01}):
        assert not check(replace(PLAN, published=replace(PLAN.published, **change))).ok


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("gravity = 9.81", "gravity = '9.81'", "fixed.gravity"),
        ("gravity = 9.81", "gravity = nan", "fixed.gravity"),
        ("gravity = 9.81", "", "fixed.gravity is missing"),
        ("gravity = 9.81", "gravity = 9.81\nmoon = 1", "fixed.moon is unknown"),
        ("runs = 72", "runs = 72.0", "runs"),
        ("runs = 72", "runs = ", "line 5"),
        ("levels = [3, 6, 9]", "levels = [3, 6, true]", r"factors\[1\].levels\[2\]"),
        ("upper = 2600.0", "upper = 2300.0", "DENS"),
        ('name = "SPP"', 'name = "SSP"', "factors"),
        ('name = "RF_PP"', 'name = "RF"', "parameters"),
        ("[targets]", "[[targets]]", "targets"),
    ],
)
def test_a_damaged_definition_is_refused_by_key(tmp_path, old, new, named):
    file = tmp_path / "plan.toml"
    file.write_text(TOML.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=named) as caught:
        read_plan(file, Path(PLAN.origin))
    assert str(caught.value).startswith(f"{file}: ")
    assert len(str(caught.value).splitlines()) == 1


# Export and the choice of rows


def test_csv_export_is_the_shipped_file(tmp_path):
    assert export(PLAN, "csv") == TEXT
    file = tmp_path / "plan.csv"
    file.write_text(export(PLAN, "csv"), encoding="utf-8")
    assert load_plan(file) == PLAN


def test_json_and_parquet_exports_hold_the_same_rows():
    expected = pd.read_csv(io.StringIO(TEXT)).astype({"WRL": float})
    assert tuple(expected.columns) == HEADER
    pd.testing.assert_frame_equal(pd.DataFrame(json.loads(export(PLAN, "json"))), expected)
    pd.testing.assert_frame_equal(pd.read_parquet(io.BytesIO(export(PLAN, "parquet"))), expected)


def test_parquet_export_says_which_plan_it_is():
    schema = pq.read_schema(io.BytesIO(export(PLAN, "parquet")))
    assert schema.metadata[b"plan_hash"].decode() == PLAN.hash
    assert b"Eq. 11" in schema.field("SPP").metadata[b"meaning"]


def test_an_unknown_format_is_refused():
    with pytest.raises(InputError, match="'xlsx' is unknown; use csv, parquet, json"):
        export(PLAN, "xlsx")


def test_an_unknown_row_is_refused():
    with pytest.raises(InputError, match=r"row 73 is not in plan .* 1 to 72"):
        PLAN.row(73)
    with pytest.raises(InputError, match="it has no rows"):
        replace(PLAN, rows=()).row(1)


@pytest.mark.parametrize(
    ("text", "runs"),
    [
        ("1", (1,)),
        ("1,4,10-12", (1, 4, 10, 11, 12)),
        (" 7 , 5 - 6,6", (5, 6, 7)),
        ("1-72", tuple(range(1, 73))),
    ],
)
def test_rows_are_chosen_by_numbers_and_ranges(text, runs):
    assert parse_rows_option(text, PLAN) == runs


@law
@given(st.sets(st.integers(1, 72), min_size=1))
def test_any_choice_of_rows_can_be_written(runs):
    assert parse_rows_option(",".join(map(str, runs)), PLAN) == tuple(sorted(runs))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "'' is neither a row nor a range"),
        ("1,,2", "'' is neither a row"),
        ("a", "'a' is neither a row"),
        ("1-", "'1-' is neither a row"),
        ("-3", "'-3' is neither a row"),
        ("1-2-3", "'1-2-3' is neither a row"),
        ("12-10", "goes downwards; write 10-12"),
        ("0", "0 is not in plan"),
        ("70-80", "80 is not in plan .* 1 to 72"),
        ("1-999999999", "999999999 is not in plan"),
    ],
)
def test_a_wrong_choice_of_rows_is_refused(text, said):
    with pytest.raises(InputError, match=said):
        parse_rows_option(text, PLAN)


# The full factorial


FULL = load_plan(FULL_FACTORIAL)


def test_the_full_factorial_has_every_combination_once_and_the_papers_rows_first():
    assert FULL.rows[:72] == PLAN.rows
    assert [row.run for row in FULL.rows] == list(range(1, 145))
    every = set(itertools.product(*(factor.levels for factor in PLAN.factors)))
    assert {row.levels for row in FULL.rows} == every and len(every) == 144
    assert FULL.hash != PLAN.hash


def test_nothing_is_confounded_in_the_full_factorial():
    result = check(FULL)
    assert result.ok and result.word_lengths == pytest.approx((0.0,) * 6, abs=1e-12)
    assert sum(result.samples) == 3456
    by_name = {finding.name: finding for finding in result.findings}
    assert by_name["cells"].found == "all 432 of rows 1 to 72 as in Table B-1"


@pytest.mark.parametrize("run", [1, 72, 73, 144])
def test_a_wrong_cell_of_the_full_factorial_is_found(run):
    rows = tuple(replace(r, YM=1 - r.YM) if r.run == run else r for r in FULL.rows)
    wrong = {f.name for f in check(replace(FULL, rows=rows)).findings if not f.ok}
    assert {"balance", "distinct rows"} <= wrong
    assert ("cells" in wrong) == (run <= 72)


@pytest.mark.parametrize("share_samples", [False, True])
def test_the_papers_rows_are_the_same_calibrations_in_the_full_factorial(share_samples):
    target = Target({"angle_of_repose_deg": 22.0, "bulk_density": 1500.0}, "paper", "")
    half, full = (tasks_of(plan, target, MODES["paper"], 3, share_samples) for plan in (PLAN, FULL))
    assert all(full[row] == half[row] for row in half)
    assert set(full) == set(range(1, 145))


def test_a_study_on_the_full_factorial_is_read_without_naming_it(tmp_path):
    run_study(tmp_path / "study", (2, 100), plan=FULL)
    study = read_study(tmp_path / "study")
    assert study.plan == FULL and study.planned == 144
    assert list(study.calibrations["row"]) == [2, 100]
    run_study(tmp_path / "half", (2,))
    line = read_study(tmp_path / "half").calibrations.iloc[0]
    same = study.calibrations.iloc[0]
    assert all(line[f"dem_{name}"] == same[f"dem_{name}"] for name in PARAMETERS)


def test_rows_of_three_digits_keep_their_order(tmp_path):
    run_study(tmp_path / "study", (9, 20, 100), plan=FULL)
    assert list(read_table(tmp_path / "study", "calibrations")["row"]) == [9, 20, 100]
