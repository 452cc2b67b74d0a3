"""What the documentation says is what the program does."""

from __future__ import annotations

import ast
import doctest
import re
import shlex
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from calstudy.cli.main import command_line, main
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.errors import EXIT_CODES
from calstudy.models.angle_of_repose import load_model
from calstudy.models.folder import file as folder
from calstudy.plan_file import load_plan
from calstudy.study.definition import file as definition
from calstudy.study.schema import markdown
from shipped_model import COLUMNS, QUANTITIES

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
IMAGES = ROOT / "docs" / "images"
MARKDOWN = [
    *sorted(ROOT.glob("*.md")),
    *(page for top in ("docs", "liggghts_models", "reports") for page in sorted((ROOT / top).rglob("*.md"))),
]


def test_the_tables_are_documented_as_they_are() -> None:
    assert markdown(QUANTITIES).strip() in (ROOT / "docs" / "reference" / "data.md").read_text()


def test_every_column_has_a_meaning() -> None:
    assert all(column.meaning for columns in COLUMNS.values() for column in columns)


@pytest.mark.parametrize("page", MARKDOWN, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_link_within_the_project_leads_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)#]+)\)", page.read_text())
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert missing == []


def test_the_page_of_fidelities_names_every_one() -> None:
    page = (ROOT / "docs" / "reference" / "fidelities.md").read_text()
    fixed = load_plan().fixed
    for name in ("full", "fast", "soft", "coarse", "tiny"):
        fidelity = load_model(fixed, name).fidelity
        row = next(line for line in page.splitlines() if line.startswith(f"| `{name}`"))
        assert f"{1e3 * fidelity.particle_diameter:g} mm" in row
        assert f"{fidelity.time_step_share:g}" in row
        assert "YM as given" in row if fidelity.softening == 1 else f"YM/{fidelity.softening:g}" in row
    assert LIGGGHTS.variable in (ROOT / "docs" / "reference" / "commands.md").read_text()


def test_the_help_lists_every_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert all(meaning in text for meaning in EXIT_CODES.values())


@pytest.mark.parametrize(
    ("page", "keys"), [("calibration-file.md", definition.KEYS), ("model-toml.md", folder.KEYS)]
)
def test_the_page_of_a_file_names_every_key(page: str, keys: tuple[str, ...]) -> None:
    first_column = re.findall(r"^\| (`[^|]+) \|", (ROOT / "docs" / "reference" / page).read_text(), re.M)
    assert [key for key in keys if not re.search(rf"\b{key}\b", " ".join(first_column))] == []


def test_the_readme_stays_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


# ---- code blocks -----------------------------------------------------------------------------------


def blocks(text: str, language: str) -> list[str]:
    """Fenced blocks of code in that language."""
    return [
        token.content
        for token in MarkdownIt("commonmark").parse(text)
        if token.type == "fence" and token.info.strip() == language
    ]


def commands(block: str) -> list[list[str]]:
    """Words of each command of a block: continued lines joined, comments and here-documents left out."""
    block = re.sub(r"<<'(\w+)'\n.*?^\1$", "", block.replace("\\\n", " "), flags=re.MULTILINE | re.DOTALL)
    lines = (shlex.split(line, comments=True) for line in block.splitlines())
    return [words for words in lines if words]


def unparsed(words: list[str]) -> str:
    """What is wrong with a command of the documentation; empty if nothing is."""
    program, *rest = words
    if program.rpartition("/")[2] == "calstudy":
        try:
            command_line().parse_args(rest)
        except SystemExit as ended:
            return f"{shlex.join(words)}: exit code {ended.code}" if ended.code else ""
    elif program == "python" and rest[0] != "-m" and not (ROOT / rest[0]).is_file():
        return f"{rest[0]} is not there"
    elif program.startswith(("scripts/", ".ci/")) and not (ROOT / program).is_file():
        return f"{program} is not there"
    return ""


@pytest.mark.parametrize("page", MARKDOWN, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_command_of_the_pages_is_one(page: Path) -> None:
    found = [words for block in blocks(page.read_text(), "bash") for words in commands(block)]
    assert [wrong for wrong in map(unparsed, found) if wrong] == []


@pytest.mark.parametrize(
    "line",
    [
        "calstudy plan ran",
        "calstudy plan run --row 1",
        "python docs/none.py",
        ".venv/bin/calstudy x \\\n --y",
    ],
)
def test_a_command_that_is_none_is_found(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert [unparsed(words) for words in commands(line)] != [""]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_the_python_of_the_pages_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Blocks with prompts are run and held to their output, in turn, as one session in a directory that
    # has the repository's reports. Of the others each line that imports calstudy must.
    found = blocks(page.read_text(), "python")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    (tmp_path / "reports").symlink_to(ROOT / "reports")
    session = "\n".join(block for block in found if ">>>" in block)
    test = doctest.DocTestParser().get_doctest(session, {}, page.name, str(page), 0)
    out: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE).run(
        test, out=out.append
    )
    assert "".join(out) == ""
    assert {path.name for path in tmp_path.glob("*.png")} <= {path.name for path in IMAGES.iterdir()}
    for block in found:
        if ">>>" not in block:
            imports = [n for n in ast.walk(ast.parse(block)) if isinstance(n, ast.Import | ast.ImportFrom)]
            own = [ast.unparse(n) for n in imports if "calstudy" in ast.unparse(n)]
            exec("\n".join(own), {})


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


def test_every_report_that_a_page_links_to_is_a_page_of_the_site() -> None:
    source = (ROOT / "docs" / "site" / "prepare.py").read_text()
    pages = ast.literal_eval(re.search(r"^ELSEWHERE = (\{.*?^\})", source, re.M | re.S)[1])
    linked = {
        str((page.parent / link).resolve().relative_to(ROOT))
        for page in PAGES
        for link in re.findall(r"\]\(([^)#:]+\.md)", page.read_text())
    }
    assert {link for link in linked if link.startswith("reports/")} <= set(pages)
