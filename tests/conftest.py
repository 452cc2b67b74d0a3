"""Settings of all laws, a study that many tests compare with, and an environment that hides no fault."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# Programs that the tests start run as on a fresh machine: PYTHONUNBUFFERED hides what goes wrong in a buffer.
for name in list(os.environ):
    if name.startswith("PYTHON") or name in {"COLUMNS", "LINES", "NO_COLOR", "FORCE_COLOR"}:
        del os.environ[name]

# What the user has done before is not known here, and is not changed.
os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp(prefix="state-")
atexit.register(shutil.rmtree, os.environ["XDG_STATE_HOME"], ignore_errors=True)

# A busy machine breaks no law, and every run tries the same examples.
settings.register_profile(
    "laws", deadline=None, derandomize=True, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("laws")


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study of two rows on the closed form that nobody disturbed. Copy it before you change it."""
    from campaigns import ROWS  # here, so that tests of other subjects load none of it
    from closed_form import ClosedForm, run_study

    directory = tmp_path_factory.mktemp("studies") / "study"
    run_study(directory, ROWS, engine=ClosedForm(noise=0.01), workers=1)
    return directory


@pytest.fixture
def coarse_profiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """The profiles in a calibration's report take five values each: their search takes half of its time."""
    monkeypatch.setattr("calstudy.calibration.narrowing.GRID", 5)
    monkeypatch.setattr("calstudy.calibration.narrowing.ROUNDS", 2)


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """``calstudy calibrate`` ends with its study: where nobody looks at the report, it is not made."""
    from calstudy.errors import FAILED_ROWS

    monkeypatch.setattr(
        "calstudy.cli.calibrate._print_outcome",
        lambda _, definition, result, *__: FAILED_ROWS if result is None else 0,
    )
