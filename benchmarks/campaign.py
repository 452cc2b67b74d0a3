"""Utilisation and overhead of a campaign, by the operating system's accounting of all its processes.

    python benchmarks/campaign.py -- --rows 1-12 --fidelity coarse --workers 2 --study studies/usage

What follows -- goes to `calstudy plan run`. While it runs, /proc is read ten times a second: processor time
of calstudy itself, and number and processor time of the programs that it started. Nothing of what calstudy
says of itself enters, but for the number of runs that wait, from the study's lock: it tells the time in which
a worker could be kept busy from the end, when rows run out. What calstudy says is printed beside it.
"""

from __future__ import annotations

import argparse
import csv
import os
import subprocess
import sys
import time
from dataclasses import astuple, dataclass, fields
from pathlib import Path

from calstudy.study.directory.session import holder, read_sessions

TICK = 1.0 / os.sysconf("SC_CLK_TCK")
EVERY_SECONDS = 0.1


@dataclass(frozen=True, slots=True)
class Look:
    """What was seen at one instant; processor times in s, since the start."""

    seconds: float
    own_cpu: float
    """Of calstudy's own process."""
    dem_cpu: float
    """Of all programs that it has started, ended ones included."""
    programs: int
    """Programs that run."""
    waiting: int
    """DEM runs that wait for a slot, as calstudy last said."""


def stat(process: int) -> tuple[int, float, float] | None:
    """Parent, processor time, and that of children waited for; None if the process is gone."""
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return None
    part = text.rpartition(")")[2].split()
    user, system, children_user, children_system = (int(part[k]) * TICK for k in (11, 12, 13, 14))
    return int(part[1]), user + system, children_user + children_system


def look(campaign: int, since: float, study: Path) -> Look | None:
    """Look at the campaign's process and all below it; None when it has ended."""
    processes = {int(path.name): stat(int(path.name)) for path in Path("/proc").glob("[0-9]*")}
    own = processes.get(campaign)
    if own is None:
        return None
    below = {campaign}
    while more := {p for p, s in processes.items() if s and s[0] in below and p not in below}:
        below |= more
    # The guardian sleeps; it is calstudy's own.
    started = [
        s for p, s in processes.items() if s and p in below - {campaign} and b"guardian.py" not in command(p)
    ]
    session = holder(study)
    return Look(
        seconds=time.monotonic() - since,
        own_cpu=own[1],
        dem_cpu=own[2] + sum(cpu + children for _, cpu, children in started),
        programs=len(started),
        waiting=session.did.runs_waiting if session else 0,
    )


def command(process: int) -> bytes:
    """Command line of a process, b"" if it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


def main() -> int:
    """Run a campaign and print how it used the machine."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="write every look as CSV")
    parser.add_argument(
        "run", nargs="+", metavar="OPTION", help="options of plan run; --study, --workers are needed"
    )
    a = parser.parse_args()
    study = Path(a.run[a.run.index("--study") + 1])
    workers = int(a.run[a.run.index("--workers") + 1])

    start, looks = time.monotonic(), []
    campaign = subprocess.Popen([sys.executable, "-m", "calstudy", "plan", "run", *a.run])
    while campaign.poll() is None:
        seen = look(campaign.pid, start, study)
        if seen is not None:
            looks.append(seen)
        time.sleep(EVERY_SECONDS)
    elapsed = time.monotonic() - start
    if a.out:
        with a.out.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(field.name for field in fields(Look))
            writer.writerows(astuple(one) for one in looks)

    own, dem = looks[-1].own_cpu, looks[-1].dem_cpu
    busy = [one for one in looks if one.waiting]
    print(f"\nexit code {campaign.returncode}, {elapsed:.0f} s, {workers} workers, {os.cpu_count()} cores")
    print("by the operating system:")
    print(f"  processor time    LIGGGHTS {dem:.1f} s, calstudy {own:.1f} s: overhead {own / dem:.2%}")
    print(f"  whole campaign    {dem / (workers * elapsed):.1%} of the workers' time had a core for LIGGGHTS")
    if len(busy) > 1:
        span = busy[-1].seconds - busy[0].seconds
        share = sum(min(one.programs, workers) for one in busy) / (workers * len(busy))
        cpu = (busy[-1].dem_cpu - busy[0].dem_cpu) / (workers * span)
        print(f"  while runs waited {share:.1%} of it ran LIGGGHTS, {cpu:.1%} had a core ({span:.0f} s)")
    for session in read_sessions(study)[-1:]:
        did = session.did
        print("by calstudy:")
        print(f"  {did.runs_done} DEM runs, utilisation {did.utilisation:.1%}, overhead {did.overhead:.2%}")
    return campaign.returncode


if __name__ == "__main__":
    sys.exit(main())
