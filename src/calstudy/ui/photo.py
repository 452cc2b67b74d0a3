"""Step 1: photographs of the heap; outline and scale are dragged, and the angle follows."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from nicegui import run, ui

from calstudy.errors import CalstudyError, StoreError
from calstudy.models.photograph.marked import Marked, as_svg, marked, read_marks
from calstudy.models.photograph.photograph import combined
from calstudy.models.photograph.photographs import METHOD_ERROR_DEG
from calstudy.study.run.project import OWN, PHOTOGRAPHS, PICTURES, Project

MARKS = f"{OWN}/photographs.json"
LARGEST = 50_000_000
"""Bytes of a photograph."""
NEAR = 0.05
"""A handle is taken from within this share of the picture's width."""
STEP, LEAP = 0.001, 0.01
"""What an arrow key moves a handle by, and with Shift; shares of the picture's width."""
ARROWS = {"ArrowLeft": (-1, 0), "ArrowRight": (1, 0), "ArrowUp": (0, -1), "ArrowDown": (0, 1)}
KEYS = json.dumps([*ARROWS, "n", "p"])


class Photo:
    """Step 1; ``use`` takes the angle and its error in degrees as a target."""

    def __init__(self, project: Project, use: Callable[[float, float], None]) -> None:
        self.project = project
        self.marked: dict[str, Marked] = {}
        self.marks: tuple[dict[str, dict[str, Any]], str] | None = None
        """What was last read or written, and what was wrong with it."""
        self.name, self.handle, self.dragging = "", 0, False
        self.bad: set[str] = set()
        """Files that are no pictures."""
        ui.label(
            "Photographs of the heap from the side. The outline must follow the heap: drag a point that does "
            "not. The blue ones are the feet, between which the base runs."
        )
        upload = ui.upload(label="Photographs", multiple=True, auto_upload=True, on_upload=self.receive)
        upload.props(f'accept="{",".join(PICTURES)}" max-file-size={LARGEST} flat bordered').classes("upload")
        self.choice = ui.select([], label="Photograph", on_change=lambda e: self.choose(e.value or ""))
        self.choice.classes("short")
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
        names = [name for name in self.project.photographs if name not in self.bad]
        try:
            said, damaged = read_marks(self.project.directory / MARKS), ""
        except StoreError as error:
            said, damaged = {}, str(error)
        new = [name for name in names if name not in self.marked]
        if not new and ((said, damaged) == self.marks or self.dragging):
            return
        if new:
            self.together.text = f"Measuring {new[0]}."
            try:
                self.marked[new[0]] = await run.io_bound(self.found, new[0])
            except CalstudyError as error:
                self.together.text = str(error)
                self.bad.add(new[0])
                return
        self.marks = (said, damaged)
        for name, changed in said.items():
            if name in self.marked:
                self.marked[name] = self.found(name).with_marks(changed)
        there = [name for name in names if name in self.marked]
        self.choice.set_options(there, value=self.name if self.name in there else next(iter(there), None))
        self.show()
        self.together.text = damaged or self.together.text

    def found(self, name: str) -> Marked:
        """A photograph as it was found; MeasurementError where it is none."""
        with self.project.computing:
            return marked(self.project.directory / PHOTOGRAPHS / name)

    def save(self) -> None:
        """Keep what was dragged."""
        said = {name: one.marks for name, one in self.marked.items()}
        self.marks = (said, "")
        self.project.keep(MARKS, json.dumps(said).encode())

    async def receive(self, event: Any) -> None:
        """Keep an uploaded photograph under its own name."""
        name = Path(event.file.name).name
        if Path(name).suffix.lower() in PICTURES:
            self.marked.pop(name, None)
            self.bad.discard(name)
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
            one.drag(self.handle, at)
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
            one.drag(self.handle, one.points[self.handle] + step * np.array(ARROWS[key]))
            self.save()
        else:
            self.handle = (self.handle + (1 if key == "n" else -1)) % len(one.points)
        self.show()

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
            self.image.content = as_svg(one, self.handle)
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
                lines.append("Height {:.1f} mm, radius {:.1f} mm.".format(*one.size_mm))
            self.details.text = "\n".join(lines)
            self.mm.value = "" if one.mm is None else f"{one.mm:g}"
        measured = sum(one.answer is not None for one in self.marked.values())
        self.take.set_visibility(measured > 0)
        if measured:
            mean, sd = self.mean
            self.together.text = (
                f"{measured} photograph(s) together: {mean:.2f}° with an error (sd) of {sd:.2f}°."
            )
