"""A table's printed cells, and its CSV, LaTeX and HTML."""

from __future__ import annotations

import io
import math
import re
from xml.etree import ElementTree

import pandas as pd
import pytest

from calstudy.analysis.exhibit import Column, Table, latex, shown, to_csv, to_html, to_latex
from calstudy.analysis.ledger.claims import _figure
from calstudy.analysis.statistics.estimates import Estimate
from calstudy.analysis.statistics.verdicts import Requirement

NAN = math.nan


@pytest.fixture
def table():
    frame = pd.DataFrame(
        {
            "term": ["MU_PP:RF_PP", "A < B & C"],
            "p": [2.2e-16, NAN],
            "r": [-0.659, NAN],
            "low": [-0.811, NAN],
            "high": [-0.4213, NAN],
            "why_not": ["", "n = 2: a correlation needs 3 rows"],
        }
    )
    columns = (
        Column("term", "Term"),
        Column("p", "p", "p"),
        Column("r", "r [95 %]", "z.3f", "low", "high"),
        Column("why_not", "Why not"),
    )
    return Table("table9", "Table 9: 100 % made up", frame, columns, ["A note_with 5 %."])


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (2.2e-16, "p", "< 2.2e-16"),
        (4.8e-60, "p", "< 2.2e-16"),
        (4.99e-10, "p", "4.99e-10"),
        (0.0219, "p", "0.0219"),
        (0.97451, "p", "0.9745"),
        (-1e-9, "z.4f", "0.0000"),
        (2.5412e-6, ".3g", "2.54e-6"),
        (NAN, ".3g", ""),
        ("text", "", "text"),
        (18, "d", "18"),
    ],
)
def test_values_are_printed(value, form, text):
    assert shown(value, form) == text


@pytest.mark.parametrize(
    ("tie", "form", "text"),
    [
        (19.625, ".4g", "19.62"),
        (-0.28125, "z.4f", "-0.2812"),
        (0.00125, "p", "0.0013"),
        (1.5e-6, ".0e", "2e-6"),
    ],
)
def test_the_last_bits_of_a_number_never_decide_a_tie(tie, form, text):
    around = (tie * (1 + k * 2.0**-52) for k in range(-20, 21))
    assert {shown(value, form) for value in around} == {text}


def test_the_ledger_prints_the_same_figure_whatever_the_last_bits_are():
    figures = (19.625 * (1 + k * 2.0**-52) for k in range(-20, 21))
    printed = {_figure(Requirement("effect", Estimate(x, x - 1, x + 1, 72), 0.0)) for x in figures}
    assert printed == {"effect 19.62 [18.62; 20.62]"}


def test_cells_show_intervals_and_leave_out_what_is_not_there(table):
    first, second = table.cells()
    assert first == ["MU_PP:RF_PP", "< 2.2e-16", "-0.659 [-0.811; -0.421]", ""]
    assert second == ["A < B & C", "", "", "n = 2: a correlation needs 3 rows"]


def test_csv_has_every_column_in_full(table):
    back = pd.read_csv(io.StringIO(to_csv(table)), keep_default_na=False, na_values=[""])
    pd.testing.assert_frame_equal(back[["p", "r", "low", "high"]], table.frame[["p", "r", "low", "high"]])
    assert list(back.columns) == list(table.frame.columns)


def test_html_is_well_formed_and_says_each_cells_heading(table):
    root = ElementTree.fromstring(to_html(table))
    cells = [[cell.text or "" for cell in row.iter("td")] for row in root.iter("tr")][1:]
    assert cells == table.cells()
    assert {cell.get("data-heading") for cell in root.iter("td")} == {c.heading for c in table.columns}


def test_latex_has_as_many_cells_in_each_line_as_columns(table):
    text = to_latex(table)
    body = text.split("\\endhead")[1].split("\\bottomrule")[0].strip().splitlines()
    assert len(body) == len(table.frame)
    for line in body:
        assert len(re.findall(r"(?<!\\)&", line)) == len(table.columns) - 1 and line.endswith(r"\\")
    assert r"MU\_PP:RF\_PP" in text and r"100 \% made up" in text and r"note\_with" in text


def test_latex_leaves_no_special_character_bare():
    assert latex(r"a_b & 5 % $x^2$ #1 {z} ~ \n <1>") == (
        r"a\_b \& 5 \% \$x\textasciicircum{}2\$ \#1 \{z\} \textasciitilde{} \textbackslash{}n "
        r"\ensuremath{<}1\ensuremath{>}"
    )
    assert latex("[1; 2]") == "{}[1; 2]"
