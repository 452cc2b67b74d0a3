"""The report as one self-contained HTML page: pictures inlined, no script, no network."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import TypeAlias

from calstudy.analysis.exhibit import Picture, Table, to_html

LONG = 12
"""A table with more lines is folded away until the reader opens it."""


@dataclass(frozen=True, slots=True)
class Block:
    """Lines to copy."""

    name: str
    title: str
    lines: Sequence[str]
    notes: Sequence[str] = ()


Part: TypeAlias = Table | Picture | Block
"""Content of a section of the page."""


def page(title: str, lead: str, facts: Mapping[str, str], parts: Sequence[Part]) -> str:
    """The whole page: what the study is, a list of contents, and a section for each part."""
    links = "".join(
        f'<li><a href="#{part.name}">{escape(part.title.split(":")[0])}</a></li>' for part in parts
    )
    rows = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>'
        for name, value in facts.items()
    )
    style = (files("calstudy.report") / "page.css").read_text()
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8"/>',
            '<meta name="viewport" content="width=device-width, initial-scale=1"/>',
            '<link rel="icon" href="data:,"/>',
            f"<title>{escape(title)}</title><style>{style}</style></head><body>",
            f"<h1>{escape(title)}</h1>",
            f"<p>{escape(lead)}</p>",
            f'<nav id="contents"><h2>Contents</h2><ul>{links}</ul></nav>',
            f'<section id="study"><h2>The study</h2><table><tbody>{rows}</tbody></table></section>',
            *map(_section, parts),
            "</body></html>",
            "",
        ]
    )


def _section(part: Part) -> str:
    """A part of the page with its title and notes."""
    notes = "".join(f'<p class="note">{escape(note)}</p>' for note in part.notes)
    head = f'<section id="{part.name}"><h2>{escape(part.title)}</h2>'
    back = '<p class="back"><a href="#contents">Back to the contents</a></p>'
    return f"{head}{content_of(part)}{notes}{back}</section>"


def content_of(part: Part) -> str:
    """A picture, block or table as HTML."""
    if isinstance(part, Picture):
        data = base64.b64encode(part.files["svg"]).decode()
        return f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{escape(part.title)}"/></figure>'
    if isinstance(part, Block):
        return f"<pre>{escape(chr(10).join(part.lines))}</pre>"
    # Focus makes the box scroll by keyboard.
    table = f'<div class="scroll" tabindex="0">{to_html(part)}</div>'
    lines = len(part.frame)
    return table if lines <= LONG else f"<details><summary>All {lines} lines</summary>{table}</details>"
