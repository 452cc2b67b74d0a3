"""What the documentation says is what the program does."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from calstudy.cli import main
from calstudy.errors import EXIT_CODES
from calstudy.liggghts import VARIABLE
from calstudy.model import load_model
from calstudy.plan import load_plan
from calstudy.schema import TABLES, markdown

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
NOTES = ROOT / "liggghts_models" / "angle_of_repose" / "NOTES.md"
MARKDOWN = [
    *sorted(ROOT.glob("*.md")),
    *(
        page
        for folder in ("docs", "liggghts_models", "reports")
        for page in sorted((ROOT / folder).rglob("*.md"))
    ),
]


def test_the_tables_are_documented_as_they_are() -> None:
    assert markdown().strip() in (ROOT / "docs" / "data.md").read_text()


def test_every_column_has_a_meaning() -> None:
    assert all(column.meaning for columns in TABLES.values() for column in columns)


@pytest.mark.parametrize("page", [*PAGES, NOTES], ids=lambda p: p.name)
def test_every_link_within_the_project_leads_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", page.read_text())
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert missing == []


def test_the_readme_names_every_fidelity_and_variant() -> None:
    readme = (ROOT / "README.md").read_text()
    fixed = load_plan().fixed
    for name in ("full", "fast", "soft", "coarse", "tiny"):
        fidelity = load_model(fixed, name).fidelity
        row = next(line for line in readme.splitlines() if line.startswith(f"| `{name}`"))
        assert f"{1e3 * fidelity.particle_diameter:g} mm" in row
        assert f"{fidelity.time_step_share:g}" in row
        assert "YM as given" in row if fidelity.softening == 1 else f"YM/{fidelity.softening:g}" in row
    assert VARIABLE in readme


def test_the_help_lists_every_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert all(meaning in text for meaning in EXIT_CODES.values())


def test_every_command_of_the_readme_is_one() -> None:
    readme = (ROOT / "README.md").read_text()
    block = readme.split("## Use")[1].split("```bash")[1].split("```")[0]
    commands = [line.split("#")[0].split() for line in block.splitlines() if line.startswith("calstudy")]
    assert len(commands) >= 8
    for words in commands:
        verb = words[1:3] if words[1] in ("plan", "emulator") else words[1:2]
        with pytest.raises(SystemExit) as ended:
            main([*verb, "--help"])
        assert ended.value.code == 0


# ---- Markdown renders as it is meant ----------------------------------------------------------------


def broken_tables(text: str) -> list[str]:
    """Lines that GitHub renders as pipes, or with another number of cells than their table's heading."""
    lines, broken = text.splitlines(), []
    for token in MarkdownIt("commonmark").enable("table").parse(text):
        first, end = token.map or (0, 0)
        if token.type == "paragraph_open":
            broken += [line for line in lines[first:end] if line.lstrip(" >").startswith("|")]
        elif token.type == "table_open":
            cells = [len(re.findall(r"(?<!\\)\|", line)) for line in lines[first:end]]
            broken += [line for line, n in zip(lines[first:end], cells, strict=True) if n != cells[0]]
    return broken


@pytest.mark.parametrize("page", MARKDOWN, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_table_renders_as_a_table(page: Path) -> None:
    assert broken_tables(page.read_text()) == []


@pytest.mark.parametrize(
    "text",
    [
        "| a | b |\n|---|---|\n| 1 | 2 |\n\n| 3 | 4 |",  # the second half has no heading
        "text\n\n| a | b |\n| 1 | 2 |",
        "| a | b |\n|---|---|\n| 1 |",
        "| a | b |\n|---|---|\n| 1 | 2 | 3 |",
    ],
)
def test_a_broken_table_is_found(text: str) -> None:
    assert len(broken_tables(text)) >= 1
    assert broken_tables("| a | b |\n|---|---|\n| 1 | `x \\| y` |\n\n```\n| not | a | table\n```") == []
