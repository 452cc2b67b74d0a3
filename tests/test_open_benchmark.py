"""The open benchmark: problems are fair and repeat, runs are paid, and anybody's function takes part."""

from __future__ import annotations

import json
import re
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from calstudy.calibration.modes import mode_of
from calstudy.cli.main import main
from calstudy.emulator.benchmark.campaign import COLUMNS, Piece, lines_of
from calstudy.emulator.benchmark.challenges import CHALLENGES, challenge
from calstudy.emulator.benchmark.methods import METHODS, method_of, task_of
from calstudy.emulator.benchmark.problem import Problem, Spent, Truth, solve
from calstudy.emulator.benchmark.scores import losses, score_table
from calstudy.errors import InputError, StoreError

NAMES = [one.name for one in CHALLENGES]


def problem(name: str = "failing", seed: int = 1, budget: float = 8) -> Problem:
    return challenge(name).pose(seed).problem(budget)


@pytest.mark.parametrize("name", NAMES)
def test_equal_seeds_pose_equal_problems(name: str) -> None:
    one, other = (challenge(name).pose(5) for _ in range(2))
    centre = one.space.box.centre
    assert one.cost.target == other.cost.target
    assert one.least == other.least
    answers = [posed.problem(4).runs([centre, centre]) for posed in (one, other)]
    assert np.array_equal(*answers, equal_nan=True)
    other = challenge(name).pose(6)
    assert other.cost.target != one.cost.target or other.space != one.space


@pytest.mark.parametrize("name", NAMES)
def test_no_point_of_the_box_beats_the_least_cost(name: str) -> None:
    posed = challenge(name).pose(3)
    box, rng = posed.space.box, np.random.default_rng(9)
    points = box.from_unit(rng.random((2000, box.dimension)))
    points = np.where(posed.space.whole, np.rint(points), points)
    _, costs = posed.exact(points)
    assert posed.least >= 0.0
    assert np.nanmin(costs) >= posed.least - 1e-9


def test_the_hidden_set_meets_a_target_within_reach_and_none_one_beyond() -> None:
    assert challenge("six").pose(2).least == 0.0
    beyond = challenge("beyond").pose(2)
    assert beyond.least > (2.0 / beyond.cost.desired[0]) ** 2


def test_noise_is_scaled_and_its_mean_is_the_truth() -> None:
    spread = {}
    for name in ("six", "quiet", "noisy"):
        posed = challenge(name).pose(4)
        centre = posed.space.box.centre
        answers = posed.problem(400).runs(np.tile(centre, (400, 1)))
        exact, _ = posed.exact(centre[None])
        spread[name] = answers.std(axis=0, ddof=1)
        assert np.abs(answers.mean(axis=0) - exact[0]) == pytest.approx(0.0, abs=4 * spread[name][0])
    assert spread["noisy"] == pytest.approx(2 * spread["six"], rel=1e-6)
    assert spread["quiet"] == pytest.approx(0.5 * spread["six"], rel=1e-6)


def test_a_run_is_paid_and_none_is_made_that_the_budget_does_not_pay() -> None:
    p = problem(budget=8)
    p.runs(np.tile(p.lower, (6, 1)))
    with pytest.raises(Spent, match="8 runs are paid for, and 6"):
        p.runs(np.tile(p.lower, (3, 1)))
    assert (p.paid, p.rounds, len(p.made)) == (6, 1, 6)
    p.runs(np.tile(p.upper, (2, 1)))
    assert (p.paid, p.rounds) == (8, 2)


@pytest.mark.parametrize("name", ["six", "flat"])
def test_no_points_are_no_runs(name: str) -> None:
    p = problem(name, budget=1)
    assert p.runs(np.empty((0, len(p.names)))).shape == (0, 2)
    assert (p.paid, p.rounds, p.asked) == (0, 0, 0)


def test_a_cheap_run_costs_what_it_takes_and_does_not_count_as_an_answer() -> None:
    p = problem("two_fidelities", budget=2)
    cheap = p.fidelities[1]
    p.runs(np.tile(p.lower, (9, 1)), cheap)
    assert p.paid == pytest.approx(9 * p.prices[cheap])
    assert 0.0 < p.prices[cheap] < 0.1
    assert p.answer(2) is None
    with pytest.raises(InputError, match="there are full, soft"):
        p.run(p.lower, "medium")


def test_a_parameter_that_counts_is_run_at_whole_numbers() -> None:
    p = problem("whole")
    p.run([3.4, 0.5, 0.5])
    assert p.made[0].point[0] == 3.0


def test_an_answer_is_the_last_point_named_by_then_or_the_cheapest_run() -> None:
    p = problem(budget=10)
    for u in (0.1, 0.5, 0.3):
        p.run(np.full(len(p.names), u))
    costs = [p.square_sum(run.point, run.responses) for run in p.made]
    assert p.answer(0.5) is None
    assert np.array_equal(p.answer(3).point, p.made[int(np.argmin(costs))].point)
    p.name(p.made[0].point)
    p.run(p.lower)
    p.name(p.lower, within=True)
    assert np.array_equal(p.answer(3).point, p.made[0].point)
    assert p.answer(3).within == p.is_within(p.made[0].responses)
    assert p.answer(10).within is True


def test_an_answer_had_cost_the_rounds_that_were_made_by_then() -> None:
    p = problem(budget=40)
    for k in (3, 11, 1):
        p.runs(np.tile(p.lower, (k, 1)))
    assert [run.rounds for run in p.made] == [1] * 3 + [2] * 8 + [3] * 3 + [4]
    for budget, rounds in ((2, 1), (3, 1), (4, 2), (11, 2), (12, 3), (14, 3), (15, 4), (40, 4)):
        assert p.answer(budget).rounds == rounds
    p.name(p.lower)
    p.run(p.upper)
    assert (p.rounds, p.answer(40).rounds, p.answer(14).rounds) == (5, 4, 3)


@pytest.mark.parametrize("name", NAMES)
def test_what_a_problem_tells_of_its_responses_is_true(name: str) -> None:
    posed = challenge(name).pose(2)
    space, responses = posed.space, posed.cost.responses
    point = space.box.centre
    for k, of in enumerate(responses):
        at = {one: column for column, one in enumerate(space.box.names)}
        by, ratio = posed.proportional.get(of), posed.ratios.get(of, ())
        if not {*ratio} <= {*at} or not ratio:
            continue
        other = point.copy()
        other[[at[one] for one in ratio]] *= 1.03
        (low, high), _ = posed.exact(np.array([point, other]))
        assert high[k] / low[k] == pytest.approx(1.03 if by in ratio else 1.0, rel=1e-9)
    assert task_of(posed.problem(8), mode_of("robust")).mode.kriging.ratios == posed.ratios


def test_surprise_is_the_error_in_the_methods_own_doubts() -> None:
    p = problem(budget=1)
    p.name(p.lower, expected=[10.0, 900.0], doubts=[1.0, 10.0])
    p.run(p.lower)
    said = p.answer(1)
    assert said.surprise(np.array([12.0, 880.0])) == pytest.approx(2.0)
    assert said.within == p.is_within(p.made[0].responses)
    p.name(p.lower)
    assert np.isnan(p.answer(1).surprise(np.array([12.0, 880.0])))
    with pytest.raises(InputError, match=r"must be \(2,\)"):
        p.name(p.lower, expected=[1.0], doubts=[1.0])


def test_robust_answers_after_each_run_and_doubts_honestly() -> None:
    lines = lines_of(Piece("robust", "flat", (1, 2, 3, 4), (11.0, 12.0, 64.0)))
    by_budget = score_table(lines).set_index("budget")
    assert (by_budget["paid"][:2] == [11.0, 12.0]).all()
    assert by_budget.loc[64.0, "excess"] < by_budget.loc[11.0, "excess"]
    assert lines[lines["budget"] == 64]["surprise"].notna().all()
    assert 0.5 < by_budget.loc[64.0, "surprise"] < 2.0


def test_runs_that_go_together_take_half_the_rounds_of_runs_one_by_one() -> None:
    lines = [lines_of(Piece(method, "six", (1, 2, 3), (16.0,))) for method in ("robust", "robust_together")]
    table = score_table(pd.concat(lines)).set_index("method")
    assert table.loc["robust_together", "paid"] == table.loc["robust", "paid"] == 16
    assert table.loc["robust_together", "rounds"] <= 0.5 * table.loc["robust", "rounds"]
    assert table.loc["robust_together", "within"] == 1.0


def test_no_sample_is_an_answer_where_the_cheap_fidelity_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    p = problem("two_fidelities", budget=40)
    good, cheap = p.fidelities
    truth, batches = p.truths[good], []
    mirrored = Truth(lambda points: truth.responses(p.lower + p.upper - points), truth.noise_sd)
    p.truths = {good: truth, cheap: mirrored}
    run = p.runs

    def noted(points: np.ndarray, fidelity: str | None = None) -> np.ndarray:
        batches.append((fidelity, points))
        return run(points, fidelity)

    monkeypatch.setattr(p, "runs", noted)
    solve(METHODS["robust_two"], p)
    (samples,) = (points for fidelity, points in batches[1:] if fidelity is None and len(points) > 1)
    assert not any(np.array_equal(one.point, samples[0]) for one in p.named)


def test_two_fidelities_buy_a_better_answer_for_fewer_runs() -> None:
    seeds = (1, 2, 3)
    lines = [lines_of(Piece(method, "two_fidelities", seeds, (64.0,))) for method in ("robust", "robust_two")]
    table = score_table(pd.concat(lines)).set_index("method")
    assert table.loc["robust_two", "paid"] < table.loc["robust", "paid"]
    assert table.loc["robust_two", "within"] == 1.0


def test_the_shipped_scores_are_those_of_the_shipped_lines() -> None:
    root = Path(__file__).parents[1]
    lines = pd.read_parquet(root / "reports" / "benchmark" / "lines.parquet").astype(COLUMNS)
    scores = score_table(lines)
    compare = runpy.run_path(str(root / "benchmarks" / "peers" / "compare.py"), run_name="imported")
    assert compare["tables"](lines, scores) == (root / "reports" / "benchmark" / "tables.md").read_text()
    planned = {(piece.method, piece.challenge) for piece in compare["pieces_of"](compare["GROUPS"], ())}
    there = set(lines.groupby(["method", "challenge"]).groups)
    assert there <= planned
    assert set(losses(scores)["method"]) <= {"robust_together"}, "no peer is ahead"


def test_each_number_of_the_page_is_in_a_table() -> None:
    report = Path(__file__).parents[1] / "reports" / "benchmark"
    page, tables = ((report / name).read_text() for name in ("README.md", "tables.md"))
    seen = page[page.index("## What is seen") : page.index("## Losses")]
    said, known = ({number.lstrip("+-") for number in NUMBER.findall(text)} for text in (seen, tables))
    assert len(said) > 40
    assert {as_number(text) for text in said} - {as_number(text) for text in known} == set()


NUMBER = re.compile(r"[+-]?\d+\.\d+(?:e-?\d+)?|[+-]?\d+e-?\d+|\d+ ?%")
"""A number with a decimal point or a power of ten, or a share."""


def as_number(text: str) -> tuple[float, bool]:
    """Its value, and whether it is a share."""
    return float(text.rstrip(" %")), "%" in text


def test_points_of_another_shape_are_refused_in_one_line() -> None:
    p = problem("six")
    for points in ([[0.2, 0.3]], p.lower, [p.lower * np.nan]):
        with pytest.raises(InputError, match=r"must be finite, and \(k, 6\): DENS, MU_PP"):
            p.runs(points)


def test_a_region_where_runs_fail_gives_nan_and_is_nobodys_answer() -> None:
    p = problem("failing")
    assert np.isnan(p.run(p.upper)).all()
    assert p.answer(8) is None


@pytest.mark.parametrize("name", METHODS)
def test_our_methods_keep_to_the_budget_and_answer(name: str) -> None:
    p = problem("flat", budget=20)
    solve(METHODS[name], p)
    assert p.paid <= 20
    assert p.answer(20) is not None


def test_robust_beats_random_points_on_the_main_challenge() -> None:
    seeds = tuple(range(1, 7))
    lines = [lines_of(Piece(method, "six", seeds, (16.0,))) for method in ("robust", "random")]
    table = score_table(pd.concat(lines)).set_index("method")
    assert table.loc["robust", "excess"] < 0.3 * table.loc["random", "excess"]
    assert table.loc["random", "worse_low"] > 0


def test_scores_are_those_of_the_lines() -> None:
    line = {"challenge": "six", "budget": 16.0, "rounds": 2, "cpu_time": 1.0, "failure": "", "paid": 10.0}
    line["surprise"] = 1.5
    made = [
        {"method": "a", "seed": 1, "excess": 0.1, "is_within": True, "said_within": True},
        {"method": "a", "seed": 2, "excess": 0.3, "is_within": False, "said_within": True},
        {"method": "b", "seed": 1, "excess": 0.2, "is_within": False, "said_within": False},
        {"method": "b", "seed": 2, "excess": np.nan, "is_within": False, "said_within": pd.NA},
    ]
    table = score_table(pd.DataFrame([line | one for one in made]).astype(COLUMNS), "a").set_index("method")
    assert table.loc["a", "excess"] == pytest.approx(0.2)
    assert table.loc["a", "said_falsely"] == 0.5
    assert np.isnan(table.loc["b", "said_falsely"])
    assert table.loc["b", "worse_by"] == pytest.approx(0.1)
    assert table.loc["b", "failures"] == 1
    assert table.loc["a", "surprise"] == pytest.approx(1.5)
    assert losses(table).empty
    assert list(losses(table.assign(worse_high=[-0.1, np.nan]))["excess"]) == [pytest.approx(0.2)]


SLOW = """
import os, pathlib, time

def slow(problem):
    pathlib.Path(f"pid-{os.getpid()}").touch()
    time.sleep(600)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_the_command(tmp_path: Path, number: int) -> None:
    (tmp_path / "sleeper.py").write_text(SLOW)
    words = "benchmark --method sleeper:slow --challenge flat --seeds 1 --workers 1".split()  # noqa: SIM905
    command = subprocess.Popen([sys.executable, "-m", "calstudy", *words], cwd=tmp_path)
    deadline = time.monotonic() + 120
    while not (found := list(tmp_path.glob("pid-*"))):
        assert time.monotonic() < deadline and command.poll() is None
        time.sleep(0.1)
    child = int(found[0].name.removeprefix("pid-"))
    command.send_signal(number)
    command.wait(timeout=60)
    while Path(f"/proc/{child}").exists():
        assert time.monotonic() < deadline
        time.sleep(0.1)


OWN = """
def halfway(problem):
    point = (problem.lower + problem.upper) / 2
    problem.run(point)
    return point

def broken(problem):
    problem.run(problem.lower)
    return 1 / 0
"""


def test_the_command_scores_a_function_of_anybodys_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "own_calibrator.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    command = "benchmark --method random,own_calibrator:halfway,own_calibrator:broken --challenge flat,whole"
    words = f"{command} --seeds 3 --workers 1 --out out --json".split()
    assert main(words) == 0
    scores = pd.DataFrame(json.loads(capsys.readouterr().out)["scores"])
    own = scores[scores["method"] == "own_calibrator:halfway"]
    assert list(own["paid"].unique()) == list(own["rounds"].unique()) == [1.0]
    assert (scores[scores["method"] == "own_calibrator:broken"]["failures"] == 3).all()
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.parquet")}
    assert len(kept) == 6
    assert main(words) == 0
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert "learning curves" in (tmp_path / "out" / "report.html").read_text().lower()
    assert main([*words, "--seeds", "4"]) == 2
    assert "other seeds" in capsys.readouterr().err
    next(iter(kept)).write_bytes(b"PAR1 cut off")
    assert main(words) == StoreError.exit_code
    assert "is damaged" in capsys.readouterr().err


def test_the_calibrator_of_the_documentation_takes_part(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (Path(__file__).parents[1] / "docs" / "how-to" / "compare-your-calibrator.md").read_text()
    (tmp_path / "mine.py").write_text(page.partition("```python\n")[2].partition("```")[0])
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    methods, challenges = ["--method", "random,mine:halving"], ["--challenge", "six", "--seeds", "4"]
    assert main(["benchmark", *methods, *challenges, "--workers", "1", "--json"]) == 0
    scores = pd.DataFrame(json.loads(capsys.readouterr().out)["scores"]).set_index(["method", "budget"])
    assert scores.loc[("mine:halving", 64), "paid"] == 61
    assert scores.loc[("mine:halving", 64), "rounds"] == 16
    assert scores["failures"].eq(0).all()
    for one in CHALLENGES:
        assert f"`{one.name}`" in page


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("robst", "did you mean robust"),
        ("no_such_module:f", "no module no_such_module"),
        ("math:no_such", "has no function no_such"),
        ("math:pi", "is not a function"),
    ],
)
def test_a_mistyped_method_is_one_line(name: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        method_of(name)


@pytest.fixture
def informed(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "benchmarks" / "peers"))
    return import_module("informed")


def test_a_peer_that_is_told_the_closed_forms_sees_the_best_density(informed: ModuleType) -> None:
    posed = challenge("six").pose(4)
    silent = replace(posed, truths={n: replace(t, noise_sd=none_of(t)) for n, t in posed.truths.items()})
    p = silent.problem(64)
    view = informed.Informed(p, ("YM", "DENS"))
    assert view.names == ("MU_PP", "MU_PW", "RF_PP", "RF_PW", "YM/DENS")
    rng, dens, ym = np.random.default_rng(2), p.names.index("DENS"), p.names.index("YM")
    for point in rng.uniform(view.lower, view.upper, (8, 5)):
        seen = view.run(point)
        cost = view.square_sum(point, seen)
        best = view.full(point, view.known[-1][1])
        exact, (least,) = posed.exact(best[None])
        assert seen == pytest.approx(exact[0])
        assert cost == pytest.approx(least)
        for share in (0.99, 1.01):  # at the same quotient
            other = best.copy()
            other[[dens, ym]] *= share
            if np.all((other >= p.lower) & (other <= p.upper)):
                assert posed.exact(other[None])[1][0] >= least
    assert p.square_sum(p.answer(64).point, posed.exact(p.answer(64).point[None])[0][0]) == pytest.approx(
        min(posed.exact(named.point[None])[1][0] for named in p.named)
    )


def none_of(truth: Truth) -> Callable[[np.ndarray], np.ndarray]:
    return lambda points: np.zeros_like(truth.responses(points))


def test_a_problem_without_closed_forms_is_left_as_it_is(informed: ModuleType) -> None:
    for name in ("flat", "five_tests"):
        answers = []
        for method in (METHODS["sobol"], informed.sobol):
            p = problem(name, budget=16)
            solve(method, p)
            answers.append(p.answer(16).point)
        assert np.array_equal(*answers)
