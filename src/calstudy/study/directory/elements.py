"""Elements of a job array: several sessions work on one study at once, each on rows that it has taken.

    STUDY/lock-3           element 3 is at work, and every few seconds what it has done so far
    STUDY/claims/row-07.0  the session in it has taken row 7; row-07.1 is of the one that took over from it

Only one session can create a claim, on network file systems too, and the latest claim on a row counts. Who is
dead is told as for ``session``: by the process of this machine, or by a lock that has not changed for longer
than a network file system may hide it. Clocks of machines play no part. Rows that share samples are taken
together, so that no DEM run is asked for by two elements.
"""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calstudy.disk.files import cannot_write, content_of, write_new
from calstudy.disk.ours import remove_file
from calstudy.errors import StoreError
from calstudy.study.directory.lock import BEAT_SECONDS, LOOK_SECONDS, MISSED_BEATS, InUse, Lock
from calstudy.study.directory.session import (
    LARGEST,
    LOCK_FILE,
    PATIENCE_SECONDS,
    Session,
    holder,
    read_session,
)

CLAIMS = "claims"


@dataclass(frozen=True, slots=True)
class Element:
    """One of the processes of a job array."""

    number: int
    """From 1."""
    of: int

    def __str__(self) -> str:
        return f"element {self.number} of {self.of}"

    def lock(self, directory: Path) -> Lock:
        """Its lock, to be acquired: no other process is this element."""
        return Lock(directory, lock_name(self.number), self.number)


@contextlib.contextmanager
def alone(directory: Path, element: Element | None) -> Iterator[None]:
    """While a study is opened: nobody else opens it, and nobody works in it but elements of an array.

    Its own lock is held already. Elements hold the study's lock, too, one after the other. InUse: a session
    that works alone has it; or an element is alive, and this one would work alone.
    """
    if element is None:
        _end_elements(directory)
        yield
        return
    opening = _opening(directory, element)
    try:
        yield
    finally:
        opening.release()


def _opening(directory: Path, element: Element) -> Lock:
    """The study's lock, acquired as soon as no other element opens the study."""
    while True:
        lock = Lock(directory, element=element.number)
        try:
            lock.acquire()
        except InUse as error:
            if error.there is not None and not error.there.element:
                raise
            time.sleep(LOOK_SECONDS / 10)
        else:
            return lock


def lock_name(element: int) -> str:
    """Name of an element's lock."""
    return f"{LOCK_FILE}-{element}"


def elements(directory: Path) -> list[int]:
    """Numbers of the elements of an array that have a lock, dead or alive."""
    found = (re.fullmatch(rf"{LOCK_FILE}-([1-9][0-9]*)", path.name) for path in directory.glob("lock-*"))
    return sorted(int(match[1]) for match in found if match)


def _end_elements(directory: Path) -> None:
    """Leave a record of elements that were killed, and no claims. InUse: an element is alive."""
    for number in elements(directory):
        dead = Lock(directory, lock_name(number), number)
        dead.acquire()
        dead.release()
    remove_claims(directory)


def remove_claims(directory: Path) -> None:
    """Remove all claims: no element is at work any more, or every row has its tables."""
    for path in (directory / CLAIMS).glob("row-*"):
        remove_file(path, directory)


class Claims:
    """The rows that an element takes, one group after the other: first its own share, then what is left.

    ``groups`` are rows that must be taken together, by a number of the group; ``finished`` gives the rows
    that have their tables.
    """

    def __init__(
        self,
        directory: Path,
        element: Element,
        lock: Lock,
        groups: Mapping[int, Sequence[int]],
        finished: Callable[[], set[int]],
    ) -> None:
        self.directory, self.lock, self.groups, self.finished = directory, lock, groups, finished
        numbers = sorted(groups)
        shares = {number: (k - element.number + 1) % element.of for k, number in enumerate(numbers)}
        self._order = sorted(numbers, key=lambda number: shares[number])
        self._mine: dict[int, Path] = {}
        self._signs: dict[Path, tuple[int | None, float, bool]] = {}
        """By claim: the latest sign of life, since when it is known, and whether it is the first one seen."""
        self._again = self._check = 0.0
        """When the others are looked at again."""

    def next(self) -> tuple[int, ...] | None:
        """Rows to calibrate now; empty: ask again; None: others, who are alive, have what is left."""
        if time.monotonic() < self._again:
            return ()
        done = self.finished()
        left = [n for n in self._order if n not in self._mine and not done.issuperset(self.groups[n])]
        if not left:
            return None
        latest = self._latest()
        for number in left:
            if number not in latest and self._take(number, 0):
                return self._unfinished(number)
        self._again = time.monotonic() + min(LOOK_SECONDS, PATIENCE_SECONDS / 10)
        ended = {number: self._has_ended(latest[number]) for number in left if number in latest}
        for number in (number for number in ended if ended[number]):
            if self._take(number, _generation(latest[number]) + 1):
                return self._unfinished(number)
        return None if len(ended) == len(left) and set(ended.values()) == {False} else ()

    def require(self) -> None:
        """Raise StoreError if another element has taken over a row from this one, thinking it dead."""
        if time.monotonic() < self._check:
            return
        self._check = time.monotonic() + BEAT_SECONDS
        latest = self._latest()
        for number, path in self._mine.items():
            if latest.get(number, path) != path and self._unfinished(number):
                raise StoreError(f"{self.directory}: another element has taken over; this one ends")

    def release(self) -> None:
        """Give back what is not finished; another element or a later command takes it."""
        for number, path in self._mine.items():
            if self._unfinished(number):
                remove_file(path, self.directory)

    def _unfinished(self, number: int) -> tuple[int, ...]:
        done = self.finished()
        return tuple(row for row in self.groups[number] if row not in done)

    def _latest(self) -> dict[int, Path]:
        """The claim on each group that counts."""
        paths = sorted((self.directory / CLAIMS).glob("row-*.*"), key=_generation)
        return {_group(path): path for path in paths if _group(path) in self.groups}

    def _take(self, number: int, generation: int) -> bool:
        """Take a group, unless another element was faster."""
        path = self.directory / CLAIMS / f"row-{number:02d}.{generation}"
        try:
            write_new(path, self.lock.session.line, self.directory)
        except FileExistsError:
            return False
        except OSError as error:
            raise cannot_write(path, error) from error
        self._mine[number] = path
        return True

    def _has_ended(self, claim: Path) -> bool | None:
        """Whether the session of a claim has ended; None while that is not known."""
        there, sign = _session(claim), None
        own = self.lock.session
        if there is not None:
            if there.ended_here or there.element == own.element:  # there is one of each number
                return True
            if there.place == own.place:
                return False
            at_work = holder(self.directory, lock_name(there.element))
            sign = at_work.beat if at_work is not None and at_work.token == there.token else None
        now, before = time.monotonic(), self._signs.get(claim)
        if before is None or before[0] != sign:
            self._signs[claim] = sign, now, before is None
        _, since, is_first = self._signs[claim]
        if now - since > PATIENCE_SECONDS:
            return True
        return None if is_first or now - since > MISSED_BEATS * BEAT_SECONDS else False


def _session(claim: Path) -> Session | None:
    try:
        return read_session(content_of(claim, LARGEST))
    except OSError:
        return None


def _generation(claim: Path) -> int:
    """How many sessions have taken over; -1 of a file that is no claim."""
    number = claim.name.rpartition(".")[2]
    return int(number) if number.isdigit() else -1


def _group(claim: Path) -> int:
    found = re.fullmatch(r"row-([0-9]+)\.[0-9]+", claim.name)
    return int(found[1]) if found else -1
