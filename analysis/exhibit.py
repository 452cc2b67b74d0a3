"""Tables with title, columns and notes, written as CSV, HTML or LaTeX, and rendered figures."""

from __future__ import annotations

import html
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd
from matplotlib import rc_context
from matplotlib.figure import Figure

WIDEST_ON_A_PHONE = 40
"""Characters in a line of a narrow screen. A wider table scrolls, and its first column stays."""
PRINT_LIMIT = 2.2e-16
"""R prints p-values below its machine epsilon as "< 2.2e-16"."""
SURE_DIGITS = 12
"""Digits on which machines agree. The last bits depend on linear algebra and must not decide a tie."""


@dataclass(frozen=True, slots=True)
class Column:
    """A printed column. ``form`` is a format specification, ``p`` for p-values, or empty for text.

    With ``low`` and ``high``, names of columns, their interval is printed after the value.
    """

    name: str
    heading: str
    form: str = ""
    low: str = ""
    high: str = ""

    def cell(self, line: dict[str, Any]) -> str:
        """Text of the column in a line of the table; empty without a value."""
        text = shown(line[self.name], self.form)
        if self.low and not _missing(line[self.low]):
            text = f"{text} [{shown(line[self.low], self.form)}; {shown(line[self.high], self.form)}]"
        return text


@dataclass(frozen=True, slots=True)
class Table:
    """A table: values in full, and how they are printed."""

    name: str
    title: str
    frame: pd.DataFrame
    columns: Sequence[Column]
    notes: Sequence[str] = ()

    def cells(self) -> list[list[str]]:
        """Printed cells, line by line."""
        lines: list[dict[Any, Any]] = self.frame.to_dict("records")
        return [[column.cell(line) for column in self.columns] for line in lines]

    def _repr_html_(self) -> str:
        """The table with its title and notes, for a notebook."""
        notes = "".join(f"<p>{html.escape(note)}</p>" for note in self.notes)
        return f"<p><b>{html.escape(self.title)}</b></p>{to_html(self)}{notes}"


def shown(value: Any, form: str) -> str:
    """A value as it is printed."""
    if _missing(value):
        return ""
    if form == "p":
        value = sure(value)
        # The published 2.2e-16 is R's print limit: it stands for "less than".
        return (
            f"< {PRINT_LIMIT:g}"
            if value <= PRINT_LIMIT
            else f"{value:.4f}"
            if value >= 1e-3
            else f"{value:.2e}"
        )
    if isinstance(value, bool) or not form:
        return str(value)
    return printed(value, form).replace("e+0", "e").replace("e-0", "e-")


def printed(value: Any, form: str) -> str:
    """A number in a format specification. A tie such as 19.625 is rounded alike on every machine."""
    return format(sure(value) if isinstance(value, float) else value, form)


def sure(value: float) -> float:
    """A number rounded to the digits that do not depend on the machine."""
    return float(f"{value:.{SURE_DIGITS}g}")


def _missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and math.isnan(value))


def to_csv(table: Table) -> str:
    """All columns in full precision."""
    return table.frame.to_csv(index=False, lineterminator="\n")


def to_html(table: Table) -> str:
    """The table as HTML. Each cell carries its heading, so that a style can address a column."""
    printed = table.cells()
    head = "".join(f'<th scope="col">{html.escape(c.heading)}</th>' for c in table.columns)
    body = []
    for cells in printed:
        parts = [
            f'<td data-heading="{html.escape(c.heading)}"{_kind(c, text)}>{html.escape(text)}</td>'
            for c, text in zip(table.columns, cells, strict=True)
        ]
        body.append(f"<tr>{''.join(parts)}</tr>")
    # A heading wraps between its words, a cell is taken in full.
    texts = [[*c.heading.split(), *(cells[k] for cells in printed)] for k, c in enumerate(table.columns)]
    wide = ' class="wide"' if sum(max(map(len, column)) for column in texts) > WIDEST_ON_A_PHONE else ""
    return f"<table{wide}><thead><tr>{head}</tr></thead><tbody>\n" + "\n".join(body) + "\n</tbody></table>"


def _kind(column: Column, text: str) -> str:
    kinds = ["number"] if column.form else []
    kinds += [] if text else ["empty"]
    return f' class="{" ".join(kinds)}"' if kinds else ""


def to_latex(table: Table) -> str:
    """A ``longtable`` that needs the packages booktabs and longtable."""
    widths = _widths(table)
    spec = "".join(widths)
    head = " & ".join(latex(c.heading) for c in table.columns) + r" \\"
    lines = [" & ".join(map(latex, cells)) + r" \\" for cells in table.cells()]
    notes = " ".join(latex(note) for note in table.notes)
    return "\n".join(
        [
            "% needs \\usepackage{booktabs,longtable,array}",
            "{\\footnotesize\\setlength{\\tabcolsep}{2pt}",
            f"\\begin{{longtable}}{{{spec}}}",
            f"\\caption{{{latex(table.title)}}}\\label{{tab:{table.name}}}\\\\",
            "\\toprule",
            head,
            "\\midrule",
            "\\endhead",
            *lines,
            "\\bottomrule",
            "\\end{longtable}",
            f"\\noindent {notes}\\par}}",
            "",
        ]
    )


def _widths(table: Table) -> list[str]:
    """Widths of the columns: long text shares the line, the others take their natural width."""
    cells = table.cells()
    longest = [max((len(line[k]) for line in cells), default=0) for k in range(len(table.columns))]
    long = sum(length > 24 for length in longest)
    share = f"p{{{0.9 / max(long, 2) * (0.75 if len(longest) > 6 else 1):.2f}\\linewidth}}"
    return [
        share if n > 24 else ("r" if c.form else "l") for n, c in zip(longest, table.columns, strict=True)
    ]


_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "<": r"\ensuremath{<}",
    ">": r"\ensuremath{>}",
    "|": r"\ensuremath{|}",
}


def latex(text: str) -> str:
    """Text with LaTeX's own characters escaped; a bracket must not look like an option."""
    escaped = "".join(_LATEX.get(character, character) for character in text)
    return f"{{}}{escaped}" if escaped.startswith("[") else escaped


PIXELS_PER_INCH = 200


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawn figure: contents of its files by format, title and notes."""

    name: str
    title: str
    files: Mapping[str, bytes]
    notes: Sequence[str]


def render(figure: Figure, formats: Sequence[str]) -> dict[str, bytes]:
    """Contents of a figure's files by format. The same figure always gives the same bytes."""
    made = {}
    # Laid out once, at one resolution, so that no format depends on which others are requested.
    figure.set_dpi(PIXELS_PER_INCH)
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)  # "none" would be one that draws everything once more for nothing
    # Without these the SVG's ids are random and its date is now.
    with rc_context({"svg.hashsalt": "calstudy"}):
        for name in formats:
            sink = io.BytesIO()
            metadata = {"Date": None} if name == "svg" else {}
            figure.savefig(sink, format=name, dpi=PIXELS_PER_INCH, metadata=metadata)
            made[name] = sink.getvalue()
    return made
