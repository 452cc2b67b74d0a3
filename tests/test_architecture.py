"""Imports between the wings go one way, no corridor and no room is too long, and README's table is true."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
HALL = "calstudy"
MAY_IMPORT = {
    HALL: (),
    "engines": (HALL,),
    "models": (HALL, "engines"),
    "calibration": (HALL,),
    "study": (HALL, "engines", "models", "calibration"),
    "emulator": (HALL, "engines", "models", "calibration", "study"),
    "analysis": (HALL, "engines", "models", "calibration", "study", "emulator"),
    "report": (HALL, "engines", "models", "calibration", "study", "emulator", "analysis"),
    "ui": (HALL, "engines", "models", "calibration", "study", "emulator", "analysis", "report"),
    "cli": (HALL, "engines", "models", "calibration", "study", "emulator", "analysis", "report", "ui"),
}
"""The one import rule: hall <- engines <- models <- study <- emulator <- analysis <- report <- ui <- cli, and
calibration, which knows the hall alone, before study."""
MOST_ROOMS = 12
MOST_LINES = 400
DOORS = {"calstudy", "calstudy.__main__"}
"""Doors into the house: the package itself, which loads a wing when it is asked for, and ``python -m``."""


def sources() -> dict[str, Path]:
    """Path of each module by its dotted name."""
    found = {}
    for top, package in ((ROOT / "src" / "calstudy", "calstudy"), (ROOT / "analysis", "calstudy.analysis")):
        for path in sorted(top.rglob("*.py")):
            parts = path.relative_to(top).with_suffix("").parts
            found[".".join([package, *parts]).removesuffix(".__init__")] = path
    return found


SOURCES = sources()


def wing(module: str) -> str:
    """Wing that a module of calstudy stands in."""
    second = module.split(".")[1] if "." in module else ""
    return second if second in MAY_IMPORT else HALL


def imported(source: str) -> set[str]:
    """Modules of calstudy that a source imports anywhere, in functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module:
            below = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= (below & set(SOURCES)) or {node.module}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return {name for name in names if name.split(".")[0] == "calstudy"}


def violations(contents: dict[str, str]) -> list[str]:
    return [
        f"{module} imports {other}"
        for module, content in contents.items()
        for other in sorted(imported(content))
        if other not in DOORS and wing(other) not in (wing(module), *MAY_IMPORT[wing(module)])
    ]


def rooms() -> dict[str, list[str]]:
    """Modules of each corridor: a wing, or a folder of it."""
    found: dict[str, list[str]] = {}
    for module, path in SOURCES.items():
        if path.stem[0] != "_":
            found.setdefault(module.rpartition(".")[0], []).append(path.stem)
    return found


def test_imports_go_one_way() -> None:
    inside = {module: path.read_text() for module, path in SOURCES.items() if module not in DOORS}
    assert violations(inside) == []


@pytest.mark.parametrize(
    "line",
    ["from calstudy.cli.main import main", "from calstudy.cli import main", "import calstudy.cli.main"],
)
def test_an_import_the_wrong_way_is_found(line: str) -> None:
    assert len(violations({"calstudy.errors": line})) == 1


def test_the_procedure_knows_no_dem() -> None:
    assert len(violations({"calstudy.calibration.cost": "from calstudy.models import geometry"})) == 1


def names_the_heap(contents: dict[str, str]) -> list[str]:
    """Modules outside its own wing and the paper's exhibits that take names of the angle-of-repose model."""
    return [
        module
        for module, content in contents.items()
        if wing(module) not in ("models", "analysis")
        and ("calstudy.models.heap" in imported(content) or re.search(r"\bAngleOfReposeModel\b", content))
    ]


def test_only_its_own_wing_and_the_papers_exhibits_name_the_angle_of_repose() -> None:
    assert names_the_heap({module: path.read_text() for module, path in SOURCES.items()}) == []
    assert names_the_heap({"calstudy.study.schema": "from calstudy.models.heap import MEASURED"})
    assert names_the_heap({"calstudy.study.run": "isinstance(model, AngleOfReposeModel)"})


def test_no_corridor_has_more_than_twelve_rooms() -> None:
    assert {corridor: names for corridor, names in rooms().items() if len(names) > MOST_ROOMS} == {}


def test_no_room_has_more_than_four_hundred_lines() -> None:
    lines = {module: len(path.read_text().splitlines()) for module, path in SOURCES.items()}
    assert {module: count for module, count in lines.items() if count > MOST_LINES} == {}


def test_the_readme_names_each_wing_with_its_rooms() -> None:
    section = (ROOT / "README.md").read_text().split("## Architecture")[1].split("\n## ")[0]
    told = {name: int(count) for name, count in re.findall(r"^\| `(\w+)` \|.*\| (\d+) \|$", section, re.M)}
    there: dict[str, int] = dict.fromkeys(MAY_IMPORT, 0)
    for corridor, names in rooms().items():
        there[wing(f"{corridor}.room")] += len(names)
    assert told == there


def test_every_corridor_is_part_of_the_wheel() -> None:
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
    assert set(rooms()) <= set(tool["setuptools"]["packages"])


def test_type_checkers_find_each_folder_where_it_is_installed() -> None:
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]
    for package, folder in tool["setuptools"]["package-dir"].items():
        assert (ROOT / "src" / package.replace(".", "/")).samefile(ROOT / folder)
    ignored = [name for override in tool["mypy"]["overrides"] for name in override["module"]]
    assert [name for name in ignored if name.startswith("calstudy")] == []


def test_no_test_file_imports_from_another() -> None:
    found = {
        path.name: sorted(found)
        for path in sorted((ROOT / "tests").glob("test_*.py"))
        if (found := set(re.findall(r"^\s*(?:from|import) (test_\w+)", path.read_text(), re.M)))
    }
    assert found == {}
