"""Advice on a calibration: each test that is not in its file yet, alone and with another, and what it would
leave."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from calstudy.calibration.expected import CONFIRMED
from calstudy.calibration.modes import MODES, mode_of
from calstudy.calibration.narrowing import in_words, made_up_for
from calstudy.calibration.sampling import sobol
from calstudy.calibration.solutions import errors_of
from calstudy.calibration.task import Task
from calstudy.emulator.advice.emulated import EmulatedTest, corners_of
from calstudy.emulator.advice.foretold import Foretold, Now, Procedure, Responses, Runs, foretell
from calstudy.emulator.advice.laboratory import USUAL
from calstudy.emulator.advice.preposterior import spread
from calstudy.emulator.emulator import Emulator, read_emulator, shipped_emulators
from calstudy.errors import InputError
from calstudy.models.find import declaration, is_shipped, shipped_noise
from calstudy.models.noise import noise_in
from calstudy.parameters import Array, Parameter, Space
from calstudy.study.definition import Definition
from calstudy.study.reading import Result
from calstudy.study.settings import CONFIRM

SHIPPED_AT = ("coarse", "coarse-ring")
"""Of the emulators that are shipped of a test, the one over a wide box."""
TELLS = 0.85
"""A test tells of a parameter if it is expected to leave less than this share of its standard deviation. What
was promised came out within a tenth or so over eight truths, so more than this may be nothing."""
FEW = 10
"""With fewer effective points (in half of the cases) a width is a guess."""
SEED = 1


@dataclass(frozen=True, slots=True)
class Question:
    """What is asked: over which box, from which knowledge, of which tests."""

    procedure: Procedure
    now: Now
    tests: Mapping[str, EmulatedTest]
    """By name; those of the file are among them."""
    there: Mapping[str, tuple[str, ...]]
    """Responses that are targets already, by test."""
    notes: tuple[str, ...]
    """What is not known, and what is taken for what it is not."""

    @property
    def candidates(self) -> dict[str, tuple[str, ...]]:
        """Responses that could be measured beside, by test."""
        left = {
            name: tuple(r for r in test.responses if r not in self.there.get(name, ()))
            for name, test in self.tests.items()
        }
        return {name: responses for name, responses in left.items() if responses}

    @property
    def asked(self) -> list[Responses]:
        """Each candidate, each two of them, each response and each two responses."""
        tests = [tuple((name, r) for r in responses) for name, responses in self.candidates.items()]
        single = [((name, r),) for name, responses in self.candidates.items() for r in responses]
        pairs = [a + b for of in (tests, single) for a, b in itertools.combinations(of, 2)]
        return list(dict.fromkeys([*tests, *single, *pairs]))

    def hours(self, responses: Responses) -> float:
        """DEM hours that a calibration takes more with these responses; tests of the file are run anyway."""
        new = {test for test, _ in responses} - set(self.there)
        return self.procedure.runs.total * sum(self.tests[name].seconds for name in new) / 3600


@dataclass(frozen=True)
class Advice:
    """What is foretold, as tables."""

    question: Question
    foretold: Foretold

    @property
    def names(self) -> tuple[str, ...]:
        """Calibrated parameters."""
        return self.question.procedure.space.axes

    @property
    def directions(self) -> list[Array]:
        """Directions along which parameters make up for each other now, in the unit cube, longest first."""
        return made_up_for(self.foretold.sample)

    @property
    def directions_in_words(self) -> list[str]:
        """The same in words."""
        width = self.question.procedure.space.box.width
        return [in_words(direction, width, self.names) for direction in self.directions]

    def tests_table(self) -> pd.DataFrame:
        """A line for each test and each two of them, the most telling first, single ones before pairs.

        Columns tests, responses, hours, nats, volume (share of the solution space's volume that is left),
        left_PARAMETER (share of its standard deviation), direction_K, effective points (median), few
        (whether a width is a guess), told (the parameters it tells of), redundant (tests of a pair that add
        nothing to the other).
        """
        candidates = self.question.candidates
        whole = {name: tuple((name, r) for r in responses) for name, responses in candidates.items()}
        lines = []
        for tests in [*((name,) for name in whole), *itertools.combinations(whole, 2)]:
            line = self._line(sum((whole[name] for name in tests), ()))
            left = np.array([line[f"left_{name}"] for name in self.names])
            redundant = [
                name
                for name in tests
                if len(tests) > 1
                and np.all(left > TELLS * self.foretold.left(whole[next(o for o in tests if o != name)]))
            ]
            told = [name for name, share in zip(self.names, left, strict=True) if share < TELLS]
            lines.append({"tests": " + ".join(tests), "number": len(tests), **line})
            lines[-1] |= {"told": ", ".join(told), "redundant": ", ".join(redundant)}
        table = pd.DataFrame(lines)
        return table.sort_values(["number", "volume"], ignore_index=True, kind="stable")

    def responses_table(self) -> pd.DataFrame:
        """A line for each response alone: columns as of ``tests_table``, and its error."""
        lines = []
        for name, responses in self.question.candidates.items():
            for response in responses:
                error = self.question.tests[name].errors[response]
                lines.append({"test": name, "response": response, "error": error})
                lines[-1] |= self._line(((name, response),))
        return pd.DataFrame(lines)

    def overlap(self) -> pd.DataFrame:
        """How much two responses say the same: 0 where their nats add up, 1 where one says nothing more.

        Columns test, response, other_test, other_response, nats, overlap.
        """
        nats = {chosen: float(of.information.mean()) for chosen, of in self.foretold.after.items()}
        single = [((name, r),) for name, responses in self.question.candidates.items() for r in responses]
        lines = []
        for a, b in itertools.combinations(single, 2):
            shared = nats[a] + nats[b] - nats[a + b]
            lines.append(
                {
                    "test": a[0][0],
                    "response": a[0][1],
                    "other_test": b[0][0],
                    "other_response": b[0][1],
                    "nats": nats[a + b],
                    "overlap": float(np.clip(shared / min(nats[a], nats[b]), 0.0, 1.0)),
                }
            )
        return pd.DataFrame(lines)

    def _line(self, responses: Responses) -> dict[str, object]:
        found, now = self.foretold.after[responses], self.foretold.now.mean(axis=0)
        left = dict(zip(self.names, self.foretold.left(responses), strict=True))
        then = found.covariance.mean(axis=0)
        line: dict[str, object] = {
            "responses": ", ".join(dict.fromkeys(response for _, response in responses)),
            "hours": self.question.hours(responses),
            "nats": float(found.information.mean()),
            "volume": float(np.exp(-found.information.mean())),
        }
        line |= {f"left_{name}": float(share) for name, share in left.items()}
        if self.directions:
            along = np.array(self.directions)
            shares = spread(then, along) / spread(now, along)
            line |= {f"direction_{k}": float(share) for k, share in enumerate(shares, start=1)}
        effective = float(np.median(found.effective))
        return line | {"effective": effective, "few": effective < FEW}


def advise(question: Question, tell: Callable[[int, int], None] = lambda done, of: None) -> Advice:
    """Simulate calibrations with each candidate, and say what they would leave."""
    if not question.candidates:
        raise InputError("no test is left that could be added; name an emulator of one with --emulator DIR")
    return Advice(question, foretell(question.procedure, question.now, question.tests, question.asked, tell))


# ---- what is asked -----------------------------------------------------------------------------------


def emulators_by_test(given: Sequence[Emulator]) -> dict[str, Emulator]:
    """Emulators of all tests that there is one of: those that are given, and else the shipped ones."""
    own = {emulator.origin.model: emulator for emulator in given}
    return {name: own.get(name) or read_emulator(at) for name, at in _shipped().items()} | own


def known_responses(given: Sequence[Emulator]) -> dict[str, tuple[str, ...]]:
    """Responses of all tests that there is an emulator of, without reading the shipped ones."""
    shipped = {name: tuple(r.name for r in declaration(name).responses) for name in _shipped()}
    return shipped | {e.origin.model: tuple(r.name for r in e.similarity.responses) for e in given}


def _shipped() -> dict[str, Path]:
    """Directory of the emulator over a wide box of each test that one is shipped of."""
    return {
        test: directory
        for test in declared_tests()
        for directory in shipped_emulators(test)
        if directory.name in SHIPPED_AT
    }


def declared_tests() -> list[str]:
    """Shipped tests, in the order of the table of usual errors."""
    return list(dict.fromkeys(test for test, _ in USUAL))


def question_of(
    definition: Definition | None,
    result: Result | None,
    emulators: Mapping[str, Emulator],
    errors: Mapping[tuple[str, str], float],
    only: Sequence[str] | None = None,
) -> Question:
    """What to ask about a file's calibration; without one, about the emulators' own box with nothing
    measured.

    ``result`` is that of its finished study, if there is one; ``errors`` replace the laboratory's usual
    ones, by test and response. InputError where the file's own tests are not emulated, and not known by a
    study.
    """
    if not emulators:
        raise InputError("there is no emulator of any test; name one with --emulator DIR")
    tests = {name: _emulated(emulator, errors) for name, emulator in emulators.items()}
    if only is not None and (strange := [name for name in only if name not in tests]):
        raise InputError(f"--tests: there is no emulator of {strange[0]}; there are {', '.join(tests)}")
    space = _space_of(emulators) if definition is None else definition.task.space
    corners, notes = corners_of(space), list[str]()
    outside: dict[str, str] = {}
    there = {} if definition is None else _there(definition)
    for name in list(tests):
        if only is not None and name not in only and name not in there:
            del tests[name]
            continue
        try:
            tests[name].require_covered(space, corners)
        except InputError as error:
            outside[name] = f"{error}; make one of your own box: calstudy emulator sample --model {name}"
            del tests[name]
    if definition is None:
        task = None
        procedure = _procedure(space, None)
        now = Now()
    else:
        task = replace(definition.task, cheap=None, stored=())
        procedure = _procedure(space, task)
        tests, targets, said = _with_targets(definition, task, tests, outside, result is not None)
        notes += said
        now = Now(targets=targets) if result is None else Now(points=result.solutions.points)
    return Question(procedure, now, tests, there, (*outside.values(), *notes))


def _emulated(emulator: Emulator, given: Mapping[tuple[str, str], float]) -> EmulatedTest:
    """A test with all responses that an error is known of: the given one, or the usual one at the runs'
    mean."""
    name, runs = emulator.origin.model, emulator.runs
    errors = {}
    for response in (r.name for r in emulator.similarity.responses):
        if (name, response) in given:
            errors[response] = given[name, response]
        elif (name, response) in USUAL:
            errors[response] = USUAL[name, response].at(float(runs[response].mean()))
    noise = noise_in(shipped_noise(name), emulator.origin.model_hash) if is_shipped(name) else None
    known = {r: sd for r, sd in (noise or {}).items() if np.isfinite(sd) and sd > 0}
    return EmulatedTest(emulator, tuple(errors), errors, known, float(runs["cpu_time"].mean()))


def _there(definition: Definition) -> dict[str, tuple[str, ...]]:
    """Responses that are targets, by test."""
    targets = definition.task.cost.responses
    return {
        chosen.model.name: tuple(
            r.name for r in chosen.model.responses if f"{chosen.prefix}{r.name}" in targets
        )
        for chosen in definition.models
    }


def _with_targets(
    definition: Definition,
    task: Task,
    tests: Mapping[str, EmulatedTest],
    outside: Mapping[str, str],
    has_study: bool,
) -> tuple[dict[str, EmulatedTest], dict[str, dict[str, float]], list[str]]:
    """Tests with the file's errors, the targets by test and response, and what is to be said."""
    tests, targets, notes = dict(tests), {}, []
    noise = {name: sd for chosen in definition.models for name, sd in chosen.noise.items()}
    errors = errors_of(task, noise | dict(task.noise or {}))
    for chosen in definition.models:
        name = chosen.model.name
        values = {
            r.name: task.cost.target.values[f"{chosen.prefix}{r.name}"]
            for r in chosen.model.responses
            if f"{chosen.prefix}{r.name}" in task.cost.target.values
        }
        test = tests.get(name)
        known = set() if test is None else {r.name for r in test.emulator.similarity.responses}
        minimised = {r for r in values if f"{chosen.prefix}{r}" in task.cost.target.minimised}
        if strange := sorted((set(values) - known) | minimised):
            if not has_study:
                what = f"{strange[0]} of {name}" if test else name
                raise InputError(
                    f"no emulator knows {what}, so what the file's targets leave is not known; calibrate it "
                    "first (its study tells), or name an emulator of the box with --emulator DIR"
                    + (f" ({outside[name]})" if name in outside else "")
                )
            tests.pop(name, None)
            continue
        if test is None:
            continue
        of_file = {r: errors[f"{chosen.prefix}{r}"] for r in values}
        responses = tuple(dict.fromkeys([*values, *test.responses]))
        tests[name] = replace(test, responses=responses, errors={**test.errors, **of_file})
        targets[name] = values
        if chosen.model.hash != test.emulator.origin.model_hash:
            notes.append(
                f"{name}: the file's is another fidelity, material or version than the emulator's, "
                f"{test.emulator.origin.in_words}; what is said of it is a guess"
            )
    return tests, targets, notes


def _space_of(emulators: Mapping[str, Emulator]) -> Space:
    """The box that all emulators know, of their shipped declaration's parameters."""
    ends: dict[str, tuple[float, float]] = {}
    for emulator in emulators.values():
        box = emulator.box
        for name, low, high in zip(box.names, box.lower, box.upper, strict=True):
            first, last = ends.get(name, (low, high))
            ends[name] = max(first, low), min(last, high)
    units = next(iter(emulators.values())).similarity.parameters
    if missing := [name for name, _ in units if name not in ends]:
        raise InputError(f"no emulator has the interval of {missing[0]} for itself; name a FILE.toml")
    parameters = tuple(Parameter(name, unit, *ends[name], None) for name, unit in units)
    return Space(parameters, tuple(name for name, _ in units))


def _procedure(space: Space, task: Task | None) -> Procedure:
    """How a task's calibrations are made; without one, those of mode ``robust``."""
    box, mode = space.box, mode_of("robust") if task is None else task.mode
    allowed = None if task is None else task.allowed

    def design(n: int, rng: np.random.Generator) -> Array:
        points = mode.design(n, box.dimension, rng) if allowed is None else allowed.design(n, rng)
        return space.snapped(box.from_unit(points))

    def prior(n: int, rng: np.random.Generator) -> Array:
        spread = sobol(n, box.dimension, seed=rng)
        points = spread if allowed is None else allowed.spread(n, rng)
        return space.snapped(box.from_unit(points))

    robust = MODES["robust"]
    assert robust.samples is not None
    runs = Runs(robust.samples(box.dimension), CONFIRMED[True], CONFIRM) if task is None else Runs.of(task)
    return Procedure(space, runs, design, prior, replace(robust.kriging, settled=True), SEED)
