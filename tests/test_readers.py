"""How a response is read in what a run left, and what a person is shown of it."""

import numpy as np
import pytest

from calstudy.engines.liggghts import LOG
from calstudy.errors import RunError
from calstudy.models.measurement import measure_heap
from calstudy.models.readers import NumberInFile, NumberInLog, Silhouette

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


def dump(points, radii=None):
    column = "" if radii is None else " radius"
    lines = [f"{k} {x} {y} {z}" for k, (x, y, z) in enumerate(points)]
    lines = lines if radii is None else [f"{line} {r}" for line, r in zip(lines, radii, strict=True)]
    head = ["ITEM: TIMESTEP", "1", "ITEM: NUMBER OF ATOMS", str(len(points)), "ITEM: BOX BOUNDS f f f"]
    return "\n".join([*head, "0 1", "0 1", "0 1", f"ITEM: ATOMS id x y z{column}", *lines, ""])


def test_beads_are_drawn_with_the_dump_s_own_radii(tmp_path):
    rng = np.random.default_rng(1)
    radii = rng.uniform(0.001, 0.003, 400)
    around, angle = 0.03 * np.sqrt(rng.random(400)), rng.uniform(0, 2 * np.pi, 400)
    z = 0.002 + (0.03 - around) * 0.5 * rng.random(400)
    points = np.column_stack([around * np.cos(angle), around * np.sin(angle), z]).astype(np.float32)
    (tmp_path / "heap.dump").write_text(dump(points, radii))
    for given in (0.002, 0.006):  # what model.toml says does not count
        found = Silhouette("heap.dump", given, 4.0, 0.050).measure(tmp_path)[1]
        expected = measure_heap(points.astype(float), 2 * radii.mean(), radii=radii)
        assert found == expected
    assert Silhouette("heap.dump", 0.004, 4.0, 0.050).shown(tmp_path).startswith("heap.dump: 400 beads drawn")
    (tmp_path / "heap.dump").write_text(dump(points, np.full(400, 0.002)))
    same = Silhouette("heap.dump", 0.006, 4.0, 0.050).read(tmp_path)
    (tmp_path / "heap.dump").write_text(dump(points))
    assert Silhouette("heap.dump", 0.004, 4.0, 0.050).read(tmp_path) == same
