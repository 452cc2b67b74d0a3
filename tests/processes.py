"""Whether processes still run, and waiting for it."""

import time
from pathlib import Path


def runs(pid):
    """Whether a process still runs; one that has ended and was not yet fetched by its parent does not."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def wait_until(condition):
    """True as soon as it holds, False when it never comes true."""
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.01)
    return False


def at_work_in(directory: Path) -> list[int]:
    """Processes whose working directory is below a directory."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if directory in (process / "cwd").readlink().parents:
                found.append(int(process.name))
        except OSError:
            continue  # it has ended meanwhile
    return found
