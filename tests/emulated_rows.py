"""Rows of the study on the shipped emulator of `soft`, as one replicate; a program, too, for other libraries.

python tests/emulated_rows.py MODE GRID ROWS prints JSON: which linear algebra answered, and the replicate's
runs with all digits. GRID 0 is none. The golden file is made by: python tests/emulated_rows.py > FILE
"""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path

import pandas as pd
from threadpoolctl import threadpool_info, threadpool_limits

from calstudy.calibration.modes import mode_of
from calstudy.cli.options.choices import parse_target
from calstudy.emulator.emulator import read_emulator, shipped_emulator
from calstudy.emulator.engine import EmulatorEngine
from calstudy.emulator.replicates import CALIBRATIONS, RUNS, Replication
from calstudy.models.angle_of_repose import load_model
from calstudy.models.heap import MEASURED, PROPORTIONAL
from calstudy.models.noise import known_noise
from calstudy.parameters import GRID
from calstudy.plan_file import load_plan
from calstudy.study.settings import StudySettings

GOLDEN = Path(__file__).parent / "golden" / "runs_on_grid.csv"
ROWS = {"paper": (1, 23, 11), "robust": (1, 23, 11)}
RUN = ["row", "phase", "index", "DENS", "MU_PP", "MU_PW", "RF_PP", "RF_PW", "YM", "outcome", *MEASURED]


def replication(mode_name: str, grid: int | None, rows: tuple[int, ...]) -> Replication:
    """Rows at `soft`, `ring`; the study's seed is 1, so replicate 1 has 2."""
    plan, mode = load_plan(), mode_of(mode_name, grid=grid).knowing(PROPORTIONAL)
    emulator = read_emulator(shipped_emulator("angle_of_repose", "soft", "ring"))
    model = load_model(plan.fixed, "soft", "ring")
    settings = StudySettings(
        plan=plan.name,
        plan_hash=plan.hash,
        model=model.name,
        deck=model.deck,
        model_hash=model.hash,
        fidelity="soft",
        variant="ring",
        engine=EmulatorEngine(model, emulator).identity,
        calstudy="test",
        mode=mode.name,
        budget=mode.second_optimisation.budget,
        seed=1,
        target=parse_target("paper", plan, model, ""),
        noise=known_noise(model.name, model.hash) if mode.takes_noise else None,
        grid=mode.grid,
    )
    return Replication(settings, plan, rows, mode, model, emulator)


def replicate(mode_name: str, grid: int | None, rows: tuple[int, ...]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Calibrations, and runs in the order in which they were asked for."""
    with threadpool_limits(1):
        tables = replication(mode_name, grid, rows).replicate(1, threading.Event(), lambda: None)
    return tables[CALIBRATIONS], tables[RUNS][RUN]


def kernels() -> list[str]:
    """Processors that the loaded linear algebra was written for."""
    return sorted(str(i.get("architecture")) for i in threadpool_info() if i["user_api"] == "blas")


def as_golden(runs: pd.DataFrame, mode_name: str) -> pd.DataFrame:
    """Runs as the golden file has them: every number by all its digits."""
    return runs.assign(mode=mode_name)[["mode", *RUN]].map(
        lambda value: repr(float(value)) if isinstance(value, float) else str(value)
    )


if __name__ == "__main__" and len(sys.argv) == 1:
    tables = [as_golden(replicate(name, GRID, rows)[1], name) for name, rows in ROWS.items()]
    pd.concat(tables).to_csv(sys.stdout, index=False, lineterminator="\n")
elif __name__ == "__main__":
    name, steps, numbers = sys.argv[1:]
    rows = tuple(map(int, numbers.split(",")))
    calibrations, runs = replicate(name, int(steps) or None, rows)
    golden = as_golden(runs, name)
    print(json.dumps({"kernels": kernels(), "runs": golden.values.tolist(), "rows": len(calibrations)}))
