"""How a response is read in what a run left, and what a person is shown of it."""

import pytest

from calstudy.engines.liggghts import LOG
from calstudy.errors import RunError
from calstudy.models.readers import NumberInFile, NumberInLog

LOG_TEXT = """AOR = 1018
AOR2 = 31.5
 AOR: 30.25 deg
AOR = unknown
print "AOR = ${angle}"
"""


@pytest.fixture
def run(tmp_path):
    (tmp_path / LOG).write_text(LOG_TEXT)
    (tmp_path / "out.txt").write_text("# step force\n1 10.5\n\n2, 20.5 # the last\n")
    return tmp_path


@pytest.mark.parametrize(
    ("marker", "value", "line"),
    [
        ("AOR", 30.25, 3),
        ("AOR =", 1018.0, 1),
        ("AOR2", 31.5, 2),
        ("AOR2 =", 31.5, 2),
        ("AOR:", 30.25, 3),
    ],
)
def test_a_marker_ends_at_a_word_s_end_and_its_last_number_counts(run, marker, value, line):
    reader = NumberInLog(marker)
    assert reader.read(run) == value
    assert reader.shown(run) == f"{LOG}, line {line}: {LOG_TEXT.splitlines()[line - 1].strip()}"


@pytest.mark.parametrize("marker", ["OR", "AOR1", "print", "A"])
def test_a_marker_without_a_number_behind_it_is_refused(run, marker):
    with pytest.raises(RunError, match="no line that begins with"):
        NumberInLog(marker).read(run)


def test_the_line_of_a_file_is_shown(run):
    assert NumberInFile("out.txt").read(run) == 20.5
    assert NumberInFile("out.txt").shown(run) == "out.txt: 2, 20.5"
    assert NumberInFile("out.txt", line=1).shown(run) == "out.txt: 1 10.5"


def test_a_long_line_is_shortened(run):
    (run / LOG).write_text("AOR = 30" + " deg" * 100)
    assert len(NumberInLog("AOR").shown(run)) < 100
