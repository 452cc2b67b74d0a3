"""Writes all pages of the site into a directory: those of docs/, Markdown from elsewhere, and generated ones.

Links that leave docs/ are turned into links within the site: Markdown is shown as a page, a module by its
reference, any other file as a download; a directory loses its link. GitHub shows the same pages as they are.

python docs/site/prepare.py DIRECTORY
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from pathlib import Path

from api import api_pages
from commands import command_pages

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOT_PAGES = ("site", "pictures")
"""Folders of docs/ that hold no pages."""
ELSEWHERE = {
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "docs/site/README.md": "site/README.md",
    "README.md": "index.md",
    "liggghts_models/angle_of_repose/NOTES.md": "reference/angle_of_repose.md",
    "liggghts_models/angle_of_repose_lammps/NOTES.md": "reference/angle_of_repose_lammps.md",
    "liggghts_models/angle_of_repose_yade/NOTES.md": "reference/angle_of_repose_yade.md",
    "liggghts_models/draw_down/NOTES.md": "reference/draw_down.md",
    "liggghts_models/rotating_drum/NOTES.md": "reference/rotating_drum.md",
    "liggghts_models/uniaxial_compression/NOTES.md": "reference/uniaxial_compression.md",
    "liggghts_models/shear_cell/NOTES.md": "reference/shear_cell.md",
    "reports/angle_of_repose/PLATE.md": "reports/plate.md",
    "reports/angle_of_repose/tables.md": "reports/angle_of_repose.md",
    "benchmarks/peers/README.md": "reports/peers.md",
    "reports/benchmark/README.md": "reports/benchmark.md",
    "reports/readings/README.md": "reports/readings.md",
    "reports/benchmark/tables.md": "reports/benchmark_tables.md",
    "reports/coarse-rows/README.md": "reports/coarse-rows.md",
    "reports/cross_code/README.md": "reports/cross_code.md",
    "reports/cross_code/tables.md": "reports/cross_code_tables.md",
    "reports/emulated/README.md": "reports/emulated.md",
    "reports/emulator/README.md": "reports/emulator.md",
    "reports/fast/README.md": "reports/fast.md",
    "reports/glass_beads/README.md": "reports/glass_beads.md",
    "reports/material_tests/cohesive_powder/README.md": "reports/cohesive_powder.md",
    "reports/material_tests/compression_curve/README.md": "reports/compression_curve.md",
    "reports/material_tests/three_tests/README.md": "reports/three_tests.md",
    "reports/materials/README.md": "reports/material_cards.md",
    "reports/next_test/README.md": "reports/next_test.md",
    "reports/next_test/more_tests/README.md": "reports/more_tests.md",
    "reports/soft/README.md": "reports/soft.md",
    "reports/solution_space/README.md": "reports/solution_space.md",
    "reports/two_fidelities/README.md": "reports/two_fidelities.md",
    "tests/golden/README.md": "reports/golden.md",
}
"""Markdown files outside docs/, and the pages of the site that show them."""
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
FENCED = re.compile(r"(^```.*?^```\s*?$)", re.MULTILINE | re.DOTALL)
INCLUDED = re.compile(r"^(```\{literalinclude\} )(\S+)", re.MULTILINE)
PACKAGES = {"src/calstudy/": "calstudy.", "analysis/": "calstudy.analysis."}


def page_of(path: str) -> str | None:
    """The site's page that shows a Markdown file of the repository, or None; both paths are relative."""
    if path in ELSEWHERE:
        return ELSEWHERE[path]
    inside = path.removeprefix("docs/")
    return inside if inside != path and inside.endswith(".md") else None


def linked(text: str, source: str, out: Path) -> str:
    """The page's text with its links turned to the site; ``source`` is its path in the repository.

    Files that it links to or shows are copied to ``out``. FileNotFoundError names a link that leads nowhere.
    """
    page = page_of(source) or source

    def one(link: re.Match[str]) -> str:
        mark, words, target = link.groups()
        path, hash_, anchor = target.partition("#")
        if "://" in target or not path:
            return link[0]
        there = os.path.normpath(Path(source).parent / path)
        if not (ROOT / there).exists():
            raise FileNotFoundError(f"{source}: {target}")
        shown = page_of(there)
        if shown is None and (ROOT / there).is_dir():
            return words
        module = next((p + there.removeprefix(f) for f, p in PACKAGES.items() if there.startswith(f)), "")
        if shown is None and module.endswith(".py"):
            return f"{{py:mod}}`{words} <{module.removesuffix('.py').replace('/', '.')}>`"
        if shown is None:
            shown = there.removeprefix("docs/") if there.startswith("docs/") else f"files/{there}"
            (out / shown).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / there, out / shown)
        relative = os.path.relpath(shown, Path(page).parent)
        return f"{mark}[{words}]({relative}{hash_}{anchor})"

    here = (out / page).parent
    text = INCLUDED.sub(lambda m: m[1] + os.path.relpath((ROOT / source).parent / m[2], here), text)
    parts = FENCED.split(text)  # every second one is a block of code
    return "".join(part if k % 2 else LINK.sub(one, part) for k, part in enumerate(parts))


def prepare(out: Path) -> None:
    """Write the pages; what ``out`` held before is removed."""
    shutil.rmtree(out, ignore_errors=True)
    shutil.copytree(DOCS / "site", out / "site", ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    shutil.copyfile(DOCS / "site" / "conf.py", out / "conf.py")
    sources = [
        str(path.relative_to(ROOT))
        for path in sorted(DOCS.rglob("*.md"))
        if path.relative_to(DOCS).parts[0] not in NOT_PAGES
    ]
    sources += [path for path in ELSEWHERE if (ROOT / path).exists() and path != "README.md"]
    pages = {str(page_of(source)): linked((ROOT / source).read_text(), source, out) for source in sources}
    for page, text in {**pages, **command_pages(), **api_pages()}.items():
        (out / page).parent.mkdir(parents=True, exist_ok=True)
        (out / page).write_text(text)


if __name__ == "__main__":
    prepare(Path(sys.argv[1]))
