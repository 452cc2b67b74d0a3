"""The shipped material tests as their tests need them: their Python files, and one real run of each."""

import importlib.util
import tempfile
import threading
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from calstudy.engines.choose import profile_of
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.liggghts import LOG, markers
from calstudy.errors import SetupError
from calstudy.models.find import SHIPPED
from calstudy.models.folder import load_folder
from calstudy.records import Run

_SCRATCH = tempfile.TemporaryDirectory(prefix="calstudy-tests-")


def measures(name: str) -> ModuleType:
    """The Python file of a test's folder."""
    return module(SHIPPED / name / f"{name}.py")


def proof(name: str) -> ModuleType:
    """A script of the material tests' reports."""
    return module(Path(__file__).parent.parent / "reports" / "material_tests" / f"{name}.py")


def module(path: Path) -> ModuleType:
    """A Python file as a module of its own."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


@cache
def tiny_run(name: str, **changes: float) -> tuple[Run, dict[str, str], Path]:
    """A real run of a test's tiny fidelity: its record, what its log marked, and its directory.

    ``changes`` are of parameters and of what the model holds fixed.
    """
    folder = SHIPPED / name
    known = load_folder(folder).fixed
    fixed = {key: value for key, value in changes.items() if key in known}
    model = load_folder(folder, insist=True, fidelity="tiny", changes=fixed)
    parameters = dict(model.reference) | {key: v for key, v in changes.items() if key not in fixed}
    try:
        engine = ProgramEngine(model, profile_of().find(None))
    except SetupError as error:
        pytest.fail(f"these tests need the real LIGGGHTS: {error}", pytrace=False)
    directory = Path(tempfile.mkdtemp(dir=_SCRATCH.name)) / "run"
    run = engine.run(parameters, 1, directory, threading.Event())
    return run, markers(directory / LOG), directory
