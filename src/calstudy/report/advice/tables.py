"""Advice as tables: on the terminal, as a page, as files, for machines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from calstudy import __version__
from calstudy.analysis.exhibit import Column, Picture, Table, render, to_csv
from calstudy.disk.files import write_atomically
from calstudy.emulator.advice.advice import TELLS, Advice
from calstudy.emulator.advice.laboratory import NOT_COUNTED, USUAL
from calstudy.errors import SetupError
from calstudy.report.advice.pictures import draw_left, draw_overlap
from calstudy.report.page import page
from calstudy.report.terminal import Column as TerminalColumn
from calstudy.report.terminal import fitted

ON_TERMINAL = ("tests", "pairs")
"""Tables that are printed."""


def advice_tables(advice: Advice) -> list[Table]:
    """Single tests, pairs, responses with their errors, overlaps."""
    tests, responses = advice.tests_table(), advice.responses_table()
    tests = tests.assign(remark=[_remark(line) for line in tests.to_dict("records")])
    shares = [Column(f"left_{name}", name, ".2f") for name in advice.names]
    shares += [Column(f"direction_{k}", f"way {k}", ".2f") for k in range(1, 1 + len(advice.directions))]
    rest = (Column("hours", "DEM hours", ".2g"), Column("volume", "volume", ".2g"), *shares)
    columns = (Column("tests", "test"), *rest, Column("remark", ""))
    parts = [
        Table(name, title, tests[tests["number"] == number].drop(columns="number"), columns, notes)
        for name, title, number, notes in (
            ("tests", "What one more test would leave", 1, _notes(advice)),
            ("pairs", "What two more tests would leave", 2, ()),
        )
        if (tests["number"] == number).any()
    ]
    reasons = [
        USUAL[key].reason if key in USUAL else "given"
        for key in zip(responses["test"], responses["response"], strict=True)
    ]
    responses = responses.assign(reason=reasons)
    of = (Column("test", "test"), Column("response", "response"), Column("error", "error", ".3g"))
    out = [f"{test}, {response}: {why}" for (test, response), why in NOT_COUNTED.items()]
    parts.append(
        Table(
            "responses",
            "What one response alone would leave",
            responses,
            (*of, *rest[1:], Column("reason", "why this error")),
            [f"Not counted: {'; '.join(out)}. Give --error to count one."],
        )
    )
    pairs = advice.overlap()
    if len(pairs):
        named = [Column(c, c.replace("_", " ")) for c in pairs.columns[:4]]
        form = [Column("nats", "nats", ".2f"), Column("overlap", "overlap", ".2f")]
        parts.append(Table("overlap", "Which responses say the same", pairs, (*named, *form)))
    return parts


def lead(advice: Advice) -> str:
    """The advice in words: what tells most, what tells most for an hour, what is redundant."""
    table = advice.tests_table()
    single = table[table["number"] == 1]
    best = single.iloc[0]
    words = [_told(best)]
    paid = single[single["hours"] > 0]
    if len(paid) > 1:
        rate = (paid["nats"] / paid["hours"]).to_numpy()
        cheap = paid.iloc[int(np.argmax(rate))]
        if cheap["tests"] != best["tests"]:
            words.append(f"For an hour of DEM, {cheap['tests']} tells most.")
    if idle := list(single.loc[single["told"] == "", "tests"]):
        words.append(f"{' and '.join(idle)} would tell nothing new.")
    pairs = table[table["number"] == 2]
    if len(pairs):
        two = pairs.iloc[0]
        words.append(f"Of the pairs {two['tests']} leaves least: {two['volume']:.2g} of the volume.")
    return " ".join(words)


def _told(line: pd.Series) -> str:
    what = f"narrows {line['told']}" if line["told"] else "narrows no parameter"
    return (
        f"Most is to be expected of {line['tests']}: it leaves {line['volume']:.2g} of the solution space's "
        f"volume, {what}, and takes {line['hours']:.2g} DEM hours."
    )


def _remark(line: dict[Any, Any]) -> str:
    few = ["a guess: too little is left for the sample"] if line["few"] else []
    if line["number"] == 1:
        return "; ".join(["tells nothing new"] * (line["told"] == "") + few)
    return "; ".join([f"{line['redundant']} adds nothing"] * (line["redundant"] != "") + few)


def _notes(advice: Advice) -> list[str]:
    """What the numbers are, and what is not known."""
    runs, now = advice.question.procedure.runs, advice.question.now
    known = (
        "the solution space of the study"
        if now.points is not None
        else "what calibrations to the file's targets would leave, by the emulators"
        if now.targets
        else "the whole box: nothing is measured"
    )
    of = ", ".join(
        f"{t.name} {t.emulator.version} ({t.emulator.origin.fidelity})"
        for t in advice.question.tests.values()
    )
    notes = [
        f"Known now: {known}. Shares of the standard deviation of each parameter, and of the volume, that a "
        f"calibration with the test is expected to leave, of {runs.total} DEM runs each ({runs.samples} "
        f"samples, {runs.trials} of the second optimisation, {runs.again} to confirm it). Emulators: {of}.",
        f"A test tells of a parameter if it leaves less than {TELLS:g}.",
    ]
    notes += [f"way {k}: {words}." for k, words in enumerate(advice.directions_in_words, start=1)]
    return notes + [f"Not known: {note}." for note in advice.question.notes]


def as_json(advice: Advice) -> dict[str, Any]:
    """The advice for machines."""
    return {
        "advice": lead(advice),
        "runs": advice.question.procedure.runs.total,
        "tests": advice.tests_table().to_dict("records"),
        "responses": advice.responses_table().to_dict("records"),
        "overlap": advice.overlap().to_dict("records"),
        "directions": advice.directions_in_words,
        "emulators": {name: test.emulator.version for name, test in advice.question.tests.items()},
        "notes": list(advice.question.notes),
    }


def print_advice(console: Console, advice: Advice) -> None:
    """Print single tests and pairs, and the advice in words."""
    for table in advice_tables(advice):
        if table.name not in ON_TERMINAL:
            continue
        columns = [
            TerminalColumn(
                column.heading, list(cells), right=bool(column.form), folds=column.name == "remark"
            )
            for column, cells in zip(table.columns, zip(*table.cells(), strict=True), strict=True)
        ]
        for shown in fitted(columns, console.width, table.title):
            console.print(shown)
        for note in table.notes:
            console.print(note, highlight=False, soft_wrap=True)
    console.print(lead(advice), highlight=False, soft_wrap=True)


def write_advice(advice: Advice, directory: Path, made_by: str) -> list[Path]:
    """Write page, tables and pictures; SetupError where that cannot be done."""
    tables = advice_tables(advice)
    left = Picture(
        "left",
        "What is left",
        render(draw_left(advice), ("svg", "png")),
        ["A line for each test, pair, response."],
    )
    pictures = [left]
    if len(advice.overlap()):
        said = (
            "Diagonal: nats that a response tells alone. Below, the overlap: the share of the smaller of two "
            "that the other tells, too. At 0 what both tell adds up, at 1 one tells nothing more."
        )
        drawn = render(draw_overlap(advice), ("svg", "png"))
        pictures.append(Picture("overlaps", "Which responses say the same", drawn, [said]))
    html = page(
        "What each test would tell",
        lead(advice),
        {"made by": f"calstudy {__version__}: {made_by}"},
        [
            *(t for t in tables if t.name in ON_TERMINAL),
            *pictures,
            *(t for t in tables if t.name not in ON_TERMINAL),
        ],
    )
    contents = {"advice.html": html.encode()}
    contents |= {f"{table.name}.csv": to_csv(table).encode() for table in tables}
    contents |= {f"{picture.name}.png": picture.files["png"] for picture in pictures}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            write_atomically(directory / name, content, directory)
    except OSError as error:
        raise SetupError(f"{directory}: cannot be written: {error.strerror}; choose another --out") from error
    return [directory / name for name in contents]
