import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calstudy.engines.liggghts import COLUMNS, read_dump
from calstudy.errors import RunError

HEAD = """ITEM: TIMESTEP
15775
ITEM: NUMBER OF ATOMS
{count}
ITEM: BOX BOUNDS ff ff ff
-0.065 0.065
-0.065 0.065
-0.001 0.2
ITEM: ATOMS id x y z vx vy vz {end}"""
BEADS = [
    (53, -0.00904318, -0.0440889, 0.00498044, 1.80517e-06, -3.53494e-06, -4.71414e-06),
    (7, 0.000875582, -0.0451405, 0.00498351, 5.80606e-06, 1.03098e-06, 6.85343e-06),
    (360, 0.0107705, -0.0438537, 0.00497962, 7.20657e-06, 4.27716e-07, -1.53182e-06),
]


def dump_text(beads, count=None):
    """As LIGGGHTS 3.8.0 writes it: each line ends with a blank."""
    rows = "".join(" ".join(map(repr, bead)) + " \n" for bead in beads)
    return HEAD.format(count=len(beads) if count is None else count, end="\n") + rows


def read(text):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "heap.dump"
        path.write_text(text)
        return read_dump(path)


def refusal(text):
    with pytest.raises(RunError) as caught:
        read(text)
    message = str(caught.value)
    assert message.startswith("heap.dump: ")
    assert "\n" not in message
    return message


numbers = st.floats(-1e3, 1e3)
rows = st.tuples(*[numbers] * 6)
tables = st.dictionaries(st.integers(1, 10**6), rows, max_size=30)


@given(tables)
def test_what_was_written_is_read_with_all_digits_and_sorted_by_id(table):
    found = read(dump_text([(name, *row) for name, row in table.items()]))
    assert found.shape == (len(table), len(COLUMNS))
    np.testing.assert_array_equal(found, [(name, *table[name]) for name in sorted(table)] or found)


@given(tables, st.randoms(use_true_random=False))
def test_the_order_of_the_lines_does_not_matter(table, random):
    beads = [(name, *row) for name, row in table.items()]
    mixed = random.sample(beads, len(beads))
    np.testing.assert_array_equal(read(dump_text(mixed)), read(dump_text(beads)))


def test_no_bead_is_a_table_of_no_rows():
    assert read(dump_text([])).shape == (0, len(COLUMNS))


@pytest.mark.parametrize("beads", [BEADS, BEADS[:1], []], ids=len)
def test_a_dump_that_was_cut_anywhere_is_refused(beads):
    text = dump_text(beads)
    assert len(read(text)) == len(beads)
    for end in range(len(text)):
        refusal(text[:end])


def test_a_cut_within_the_last_number_is_told_from_a_shorter_number():
    text = dump_text(BEADS)
    assert text.endswith("-1.53182e-06 \n")
    assert "of 3 beads are there" in refusal(text[: -len("e-06 \n")])


@pytest.mark.parametrize("count", [2, 4, 0, -3])
def test_another_number_of_beads_than_announced_is_refused(count):
    assert f"of {count} beads are there" in refusal(dump_text(BEADS, count))


@pytest.mark.parametrize("count", ["many", "", "3.0", "3 beads", "9" * 5000])
def test_a_number_of_beads_that_is_none_is_refused(count):
    assert "garbled" in refusal(dump_text(BEADS, count))


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "1e999"])
@pytest.mark.parametrize("column", range(1, 7))
def test_a_value_that_is_not_finite_is_refused(value, column):
    bead = [str(number) for number in BEADS[0]]
    bead[column] = value
    text = HEAD.format(count=1, end="\n") + " ".join(bead) + " \n"
    assert "not finite" in refusal(text)


@pytest.mark.parametrize("bad", ["x", "0.1.2", "#", "0.1 #", "--1", "1,0"])
def test_a_value_that_is_no_number_is_refused(bad):
    assert "garbled" in refusal(HEAD.format(count=1, end="\n") + f"1 0 0 {bad} 0 0 0\n")


def test_two_frames_are_refused():
    refusal(dump_text(BEADS) * 2)


@pytest.mark.parametrize("columns", ["id x y z", "id x y z vx vy vz radius", "id y x z vx vy vz", ""])
def test_other_columns_are_refused(columns):
    text = dump_text(BEADS).replace("id x y z vx vy vz", columns)
    assert "not a dump of id x y z vx vy vz" in refusal(text)


def test_a_dump_without_the_number_of_beads_is_refused():
    assert "not a dump" in refusal(dump_text(BEADS).replace("ITEM: NUMBER OF ATOMS", "ITEM: NUMBER"))


@pytest.mark.parametrize("text", ["", "\n", "hello\n", "ITEM: ATOMS id x y z vx vy vz \n"])
def test_something_else_is_refused(text):
    assert "not a dump" in refusal(text)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(RunError, match=r"heap\.dump cannot be read \(FileNotFoundError\)"):
        read_dump(tmp_path / "heap.dump")


def test_bytes_that_are_no_text_are_refused(tmp_path):
    (tmp_path / "heap.dump").write_bytes(b"\xff\xfe" + dump_text(BEADS).encode())
    with pytest.raises(RunError, match="cannot be read"):
        read_dump(tmp_path / "heap.dump")


def test_finite_values_are_not_refused():
    assert math.isclose(read(dump_text(BEADS))[-1, 1], 0.0107705)
    assert read(dump_text(BEADS))[:, 0].tolist() == [7, 53, 360]
