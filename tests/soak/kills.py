"""SIGKILL at random moments of the long commands: what they leave goes on to the same tables."""

import multiprocessing
import os
import random
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from calstudy.cli import main as cli
from fake_liggghts import COMMAND
from same_tables import tables

COLUMNS = "label,fidelity,variant,seed,DENS,MU_PP,MU_PW,RF_PP,RF_PW,YM"
CALIBRATION = """
mode = "robust"
seed = 1
WRL = 0.0
[[models]]
name = "angle_of_repose"
fidelity = "soft"
[models.fixed]
poissons_ratio = 0.22
restitution_pp = 0.89
restitution_pw = 0.60
rolling_viscous_damping_pp = 0.25
rolling_viscous_damping_pw = 0.25
[parameters]
MU_PP = [0.1, 0.3]
MU_PW = 0.2
RF_PP = 0.05
RF_PW = 0.01
YM = 5.06e8
"""
ONE_TARGET = """DENS = 2500.0
[targets]
angle_of_repose_deg = { value = 22.0, tolerance = 2.0 }
"""
TWO_TARGETS = """DENS = [2400.0, 2600.0]
[targets]
angle_of_repose_deg = { value = 22.0, tolerance = 2.0 }
bulk_density = { value = 1500.0, tolerance = 15.0 }
"""
PLAN = "plan run --fidelity tiny --budget 2 --workers 1 --study {out}"
EMULATED = "plan run --engine emulator --fidelity coarse --budget 4 --workers 1 --study {out}"
COMMANDS = {
    "plan run": (f"{PLAN} --rows 1",),
    "plan run on an emulator": (f"{EMULATED} --rows 1",),
    "plan run --array": tuple(f"{EMULATED} --rows 1,5 --array {k}/2" for k in (1, 2)),
    "replicates": (f"{EMULATED} --rows 1 --replicates 2",),
    "calibrate": ("calibrate {folder}/file.toml --workers 1 --study {out}",),
    "sweep": ("sweep {folder}/design.csv --workers 1 --out {out}",),
    "emulator sample": (
        "emulator sample --points {points} --fidelity tiny --reference tiny --workers 1 --out {out}",
    ),
}
"""Long commands on engines that answer at once; of an array each element, of which one is killed."""
DEARER = {"replicates": 25, "calibrate": 25}
"""Commands that take so many times the processor of the others, and are killed so many times less often."""


@dataclass(frozen=True)
class Size:
    """How large the commands' work is, and how often they are killed in it."""

    calibration: str
    points: int
    """DEM runs of a sweep and of an emulator's sample."""
    kills: int
    """Of one study."""


WHOLE, LEAST = Size(CALIBRATION + TWO_TARGETS, 24, 12), Size(CALIBRATION + ONE_TARGET, 6, 1)
PRELOADED = [
    *(f"calstudy.cli.{name}" for name in ("plan.run", "calibrate", "sweep", "emulator")),
    "soak.kills",
]
TIMED = {"wall_time", "cpu_time", "host", "finished_at"}


def _run(words):
    os.environ |= {"CALSTUDY_LIGGGHTS": COMMAND}
    os.setsid()
    sys.stdout = sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115
    sys.exit(cli.main(words))


def results(out: Path):
    """All tables of a study or a sweep, without what differs between two runs of the same."""
    if (out / "study.json").exists():
        found = dict(tables(out))
    else:
        found = {"runs": pd.read_parquet(out / "runs.parquet")}
    for path in sorted(out.glob("replicate*/*.parquet")):
        found[f"{path.parent.name}/{path.name}"] = pd.read_parquet(path)
    return {n: t.drop(columns=[c for c in t if c in TIMED]) for n, t in found.items()}


def check(folder: Path, kills: int, size: Size = WHOLE, seed: int = 1) -> dict[str, int]:
    """Kill the commands that often in all; AssertionError where a result differs or something is left."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)  # so that kills meet the work, and not the imports before it
    first = context.Process(target=int)
    first.start()
    first.join()
    instants = random.Random(seed)
    design = [f"a,tiny,ring,{k},2500,0.2,0.2,0.05,0.01,5.06e8" for k in range(1, size.points + 1)]
    (folder / "design.csv").write_text("\n".join([COLUMNS, *design, ""]))
    (folder / "file.toml").write_text(size.calibration)
    done = dict.fromkeys(COMMANDS, 0)
    wholes: dict[str, tuple[Path, float]] = {}
    studies = 0

    def started(line, out):
        words = line.format(out=out, folder=folder, points=size.points).split()
        process = context.Process(target=_run, args=(words,))
        process.start()
        return process

    def ended(name, line, out):
        """Seconds that a command takes that nobody disturbs."""
        begun = time.monotonic()
        process = started(line, out)
        process.join()
        assert process.exitcode in (0, 11), f"{name}: {process.exitcode}"
        return time.monotonic() - begun

    while sum(done.values()) < kills:
        name = min(done, key=lambda one: done[one] * DEARER.get(one, 1))
        lines = COMMANDS[name]
        alone = lines[0].partition(" --array")[0]
        if name not in wholes:
            whole = folder / f"whole-{len(wholes)}" / "study"
            wholes[name] = whole, ended(name, alone, whole)
        whole, lasts = wholes[name]
        studies += 1
        # Each in a project of its own: a calibration takes over the runs of the studies beside it.
        out = folder / f"killed-{studies}" / "study"
        for _ in range(size.kills):
            processes = [started(line, out) for line in lines]
            victim = instants.choice(processes)
            victim.join(instants.uniform(0.05, 0.9) * lasts)
            is_killed = victim.exitcode is None
            if is_killed:
                os.kill(victim.pid, signal.SIGKILL)
                done[name] += 1
            for process in processes:
                process.join()
                assert process is victim or process.exitcode in (0, 11), f"{name}: {process.exitcode}"
            if not is_killed:
                break
        ended(name, alone, out)
        assert_same_results(results(out), results(whole))
        runs = out / "runs"
        assert not runs.exists() or list(runs.iterdir()) == []
        shutil.rmtree(out.parent)
        print(f"{sum(done.values())} kills, {studies} studies", file=sys.stderr, flush=True)
    return {"kills": sum(done.values()), "studies": studies, **done}


def assert_same_results(found, expected):
    """Tables that agree to the last digit."""
    assert found.keys() == expected.keys()
    for name, table in found.items():
        pd.testing.assert_frame_equal(
            table.reset_index(drop=True), expected[name].reset_index(drop=True), check_exact=True
        )
