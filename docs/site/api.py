"""The Python reference: one page for each package of calstudy, from the docstrings of what is there."""

from __future__ import annotations

import pkgutil
import tomllib
from importlib import import_module
from pathlib import Path


def modules() -> dict[str, list[str]]:
    """Public modules of each package that is shipped, by the package's name."""
    settings = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    packages = settings["tool"]["setuptools"]["packages"]
    return {package: public(package) for package in packages}


def public(package: str) -> list[str]:
    """Names of the package's modules that have no underscore in front."""
    found = pkgutil.iter_modules(import_module(package).__path__, f"{package}.")
    return [m.name for m in found if not m.ispkg and not m.name.removeprefix(f"{package}.").startswith("_")]


def heading(name: str) -> str:
    """First sentence of a module's docstring."""
    return (
        (import_module(name).__doc__ or "")
        .strip()
        .split("\n\n")[0]
        .replace("\n", " ")
        .replace("|", "\\|")
        .replace("``", "`")
    )


def page(package: str, names: list[str]) -> str:
    """Markdown of one package: its own docstring, then each module's."""
    parts = [f"# {package}", f"```{{eval-rst}}\n.. automodule:: {package}\n```"]
    for name in names:
        title = name.removeprefix(f"{package}.")
        parts.append(f"## {title}\n\n```{{eval-rst}}\n.. automodule:: {name}\n```")
    return "\n\n".join(parts) + "\n"


def api_pages() -> dict[str, str]:
    """Pages of all packages, and the table of the page api.md, by their path in the site."""
    found = modules()
    table = ["| package | what it is |", "|---|---|"]
    table += [f"| [`{name}`](api/{name}.md) | {heading(name)} |" for name in found]
    pages = {f"reference/api/{name}.md": page(name, names) for name, names in found.items()}
    return {"reference/api/table.txt": "\n".join(table), **pages}
