"""Steps 3 and 4: the trial, and the calibration while it runs."""

from __future__ import annotations

from html import escape

from nicegui import run, ui

from calstudy.analysis.exhibit import Picture
from calstudy.errors import CalstudyError, StoreError
from calstudy.report.live.pictures import pictures_so_far
from calstudy.report.page import content_of
from calstudy.study.directory.session import activity_in_words
from calstudy.study.run.project import Project

DOCTOR, TRIAL, COST, CALIBRATE = "doctor", "try", "cost", "calibrate"
"""Commands of these steps, by the names of their logs."""


class Command:
    """Lines that a command of the page wrote, and why it ended."""

    def __init__(self, project: Project, name: str) -> None:
        self.project, self.name = project, name
        self.log = ui.html("", sanitize=True).classes("log").props('role="log"')
        self.look()

    def look(self) -> None:
        """Show what is new."""
        lines = self.project.said(self.name)
        if self.project.runs(self.name):
            lines.append("...")
        text = escape("\n".join(lines))
        self.log.content = f"<pre tabindex='0'>{text}</pre>" if text else ""


class Trial:
    """Step 3."""

    def __init__(self, project: Project) -> None:
        self.project = project
        ui.label(
            "Two runs of each model of your own, at both ends of the intervals, read and checked; shipped "
            "models need none. The DEM program is looked at, and the calibration's cost is estimated."
        )
        self.button = ui.button("Try it", icon="science", on_click=self.start).props("no-caps")
        self.commands = [Command(project, name) for name in (TRIAL, DOCTOR, COST)]

    def start(self) -> None:
        """Start all three."""
        self.project.start(DOCTOR, self.project.words(DOCTOR))
        self.project.start(TRIAL, self.project.words("try"))
        self.project.start(COST, [*self.project.words("calibrate"), "--dry-run"])

    def look(self) -> None:
        """Show what is new."""
        self.button.set_enabled(
            self.project.file.exists() and not any(map(self.project.runs, (DOCTOR, TRIAL, COST)))
        )
        for command in self.commands:
            command.look()


class Running:
    """Step 4."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self.seen: object = None
        with ui.row():
            self.start = ui.button(on_click=self.go, icon="play_arrow").props("no-caps")
            self.pause = ui.button("Pause", on_click=project.pause, icon="pause").props("no-caps outline")
            self.another = ui.button("Begin another study", on_click=self.begin, icon="add").props("no-caps")
        self.changed = False
        """Whether the file asks for another study than the one that is there."""
        self.state = ui.label().classes("verdict").props('role="status"')
        self.bar = ui.linear_progress(0, show_value=False).props('aria-label="share of the runs"')
        self.words = ui.label().classes("note")
        self.command = Command(project, CALIBRATE)
        self.pictures = ui.column().classes("part")

    def go(self) -> None:
        """Begin, or go on."""
        self.project.start(CALIBRATE, self.project.words("calibrate"))

    def begin(self) -> None:
        """Begin another study beside the one that is there."""
        self.project.begin_another()
        self.go()

    def look(self) -> None:
        """Show how far it is."""
        project, session = self.project, self.project.session
        self.start.text = "Go on" if project.begun else "Calibrate"
        self.start.set_enabled(project.file.exists() and not project.working)
        self.another.set_visibility(self.changed and not project.working)
        self.start.set_visibility(not project.finished)
        self.pause.set_visibility(not project.finished)
        self.pause.set_enabled(project.working)
        self.state.text = project.state
        did = project.activity
        done = did.runs_done + did.runs_reused
        self.bar.value = 1.0 if project.finished else done / max(1, done + did.runs_left)
        self.words.text = activity_in_words(did) if session or project.begun else ""
        self.command.look()

    def drawn(self) -> tuple[list[Picture], str]:
        """Pictures of the runs so far, which take seconds, and a note."""
        result = self.project.result()
        if result is None:
            return [], "No run has given all responses yet."
        with self.project.computing:
            return pictures_so_far(result, self.project.finished)

    async def draw(self) -> None:
        """Draw the pictures anew when another run has ended."""
        there = self.project.version
        if there == self.seen:
            return
        try:
            pictures, note = await run.io_bound(self.drawn) or ([], "")  # nothing once the server ends
            self.changed = False
        except CalstudyError as error:
            pictures, note, self.changed = [], str(error), isinstance(error, StoreError)
        self.seen = there
        self.pictures.clear()
        with self.pictures:
            ui.label(note).classes("note")
            for picture in pictures:
                ui.label(picture.title).classes("heading")
                ui.html(content_of(picture), sanitize=False).classes("picture")
