"""The built wheel holds the plan, the models and the analysis, and works from there."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from calstudy.emulator.benchmark.emulated import KEPT

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--quiet", "--no-deps"]
    # Built from a copy, so that no build directory appears in the project.
    copy = folder / "project"
    copied = ["pyproject.toml", "README.md", "LICENSE", "src", "plans", "analysis", "liggghts_models"]
    copy.mkdir()
    subprocess.run(["cp", "-r", *(str(ROOT / name) for name in copied), str(copy)], check=True)
    subprocess.run([*command, "--wheel-dir", str(folder), str(copy)], check=True, capture_output=True)
    return next(folder.glob("*.whl"))


def test_the_wheel_holds_all_data(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    emulators = ROOT.glob("liggghts_models/*/emulators/*")
    models = [str(path.parent.relative_to(ROOT)) for path in ROOT.glob("liggghts_models/*/model.toml")]
    folders = ["plans", *models, "analysis", "analysis/published"]
    for folder in [*folders, *(str(path.relative_to(ROOT)) for path in emulators)]:
        there = {p.name for p in (ROOT / folder).iterdir() if p.is_file()}
        assert {f"calstudy/{folder}/{name}" for name in there} <= names
    assert "calstudy/report/page.css" in names
    for top, package in (("src/calstudy", "calstudy"), ("analysis", "calstudy/analysis")):
        modules = {path.relative_to(ROOT / top).as_posix() for path in (ROOT / top).rglob("*.py")}
        assert {f"{package}/{module}" for module in modules} <= names
    kept = (path for path in KEPT.rglob("*") if path.is_file())
    assert {f"calstudy/{path.relative_to(ROOT / 'src' / 'calstudy').as_posix()}" for path in kept} <= names


def test_the_wheel_works_where_the_project_is_not(wheel: Path, tmp_path: Path) -> None:
    target = tmp_path / "installed"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    code = (
        f"import sys; sys.path.insert(0, {str(target)!r}); import calstudy;"
        f"assert {str(target)!r} in calstudy.__file__;"
        "from calstudy.plan_file import load_plan; from calstudy.models.angle_of_repose import load_model;"
        "from calstudy.analysis import claims, table5;"
        "from calstudy.analysis.published import published; assert len(published('table5')) == 21;"
        "print(len(load_plan().rows), len(load_model(load_plan().fixed, 'soft').files))"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["72", "4"], done.stderr
