"""SIGKILL at random moments of the long commands: what they leave goes on to the same tables."""

import multiprocessing
import os
import random
import signal
import sys
import time
from pathlib import Path

import pandas as pd

from calstudy.cli import main as cli
from fake_liggghts import COMMAND
from same_tables import tables

DESIGN = "label,fidelity,variant,seed,DENS,MU_PP,MU_PW,RF_PP,RF_PW,YM\n" + "".join(
    f"a,tiny,ring,{seed},2500,0.2,0.2,0.05,0.01,5.06e8\n" for seed in range(1, 25)
)
COMMANDS = {
    "plan run": "plan run --rows 1,5 --fidelity tiny --budget 8 --workers 2 --seed {seed} --study {out}",
    "plan run on an emulator": "plan run --rows 1-6 --engine emulator --fidelity soft --seed {seed} "
    "--study {out}",
    "replicates": "plan run --rows 1,5 --engine emulator --fidelity soft --replicates 3 --workers 2 "
    "--seed {seed} --study {out}",
    "calibrate": "calibrate {folder}/file.toml --workers 2 --study {out}",
    "sweep": "sweep {folder}/design.csv --workers 2 --out {out}",
}
"""Long commands on engines that answer at once."""
PRELOADED = ["calstudy.cli.plan.run", "calstudy.cli.calibrate", "calstudy.cli.sweep", "soak.kills"]
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


def check(folder: Path, kills: int, seed: int = 1) -> dict[str, int]:
    """Kill the commands that often in all; AssertionError where a result differs or something is left."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)  # so that kills meet the work, and not the imports before it
    instants = random.Random(seed)
    (folder / "design.csv").write_text(DESIGN)
    assert cli.main(["calibrate", "--init", str(folder / "file.toml")]) == 0
    done = dict.fromkeys(COMMANDS, 0)
    studies = 0
    while sum(done.values()) < kills:
        name = min(done, key=lambda one: done[one])
        studies += 1
        # Each in a project of its own: a calibration takes over the runs of the studies beside it.
        out, whole = (folder / f"{kind}-{studies}" / "study" for kind in ("killed", "whole"))

        def words(to, name=name, number=studies):
            return COMMANDS[name].format(seed=number, out=to, folder=folder).split()

        started = time.monotonic()
        undisturbed = context.Process(target=_run, args=(words(whole),))
        undisturbed.start()
        undisturbed.join()
        assert undisturbed.exitcode in (0, 11), name
        lasts = time.monotonic() - started
        for _ in range(12):
            process = context.Process(target=_run, args=(words(out),))
            process.start()
            process.join(instants.uniform(0.05, 0.9) * lasts)
            if process.exitcode is not None:
                break
            os.kill(process.pid, signal.SIGKILL)
            process.join()
            done[name] += 1
        last = context.Process(target=_run, args=(words(out),))
        last.start()
        last.join()
        assert last.exitcode in (0, 11), name
        assert_same_results(results(out), results(whole))
        runs = out / "runs"
        assert not runs.exists() or list(runs.iterdir()) == []
    return {"kills": sum(done.values()), "studies": studies, **done}


def assert_same_results(found, expected):
    """Tables that agree to the last digit."""
    assert found.keys() == expected.keys()
    for name, table in found.items():
        pd.testing.assert_frame_equal(
            table.reset_index(drop=True), expected[name].reset_index(drop=True), check_exact=True
        )
