"""Steps 5 and 6: the result, its trade-offs turned by hand, and what is taken away."""

from __future__ import annotations

from dataclasses import dataclass, replace
from html import escape

import numpy as np
from nicegui import run, ui

from calstudy.analysis.exhibit import Picture, Table, to_html
from calstudy.calibration.narrowing import held, weighted_quantiles
from calstudy.calibration.solutions import QUANTILES
from calstudy.errors import CalstudyError
from calstudy.report.calibration import FOLDER, block, lead, parameters_table, responses_table
from calstudy.report.live.pictures import bars_of
from calstudy.report.page import content_of
from calstudy.report.solution_space import narrowing_table, spread_picture
from calstudy.report.terminal import IN_SHORT
from calstudy.study.reading import Result
from calstudy.study.run.project import Project

FEW = 30.0
"""Fewer solutions than that count for little."""
TAKEN = {
    "report.html": "the report, one page with all tables and pictures",
    "material.json": "the material card",
    "parameters.in": "the lines with all digits",
    "solutions.parquet": "the solutions",
}


@dataclass(frozen=True)
class Finished:
    """What steps 5 and 6 show of a result."""

    result: Result
    lead: str
    tables: tuple[Table, ...]
    narrowing: Table
    spread: Picture
    lines: tuple[str, ...]

    @classmethod
    def of(cls, project: Project) -> Finished | None:
        """Computes all of it, which takes seconds the first time; None where there is no result."""
        result = project.result() if project.finished else None
        if result is None:
            return None
        with project.computing:
            return cls(
                result,
                lead(result),
                (responses_table(result), parameters_table(result)),
                narrowing_table(result),
                spread_picture(result),
                tuple(block(result).lines),
            )


async def show_finished(project: Project, result: ui.column, taken: ui.column) -> None:
    """Fill steps 5 and 6, with a word in their place while there is no result."""
    for part in (result, taken):
        part.clear()
        with part:
            ui.label("Reading." if project.finished else "No result yet. Step 4 runs the calibration.")
    if not project.finished:
        return
    try:
        found, why = await run.io_bound(Finished.of, project), "The calibration failed; step 4 says why."
    except CalstudyError as error:
        found, why = None, str(error)
    for part, fill in ((result, _result), (taken, _taken)):
        part.clear()
        with part:
            if found is None:
                ui.label(why).classes("wrong")
            else:
                fill(found, project)


def _result(found: Finished, _: Project) -> None:
    """Step 5."""
    result = found.result
    confirmed = result.confirmed
    ui.label(
        "Not confirmed: no run was made again at the optimum."
        if confirmed is None
        else f"Run again {confirmed.runs} times with fresh seeds at the optimum: all within tolerance with "
        f"probability {confirmed.all_within:.2f}."
    ).classes("verdict")
    ui.label(found.lead)
    for table, kept in zip(found.tables, IN_SHORT, strict=True):
        _table(replace(table, columns=[column for column in table.columns if column.name in kept]))
    ui.label("Turn it by hand").classes("heading")
    ui.label(
        "Move a parameter: the others show what they must do, by the solutions that have it there. Held "
        "ones stay. Grey: all solutions; blue: those that are left; orange: the optimum."
    ).classes("note")
    Tradeoffs(result)
    _table(found.narrowing)
    ui.label(found.spread.title).classes("heading")
    ui.html(content_of(found.spread), sanitize=False).classes("picture")
    for note in found.spread.notes:
        ui.label(note).classes("note")


def _taken(found: Finished, project: Project) -> None:
    """Step 6."""
    lines = "\n".join(found.lines)
    ui.label("Lines for a LIGGGHTS script").classes("heading")
    ui.html(f'<pre tabindex="0" id="lines">{escape(lines)}</pre>', sanitize=False).classes("picture")
    ui.button("Copy", icon="content_copy", on_click=lambda: ui.clipboard.write(lines)).props("no-caps")
    ui.label("Files").classes("heading")
    for name, what in TAKEN.items():
        with ui.row().classes("items-baseline"):
            ui.link(name, f"/files/{name}", new_tab=True)
            ui.label(f"{what}: {project.study / FOLDER / name}").classes("note")


def _table(table: Table) -> None:
    ui.label(table.title).classes("heading")
    ui.html(f'<div class="scroll" tabindex="0">{to_html(table)}</div>', sanitize=False).classes("picture")
    for note in table.notes:
        ui.label(note).classes("note")


class Tradeoffs:
    """Sliders of the parameters, over the solutions."""

    def __init__(self, result: Result) -> None:
        self.result, self.space = result, result.definition.task.space
        self.unit = self.space.box.to_unit(result.solutions.points)
        self.optimum = self.space.box.to_unit(result.optimum_point)
        self.held: dict[int, float] = {}
        self.rows = [self._row(k, name) for k, name in enumerate(self.space.box.names)]
        self.left = ui.label().classes("note")
        self.responses = ui.html("", sanitize=False).classes("picture")
        ui.button("Let all go", on_click=self.release).props("no-caps outline")
        self.show()

    def _row(self, k: int, name: str) -> tuple[ui.checkbox, ui.slider, ui.html, ui.label]:
        with ui.element("div").classes("tradeoff"):
            holds = ui.checkbox(name).on("update:model-value", lambda e: self.hold(k, bool(e.args)))
            with ui.element("div").classes("strip"):
                bars = ui.html("", sanitize=False)
                slider = ui.slider(min=0, max=1, step=0.005, value=float(self.optimum[k]))
                slider.props(f'aria-label="{name}" color="orange-9"')
                slider.on("update:model-value", lambda e: self.turn(k, float(e.args)), throttle=0.05)
            says = ui.label()
        return holds, slider, bars, says

    def turn(self, k: int, value: float) -> None:
        """Hold a parameter at a place of its slider."""
        self.held[k] = value
        self.show()

    def hold(self, k: int, on: bool) -> None:
        """Hold a parameter where its slider is, or let it go."""
        if on:
            self.held[k] = float(self.rows[k][1].value)
        else:
            self.held.pop(k, None)
        self.show()

    def release(self) -> None:
        """Let all parameters go."""
        self.held.clear()
        self.show()

    def show(self) -> None:
        """Show what the others must do."""
        s, task = self.result.solutions, self.result.definition.task
        weights, left = held(self.unit, s.weights, self.held)
        for k, (holds, slider, bars, says) in enumerate(self.rows):
            low, middle, high = weighted_quantiles(
                self.unit[:, k], weights, (QUANTILES[0], 0.5, QUANTILES[1])
            )
            if k in self.held:
                middle = self.held[k]
            name = self.space.box.names[k]
            ends = [self._shown(name, k, u) for u in (low, middle, high)]
            holds.value = k in self.held
            if k not in self.held:  # a held one is where the user has it, who may have moved on meanwhile
                slider.value = float(middle)
            bars.content = bars_of(self.unit[:, k], s.weights, weights, float(self.optimum[k]))
            unit = "" if self.result.units[name] == "-" else f" {self.result.units[name]}"
            says.text = (
                f"held at {ends[1]}{unit}"
                if k in self.held
                else f"{ends[1]}, from {ends[0]} to {ends[2]}{unit}"
            )
        self.left.text = (
            f"{len(self.unit)} solutions; nothing is held."
            if not self.held
            else f"About {left:.0f} of {len(self.unit)} solutions are there."
            + (" Too few to say: hardly any solution has these values." if left < FEW else "")
        )
        mean = weights @ s.responses
        spread = np.sqrt(weights @ (s.responses - mean) ** 2)
        lines = "".join(
            f"<tr><td>{escape(name)}</td><td>{task.cost.target.values[name]:.5g}</td><td>{m:.5g}</td>"
            f"<td>{sd:.2g}</td><td>{escape(self.result.units[name])}</td></tr>"
            for name, m, sd in zip(task.cost.responses, mean, spread, strict=True)
        )
        head = "".join(f"<th>{h}</th>" for h in ("Response", "Target", "Then expected", "+-", "Unit"))
        self.responses.content = f'<div class="scroll"><table><tr>{head}</tr>{lines}</table></div>'

    def _shown(self, name: str, k: int, unit: float) -> str:
        box = self.space.box
        return f"{self.space.shown(name, box.lower[k] + float(unit) * float(box.width[k])):.4g}"
