"""The soak: ``scripts/soak``, and with ``--quick`` what the suite runs. Prints its figures as a table."""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from soak import faults, fuzz, kills, memory

PARTS: dict[str, tuple[Callable[[Path], dict[str, int]], Callable[[Path], dict[str, int]]]] = {
    "a fault at every operation on the disk": (faults.check, lambda folder: faults.check(folder, 23)),
    "corrupted files": (lambda folder: fuzz.check(folder, 10_000), lambda folder: fuzz.check(folder, 300)),
    "failing allocations": (
        lambda folder: memory.check(folder, 500),
        lambda folder: memory.check(folder, 4),
    ),
    "SIGKILL at random moments": (
        lambda folder: kills.check(folder, 1000),
        lambda folder: kills.check(folder, len(kills.COMMANDS), kills.LEAST),
    ),
}
"""Parts of the soak: whole, and as the suite runs them."""


def main(words: list[str]) -> None:
    """Run the parts that are named by numbers from 1, all without any."""
    quick = "--quick" in words
    chosen = [int(word) - 1 for word in words if word.isdigit()] or range(len(PARTS))
    print("| part | figures | time |\n|---|---|---|")
    for name, parts in [list(PARTS.items())[k] for k in chosen]:
        with tempfile.TemporaryDirectory(prefix="soak-") as folder:
            started = time.monotonic()
            found = parts[quick](Path(folder))
            told = ", ".join(f"{what} {count}" for what, count in found.items())
            print(f"| {name} | {told} | {time.monotonic() - started:.0f} s |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
