"""The command ``sweep``, and running a design as ``emulator sample`` does."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from calstudy.cli.model import model_of_file, own_model
from calstudy.cli.terminal import messages_console, print_json, results_console, say, stop_on_signals
from calstudy.engines.choose import profile_of, program_of, slots
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Model
from calstudy.engines.queue import LocalExecutor
from calstudy.errors import InputError
from calstudy.models.angle_of_repose import load_model
from calstudy.models.material.regime import cautions
from calstudy.plan_file import load_plan
from calstudy.records import Outcome
from calstudy.study.directory.session import duration
from calstudy.study.sweep import RUNS, Line, read_design, without_heaps
from calstudy.study.sweep import sweep as run_sweep


def sweep(a: Namespace) -> None:
    """Run a table of DEM runs."""
    if a.calibration is not None:
        own: Model | None = model_of_file(a, {"fidelity": a.fidelity})
    else:
        own = own_model(a.model, {"fidelity": a.fidelity}, a.force, a.ranks)
    if own is None and a.fidelity is not None:
        raise InputError(f"--fidelity {a.fidelity}: the design has a column for it; leave the option out")
    design = read_design(a.design, a.force, own)
    for caution in cautions(own, [line.parameters for line in design]) if own else ():
        say(messages_console(), caution)
    table = run_design(design, a.out, a.liggghts, a.workers, a.keep_beads, own)
    if a.keep_beads and (lacking := without_heaps(table, a.out)):
        say(
            messages_console(),
            f"NOTE {lacking} run(s) had been made without --keep-beads, and their beads are gone; to have "
            "them, choose another --out",
        )
    failed = table[table["outcome"] != Outcome.OK]
    if a.json:
        print_json({"runs": len(table), "failed": len(failed), "table": str(a.out / RUNS)})
        return
    out = results_console()
    for _, line in failed.iterrows():
        out.print(
            f"{line['label']}, seed {line['seed']}: {line['outcome']}: {line['reason']}", highlight=False
        )
    out.print(f"{len(table)} runs, {len(failed)} not ok: {a.out / RUNS}", highlight=False, soft_wrap=True)


def run_design(
    design: Sequence[Line],
    out: Path,
    liggghts: str | None,
    at_once: int | None,
    keep_beads: bool = False,
    own: Model | None = None,
) -> pd.DataFrame:
    """Run a design into a sweep's directory, and say how far it is; returns its table."""
    program = profile_of().find(liggghts) if own is None else program_of(own, liggghts)
    fixed = load_plan().fixed
    workers = at_once or slots(*([own] if own else []))
    console = messages_console()
    started = time.monotonic()
    heard: list[float] = []

    def tell(done: int, of: int, seconds_left: float) -> None:
        heard.append(seconds_left)
        # What the model expects is another machine's; what has been done since the start corrects it.
        spent = heard[0] - seconds_left
        pace = (time.monotonic() - started) / spent if spent else 1 / workers
        left = duration(seconds_left * pace)
        console.print(f"{done} of {of} runs · about {left} left", highlight=False, soft_wrap=True)

    def engine_of(fidelity: str, variant: str) -> ProgramEngine[Model]:
        return ProgramEngine(own or load_model(fixed, fidelity, variant), program)

    with stop_on_signals(console) as stop:
        return run_sweep(design, engine_of, out, LocalExecutor(workers, stop), tell, keep_beads)
