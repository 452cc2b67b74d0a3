"""The command line's reference, generated from its parser."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator

from calstudy.cli.main import Parser, command_line
from calstudy.errors import EXIT_CODES


def commands(parser: Parser) -> Iterator[Parser]:
    """Parsers of all commands that do something, in the order of the help."""
    groups = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    if not groups:
        parser.declare()
        yield parser
    for group in groups:
        for verb in group.choices.values():
            yield from commands(verb)


def page(parser: argparse.ArgumentParser) -> str:
    """Markdown of one command: what it does, its usage, and each argument with its help."""
    os.environ["COLUMNS"] = "88"  # argparse wraps the usage to it
    parts = [f"# {parser.prog}", parser.description or "", "```text\n" + parser.format_usage() + "```"]
    named = [a for a in parser._actions if a.option_strings]
    for title, actions in (
        ("Arguments", [a for a in parser._actions if not a.option_strings]),
        ("Options", named),
    ):
        if actions:
            parts.append(f"## {title}")
        for action in actions:
            names = ", ".join(action.option_strings)
            value = "" if action.nargs == 0 else str(action.metavar or action.dest)
            text = (action.help or "").replace("<", "\\<").replace("*", "\\*")
            parts.append(f"`{' '.join(filter(None, (names, value)))}`\n: {text or 'required'}")
    return "\n\n".join(parts) + "\n"


def command_pages() -> dict[str, str]:
    """Pages of all commands, and the two tables of the page commands.md, by their path in the site."""
    parsers = list(commands(command_line()))
    names = {parser.prog: parser.prog.removeprefix("calstudy ").replace(" ", "-") for parser in parsers}
    table = ["| command | what it does |", "|---|---|"]
    table += [f"| [`{p.prog}`](commands/{names[p.prog]}.md) | {p.description} |" for p in parsers]
    codes = [
        "| code | meaning |",
        "|---|---|",
        *(f"| {code} | {text} |" for code, text in EXIT_CODES.items()),
    ]
    return {
        "reference/commands/table.txt": "\n".join(table),
        "reference/commands/exit_codes.txt": "\n".join(codes),
        **{f"reference/commands/{names[p.prog]}.md": page(p) for p in parsers},
    }
