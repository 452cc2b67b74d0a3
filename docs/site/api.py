"""The Python reference: one page for each package of calstudy, from the docstrings of what is there."""

from __future__ import annotations

import pkgutil
from collections import defaultdict
from importlib import import_module


def modules(package: str) -> dict[str, list[str]]:
    """Public modules of each package from ``package`` down, by the package's name."""
    found: dict[str, list[str]] = defaultdict(list)
    found[package] = []
    for module in pkgutil.walk_packages(import_module(package).__path__, f"{package}."):
        name = module.name.rpartition(".")[2]
        if name.startswith("_"):
            continue
        if module.ispkg:
            found[module.name] += []
        else:
            found[module.name.rpartition(".")[0]].append(module.name)
    return dict(found)


def heading(name: str) -> str:
    """First sentence of a module's docstring."""
    return (import_module(name).__doc__ or "").strip().split("\n\n")[0].replace("\n", " ").replace("|", "\\|")


def page(package: str, names: list[str]) -> str:
    """Markdown of one package: its own docstring, then each module's."""
    parts = [f"# {package}", f"```{{eval-rst}}\n.. automodule:: {package}\n```"]
    for name in names:
        title = name.removeprefix(f"{package}.")
        parts.append(f"## {title}\n\n```{{eval-rst}}\n.. automodule:: {name}\n```")
    return "\n\n".join(parts) + "\n"


def api_pages() -> dict[str, str]:
    """Pages of all packages, and the table of the page api.md, by their path in the site."""
    found = modules("calstudy")
    table = ["| package | what it is |", "|---|---|"]
    table += [f"| [`{name}`](api/{name}.md) | {heading(name)} |" for name in found]
    pages = {f"reference/api/{name}.md": page(name, names) for name, names in found.items()}
    return {"reference/api/table.txt": "\n".join(table), **pages}
