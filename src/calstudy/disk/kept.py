"""What DEM runs wrote, kept by what made them, so that it can be read anew.

One file holds a run: an archive of what it wrote, and before that a JSON of how it ended.
"""

from __future__ import annotations

import gzip
import io
import json
import tarfile
import zlib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from calstudy.disk.files import open_to_read, write_atomically
from calstudy.disk.ours import MARK

ABOUT = "run.json"
"""First member of an archive."""
ENDING = ".tar.gz"
MOST_OF_RUN = 20e6
"""Bytes of a run that are kept, unless its model says otherwise."""
MOST_IN_ALL = 2e9
"""Compressed bytes of a project's kept runs."""
LARGEST_ABOUT, MOST_OF_TAR = 4e6, 20e6
"""Bytes that tell how a run ended; bytes of an archive besides the files' own."""
_DAMAGED = (EOFError, ValueError, zlib.error, gzip.BadGzipFile, tarfile.TarError)


@dataclass(frozen=True, slots=True)
class KeptRuns:
    """Runs in a directory, which need not exist."""

    directory: Path
    wanted: tuple[str, ...] = ()
    """Files that readers read, or folders of such: a run is kept with all of them, or not at all."""
    most: float = MOST_OF_RUN
    """Bytes that are kept of a run, before they are compressed."""

    def keep(self, making: str, about: Mapping[str, Any], run: Path, given: Mapping[str, bytes]) -> bool:
        """Keep what a run wrote into its directory, and whether there was room for it. OSError: no file.

        ``given`` are files that it was given, which are not kept unless it changed them. Of the others the
        smallest are kept where there is no room for all.
        """
        written = sorted(
            (size, name)
            for path in run.rglob("*")
            if path.is_file() and not path.is_symlink() and path.name != MARK
            for name, size in ((path.relative_to(run).as_posix(), path.stat().st_size),)
            if name not in given or size != len(given[name]) or path.read_bytes() != given[name]
        )
        wanted = [(size, name) for size, name in written if _is_of(name, self.wanted)]
        used = sum(size for size, _ in wanted)
        if used > self.most or self.bytes > MOST_IN_ALL:
            return False
        chosen = dict.fromkeys(name for _, name in wanted)
        for size, name in written:
            if name not in chosen and (used := used + size) <= self.most:
                chosen[name] = None
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w:gz", compresslevel=6) as archive:
            _add(archive, ABOUT, json.dumps(about).encode())
            for name in chosen:
                _add(archive, name, (run / name).read_bytes())
        self.directory.mkdir(parents=True, exist_ok=True)
        write_atomically(self._path(making), packed.getvalue(), self.directory)
        return True

    def about(self, making: str) -> dict[str, Any] | None:
        """How a run ended; None for one that is not kept, or damaged."""
        try:
            with self._opened(making, LARGEST_ABOUT) as archive:
                told: dict[str, Any] = json.loads(_content(archive, archive.next()))
                return told
        except (OSError, RecursionError, *_DAMAGED):
            return None

    def unpack(self, making: str, into: Path) -> bool:
        """Write what a run wrote into a directory, and whether all of it was sound."""
        try:
            with self._opened(making, max(self.most, MOST_OF_RUN) + MOST_OF_TAR) as archive:
                for member in archive:
                    path = PurePosixPath(member.name)
                    if member.name != ABOUT and not path.is_absolute() and ".." not in path.parts:
                        (into / path).parent.mkdir(parents=True, exist_ok=True)
                        (into / path).write_bytes(_content(archive, member))
        except _DAMAGED:
            return False
        return True

    @contextmanager
    def _opened(self, making: str, most: float) -> Iterator[tarfile.TarFile]:
        """Archive of a run, of which that many bytes are unpacked: a small file may unpack to terabytes."""
        with open_to_read(self._path(making)) as file, gzip.open(file) as packed:
            content = packed.read(int(most))
        with tarfile.open(fileobj=io.BytesIO(content)) as archive:
            yield archive

    def all(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Identity of the making of each kept run, and how it ended."""
        for path in sorted(self.directory.glob(f"*{ENDING}")):
            making = path.name.removesuffix(ENDING)
            if (about := self.about(making)) is not None:
                yield making, about

    @property
    def bytes(self) -> int:
        """Bytes of all kept runs."""
        return sum(path.stat().st_size for path in self.directory.glob(f"*{ENDING}"))

    def _path(self, making: str) -> Path:
        return self.directory / f"{making}{ENDING}"


def _is_of(name: str, places: Collection[str]) -> bool:
    return any(name == place or name.startswith(f"{place.rstrip('/')}/") for place in places)


def _add(archive: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    archive.addfile(member, io.BytesIO(content))


def _content(archive: tarfile.TarFile, member: tarfile.TarInfo | None) -> bytes:
    """Content of a file of the archive; ValueError for anything else."""
    file = None if member is None else archive.extractfile(member)
    if file is None:
        raise ValueError("no file")
    return file.read()
