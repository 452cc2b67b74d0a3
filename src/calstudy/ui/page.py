"""The page: six steps over one project, each shown from what is on disk."""

from __future__ import annotations

from importlib.resources import files

from fastapi import FastAPI, HTTPException
from fastapi.responses import FileResponse
from nicegui import ui

from calstudy.report.calibration import FOLDER
from calstudy.study.run.project import PHOTOGRAPHS, Project
from calstudy.ui.material import Material
from calstudy.ui.photo import Photo
from calstudy.ui.result import TAKEN, show_finished
from calstudy.ui.runs import Running, Trial

STEPS = ("Photo", "Material", "Trial", "Run", "Result", "Take away")
LOOK_SECONDS = 1.0


def serve_files(app: FastAPI, project: Project) -> None:
    """Serve the photographs and the files of the report, and nothing else."""

    @app.get("/files/{name}")
    def of_report(name: str) -> FileResponse:
        return _file(project, FOLDER, name, name in TAKEN)

    @app.get("/photographs/{name}")
    def photograph(name: str) -> FileResponse:
        return _file(project, PHOTOGRAPHS, name, name in project.photographs)


def _file(project: Project, folder: str, name: str, known: bool) -> FileResponse:
    path = (project.study if folder == FOLDER else project.directory) / folder / name
    if not known or not path.is_file():
        raise HTTPException(404)
    return FileResponse(path, headers={"Cache-Control": "no-store"})


def show(project: Project) -> None:
    """One browser's view of the project."""
    ui.add_css((files("calstudy.ui") / "page.css").read_text())
    ui.colors(primary="#00527f")
    with ui.header().classes("top"):
        ui.label(project.file.stem).classes("name").props('role="heading" aria-level="1"')
        state = ui.label().classes("state")
    with ui.tabs().props("dense no-caps outside-arrows mobile-arrows inline-label").classes("steps") as tabs:
        for number, name in enumerate(STEPS, 1):
            ui.tab(name, f"{number} {name}")
    with ui.tab_panels(tabs, value=STEPS[_first(project)], animated=False, keep_alive=True).classes("panels"):
        with ui.tab_panel(STEPS[0]):
            photo = Photo(project, lambda mean, sd: take(mean, sd))
        with ui.tab_panel(STEPS[1]):
            material = Material(project)
        with ui.tab_panel(STEPS[2]):
            trial = Trial(project)
        with ui.tab_panel(STEPS[3]):
            running = Running(project)
        with ui.tab_panel(STEPS[4]):
            result = ui.column().classes("part")
        with ui.tab_panel(STEPS[5]):
            taken = ui.column().classes("part")
    shown: list[object] = []

    def take(mean: float, sd: float) -> None:
        material.take_angle(mean, sd)
        tabs.set_value(STEPS[1])

    def look() -> None:
        state.text = project.state
        material.look()
        trial.look()
        running.look()

    async def look_for_result() -> None:
        there = project.version[:-1]
        if shown != [there]:
            shown[:] = [there]
            await show_finished(project, result, taken)

    for looks in (look, photo.look, running.draw, look_for_result):
        ui.timer(LOOK_SECONDS, looks)


def _first(project: Project) -> int:
    """Step to begin with: where the work is."""
    if not project.file.exists():
        return 0
    return 4 if project.finished else 3 if project.begun else 1
