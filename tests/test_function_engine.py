"""A Python function as an engine: how it is called, what it is known by, what becomes of its faults."""

import math
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from calstudy.engines.function import FunctionEngine
from calstudy.errors import InputError, Stopped
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED
from calstudy.plan import PARAMETERS
from calstudy.records import Outcome, Run
from closed_form import responses, run_study

UNITS = {"mu": "-", "cohesion": "Pa"}
ONE = {"shear_stress": "Pa"}
SCALE = 3.0


def shear_stress(mu: float, cohesion: float) -> float:
    return 1000.0 * mu + cohesion


def call(engine: FunctionEngine, seed: int = 1, **parameters: float) -> Run:
    return engine.run(parameters, seed, Path("nowhere"), threading.Event())


def test_keywords_and_a_mapping_give_the_same_responses() -> None:
    def of_mapping(values: Mapping[str, float]) -> dict[str, float]:
        return {"shear_stress": 1000.0 * values["mu"] + values["cohesion"], "more": 1.0}

    by_name, by_mapping = (FunctionEngine(f, UNITS, ONE) for f in (shear_stress, of_mapping))
    found = call(by_name, mu=0.3, cohesion=20.0)
    assert found.outcome is Outcome.OK and found.responses["shear_stress"] == 320.0
    assert call(by_mapping, mu=0.3, cohesion=20.0).responses["shear_stress"] == 320.0
    assert "more" not in call(by_mapping, mu=0.3, cohesion=20.0).responses


def test_a_function_that_asks_for_the_seed_gets_it() -> None:
    def noisy(mu: float, cohesion: float, seed: int) -> float:
        return mu + cohesion + seed

    assert call(FunctionEngine(noisy, UNITS, ONE), 5, mu=1.0, cohesion=2.0).responses["shear_stress"] == 8.0


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (lambda mu, cohesion: 1 / 0, "ZeroDivisionError: division by zero"),
        (lambda mu, cohesion: math.inf, "shear_stress is inf, not a finite number"),
        (lambda mu, cohesion: math.nan, "shear_stress is nan, not a finite number"),
        (lambda mu, cohesion: "a word", "ValueError: could not convert string to float: 'a word'"),
        (lambda mu, cohesion: None, "TypeError: float() argument must be a string or a real number"),
        (lambda mu, cohesion: {"wall_angle": 1.0}, "ValueError: the answer has no shear_stress"),
    ],
)
def test_what_goes_wrong_in_it_is_a_failed_run_with_its_reason(
    answer: Callable[..., object], reason: str
) -> None:
    run = call(FunctionEngine(answer, UNITS, ONE, version="1"), mu=0.3, cohesion=1.0)
    assert run.outcome is Outcome.FAILED and run.reason.startswith(reason)
    assert math.isnan(run.responses["shear_stress"])


def test_one_number_is_no_answer_to_two_responses() -> None:
    engine = FunctionEngine(shear_stress, UNITS, ONE | {"wall_angle": "deg"})
    assert "one number was returned for 2 responses" in call(engine, mu=0.3, cohesion=1.0).reason


def test_a_stopped_engine_is_not_a_failed_run() -> None:
    stop = threading.Event()
    stop.set()
    with pytest.raises(Stopped):
        FunctionEngine(shear_stress, UNITS, ONE).run({"mu": 1.0, "cohesion": 1.0}, 1, Path("nowhere"), stop)


def defined(source: str, tmp_path: Path, **around: object) -> FunctionEngine:
    """Engine of the function ``f`` of a module with this source."""
    path = tmp_path / f"of_{len(list(tmp_path.iterdir()))}.py"
    path.write_text(source)
    names = dict(around)
    exec(compile(source, path, "exec"), names)
    return FunctionEngine(names["f"], UNITS, ONE)  # type: ignore[arg-type]


SOURCE = "def f(mu, cohesion):\n    return k * mu + cohesion\n"


def test_a_changed_function_is_another_engine_and_a_comment_changes_nothing(tmp_path: Path) -> None:
    one = defined(SOURCE, tmp_path, k=1.0).identity
    assert one.startswith("function f ")
    assert defined(SOURCE.replace("return", "# noted\n    return"), tmp_path, k=1.0).identity == one
    assert defined(SOURCE.replace("+", "-"), tmp_path, k=1.0).identity != one
    assert defined(SOURCE, tmp_path, k=2.0).identity != one
    assert defined(SOURCE.replace("cohesion)", "cohesion, m=1)"), tmp_path, k=1.0).identity != one


def test_a_value_from_around_a_function_is_part_of_it() -> None:
    def of(factor: float) -> Callable[..., float]:
        def f(mu: float, cohesion: float) -> float:
            return factor * SCALE * mu + cohesion

        return f

    one, again, other = (FunctionEngine(of(factor), UNITS, ONE).identity for factor in (1.0, 1.0, 2.0))
    assert one == again != other


class Model:
    def __call__(self, mu: float, cohesion: float) -> float:
        return mu + cohesion


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (Model(), "it is not a plain function"),
        (eval("lambda mu, cohesion: mu + cohesion"), "its source cannot be read"),
        (
            (lambda mu, cohesion: mu, lambda mu, cohesion: cohesion)[1],
            "cannot be told from the code around",
        ),
        (
            (lambda model: lambda mu, cohesion: model(mu))(Model()),
            "cannot be told from the code around",
        ),
    ],
)
def test_a_function_that_cannot_be_told_from_others_needs_a_version(
    function: Callable[..., float], said: str
) -> None:
    with pytest.raises(InputError, match=rf"name its version, such as version='1', for .*{said}"):
        FunctionEngine(function, UNITS, ONE)
    assert FunctionEngine(function, UNITS, ONE, version="7").identity.endswith(" 7")


def test_a_function_of_other_parameters_is_refused() -> None:
    with pytest.raises(InputError, match=r"shear_stress\(.*does not take the parameters mu, angle"):
        FunctionEngine(shear_stress, {"mu": "-", "angle": "deg"}, ONE)


def test_a_campaign_runs_rows_on_a_function_and_repeats_nothing(tmp_path: Path) -> None:
    called: list[float] = []

    def heap(DENS: float, MU_PP: float, MU_PW: float, RF_PP: float, RF_PW: float, YM: float) -> object:
        called.append(DENS)
        if 0.29 < MU_PP < 0.31:
            raise ValueError("the heap slid off")
        values = (DENS, MU_PP, MU_PW, RF_PP, RF_PW, YM)
        return responses(dict(zip(PARAMETERS, values, strict=True)))

    units = {ANGLE_OF_REPOSE: "deg", BULK_DENSITY: "kg/m3"}
    engine = FunctionEngine(heap, dict.fromkeys(PARAMETERS, "-"), units, version="1")
    _, summary = run_study(tmp_path / "study", (1, 5), engine=engine)
    assert summary.failed == ()
    table = pq.read_table(tmp_path / "study" / "calibrations").to_pydict()
    assert all(math.isfinite(value) for name in MEASURED for value in table[f"dem_{name}"])
    made = pq.read_table(tmp_path / "study" / "evaluations").to_pydict()
    assert "ValueError: the heap slid off" in made["reason"]
    before = len(called)
    run_study(tmp_path / "study", (1, 5), engine=engine)
    assert len(called) == before > 20
