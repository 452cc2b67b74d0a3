"""The files of a model's folder."""

from __future__ import annotations

import ast
import hashlib
import posixpath
import re
from collections.abc import Collection, Mapping
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath

from calstudy.engines.interface import Linked
from calstudy.errors import InputError
from calstudy.models.find import EMULATOR_FILE, EMULATORS, FILE, NOISE_FILE, NOTES_FILE

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Names of parameters, responses and labels."""


LARGEST_FOLDER = 50e6
"""Bytes of a folder that each run copies; results and old runs make more than that."""


def files_of(
    folder: Path, patterns: Collection[str] = (), linked: Collection[str] = ()
) -> tuple[dict[str, bytes], dict[str, Linked]]:
    """Files that a run gets, and those that it gets as links, by relative name; an empty folder ends with /.

    Emulators of the model are left out. With ``patterns``, such as ``meshes/*``, only files that match one;
    those that match one of ``linked`` are not read into memory. InputError: the others together are larger
    than a run should copy.
    """
    links: dict[str, Linked] = {}
    chosen: dict[str, Path] = {}
    files: dict[str, bytes] = {}
    try:
        emulators = {path.parent for path in folder.glob(f"{EMULATORS}/*/{EMULATOR_FILE}")}
        for path in sorted(folder.rglob("*")):
            name = path.relative_to(folder).as_posix()
            if "__pycache__" in path.parts or name in (FILE, NOISE_FILE, NOTES_FILE):
                continue
            if emulators.intersection(path.parents):
                continue
            if path.is_symlink() and path.is_dir():
                raise InputError(
                    f"{path}: is a link to a folder, which a run does not get; put a folder there"
                )
            if path.is_dir() and not any(path.iterdir()):
                files[f"{name}/"] = b""
            elif path.is_file() and any(fnmatch(name, pattern) for pattern in linked):
                links[name] = _linked(path)
            elif path.is_file() and (not patterns or any(fnmatch(name, pattern) for pattern in patterns)):
                chosen[name] = path
        _require_small(folder, {name: path.stat().st_size for name, path in chosen.items()})
        files |= {name: path.read_bytes() for name, path in chosen.items()}
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}; check the folder") from error
    return dict(sorted(files.items())), links


def _linked(path: Path) -> Linked:
    """A file where it lies; its hash takes no memory."""
    there = path.resolve()
    with there.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return Linked(there, digest, there.stat().st_size, there.stat().st_mtime_ns)


def _require_small(folder: Path, sizes: Mapping[str, int]) -> None:
    """Refuse a folder that holds old results, say: each run would copy it."""
    total = sum(sizes.values())
    if total > LARGEST_FOLDER:
        largest = sorted(sizes, key=lambda name: sizes[name], reverse=True)[:3]
        raise InputError(
            f"{folder}: {total / 1e6:.0f} MB in {len(sizes)} files, which each run would copy, most of it in "
            f"{', '.join(largest)}; name what a run needs with files = ['in.*', 'meshes/*'] in {FILE}, "
            "and what it reads alone and need not copy with links = ['meshes/*']"
        )


def stale(output: str, files: Collection[str]) -> str | None:
    """File of the folder that an output would replace, or lie in; None if there is none."""
    place = posixpath.normpath(output)
    there = (name for name in files if not name.endswith("/"))
    return next((n for n in there if place == "." or n == place or n.startswith(f"{place}/")), None)


def read_apart(files: Mapping[str, bytes], sources: Collection[str], used: Collection[str]) -> frozenset[str]:
    """Files that what reads a run uses alone: ``sources``, and Python files that nothing else names.

    ``used`` are names that the command has. What a file names, or a Python file imports, it uses.
    """
    apart = {name for name in files if name in sources or name.endswith(".py")} - set(used)
    while True:
        others = [name for name in files if name not in apart]
        named = {name for other in others for name in _imported(other, files)}
        named |= {
            name for name in apart if any(PurePosixPath(name).name.encode() in files[o] for o in others)
        }
        if not named & apart:
            return frozenset(apart)
        apart -= named


def _imported(file: str, files: Mapping[str, bytes]) -> set[str]:
    """Python files of the folder that a Python file imports; all of them where it decides as it runs."""
    if not file.endswith(".py"):
        return set()
    if re.search(rb"importlib|__import__|runpy|\bexec\b", files[file]):
        return {name for name in files if name.endswith(".py")}
    try:
        nodes = list(ast.walk(ast.parse(files[file])))
    except (SyntaxError, ValueError):
        return set()
    modules = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    modules |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    return {name for name in files if PurePosixPath(name).stem in {m.split(".")[-1] for m in modules}}


PLACEHOLDER = re.compile(rb"\{\{\s*(\w+)\s*\}\}")
"""Of a template: a name of a variable in double braces."""


def placeholders(content: bytes) -> set[str]:
    """Names in double braces."""
    return {found[1].decode() for found in PLACEHOLDER.finditer(content)}


def inside(name: str) -> bool:
    """Whether a relative name stays in its directory."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts
