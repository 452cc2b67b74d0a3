"""What is ours on a disk that others use, too: no link is followed, and nothing without our mark is removed.

A study may come from somebody else, and a link in it would lead what we write or remove to another place. So
below the directory that the user named each directory is opened by itself, without following links, and its
files are named relative to it. A directory that goes with all that is in it carries MARK, a file that we put
there when we made it.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from calstudy import machine
from calstudy.errors import SetupError, StoreError

MARK = ".calstudy"
"""File in a directory that we made for a run or for temporary files."""
MARKED = b"made by calstudy, which removes this directory\n"
PREFIX = "calstudy-"
"""Of directories that we make in a place of others, such as /tmp."""
ABROAD = 65534
"""Owner, in a container, of files whose owner the container does not know, such as the machine's root."""
OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH

_DIRECTORY = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC


@contextlib.contextmanager
def opened(path: Path, below: Path | None = None, make: bool = False) -> Iterator[int]:
    """Descriptor of a directory. Links are followed up to ``below``, which the user named, and not further.

    With ``make``, directories below it are made if they do not exist. StoreError names a link, OSError
    tells what else is wrong. Without ``below`` the user named the whole path.
    """
    here = below or path
    handle = os.open(here, _DIRECTORY)
    try:
        for part in path.relative_to(here).parts:
            if part == "..":
                raise StoreError(f"{path}: leads out of {below}; correct the name")
            here /= part
            refuse_link(here, handle)
            if make:
                with contextlib.suppress(FileExistsError):
                    os.mkdir(part, dir_fd=handle)
            outer, handle = handle, os.open(part, _DIRECTORY | os.O_NOFOLLOW, dir_fd=handle)
            os.close(outer)
        yield handle
    finally:
        os.close(handle)


def refuse_link(path: Path, place: int) -> None:
    """Raise StoreError if this is a link; ``place`` is the descriptor of its directory."""
    there = _status(path.name, place)
    if there is not None and stat.S_ISLNK(there.st_mode):
        raise StoreError(
            f"{path} is a symbolic link, which nothing is written through; remove it, or put there what it "
            "leads to"
        )


def _status(name: str, place: int) -> os.stat_result | None:
    """Status of a name in a directory, of a link itself; None where nothing has the name."""
    try:
        return os.stat(name, dir_fd=place, follow_symlinks=False)
    except FileNotFoundError:
        return None


def _names(place: int) -> list[str]:
    """Names in a directory, by its descriptor."""
    with os.scandir(place) as entries:
        return [entry.name for entry in entries]


def make_directory(path: Path, below: Path) -> None:
    """Make a directory below one that exists, unless it is there. StoreError: a link is there."""
    with opened(path, below, make=True):
        pass


def remove_file(path: Path, below: Path | None = None) -> None:
    """Remove a file, or a link itself; it need not exist."""
    with contextlib.suppress(FileNotFoundError), opened(path.parent, below) as place:
        os.unlink(path.name, dir_fd=place)


# ---- directories of runs -----------------------------------------------------------------------------


def scratch_of_ours(scratch: Path, session: str) -> Path:
    """Directory of a session's runs that nobody else can write to: ``scratch``, or a new one in it.

    What runs there is loaded from there. So a directory that others may write to holds one of our own, whose
    name nobody can know before. SetupError: somebody else owns ``scratch``, or it cannot be made.
    """
    try:
        scratch.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            scratch.mkdir(mode=0o700)
        with opened(scratch, scratch.parent) as place:
            if _is_ours_alone(os.fstat(place)):
                return scratch
            _refuse_foreign(scratch, os.fstat(place))
            own = scratch / f"{PREFIX}{session}"
            with contextlib.suppress(FileExistsError):
                os.mkdir(own.name, 0o700, dir_fd=place)
            status = _status(own.name, place)
            if status is None or not stat.S_ISDIR(status.st_mode) or not _is_ours_alone(status):
                raise SetupError(f"{own}: somebody else made it; choose another --scratch")
            return own
    except OSError as error:
        raise SetupError(f"{scratch}: {error.strerror}; choose another --scratch") from error


def _is_ours_alone(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & OTHERS_WRITE


def _refuse_foreign(scratch: Path, status: os.stat_result) -> None:
    if status.st_uid not in (0, ABROAD, os.geteuid()):
        try:
            owner = pwd.getpwuid(status.st_uid).pw_name
        except KeyError:
            owner = f"user {status.st_uid}"
        raise SetupError(
            f"{scratch} belongs to {owner}, who could change what runs there; name a directory of your own "
            "with --scratch"
        )


def make_marked(directory: Path) -> None:
    """Make a directory that we may remove; OSError where it exists or cannot be made."""
    directory.mkdir(mode=0o700, parents=True)
    with opened(directory) as place:
        _mark(place)


def _mark(place: int) -> None:
    """Put our mark into a directory, unless it is there."""
    with contextlib.suppress(FileExistsError):
        handle = os.open(MARK, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o600, dir_fd=place)
        with os.fdopen(handle, "wb") as file:
            file.write(MARKED)


def discard(directory: Path) -> None:
    """Remove a directory whose name this process chose at random, as far as it can be removed."""
    with contextlib.suppress(OSError, StoreError), opened(directory.parent, directory.parent.parent) as place:
        _remove_all(directory.name, place)


def keep(directory: Path, name: str) -> None:
    """Give a directory of ours a lasting name beside it, in place of a marked one that has it.

    If something else has the name, the directory keeps its own.
    """
    with contextlib.suppress(OSError, StoreError), opened(directory.parent, directory.parent.parent) as place:
        with opened(directory, directory.parent) as here:
            _mark(here)
        if _is_marked(name, place):
            _remove_all(name, place)
        os.rename(directory.name, name, src_dir_fd=place, dst_dir_fd=place)


def kept(scratch: Path, name: str) -> Path:
    """Where a directory that was kept is: in the scratch folder, or in a session's own one in it."""
    there = (scratch / name, *sorted(scratch.glob(f"{PREFIX}*/{name}")))
    return next((path for path in there if path.is_dir()), scratch / name)


def sweep(scratch: Path, sessions: set[str]) -> None:
    """Remove the marked run directories RUN.SESSION.NUMBER that ended sessions left in a scratch folder.

    SetupError: the folder belongs to somebody else.
    """
    # A session's token comes from the study: it must not lead anywhere else.
    places = [scratch, *(scratch / f"{PREFIX}{session}" for session in sessions if session.isalnum())]
    for path in places:
        try:
            with opened(path, path.parent) as place:
                _refuse_foreign(path, os.fstat(place))
                for name in _names(place):
                    words = name.split(".")
                    if len(words) == 3 and words[1] in sessions and _is_marked(name, place):
                        _remove_all(name, place)
                if path != scratch:
                    path.rmdir()  # unless failed runs are kept in it
        except OSError:
            continue


def _is_marked(name: str, place: int) -> bool:
    """Whether a name in a directory is a directory of ours with our mark; one that is empty counts, too."""
    try:
        here = os.open(name, _DIRECTORY | os.O_NOFOLLOW, dir_fd=place)
    except OSError:
        return False
    try:
        if os.fstat(here).st_uid != os.geteuid():
            return False
        mark = _status(MARK, here)
        if mark is None:
            return not _names(here)
        return stat.S_ISREG(mark.st_mode) and mark.st_uid == os.geteuid()
    finally:
        os.close(here)


def _remove_all(name: str, place: int) -> None:
    """Remove a directory as far as that can be done.

    The mark goes last, so that what a killed process leaves is still known for ours.
    """
    with contextlib.suppress(OSError):
        here = os.open(name, _DIRECTORY | os.O_NOFOLLOW, dir_fd=place)
        try:
            for entry in _names(here):
                status = _status(entry, here)
                if status is not None and stat.S_ISDIR(status.st_mode):
                    shutil.rmtree(entry, ignore_errors=True, dir_fd=here)
                elif entry != MARK:
                    with contextlib.suppress(OSError):
                        os.unlink(entry, dir_fd=here)
            if _names(here) == [MARK]:
                os.unlink(MARK, dir_fd=here)
        finally:
            os.close(here)
        os.rmdir(name, dir_fd=place)


# ---- temporary directories ---------------------------------------------------------------------------


@contextlib.contextmanager
def temporary() -> Iterator[Path]:
    """A directory for temporary files, ours alone, that is removed in the end.

    What killed processes of the same user left is removed first. A process holds a lock on the mark of its
    own as long as it lives.
    """
    _sweep_temporary(Path(tempfile.gettempdir()))
    directory = Path(tempfile.mkdtemp(prefix=PREFIX))
    try:
        with (directory / MARK).open("xb") as mark:
            with contextlib.suppress(OSError):  # where nothing can be locked, nothing is taken for left
                machine.lock(mark.fileno())
            mark.write(MARKED)
            mark.flush()
            yield directory
    finally:
        discard(directory)


def _sweep_temporary(folder: Path) -> None:
    with contextlib.suppress(OSError), opened(folder) as place:
        for name in _names(place):
            if name.startswith(PREFIX) and _is_marked(name, place) and _is_left(name, place):
                _remove_all(name, place)


def _is_left(name: str, place: int) -> bool:
    """Whether nobody holds the lock on a directory's mark; one without content is just being made."""
    try:
        here = os.open(f"{name}/{MARK}", os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC, dir_fd=place)
    except OSError:
        return False
    with os.fdopen(here, "rb") as mark:
        try:
            machine.lock(mark.fileno())
        except OSError:
            return False
        return mark.read() == MARKED
