"""A response's Python function, in a process of its own.

It is started by ``python -m calstudy.models.python_reader RUN FILE FUNCTION``.

It runs in the run's directory, may import what lies beside it, and cannot harm the campaign. What it returns,
or what went wrong, is one line of JSON; whatever else it prints goes to the error stream.
"""

from __future__ import annotations

import inspect
import json
import os
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

MODULE = "calstudy_response"
PARAMETERS = "calstudy_parameters.json"
"""As in ``readers``, which would load much more."""


def call(directory: Path, file: str, function: str) -> float:
    """What the function of the file returns for the run's directory, and the parameters if it takes two."""
    path = directory / file
    sys.path.insert(0, str(path.parent))
    loader = SourceFileLoader(MODULE, str(path))
    spec = spec_from_loader(MODULE, loader)
    assert spec is not None
    module = sys.modules[MODULE] = module_from_spec(spec)
    loader.exec_module(module)
    chosen = getattr(module, function)
    taken = [p for p in inspect.signature(chosen).parameters.values() if p.default is p.empty]
    if len(taken) < 2:
        return float(chosen(directory))
    return float(chosen(directory, json.loads((directory / PARAMETERS).read_text())))


def main(directory: str, file: str, function: str) -> None:
    """Call it and answer."""
    with os.fdopen(os.dup(1), "w") as answer:
        os.dup2(2, 1)
        try:
            said: dict[str, float | str] = {"value": call(Path(directory), file, function)}
        except BaseException as error:
            said = {"error": " ".join(f"{type(error).__name__}: {error}".split())}
        json.dump(said, answer)


if __name__ == "__main__":
    main(*sys.argv[1:])
