"""Folders whose code this user has run: the first time it is said that it will run."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from calstudy.disk.files import append_line, content_of

LARGEST = 10e6
"""Bytes of the list of folders."""


def is_first_use(folder: Path) -> bool:
    """Whether this user has not used a folder before, which is noted; True where nothing can be noted."""
    with contextlib.suppress(OSError, RuntimeError):  # without a home directory, say
        state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
        known = Path(state) / "calstudy" / "folders"
        name = os.fsencode(folder.resolve()).replace(b"\n", b"\\n")
        if known.exists() and name in content_of(known, LARGEST).split(b"\n"):
            return False
        known.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        append_line(known, name + b"\n", known.parent)
    return True
