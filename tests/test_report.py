import io
import re
import shutil
from dataclasses import replace
from itertools import combinations
from multiprocessing.process import BaseProcess

import numpy as np
import pytest
from rich.console import Console

from calstudy.analysis import figure9
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY
from calstudy.parameters import Parameter, Space
from calstudy.records import Outcome, Phase
from calstudy.report import pictures
from calstudy.report import terminal as report
from calstudy.study.directory.store import read_table
from calstudy.study.reading import read_study
from calstudy.study.settings import read_settings
from closed_form import PLAN, TRUTH, ClosedForm, run_study, target_of, wait_for

pytestmark = pytest.mark.slow

ROWS = (1, 2, 31, 53)


def row_1_fails(_, parameters):
    return Outcome.FAILED if parameters["MU_PP"] == 0.2 else None


def far_target():
    target = target_of()
    return replace(target, values={**target.values, ANGLE_OF_REPOSE: 5.0}, truth=None, kind="set")


@pytest.fixture(scope="module")
def studies(tmp_path_factory):
    """Three studies: a sound one, one whose target is out of reach, one with a failed row."""
    directory = tmp_path_factory.mktemp("studies")
    run_study(directory / "sound", ROWS)
    run_study(directory / "far", (1,), target=far_target())
    run_study(directory / "failing", (1, 2), engine=ClosedForm(fails=row_1_fails))
    return directory


def rows_of(text):
    """Lines of the table of many rows."""
    return [line for line in text.splitlines() if re.match(r" +\d", line)]


def numbers(text):
    return sorted(re.findall(r"[\d.]+(?:e-?\d+)?", text))


def printed(directory, rows=None, width=200, **options):
    calibrations = read_table(directory, "calibrations")
    if rows:
        calibrations = calibrations[calibrations["row"].isin(rows)]
    sink = io.StringIO()
    console = Console(file=sink, width=width)
    report.print_results(console, calibrations.to_dict("records"), PLAN, read_settings(directory), **options)
    return sink.getvalue()


def pixels(figure):
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())[..., :3]


def colours(picture):
    return len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0))


# ---- pictures -------------------------------------------------------------------------------------


@pytest.fixture
def drawn(monkeypatch):
    """Give every figure a canvas that can be read back."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    def draw(figure):
        FigureCanvasAgg(figure)
        return pixels(figure)

    return draw


def test_figure_9_shows_black_beads_and_what_is_measured_in_colour(studies, drawn):
    of = read_study(studies / "sound")
    picture = drawn(figure9(of, 1)).astype(int)
    black = (picture.max(axis=-1) < 20).mean()
    vermilion = (np.abs(picture - [0xD5, 0x5E, 0x00]).max(axis=-1) < 10).sum()
    assert black > 0.02 and vermilion > 100 and colours(picture) > 10


def test_figure_9_of_another_heap_is_another_picture(studies, drawn):
    of = read_study(studies / "sound")
    assert (drawn(figure9(of, 1)) != drawn(figure9(of, 2))).any()


def test_figure_9_says_the_responses_of_the_dem_optimum(studies):
    of = read_study(studies / "sound")
    line = of.calibrations.set_index("row").loc[53]
    title = figure9(of, 53).get_suptitle()
    assert f"angle of repose {line[f'dem_{ANGLE_OF_REPOSE}']:.1f} deg" in title
    assert f"bulk density {line[f'dem_{BULK_DENSITY}']:.0f} kg/m3" in title


def test_convergence_shows_every_run_once_in_its_phase(studies, drawn):
    of = read_study(studies / "sound")
    figure = pictures.draw_runs(of, 1)
    runs = of.evaluations[of.evaluations["row"] == 1]
    labels = {"sampling": Phase.SAMPLING, "Jacobian": Phase.JACOBIAN, "trial": Phase.TRIAL}
    for axes, name in zip(figure.axes, (ANGLE_OF_REPOSE, BULK_DENSITY), strict=True):
        lines = {line.get_label(): line for line in axes.get_lines()}
        for label, phase in labels.items():
            shown = sorted(lines[label].get_ydata())
            assert shown == sorted(runs[name][runs["phase"] == phase])
        assert set(lines["target (twin)"].get_ydata()) == {target_of().values[name]}
        optimum = of.calibrations.set_index("row").loc[1, f"dem_{name}"]
        assert set(lines["DEM optimum"].get_ydata()) == {optimum}
    assert colours(drawn(figure)) > 10


def test_only_the_first_run_of_a_round_is_drawn_as_the_kriging_optimum(studies):
    of = read_study(studies / "sound")
    row = of.evaluations[(of.evaluations["row"] == 1) & (of.evaluations["phase"] == Phase.JACOBIAN)].index
    at_once = of.evaluations.assign(
        phase=of.evaluations["phase"].where(~of.evaluations.index.isin(row), "start")
    )
    lines = pictures.draw_runs(replace(of, evaluations=at_once), 1).axes[0].get_lines()
    shown = {line.get_label(): len(line.get_ydata()) for line in lines}
    assert shown["Kriging optimum"] == 1
    assert shown["trial"] == sum((at_once["row"] == 1) & (at_once["phase"] == Phase.TRIAL)) + len(row)


def test_a_phase_without_runs_is_not_in_the_legend(studies):
    of = read_study(studies / "sound")
    without = replace(of, evaluations=of.evaluations[of.evaluations["phase"] != Phase.JACOBIAN])
    named = [
        [t.get_text() for t in pictures.draw_runs(s, 1).axes[0].get_legend().get_texts()]
        for s in (of, without)
    ]
    assert "Jacobian" in named[0] and [name for name in named[0] if name != "Jacobian"] == named[1]


def space_of(names, lower, upper):
    bounds = zip(names, lower, upper, strict=True)
    return Space(tuple(Parameter(name, "-", low, high, None) for name, low, high in bounds), names)


def test_an_optimum_on_a_bound_is_drawn_whole():
    space = space_of(("a", "YM"), (0.0, 5e6), (1.0, 5e8))
    points = space.box.from_unit(np.random.default_rng(1).uniform(size=(50, 2)))
    figure = pictures.pairs(points, np.array([0.0, 5e8]), space)
    pixels_of = figure.get_dpi() / 72
    figure.canvas.draw()
    (axes,) = (axes for axes in figure.axes if axes.get_xlabel() == "a" and axes.get_ylabel() == "YM")
    (mark,) = (line for line in axes.get_lines() if line.get_markersize() == 9)
    assert not mark.get_clip_on()
    x, y = axes.transData.transform((0.0, 5e8))
    assert x > axes.bbox.x0 + pixels_of and y < axes.bbox.y1 - pixels_of


def test_labels_of_the_solution_space_do_not_lie_on_each_other():
    names = ("DENS", "MU_PP", "MU_PW", "RF_PP", "RF_PW", "YM")
    space = space_of(names, (2400.0, 0.1, 0.1, 0.01, 0.01, 5e6), (2600.0, 1.0, 1.0, 0.3, 0.3, 5e8))
    points = space.box.from_unit(np.random.default_rng(1).uniform(size=(50, 6)))
    figure = pictures.pairs(points, space.box.centre, space)
    figure.canvas.draw()
    axes = [axis for panel in figure.axes if panel.axison for axis in (panel.xaxis, panel.yaxis)]
    texts = [text for a in axes for text in (*a.get_ticklabels(), a.label, a.get_offset_text())]
    boxes = [text.get_window_extent() for text in texts if text.get_visible() and text.get_text()]
    assert len(boxes) > 30
    assert not [(a, b) for a, b in combinations(boxes, 2) if a.overlaps(b)]


def test_pictures_of_a_row_are_files_that_are_not_blank(studies, tmp_path):
    from matplotlib.image import imread

    paths = pictures.draw_row(tmp_path, read_study(studies / "sound"), 1)
    assert sorted(path.name for path in paths) == ["row-01-heap.png", "row-01-runs.png"]
    for path in paths:
        assert colours(imread(path)) > 10


def test_pictures_drawn_meanwhile_are_those_drawn_afterwards(studies, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MANY", 2)
    meanwhile, afterwards = tmp_path / "meanwhile", tmp_path / "afterwards"
    shutil.copytree(studies / "sound", meanwhile)
    rows = list(read_study(meanwhile).ok["row"])
    assert len(rows) > 1
    with pictures.drawn_meanwhile(meanwhile, None, rows):
        wait_for(lambda: len(list(meanwhile.glob("pictures/[!.]*"))) == 2 * len(rows), 60.0)
    afterwards.mkdir()
    for path in pictures.draw_rows(afterwards, read_study(meanwhile), rows):
        assert path.read_bytes() == (meanwhile / "pictures" / path.name).read_bytes()


def test_where_no_second_process_starts_the_pictures_are_drawn_afterwards(studies, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MANY", 1)

    def start(_):
        raise BlockingIOError

    monkeypatch.setattr(BaseProcess, "start", start)
    with pictures.drawn_meanwhile(studies / "sound", None, [1]):
        pass
    assert len(pictures.draw_rows(tmp_path, read_study(studies / "sound"), [1])) == 2


def test_a_failed_row_has_no_pictures(studies, tmp_path):
    assert pictures.draw_row(tmp_path, read_study(studies / "failing"), 1) == []


# ---- tables ---------------------------------------------------------------------------------------


def test_the_result_of_a_row_is_printed_with_truth_and_both_optima(studies):
    text = printed(studies / "sound", (1,))
    line = read_table(studies / "sound", "calibrations").set_index("row").loc[1]
    assert "Row 1: WRL 0, SPP 3, exact fidelity" in text and "twin's" in text
    (density,) = (line_ for line_ in text.splitlines() if line_.startswith(" DENS"))
    assert "[2400; 2600]" in density and f"{TRUTH['DENS']:.4g}" in density
    assert f"{line['dem_DENS']:.4g}" in density and f"{line['kriging_DENS']:.4g}" in density
    (friction,) = (line_ for line_ in text.splitlines() if line_.startswith(" MU_PP"))
    assert "constant" in friction
    assert f"{line['runs_jacobian']} jacobian" in text and "Target: closed form" in text


def test_without_a_twin_no_truth_is_claimed(studies):
    assert "twin" not in printed(studies / "far")


def test_a_target_outside_the_sampled_range_is_warned_of(studies):
    text = printed(studies / "far")
    (warning,) = (line for line in text.splitlines() if "WARNING" in line)
    assert warning.startswith("WARNING row 1: the target angle_of_repose_deg = 5 is OUT OF REACH")


@pytest.mark.parametrize("rows", [(1,), ROWS])
def test_a_target_inside_the_sampled_range_is_not_warned_of(studies, rows):
    text = printed(studies / "sound", rows)
    assert "WARNING" not in text and "OUT OF REACH" not in text


def test_a_failed_row_is_shown_as_failed_with_its_reason(studies):
    text = printed(studies / "failing")
    assert "Row 1 failed: only 0 of 6 sampling runs are usable" in text
    assert "Row 2: WRL" in text and "Row 1: WRL" not in text and "WARNING" not in text


def test_many_rows_get_one_line_each(studies):
    text = printed(studies / "sound")
    lines = rows_of(text)
    assert [int(line.split()[0]) for line in lines] == list(ROWS)
    assert "DENS MU_PW RF_PP" in lines[3] and "Target: closed form" in text
    assert "Row 1: WRL" not in text


def test_the_table_of_many_rows_shows_failures_and_targets_out_of_reach(studies):
    failing = printed(studies / "failing", detailed_up_to=0)
    lines = rows_of(failing)
    assert "failed" in lines[0] and "failed" not in lines[1]
    assert "Row 1 failed: only 0 of 6 sampling runs are usable" in failing
    assert "missed: angle" in printed(studies / "far", detailed_up_to=0)
    assert "missed:" not in printed(studies / "sound", detailed_up_to=0)


def test_a_failed_row_misses_nothing(studies):
    settings = read_settings(studies / "failing")
    lines = read_table(studies / "failing", "calibrations").to_dict("records")
    assert [report.missed(line, settings) for line in lines] == [[], []]


def test_a_target_that_is_reached_outside_the_samples_is_not_missed(studies):
    settings = read_settings(studies / "far")
    (line,) = read_table(studies / "far", "calibrations").to_dict("records")
    assert report.missed(line, settings) == [ANGLE_OF_REPOSE]
    reached = line | {f"dem_{ANGLE_OF_REPOSE}": line[f"target_{ANGLE_OF_REPOSE}"]}
    assert report.missed(reached, settings) == []


WIDTH = 80


@pytest.mark.parametrize("which", ["sound", "far", "failing"])
@pytest.mark.parametrize("detailed", [0, 9])
def test_80_columns_show_every_number_as_a_pipe_does(studies, which, detailed):
    narrow = printed(studies / which, width=WIDTH, detailed_up_to=detailed)
    wide = printed(studies / which, detailed_up_to=detailed)
    assert numbers(narrow) == numbers(wide) and "…" not in narrow
    tables = [line for line in narrow.splitlines() if not line.startswith(("WARNING", "Row", "Target"))]
    assert max(map(len, tables)) <= WIDTH


NAMES = ("angle_of_repose_in_the_drum_deg", "torque_of_the_mixer", "mass_flow_of_the_hopper", "bulk_density")


@pytest.mark.parametrize("width", [40, WIDTH, 120])
def test_a_table_that_is_too_wide_is_laid_out_in_several(width):
    columns = [
        report.Column("row", ["1", "12"]),
        *(report.Column(f"{name}\nkg/m3", ["-1.23456e-05", "3.008e-05"]) for name in NAMES),
        report.Column("", ["the reason is a long one", ""], right=False, folds=True),
        report.Column("none", ["", ""]),
    ]
    tables = report.fitted(columns, width, "Title")
    sink = io.StringIO()
    console = Console(file=sink, width=width)
    for table in tables:
        console.print(table)
    text = sink.getvalue()
    assert max(map(len, text.splitlines())) <= width and "…" not in text and "none" not in text
    assert text.count("-1.23456e-05") == text.count("3.008e-05") == len(NAMES)
    assert text.count("Title") == 1 and text.count("row") == len(tables) == text.count("12 ")
