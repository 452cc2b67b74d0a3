"""The files of a model's folder."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Collection
from pathlib import Path, PurePosixPath

from calstudy.errors import InputError
from calstudy.models.find import FILE, NOISE_FILE, NOTES_FILE

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Names of parameters, responses and labels."""


def files_of(folder: Path) -> dict[str, bytes]:
    """Files that a run gets, by relative name; the name of an empty folder ends with /."""
    files = {}
    try:
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if "__pycache__" in path.parts or name in (FILE, NOISE_FILE, NOTES_FILE):
                continue
            if path.is_symlink() and path.is_dir():
                raise InputError(
                    f"{path}: is a link to a folder, which a run does not get; put a folder there"
                )
            if path.is_file():
                files[name] = path.read_bytes()
            elif path.is_dir() and not any(path.iterdir()):
                files[f"{name}/"] = b""
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}; check the folder") from error
    return files


def stale(output: str, files: Collection[str]) -> str | None:
    """File of the folder that an output would replace, or lie in; None if there is none."""
    place = posixpath.normpath(output)
    there = (name for name in files if not name.endswith("/"))
    return next((n for n in there if place == "." or n == place or n.startswith(f"{place}/")), None)


def inside(name: str) -> bool:
    """Whether a relative name stays in its directory."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts
