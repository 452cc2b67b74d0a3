"""One calibration: its photographs, its file, its study, and the commands that work on them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calstudy import machine
from calstudy.disk.files import cannot_write, write_atomically
from calstudy.errors import CalstudyError, InputError
from calstudy.study.definition import Definition, read_definition
from calstudy.study.directory.begun import free_name, start_there
from calstudy.study.directory.session import Activity, Session, holder, read_sessions
from calstudy.study.directory.store import finished_rows, journals
from calstudy.study.reading import Result
from calstudy.study.run.under_way import definition_there, evaluations_there, read_finished, so_far
from calstudy.study.settings import SETTINGS_FILE
from calstudy.tomlfile import Keys, key_lines, read_toml, toml_of, with_value
from calstudy.written import text_of

PHOTOGRAPHS, OWN = "photographs", ".calstudy"
"""Folders of the project: of photographs, and of what the page itself keeps."""
PICTURES = (".jpg", ".jpeg", ".png")
STUDY = f"{OWN}/study"
"""Which study the page works on, where it is not the default one."""
LAST_LINES = 40
MOST_MISTAKES = 20


@dataclass
class Project:
    """One calibration; its file is the truth, and may be changed by anybody at any time."""

    file: Path
    study: Path
    running: Sequence[str] = ()
    """Options that ``calstudy calibrate`` is given."""
    common: Sequence[str] = ()
    """Options that every command is given."""
    program: Sequence[str] = ()
    """Options that name the DEM program."""
    models: Sequence[Path] = ()
    insist: bool = False
    _processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)
    _results: dict[object, Result | None] = field(default_factory=dict)
    _starting: threading.Lock = field(default_factory=threading.Lock)
    _reading: threading.Lock = field(default_factory=threading.Lock)
    computing: threading.Lock = field(default_factory=threading.Lock)
    """What a result computes when it is first asked for is computed once."""
    _whole: dict[str, Any] = field(default_factory=dict)
    """Content of the file when it last was without mistakes."""

    @property
    def directory(self) -> Path:
        """The project's directory."""
        return self.file.parent

    # ---- the file ----------------------------------------------------------------------------------

    @property
    def text(self) -> str:
        """Text of the file; empty while there is none."""
        return text_of(self.file) if self.file.exists() else ""

    @property
    def content(self) -> dict[str, Any]:
        """Content of the file; empty where it is not TOML."""
        try:
            return dict(read_toml(self.file).data)
        except CalstudyError:
            return {}

    def write(self, text: str) -> None:
        """Write the file; SetupError: it cannot be written."""
        self._keep(self.file, text.encode())

    def set(self, keys: Keys, value: str | None) -> None:
        """Change one value of the file, or remove it; everything else stays. InputError as with_value."""
        self.write(with_value(self.text, keys, value))

    def mistakes(self, fields: Sequence[Keys]) -> dict[Keys, str]:
        """What the validation finds, by the field that it concerns; () for no field.

        It stops at the first mistake. So that each is told, one is put right by what last was without
        mistakes, and what is left is read again.
        """
        found: dict[Keys, str] = {}
        text = self.text
        for _ in range(MOST_MISTAKES):
            try:
                read_definition(self.file, self.models, self.insist, start=start_there(self.study), text=text)
            except InputError as error:
                place = _nearest(error.keys, fields)
                if place in found:
                    break
                found[place] = error.what or str(error)
                line = place if place in key_lines(text) else place[:2]
                before = _value(self._whole, line)
                if not place or before is None:
                    break
                text = with_value(text, line, before)
            except CalstudyError as error:
                found[()] = str(error)
                break
            else:
                break
        if not found:
            self._whole = self.content
        return found

    def definition(self) -> Definition:
        """The calibration as its file says; raises as ``definition_there``."""
        return definition_there(self.file, self.study, self.models, self.insist)

    @property
    def photographs(self) -> list[str]:
        """Names of the photographs, in order."""
        folder = self.directory / PHOTOGRAPHS
        return sorted(path.name for path in folder.glob("*") if path.suffix.lower() in PICTURES)

    # ---- its files ---------------------------------------------------------------------------------

    def keep(self, name: str, content: bytes) -> Path:
        """Write a file of the page's own, or a photograph; SetupError: it cannot be written."""
        return self._keep(self.directory / name, content)

    def _keep(self, path: Path, content: bytes) -> Path:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, content)
        except OSError as error:
            raise cannot_write(path, error) from error
        return path

    # ---- its commands ------------------------------------------------------------------------------

    def start(self, name: str, words: Sequence[str]) -> None:
        """Run a command of calstudy as a process of its own, unless it runs already; its words are logged.

        It outlives the page and the server.
        """
        with self._starting:
            if self.runs(name):
                return
            log = self.keep(f"{OWN}/{name}.log", b"")
            with log.open("wb") as out:
                self._processes[name] = subprocess.Popen(
                    [sys.executable, "-m", "calstudy", *words],
                    cwd=self.directory,
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=subprocess.STDOUT,
                    start_new_session=True,
                )

    def begin_another(self) -> None:
        """Take a new directory for the study, which the page keeps to."""
        self.study = free_name(self.study)
        self.keep(STUDY, str(self.study).encode())

    def runs(self, name: str) -> bool:
        """Whether a command that this server has started still runs."""
        process = self._processes.get(name)
        return process is not None and process.poll() is None

    def ended(self, name: str) -> int | None:
        """Exit code of a command that this server has started; None while it runs, or before."""
        process = self._processes.get(name)
        return None if process is None else process.poll()

    def said(self, name: str) -> list[str]:
        """Last lines that a command wrote, however long ago."""
        path = self.directory / OWN / f"{name}.log"
        if not path.exists():
            return []
        return path.read_text(errors="replace").splitlines()[-LAST_LINES:]

    def words(self, command: str) -> list[str]:
        """The command ``calibrate``, ``try`` or ``doctor``, as it is typed in the project's directory."""
        if command == "doctor":
            return [command, *self.program]
        place = ["--study", os.path.relpath(self.study, self.directory)]
        return [
            command,
            self.file.name,
            *place,
            *self.common,
            *self.program,
            *(self.running if command == "calibrate" else ()),
        ]

    # ---- its study ---------------------------------------------------------------------------------

    @property
    def begun(self) -> bool:
        """Whether a study is there."""
        return (self.study / SETTINGS_FILE).exists()

    @property
    def finished(self) -> bool:
        """Whether the calibration has ended, with a result or without."""
        return self.begun and bool(finished_rows(self.study))

    @property
    def session(self) -> Session | None:
        """The session that works on the study, whoever started it; None without any."""
        there = holder(self.study)
        return None if there is None or there.ended_here or there.is_silent else there

    @property
    def working(self) -> bool:
        """Whether anybody works on it."""
        return self.runs("calibrate") or self.session is not None

    @property
    def activity(self) -> Activity:
        """What the session at work, or the last one, has done."""
        there = self.session
        past = [] if there else read_sessions(self.study)
        return there.did if there else past[-1].did if past else Activity()

    @property
    def version(self) -> tuple[object, ...]:
        """What there is of the study and the file: another one, another picture."""
        written = self.file.stat().st_mtime_ns if self.file.exists() else 0
        runs = sum(path.stat().st_size for path in journals(self.study).values())
        return self.study, written, self.finished, runs

    @property
    def state(self) -> str:
        """In words, whether anybody works on it."""
        if there := self.session:
            return f"Running: {there}."
        if self.runs("calibrate"):
            return "Writing the report." if self.finished else "Starting."
        if self.finished:
            return "Finished."
        return "Paused." if self.begun else "Not begun."

    def pause(self) -> None:
        """Ask whoever works on the study on this machine to stop; what is finished is kept."""
        there = self.session
        process = self._processes.get("calibrate")
        if there is not None and there.place == machine.place():
            with contextlib.suppress(ProcessLookupError):
                os.kill(there.process, signal.SIGTERM)
        elif process is not None and process.poll() is None:
            process.terminate()

    def result(self) -> Result | None:
        """The result, or what the runs so far tell; None before the first run. Computed once for each."""
        if not self.begun:
            return None
        evaluations = [] if self.finished else evaluations_there(self.study)
        key = (self.text, self.finished, len(evaluations))
        with self._reading:
            if key not in self._results:
                definition = self.definition()
                self._results.clear()
                self._results[key] = (
                    read_finished(definition, self.study)
                    if self.finished
                    else so_far(definition, self.study, evaluations)
                )
            return self._results[key]


def _nearest(keys: Keys, fields: Sequence[Keys]) -> Keys:
    """Field of a value of the file, or the first one of its row; () for none."""
    own = [field for field in fields if keys[: len(field)] == field]
    row = [field for field in fields if len(field) > 2 and field[:2] == keys[:2]]
    return max(own, key=len, default=row[0] if row else ())


def _value(content: Mapping[str, Any], keys: Keys) -> str | None:
    """Value at keys, as it is written in TOML; None where there is none."""
    at: Any = content
    for key in keys:
        try:
            at = at[key]
        except (KeyError, IndexError, TypeError):
            return None
    return toml_of(at)
