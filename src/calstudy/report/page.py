"""The report as one HTML page that needs nothing else: pictures inlined, no script, no network."""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence

from calstudy.analysis.exhibit import Picture, Table, to_html

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; background: #fff; max-width: 75rem;
  margin: 0 auto; padding: 0 1rem 3rem; overflow-wrap: break-word; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 1.5rem 0 .5rem; }
h2 { font-size: 1.15rem; line-height: 1.3; margin: 0 0 .5rem; }
nav a { display: inline-block; margin-right: .8rem; color: #00527f; }
section { margin: 2.2rem 0; padding-top: .8rem; border-top: 1px solid #bbb; }
table { border-collapse: collapse; width: 100%; font-size: .82rem; }
th, td { text-align: left; vertical-align: top; padding: .25rem .5rem; border-bottom: 1px solid #ddd; }
th { border-bottom: 2px solid #333; }
#study td { overflow-wrap: anywhere; }
td[data-heading=Verdict] { font-weight: bold; }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
p.note { font-size: .85rem; color: #444; margin: .4rem 0; }
figure { margin: 0; }
figure img { max-width: 100%; height: auto; display: block; margin: 0 auto; }
@media (max-width: 45rem) {
  table.wide thead { display: none; }
  table.wide tr { display: block; padding: .4rem 0; border-bottom: 2px solid #999; }
  table.wide td { display: grid; grid-template-columns: 8.5rem minmax(0, 1fr); gap: .5rem; border: 0;
    padding: .1rem 0; white-space: normal; }
  table.wide td::before { content: attr(data-heading); color: #555; }
  table.wide td.empty { display: none; }
  table:not(.wide) { font-size: .75rem; }
  table:not(.wide) :is(th, td) { padding: .2rem .15rem; }
}
@media print {
  @page { size: A4 landscape; margin: 12mm; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  table { font-size: 7pt; line-height: 1.25; }
  th, td { padding: .1rem .3rem; }
  section { margin: 1rem 0; }
  nav { display: none; }
  thead { display: table-header-group; }
  tr, figure { break-inside: avoid; }
  h2 { break-after: avoid; }
  figure img { max-height: 150mm; }
}
"""


def page(title: str, lead: str, facts: Mapping[str, str], parts: Sequence[Table | Picture]) -> str:
    """The whole page: what the study is, then each table and figure in a section of its own."""
    links = " ".join(f'<a href="#{part.name}">{html.escape(part.title.split(":")[0])}</a>' for part in parts)
    rows = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(value)}</td></tr>'
        for name, value in facts.items()
    )
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8"/>',
            '<meta name="viewport" content="width=device-width, initial-scale=1"/>',
            '<link rel="icon" href="data:,"/>',
            f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>",
            f"<h1>{html.escape(title)}</h1>",
            f"<p>{html.escape(lead)}</p>",
            f"<nav>{links}</nav>",
            f'<section id="study"><h2>The study</h2><table><tbody>{rows}</tbody></table></section>',
            *map(_section, parts),
            "</body></html>",
            "",
        ]
    )


def _section(part: Table | Picture) -> str:
    notes = "".join(f'<p class="note">{html.escape(note)}</p>' for note in part.notes)
    head = f'<section id="{part.name}"><h2>{html.escape(part.title)}</h2>'
    if isinstance(part, Table):
        return f"{head}{to_html(part)}{notes}</section>"
    data = base64.b64encode(part.files["svg"]).decode()
    image = f'<img src="data:image/svg+xml;base64,{data}" alt="{html.escape(part.title)}"/>'
    return f"{head}<figure>{image}<figcaption>{notes}</figcaption></figure></section>"
