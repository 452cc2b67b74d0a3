"""The README's table of layers is true: imports go from a later layer to an earlier one, or stay inside."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SOURCES = {path.stem: path for path in (ROOT / "src" / "calstudy").glob("*.py") if path.stem[0] != "_"}
SOURCES |= {f"analysis.{path.stem}": path for path in (ROOT / "analysis").glob("*.py") if path.stem[0] != "_"}


def layers() -> list[list[str]]:
    """Modules of each layer, from the README's architecture table."""
    readme = (ROOT / "README.md").read_text()
    section = readme.split("## Architecture")[1].split("\n## ")[0]
    rows = [line.split("|") for line in section.splitlines() if re.match(r"\|\s*\d", line)]
    return [re.findall(r"`([\w.]+)`", row[2]) for row in rows]


def imported(source: str) -> set[str]:
    """Modules of calstudy that a source imports anywhere, in functions too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module == "calstudy":
            names |= {alias.name for alias in node.names if alias.name in SOURCES}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("calstudy."):
            names.add((node.module or "").removeprefix("calstudy."))
        elif isinstance(node, ast.Import):
            names |= {a.name.removeprefix("calstudy.") for a in node.names if a.name.startswith("calstudy.")}
    return names & set(SOURCES)


def violations(sources: dict[str, str]) -> list[str]:
    place = {module: k for k, modules in enumerate(layers()) for module in modules}
    return [
        f"{module} imports {other}"
        for module, source in sources.items()
        for other in imported(source)
        if place[other] > place[module]
    ]


def test_every_module_stands_in_one_layer() -> None:
    named = [module for modules in layers() for module in modules]
    assert sorted(named) == sorted(SOURCES)


def test_imports_go_one_way() -> None:
    assert violations({module: path.read_text() for module, path in SOURCES.items()}) == []


@pytest.mark.parametrize(
    "line", ["from calstudy.cli import main", "from calstudy import cli", "import calstudy.cli"]
)
def test_an_import_the_wrong_way_is_found(line: str) -> None:
    assert violations({"errors": line}) == ["errors imports cli"]
