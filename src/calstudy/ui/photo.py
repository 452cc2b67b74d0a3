"""Step 1: photographs of the heap; outline and scale are dragged, and the angle follows."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from nicegui import run, ui

from calstudy.errors import CalstudyError, MeasurementError
from calstudy.models.photograph.outline import HANDLES, measure_outline, outline_of
from calstudy.models.photograph.photograph import Angles, Photographed, combined, measure_photograph
from calstudy.models.photograph.photographs import METHOD_ERROR_DEG, read_photograph
from calstudy.parameters import Array
from calstudy.ui.project import OWN, PHOTOGRAPHS, PICTURES, Project

MARKS = f"{OWN}/photographs.json"
LARGEST = 50_000_000
"""Bytes of a photograph."""
NEAR = 0.05
"""A handle is taken from within this share of the picture's width."""
STEP, LEAP = 0.001, 0.01
"""What an arrow key moves a handle by, and with Shift; shares of the picture's width."""
ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowUp": (0, -1), "ArrowDown": (0, 1)}
KEYS = json.dumps([*ARROWS, "n", "p"])


@dataclass
class Marked:
    """A photograph with its outline and scale, in pixels."""

    width: float
    points: Array
    """Outline, from foot to foot, then both ends of the scale (n + 2, 2)."""
    found: Photographed | None
    why: str = ""
    """Why no heap was found."""
    by_hand: bool = False
    mm: float | None = None
    """Distance of the ends of the scale."""
    answer: Angles | None = field(init=False)
    flanks: Array | None = field(init=False)

    def __post_init__(self) -> None:
        self.measure()

    def measure(self) -> None:
        """Angles as they were found or, once the outline was changed, by hand."""
        try:
            outlined = measure_outline(self.points[:-2])
            self.answer, self.flanks = outlined, outlined.flanks
        except MeasurementError as error:
            self.answer, self.flanks, self.why = None, None, str(error)
        if self.found is not None and not self.by_hand:
            self.answer = self.found

    @property
    def scale(self) -> float:
        """mm for one pixel; NaN without a scale."""
        pixels = float(np.hypot(*(self.points[-1] - self.points[-2])))
        return self.mm / pixels if self.mm and pixels else float("nan")


@lru_cache(maxsize=100)
def _found(path: Path, _: int) -> Marked:
    """What the program finds on a photograph, as it was last written."""
    photograph = read_photograph(path)
    rows, columns = photograph.shape[:2]
    scale = np.array([[0.1 * columns, 0.93 * rows], [0.4 * columns, 0.93 * rows]])
    try:
        found = measure_photograph(photograph)
        return Marked(columns, np.vstack([outline_of(found), scale]), found)
    except MeasurementError as error:
        x = np.linspace(0.2, 0.8, HANDLES + 2)
        y = 0.8 - 0.8 * np.minimum(x - 0.2, 0.8 - x)
        points = np.vstack([np.column_stack([x * columns, y * rows]), scale])
        return Marked(columns, points, None, str(error))


class Photo:
    """Step 1; ``use`` takes the angle and its error in degrees as a target."""

    def __init__(self, project: Project, use: Callable[[float, float], None]) -> None:
        self.project = project
        self.marked: dict[str, Marked] = {}
        self.marks: str | None = None
        self.name, self.handle, self.dragging = "", 0, False
        ui.label(
            "Photographs of the heap from the side. The outline must follow the heap: drag a point that does "
            "not. The blue ones are the feet, between which the base runs."
        )
        upload = ui.upload(
            label="Photographs",
            multiple=True,
            auto_upload=True,
            max_file_size=LARGEST,
            on_upload=self.receive,
        )
        upload.props(f'accept="{",".join(PICTURES)}" flat bordered').classes("upload")
        self.choice = ui.select(
            [], label="Photograph", on_change=lambda e: self.choose(e.value or "")
        ).classes("short")
        self.measured = ui.element("div").classes("measured")
        with self.measured:
            with ui.element("div").props('tabindex="0" role="application" aria-label="outline"') as frame:
                self.image = ui.interactive_image(
                    events=["pointerdown", "pointermove", "pointerup"], sanitize=False
                )
            frame.on(
                "keydown",
                self.press,
                js_handler=f"(e) => {{ if ({KEYS}.includes(e.key)) {{ e.preventDefault(); "
                "emit({key: e.key, shift: e.shiftKey}); } }",
            )
            self.image.classes("photograph").on(
                "mouse",
                self.drag,
                js_handler="(e) => { if (e.mouse_event_type != 'pointermove' || e.buttons) emit(e); }",
            )
            with ui.element("div").classes("numbers"):
                self.angle = ui.label().classes("verdict").props('role="status"')
                self.details = ui.label().classes("note lines")
                self.mm = ui.input("mm of the purple line").props("outlined dense")
                self.mm.on("change", self.measure_scale)
                ui.button("As it was found", icon="undo", on_click=self.reset).props("no-caps outline")
                ui.label("Keys on the picture: n and p choose a point, arrows move it.").classes("note")
        self.together = ui.label().classes("verdict").props('role="status"')
        self.take = ui.button("Use as a target", icon="arrow_forward", on_click=lambda: use(*self.mean))
        self.take.props("no-caps")
        self.show()

    # ---- what is on disk ---------------------------------------------------------------------------

    async def look(self) -> None:
        """Measure what is new, and show what another browser has changed."""
        names = self.project.photographs
        marks = self.project.directory / MARKS
        text = marks.read_text() if marks.exists() else "{}"
        new = [name for name in names if name not in self.marked]
        if not new and (text == self.marks or self.dragging):
            return
        if new:
            path = self.project.directory / PHOTOGRAPHS / new[0]
            self.together.text = f"Measuring {new[0]}."
            try:
                await run.io_bound(self.find, path)
            except CalstudyError as error:
                ui.notify(str(error), type="negative")
                path.unlink()
                return
        self.marks = text
        for name, said in json.loads(text).items():
            if name in self.marked:
                one = self.found(name)
                one.by_hand, one.mm = bool(said["by_hand"]), said["mm"]
                if one.by_hand or one.mm:
                    one.points = np.array(said["points"], float)
                one.measure()
                self.marked[name] = one
        there = [name for name in names if name in self.marked]
        self.choice.set_options(there, value=self.name if self.name in there else next(iter(there), None))
        self.show()

    def find(self, path: Path) -> None:
        """Measure a photograph; MeasurementError where it is none."""
        with self.project.computing:
            self.marked[path.name] = self.found(path.name)

    def found(self, name: str) -> Marked:
        """A photograph as it was found."""
        path = self.project.directory / PHOTOGRAPHS / name
        one = _found(path, path.stat().st_mtime_ns)
        return Marked(one.width, one.points.copy(), one.found, one.why)

    def save(self) -> None:
        """Keep what was dragged."""
        said = {
            name: {"points": one.points.tolist(), "by_hand": one.by_hand, "mm": one.mm}
            for name, one in self.marked.items()
        }
        self.marks = json.dumps(said)
        self.project.keep(MARKS, self.marks.encode())

    async def receive(self, event: Any) -> None:
        """Keep an uploaded photograph under its own name."""
        name = Path(event.file.name).name
        if Path(name).suffix.lower() in PICTURES:
            self.marked.pop(name, None)
            self.project.keep(f"{PHOTOGRAPHS}/{name}", await event.file.read())
            self.name = name
            await self.look()

    # ---- one photograph ----------------------------------------------------------------------------

    def choose(self, name: str) -> None:
        """Show another photograph."""
        if name in self.marked:
            self.name, self.handle = name, 0
            self.image.set_source(f"/{PHOTOGRAPHS}/{quote(name)}")
            self.show()

    def drag(self, event: Any) -> None:
        """Take, move or leave the nearest handle."""
        one, said = self.marked.get(self.name), event.args
        if one is None:
            return
        at = np.array([said["image_x"], said["image_y"]], float)
        if said["mouse_event_type"] == "pointerdown":
            distance = np.hypot(*(one.points - at).T)
            self.handle = int(distance.argmin())
            self.dragging = bool(distance.min() < NEAR * one.width)
        elif said["mouse_event_type"] == "pointermove" and self.dragging:
            self.move(one, at)
        elif self.dragging:
            self.dragging = False
            self.save()
        self.show()

    def press(self, event: Any) -> None:
        """Choose a handle, or move it."""
        one, key = self.marked.get(self.name), event.args["key"]
        if one is None:
            return
        if key in ARROWS:
            step = (LEAP if event.args["shift"] else STEP) * one.width
            self.move(one, one.points[self.handle] + step * np.array(ARROWS[key]))
            self.save()
        else:
            self.handle = (self.handle + (1 if key == "n" else -1)) % len(one.points)
        self.show()

    def move(self, one: Marked, at: Array) -> None:
        """Move the chosen handle."""
        one.points[self.handle] = at
        one.by_hand = one.by_hand or self.handle < len(one.points) - 2
        one.measure()

    def measure_scale(self) -> None:
        """Take the distance that was typed; none where it is no number."""
        one = self.marked.get(self.name)
        if one is not None:
            try:
                one.mm = float(self.mm.value)
            except ValueError:
                one.mm = None
            self.save()
            self.show()

    def reset(self) -> None:
        """Leave the photograph as it was found."""
        if self.name in self.marked:
            self.marked[self.name] = self.found(self.name)
            self.save()
            self.show()

    # ---- what is seen ------------------------------------------------------------------------------

    @property
    def mean(self) -> tuple[float, float]:
        """Angle and its error over all photographs, in degrees."""
        return combined([one.answer for one in self.marked.values() if one.answer], METHOD_ERROR_DEG)

    def show(self) -> None:
        """Show the chosen photograph, and what all give together."""
        one = self.marked.get(self.name)
        self.measured.set_visibility(one is not None)
        if one is not None:
            self.image.content = _drawn(one, self.handle)
            answer = one.answer
            self.angle.text = (
                one.why
                if answer is None
                else f"{answer.angle_deg:.1f}° (left {answer.left_deg:.1f}°, right {answer.right_deg:.1f}°)"
            )
            lines = [
                "The outline was corrected by hand."
                if one.by_hand
                else one.why or "The outline is as it was found."
            ]
            if one.mm and answer is not None:
                outlined = measure_outline(one.points[:-2])
                height, radius = outlined.height * one.scale, outlined.width * one.scale / 2
                lines.append(f"Height {height:.1f} mm, radius {radius:.1f} mm.")
            self.details.text = "\n".join(lines)
            self.mm.value = "" if one.mm is None else f"{one.mm:g}"
        measured = sum(one.answer is not None for one in self.marked.values())
        self.take.set_visibility(measured > 0)
        if measured:
            mean, sd = self.mean
            self.together.text = (
                f"{measured} photograph(s) together: {mean:.2f}° with an error (sd) of {sd:.2f}°."
            )


def _drawn(one: Marked, chosen: int) -> str:
    """Outline, base, flanks, scale and handles over a photograph, as SVG."""
    thick = one.width / 400

    def line(points: Array, colour: str) -> str:
        text = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        return f'<polyline points="{text}" fill="none" stroke="{colour}" stroke-width="{thick:.1f}"/>'

    outline, scale = one.points[:-2], one.points[-2:]
    parts = [line(outline, "#3cc83c"), line(outline[[0, -1]], "#148ce6"), line(scale, "#c828c8")]
    parts += [line(flank, "#e62828") for flank in (() if one.flanks is None else one.flanks)]
    for k, (x, y) in enumerate(one.points):
        colour = "#c828c8" if k >= len(outline) else "#148ce6" if k in (0, len(outline) - 1) else "#3cc83c"
        width, fill = (2 * thick, "#fff") if k == chosen else (thick, "none")
        parts.append(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{4 * thick:.1f}" stroke="{colour}" '
            f'stroke-width="{width:.1f}" fill="{fill}" fill-opacity="0.6"/>'
        )
    return "".join(parts)
