"""The shipped material tests as their tests need them: their Python files, and one real run of each."""

import importlib.util
import math
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
from calstudy.records import Outcome, Run
from calstudy.study.definition import Definition, read_definition

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

    ``changes`` are of parameters and of what the model holds fixed. Every such run must give all responses.
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
    assert run.outcome is Outcome.OK, run.reason
    assert all(math.isfinite(value) for value in run.responses.values()), run.responses
    return run, markers(directory / LOG), directory


FILE = """mode = "robust"
seed = 1
WRL = 0.0
[[models]]
name = "shear_cell"
fidelity = "tiny"
[models.material]
{material}
[parameters]
DENS = 1500.0
MU_PP = [0.1, 0.6]
MU_PW = 0.3
RF_PP = 0.05
RF_PW = 0.01
YM = 5e8
{more}
[targets]
steady_state_angle_deg = {{ value = 30.0, tolerance = 1.0 }}
"""
"""Of a calibration of the shear cell; its material begins on line 8."""


def defined(tmp_path: Path, material: str, more: str = "") -> Definition:
    """A calibration with a material, and more parameters."""
    path = tmp_path / "mine.toml"
    path.write_text(FILE.format(material=material, more=more))
    return read_definition(path)
