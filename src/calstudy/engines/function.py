"""A Python function as an engine: parameters go in, one number for each response comes out."""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
import threading
import time
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calstudy.disk.files import content_hash
from calstudy.errors import CalstudyError, InputError, Stopped
from calstudy.plausible import Range
from calstudy.records import RAYLEIGH_TIME_STEP, Outcome, Response, Run

REASON_LENGTH = 200
PLAIN = (str, int, float, bool, type(None))


@dataclass(frozen=True, eq=False)
class FunctionEngine:
    """Calls a function with the parameters as keywords or, if it has one argument, as a mapping.

    The function returns its only response as a number, or all responses as a mapping. If it has an argument
    ``seed``, it gets the run's seed, too. An exception, and a response that is missing or not finite, make
    that run fail. Several threads may call the function at once.

    Two engines are the same if their functions have the same name, source (without comments) and plain values
    from the enclosing scopes. Functions that it calls are not compared. Give a ``version`` if that is not
    enough, or if the function has no source. InputError: the version must be given, or the function does not
    take the parameters.
    """

    function: Callable[..., Any]
    parameters: Mapping[str, str]
    """Units by name."""
    responses: Mapping[str, str]
    """Units by name."""
    version: str = ""
    """Distinguishes it from other functions of the same name; empty for a hash of its source."""
    expected_seconds: float = 0.001
    """Expected time of one call, in s."""
    particle_diameter: float = field(default=math.nan, init=False)
    """NaN: there are no beads."""
    by_name: bool = field(default=True, init=False)
    """Whether the parameters are given as keywords."""
    takes_seed: bool = field(default=False, init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "version", self.version or _version(self.function))
        by_name, takes_seed = _manner(self.function, tuple(self.parameters))
        object.__setattr__(self, "by_name", by_name)
        object.__setattr__(self, "takes_seed", takes_seed)

    @property
    def name(self) -> str:
        """Name of the function."""
        return _name(self.function)

    @property
    def identity(self) -> str:
        """Name and version of the function."""
        return f"function {self.name} {self.version}"

    @property
    def model_hash(self) -> str:
        """Identity of the parameters and responses, with their units."""
        quantities = {"parameters": dict(self.parameters), "responses": dict(self.responses)}
        return content_hash({"function": self.name} | quantities)

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """Call the function. ``directory`` is not used. Stopped: ``stop`` is set."""
        if stop.is_set():
            raise Stopped("interrupted")
        given = {name: float(parameters[name]) for name in self.parameters}
        more = {"seed": seed} if self.takes_seed else {}
        started, used = time.perf_counter(), time.thread_time()
        found, wrong = dict.fromkeys(self.responses, math.nan), []
        try:
            answer = self.function(**given, **more) if self.by_name else self.function(given, **more)
            for name, value in self._named(answer).items():
                number = float(value)
                if math.isfinite(number):
                    found[name] = number
                else:
                    wrong.append(f"{name} is {number}, not a finite number")
        except CalstudyError:
            raise
        except Exception as error:
            wrong = [" ".join(f"{type(error).__name__}: {error}".split())[:REASON_LENGTH]]
        return Run(
            outcome=Outcome.FAILED if wrong else Outcome.OK,
            reason="; ".join(wrong),
            responses=found | {RAYLEIGH_TIME_STEP: math.nan},
            wall_time=time.perf_counter() - started,
            cpu_time=time.thread_time() - used,
        )

    def _named(self, answer: Any) -> dict[str, Any]:
        """Responses by name. ValueError: the answer lacks one."""
        if isinstance(answer, Mapping):
            if missing := [name for name in self.responses if name not in answer]:
                raise ValueError(f"the answer has no {missing[0]}")
            return {name: answer[name] for name in self.responses}
        if len(self.responses) > 1:
            raise ValueError(f"one number was returned for {len(self.responses)} responses; return a mapping")
        return dict.fromkeys(self.responses, answer)


@dataclass(frozen=True, eq=False)
class FunctionModel:
    """A function as the model of a calibration, without particles, deck or fidelities."""

    engine: FunctionEngine
    deck: int = field(default=0, init=False)
    particles: None = field(default=None, init=False)
    """There is no Rayleigh time-step."""
    ratio: None = field(default=None, init=False)
    """Nothing is known of how its parameters act."""

    @property
    def name(self) -> str:
        """Name of the function."""
        return self.engine.name

    @property
    def seeds(self) -> tuple[str, ...]:
        """Its argument that takes the run's seed, if it has one."""
        return ("seed",) if self.engine.takes_seed else ()

    @property
    def hash(self) -> str:
        """Identity of the parameters and responses."""
        return self.engine.model_hash

    @property
    def parameters(self) -> Mapping[str, str]:
        """Units of the parameters, by name."""
        return self.engine.parameters

    @property
    def responses(self) -> tuple[Response, ...]:
        """Responses that the function returns."""
        return tuple(Response(name, unit) for name, unit in self.engine.responses.items())

    @property
    def plausible(self) -> Mapping[str, Range]:
        """Empty: no plausible ranges are known."""
        return {}

    @property
    def labels(self) -> Mapping[str, str]:
        """Empty labels: there are no fidelities or variants."""
        return {"fidelity": "", "variant": ""}

    @property
    def noise_table(self) -> str:
        """Empty: its noise was not measured."""
        return ""

    def check(self, parameters: Mapping[str, float]) -> None:
        """Accept any values."""

    def script_lines(self, parameters: Mapping[str, float]) -> list[str]:
        """Empty: there is no script."""
        return []

    def expected_seconds_at(self, parameters: Mapping[str, float]) -> float:
        """Expected time of one call, in s."""
        return self.engine.expected_seconds


def _name(function: Callable[..., Any]) -> str:
    """Name of a function, or of the class of another callable."""
    return str(getattr(function, "__name__", type(function).__name__))


def _manner(function: Callable[..., Any], names: tuple[str, ...]) -> tuple[bool, bool]:
    """Whether a function takes the parameters as keywords, and whether it takes a seed."""
    try:
        signature = inspect.signature(function)
    except (ValueError, TypeError) as error:
        raise InputError(f"{_name(function)}: its arguments are not known; wrap it in a def") from error
    takes_seed = "seed" in signature.parameters and "seed" not in names
    more = {"seed": 0} if takes_seed else {}
    for by_name, given in ((True, ((), dict.fromkeys(names, 0.0))), (False, (({},), {}))):
        try:
            signature.bind(*given[0], **given[1], **more)
        except TypeError:
            continue
        return by_name, takes_seed
    raise InputError(
        f"{_name(function)}{signature} does not take the parameters {', '.join(names)}; give it arguments of "
        "these names, or one argument that takes a mapping"
    )


def _version(function: Callable[..., Any]) -> str:
    """Hash of a function's source and of plain values from enclosing scopes. InputError: it has none."""
    remedy = f"{_name(function)}: name its version, such as version='1', for"
    if not isinstance(function, types.FunctionType):
        raise InputError(f"{remedy} it is not a plain function")
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, TypeError, SyntaxError) as error:
        raise InputError(f"{remedy} its source cannot be read") from error
    kinds = ast.Lambda if function.__name__ == "<lambda>" else ast.FunctionDef
    nodes = [node for node in ast.walk(tree) if isinstance(node, kinds)]
    if not nodes or (kinds is ast.Lambda and len(nodes) > 1):
        raise InputError(f"{remedy} its source cannot be told from the code around it; or write it as a def")
    around = inspect.getclosurevars(function)
    defaults = {f"default {k}": value for k, value in enumerate(function.__defaults__ or ())}
    own = {**around.nonlocals, **defaults, **(function.__kwdefaults__ or {})}
    if hidden := [name for name, value in own.items() if not isinstance(value, PLAIN)]:
        raise InputError(f"{remedy} it depends on {hidden[0]}, which is not a plain value")
    values = own | {name: value for name, value in around.globals.items() if isinstance(value, PLAIN)}
    plain = {name: repr(value) for name, value in values.items()}
    return content_hash({"source": ast.unparse(nodes[0]), "values": plain})[:12]
