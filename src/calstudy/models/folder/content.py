"""The files of a model's folder."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Collection, Mapping
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath

from calstudy.errors import InputError
from calstudy.models.find import FILE, NOISE_FILE, NOTES_FILE

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Names of parameters, responses and labels."""


LARGEST_FOLDER = 50e6
"""Bytes of a folder that each run copies; results and old runs make more than that."""


def files_of(folder: Path, patterns: Collection[str] = ()) -> dict[str, bytes]:
    """Files that a run gets, by relative name; the name of an empty folder ends with /.

    With ``patterns``, such as ``meshes/*``, only files that match one. InputError: together they are larger
    than a run should copy.
    """
    chosen: dict[str, Path] = {}
    files: dict[str, bytes] = {}
    try:
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if "__pycache__" in path.parts or name in (FILE, NOISE_FILE, NOTES_FILE):
                continue
            if path.is_symlink() and path.is_dir():
                raise InputError(
                    f"{path}: is a link to a folder, which a run does not get; put a folder there"
                )
            if path.is_dir() and not any(path.iterdir()):
                files[f"{name}/"] = b""
            elif path.is_file() and (not patterns or any(fnmatch(name, pattern) for pattern in patterns)):
                chosen[name] = path
        _require_small(folder, {name: path.stat().st_size for name, path in chosen.items()})
        files |= {name: path.read_bytes() for name, path in chosen.items()}
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}; check the folder") from error
    return dict(sorted(files.items()))


def _require_small(folder: Path, sizes: Mapping[str, int]) -> None:
    """Refuse a folder that holds old results, say: each run would copy it."""
    total = sum(sizes.values())
    if total > LARGEST_FOLDER:
        largest = sorted(sizes, key=lambda name: sizes[name], reverse=True)[:3]
        raise InputError(
            f"{folder}: {total / 1e6:.0f} MB in {len(sizes)} files, which each run would copy, most of it in "
            f"{', '.join(largest)}; name what a run needs with files = ['in.*', 'meshes/*'] in {FILE}"
        )


def stale(output: str, files: Collection[str]) -> str | None:
    """File of the folder that an output would replace, or lie in; None if there is none."""
    place = posixpath.normpath(output)
    there = (name for name in files if not name.endswith("/"))
    return next((n for n in there if place == "." or n == place or n.startswith(f"{place}/")), None)


def inside(name: str) -> bool:
    """Whether a relative name stays in its directory."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts
