"""A DEM program of a few lines whose optimum is known, and studies made with it."""

import json
import math
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from calstudy.calibration import procedure as calibration
from calstudy.calibration import task as rows_of
from calstudy.calibration.cost import Cost
from calstudy.calibration.kriging.surrogates import Surrogates
from calstudy.calibration.modes import MODES, Mode
from calstudy.calibration.optimise import Optimum
from calstudy.calibration.sampling import maximin_optimised, maximin_search
from calstudy.calibration.task import Runs, Task
from calstudy.engines.queue import LocalExecutor
from calstudy.errors import Stopped
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, MEASURED, PROPORTIONAL
from calstudy.plan import PARAMETERS, Plan
from calstudy.plan_file import load_plan
from calstudy.rayleigh import rayleigh_time_step
from calstudy.records import RAYLEIGH_TIME_STEP, Beads, Evaluation, Outcome, Request, Run, Target
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign, Summary
from calstudy.study.directory.elements import Element
from calstudy.study.directory.store import Store
from calstudy.study.settings import StudySettings

PLAN = load_plan()
INTERVALS = {p.name: (p.lower, p.upper) for p in PLAN.parameters}
TRUTH = {"DENS": 2470.0, "MU_PP": 0.2, "MU_PW": 0.2, "RF_PP": 0.06, "RF_PW": 0.01, "YM": 5.06e8}
"""Inside the box, and reachable by every row of the plan: what a row holds constant is at its constant."""
PAPER = replace(MODES["paper"], design=partial(maximin_search, designs_per_dimension=20))
"""Mode ``paper`` with a short search for its design."""
ROBUST = replace(MODES["robust"].knowing(PROPORTIONAL), design=partial(maximin_optimised, steps=100))
"""Mode ``robust`` with a short search for its design."""

Fails = Callable[[int, Mapping[str, float]], Outcome | None]


def responses(parameters: Mapping[str, float]) -> dict[str, float]:
    """Noise-free responses of a parameter set."""
    u = {name: (parameters[name] - low) / (high - low) for name, (low, high) in INTERVALS.items()}
    solid = 0.62 - 0.03 * u["MU_PP"] - 0.005 * u["MU_PW"] - 0.005 * u["RF_PP"] ** 2
    step = rayleigh_time_step(
        parameters["DENS"],
        parameters["YM"],
        radius=PLAN.fixed.particle_radius,
        poissons_ratio=PLAN.fixed.poissons_ratio,
    )
    return {
        ANGLE_OF_REPOSE: 21.9 + 5.6 * u["MU_PP"] + 3.5 * u["RF_PP"],
        BULK_DENSITY: parameters["DENS"] * solid,
        RAYLEIGH_TIME_STEP: float(step),
    }


def chaotic_responses(parameters: Mapping[str, float]) -> dict[str, float]:
    """Responses with a scatter that another last digit of a parameter makes another one, as collisions do."""
    rng = np.random.default_rng(zlib.crc32(repr(sorted(parameters.items())).encode()))
    return {
        name: value * (1.0 + 0.01 * rng.standard_normal() * (name in MEASURED))
        for name, value in responses(parameters).items()
    }


@dataclass
class ClosedForm:
    """Engine of smooth functions, with noise, failures and files on request."""

    noise: float = 0.0
    """Relative standard deviation of the measured responses."""
    fails: Fails | None = None
    """Outcome of the call with that number, from 0, and those parameters; None for a good run."""
    seconds: float = 0.0
    writes: bool = False
    answer: Callable[[Mapping[str, float]], Mapping[str, float]] = responses
    on_call: Callable[[int], None] | None = None
    calls: Counter = field(default_factory=Counter)
    """Calls by the run's identity."""
    guard: threading.Lock = field(default_factory=threading.Lock)

    identity = "closed form 1"
    model_hash = "closed-form"
    particle_diameter = 0.0075

    @property
    def expected_seconds(self) -> float:
        return self.seconds

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        run_id = directory.name.partition(".")[0]
        with self.guard:
            number = self.calls.total()
            self.calls[run_id] += 1
        if self.on_call is not None:
            self.on_call(number)
        if self.writes:
            directory.mkdir(parents=True)
            (directory / "log").write_text("closed form\n")
        if self.seconds and stop.wait(self.seconds):
            raise Stopped("stopped")
        outcome = (self.fails and self.fails(number, parameters)) or Outcome.OK
        found = dict(self.answer(parameters))
        rng = np.random.default_rng(seed)
        for name in MEASURED:
            found[name] *= 1.0 + self.noise * rng.standard_normal()
            if outcome is not Outcome.OK:
                found[name] = math.nan
        angle = math.radians(found[ANGLE_OF_REPOSE])
        heap = np.random.default_rng(seed).uniform([-0.05, -0.05, 0], [0.05, 0.05, 0.02], (40, 3))
        return Run(
            outcome=outcome,
            reason="" if outcome is Outcome.OK else "failed as it was told to",
            responses=found,
            wall_time=max(self.seconds, 1e-3),
            cpu_time=1e-3,
            radius=0.05,
            height=0.05 * math.tan(angle),
            beads=Beads(poured=60, filled=50, on_plate=40, lost=10),
            simulated_time=2.0,
            engine_time_step=1e-5,
            positions=(heap + 1e-3 * parameters["RF_PP"]).astype(np.float32).astype(float),
        )


def target_of(parameters: Mapping[str, float] = TRUTH) -> Target:
    """Target that the closed form reaches at a parameter set."""
    reached = responses(parameters)
    return Target({name: reached[name] for name in MEASURED}, "twin", "closed form", dict(parameters))


def cost_of(row: int, target: Target | None = None) -> Cost:
    """Cost of a row of the plan."""
    return rows_of.cost_of(PLAN, PLAN.row(row), target or target_of())


def identify(request: Request, engine: ClosedForm | type[ClosedForm] = ClosedForm) -> str:
    """Identity of a request's run."""
    return request.run_id(engine.model_hash, engine.identity)


def study_settings(plan: Plan = PLAN, target: Target | None = None, **changes: object) -> StudySettings:
    """Settings of a study with the closed form."""
    settings = StudySettings(
        plan=plan.name,
        plan_hash=plan.hash,
        model="angle_of_repose",
        deck=1,
        model_hash=ClosedForm.model_hash,
        fidelity="exact",
        variant="standard",
        engine=ClosedForm.identity,
        calstudy="test",
        mode="paper",
        budget=120,
        seed=7,
        target=target or target_of(),
    )
    return replace(settings, **changes)


def run_study(
    directory: Path,
    rows: tuple[int, ...] = (1, 5),
    *,
    engine: ClosedForm | None = None,
    mode: Mode = PAPER,
    plan: Plan = PLAN,
    target: Target | None = None,
    workers: int = 2,
    seed: int = 7,
    keep_runs: bool = False,
    stop: threading.Event | None = None,
    share_samples: bool = False,
    scratch: Path | None = None,
    element: Element | None = None,
    **options: object,
) -> tuple[Campaign, Summary]:
    """Run rows of the plan with the closed form into ``directory``, as ``plan run`` does."""
    target, stop = target or target_of(), stop or threading.Event()
    settings = study_settings(plan, target, seed=seed, share_samples=share_samples)
    with Store(directory, settings, element=element) as store:
        campaign = Campaign(
            rows_of.tasks_of(plan, target, mode, seed, share_samples),
            [MaterialTest(engine or ClosedForm(), PARAMETERS)],
            store,
            LocalExecutor(workers, stop),
            scratch=scratch or directory / "runs",
            keep_runs=keep_runs,
            stop=stop,
            **options,
        )
        return campaign, campaign.run(rows)


@contextmanager
def other_last_digits(share: float = 1e-9) -> Iterator[None]:
    """Let the surrogates' optima be what another processor's linear algebra makes of them."""
    on_this_one = calibration.optimise_surrogates

    def elsewhere(task: Task, surrogates: Surrogates, runs: Runs) -> Optimum:
        found, box = on_this_one(task, surrogates, runs), task.space.box
        return replace(found, best=np.clip(found.best * (1.0 + share), box.lower, box.upper))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "optimise_surrogates", elsewhere)
        yield


def wait_for(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    """Wait until a condition holds; AssertionError when it does not in time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def task_of(row, mode=PAPER, target=None, seed=7):
    plan_row = PLAN.row(row)
    cost = cost_of(row, target)
    return Task(row, cost.space, plan_row.samples, cost, mode, seed, row)


class Desk:
    """Answers requests one after the other, and keeps them."""

    def __init__(self, answer=responses, fails=None, noise=0.0):
        self.engine = ClosedForm(answer=answer, noise=noise)
        self.fails = fails
        self.batches = []

    @property
    def requests(self):
        return [request for batch in self.batches for request in batch]

    def __call__(self, requests):
        self.batches.append(list(requests))
        return [self.evaluation(request) for request in requests]

    def evaluation(self, request):
        self.engine.fails = lambda *_: self.fails(request) if self.fails else None
        run_id = identify(request)
        run = self.engine.run(request.parameters, request.seed, PathLike(run_id), stop=None)
        return Evaluation(request, run_id, run)


class PathLike:
    """A directory's name; the engine writes nothing there."""

    def __init__(self, name):
        self.name = name


def resettle(directory: Path, **changes: object) -> None:
    """Give a study other settings, as if it had been made with them: in study.json and in its tables."""
    path = directory / "study.json"
    content = json.loads(path.read_text()) | changes
    made = StudySettings.of_content({k: v for k, v in content.items() if k not in ("format", "id")})
    path.write_text(json.dumps(content | {"id": made.id}))
    for part in directory.rglob("row-*.parquet"):
        table = pq.read_table(part)
        for name, value in {"study": made.id, **changes}.items():
            if name in table.column_names:
                k = table.schema.get_field_index(name)
                values = pa.array([value] * len(table), table.schema.field(k).type)
                table = table.set_column(k, table.schema.field(k), values)
        pq.write_table(table, part)
