"""Calibration of a Python function."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from calstudy.disk.ours import temporary
from calstudy.engines.function import FunctionEngine, FunctionModel
from calstudy.errors import InputError
from calstudy.study.definition import Chosen, define
from calstudy.study.directory.begun import begun_with
from calstudy.study.reading import Result
from calstudy.study.run.definition import finished, run_definition
from calstudy.study.run.taking import definition_work
from calstudy.study.run.work import Running
from calstudy.tomlfile import Section
from calstudy.written import choice


def calibrate(
    function: Callable[..., object],
    parameters: Mapping[str, tuple[float, float] | float | str | Mapping[str, object]],
    targets: Mapping[str, float | Mapping[str, object]],
    *,
    units: Mapping[str, str] | None = None,
    tolerances: Mapping[str, float] | None = None,
    noise: Mapping[str, float] | None = None,
    constraints: Sequence[str] = (),
    mode: str = "robust",
    samples_per_parameter: int | None = None,
    budget: int | None = None,
    together: int = 1,
    confirm: int | None = None,
    seed: int = 1,
    workers: int = 1,
    path: str | Path | None = None,
    version: str = "",
) -> Result:
    """Calibrate a Python function to targets by the procedure of ``calstudy calibrate``.

    Parameters
    ----------
    function : takes the parameters as keywords, or one mapping, and a ``seed`` if it has such an argument;
        returns a mapping with each response, or the only response. What it raises fails that run.
    parameters : an interval (lower, upper) for each that is calibrated, a number for each that is fixed, a
        text such as ``"mu / 10"`` for each that follows from others; or a mapping with keys as in the file,
        such as ``{"interval": (1e6, 1e9), "scale": "log"}``.
    targets : desired responses; of each a number, which is not 0 (Eq. 9 divides by it), or a mapping with
        the keys of a target in the file, such as ``{"value": 22, "sd": 0.8}``.
    units : of parameters and responses, "-" where not named.
    tolerances : deviations from the targets at which the second optimisation ends, in units of the responses.
    noise : known standard deviations of the responses from seed to seed.
    constraints : linear comparisons of parameters, such as ``"mu_pp >= mu_pw"``, which every run keeps.
    mode, samples_per_parameter, budget, together, confirm, seed : as in the file of ``calstudy calibrate``;
        WRL is 0.
    workers : calls at once, by threads.
    path : the study, which goes on where it stopped; None keeps nothing.
    version : what tells the function from others of its name; by default a hash of its source.

    Raises
    ------
    InputError : what is wrong with the arguments, RunError : the calibration failed.
    """
    tolerances, noise, units = tolerances or {}, noise or {}, units or {}
    _require_known("units", units, (*parameters, *targets))
    _require_known("tolerances", tolerances, targets)
    _require_known("noise", noise, targets)
    engine = FunctionEngine(
        function,
        {name: units.get(name, "-") for name in parameters},
        {name: units.get(name, "-") for name in targets},
        version or ("" if path else "of this process"),
    )
    said: dict[str, object] = {
        "mode": mode,
        "seed": seed,
        "WRL": 0.0,
        "parameters": {name: _as_in_the_file(given) for name, given in parameters.items()},
        "targets": {
            name: (dict(value) if isinstance(value, Mapping) else {"value": value})
            | ({"tolerance": tolerances[name]} if name in tolerances else {})
            | ({"noise": noise[name]} if name in noise else {})
            for name, value in targets.items()
        },
    }
    said |= {"constraints": list(constraints)} if constraints else {}
    said |= {} if budget is None else {"budget": budget}
    said |= {} if together == 1 else {"together": together}
    said |= {} if confirm is None else {"confirm": confirm}
    said |= {} if samples_per_parameter is None else {"samples_per_parameter": samples_per_parameter}
    model = Chosen(FunctionModel(engine), engine.name, "")
    with temporary() as scratch:
        directory = Path(path or scratch)
        file = Section(Path(engine.name), said, {})
        definition = define(file, (model,), False, *begun_with(directory))
        how = Running(workers=workers, scratch=scratch / "runs")
        work = definition_work(definition, [engine], directory)
        return finished(definition, run_definition(definition, work, how.here(), how), directory)


def _require_known(
    what: str, given: Mapping[str, object], known: Sequence[str] | Mapping[str, object]
) -> None:
    for name in given:
        if name not in known:
            raise InputError(f"{what}: {name} is unknown; {choice(name, known, 'there are')}")


def _as_in_the_file(given: object) -> object:
    """What a caller says of a parameter, in TOML's types."""
    if isinstance(given, Mapping):
        return {key: _as_in_the_file(value) for key, value in given.items()}
    return list(given) if isinstance(given, Sequence) and not isinstance(given, str) else given
