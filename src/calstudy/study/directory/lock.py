"""A lock in a study directory: one session has it at a time."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from calstudy import machine
from calstudy.disk.files import append_line, write_atomically, write_new
from calstudy.disk.ours import opened, refuse_link, remove_file
from calstudy.errors import StoreError
from calstudy.study.directory.session import (
    FINISHED,
    KILLED,
    LOCK_FILE,
    PATIENCE_SECONDS,
    SESSIONS_FILE,
    Activity,
    Session,
    holder,
    now,
)

BEAT_SECONDS = 5.0
LOOK_SECONDS = 1.0
MISSED_BEATS = 3
"""So many signs of life must be missing before a clock is believed, which may have jumped."""


class InUse(StoreError):
    """A live session has the lock."""

    def __init__(self, directory: Path, there: Session | None) -> None:
        remedy = "wait for it or choose another --study"
        super().__init__(f"{directory}: in use by {there or 'another process'}; {remedy}")
        self.there = there
        """The session, if it left its name."""


class Lock:
    """The study's lock, or that of an element of a job array; one for each session."""

    def __init__(self, directory: Path, name: str = LOCK_FILE, element: int = 0) -> None:
        self.path = directory / name
        self.session = Session.here(element)
        self.report: Callable[[], Activity] | None = None
        """Reports what the session has done; without it the session leaves no record."""
        self.lost = threading.Event()
        """Set when another process has taken over from this session, thinking it dead."""
        self._ended = threading.Event()
        self._beating = threading.Thread(target=self._beat, name="sign of life", daemon=True)
        self._held = False

    def acquire(self) -> None:
        """Take the lock, waiting at most until a holder elsewhere is known to be alive or dead.

        InUse names a holder that is alive; OSError where nothing can be written.
        """
        directory = self.path.parent
        with _alone_on_this_machine(directory):
            with opened(directory) as place:
                refuse_link(self.path, place)
            while not self._create():
                try:
                    dead = self._wait_for_death()
                except FileNotFoundError:
                    continue  # released meanwhile
                if dead is not None:
                    append_line(directory / SESSIONS_FILE, replace(dead, state=KILLED).line, directory)
                self._take_over(dead)
                break
        self._held = True
        self._beating.start()

    def _create(self) -> bool:
        try:
            write_new(self.path, self.session.line, self.path.parent)
        except FileExistsError:
            return False
        return True

    def _wait_for_death(self) -> Session | None:
        """Session that held the lock and is dead, None if it left no name.

        InUse when it is alive, FileNotFoundError when it has released the lock.
        """
        first = self._holder()
        waited = time.monotonic()
        while True:
            there = self._holder()
            if there is None and not self.path.exists():
                raise FileNotFoundError(self.path)
            if there is not None and there.ended_here:
                return there
            alive_here = there is not None and there.place == self.session.place
            changed = first is not None and there != first
            if alive_here or changed:
                raise InUse(self.path.parent, there)
            silent = time.monotonic() - waited
            is_old = silent > MISSED_BEATS * BEAT_SECONDS and self._age() > PATIENCE_SECONDS
            if is_old or silent > PATIENCE_SECONDS:
                return there
            first = first or there
            time.sleep(min(LOOK_SECONDS, PATIENCE_SECONDS / 10))

    def _holder(self) -> Session | None:
        return holder(self.path.parent, self.path.name)

    def _age(self) -> float:
        """Seconds since the last sign of life, by the clock of the file system."""
        probe = self.path.with_name(f".{self.path.name}.{self.session.token}")
        try:
            write_new(probe, b"", probe.parent)
            return probe.stat().st_mtime - self.path.stat().st_mtime
        finally:
            remove_file(probe, probe.parent)

    def _take_over(self, dead: Session | None) -> None:
        """Replace the lock of a dead session by this one's."""
        write_atomically(self.path, self.session.line, self.path.parent)
        if dead is None or not dead.ended_here:
            # Another machine may have come to the same conclusion; whoever wrote last has it.
            time.sleep(2 * min(LOOK_SECONDS, PATIENCE_SECONDS / 10))
            there = self._holder()
            if there is None or there.token != self.session.token:
                raise InUse(self.path.parent, there)

    def _beat(self) -> None:
        while not self._ended.wait(BEAT_SECONDS):
            # For want of memory, say. A sign is missed then, and others follow.
            with contextlib.suppress(Exception):
                there = self._holder()
                if there is not None and there.token != self.session.token:
                    self.lost.set()
                    return
                self._tell()

    def require(self) -> None:
        """Raise StoreError if another session has taken over, thinking this one dead."""
        if self.lost.is_set():
            raise StoreError(f"{self.path.parent}: taken over by another session; this one ends")

    def _tell(self) -> None:
        did = self.session.did
        with contextlib.suppress(Exception):  # a sign that tells old figures is better than none
            did = self.report() if self.report else did
        self.session = replace(self.session, beat=self.session.beat + 1, seen=now(), did=did)
        # A full disk, or a server that does not answer, is noticed where results are written.
        with contextlib.suppress(OSError):
            write_atomically(self.path, self.session.line, self.path.parent)

    def release(self, state: str = FINISHED) -> None:
        """Release the lock, and leave a record of the session."""
        self._ended.set()
        if not self._held:
            return
        self._held = False
        self._beating.join()
        there = self._holder()
        if self.lost.is_set() or there is None or there.token != self.session.token:
            return
        if self.report is not None:
            self.session = replace(self.session, state=state, seen=now(), did=self.report())
            with contextlib.suppress(OSError):
                append_line(self.path.with_name(SESSIONS_FILE), self.session.line, self.path.parent)
        remove_file(self.path, self.path.parent)


@contextlib.contextmanager
def _alone_on_this_machine(directory: Path) -> Iterator[None]:
    """Let processes of this machine look at the lock one at a time, if the file system can."""
    handle = os.open(directory, os.O_RDONLY)
    end = time.monotonic() + PATIENCE_SECONDS
    try:
        while time.monotonic() < end:
            try:
                machine.lock(handle)
                break
            except BlockingIOError:
                time.sleep(0.05)
            except OSError:
                break  # a network file system without it
        yield
    finally:
        os.close(handle)
