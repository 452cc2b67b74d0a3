"""Failing allocations at random moments: one of Python's own, or all beyond a limit of the address space."""

import multiprocessing
import os
import random
import resource
import sys
from collections import Counter
from pathlib import Path

from calstudy.engines import guardian
from closed_form import ClosedForm, run_study
from same_tables import assert_same, tables
from soak.faults import ROWS, SHORT, durable

ALLOCATIONS = 160_000
"""About so many of them a calibration takes."""
HEADROOM = 30e6
"""Bytes beyond what a process has, at most: a calibration takes some 20 MB more."""
PATIENCE = 120.0
"""Seconds after which a calibration counts as hanging."""


def work(directory: Path, log: Path, instants: random.Random | None = None) -> None:
    """Calibrate; with ``instants`` allocations fail from some moment on."""

    def note(_):
        with log.open("a") as file:
            file.write(".")

    if instants is None:
        pass
    elif instants.random() < 0.5:
        import _testcapi

        first = instants.randrange(ALLOCATIONS)
        _testcapi.set_nomemory(first, first + instants.choice((1, 1, 10, 1000)))
    else:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + int(instants.uniform(0, HEADROOM))
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    run_study(directory, ROWS, engine=ClosedForm(noise=0.01, on_call=note), mode=SHORT, workers=1)


def _child(directory: Path, log: Path, seed: int | None) -> None:
    os.setsid()
    os.close(2)
    os.open(os.devnull, os.O_WRONLY)
    with guardian.ending():
        work(directory, log, None if seed is None else random.Random(seed))


def _ended(context, directory: Path, log: Path, seed: int | None) -> str:
    process = context.Process(target=_child, args=(directory, log, seed))
    process.start()
    process.join(PATIENCE)
    if process.exitcode is None:
        process.terminate()  # what hangs is ended by one SIGTERM
        process.join(PATIENCE)
        return "hung, and ended by SIGTERM" if process.exitcode is not None else "hung"
    return {0: "did without", 1: "an error"}.get(process.exitcode, "died")


def check(folder: Path, cases: int, seed: int = 1) -> dict[str, int]:
    """Let allocations fail in so many calibrations. AssertionError: a run is lost or repeated."""
    context = multiprocessing.get_context("fork")
    whole, log = folder / "whole", folder / "log"
    work_once = context.Process(target=_child, args=(whole, log, None))
    work_once.start()
    work_once.join()
    runs, expected = log.stat().st_size, tables(whole)
    met: Counter[str] = Counter()
    for case in range(cases):
        study, log = folder / f"{case}", folder / f"log-{case}"
        log.touch()
        how = _ended(context, study, log, seed + case)
        assert how != "hung", f"case {case}: SIGTERM did not end it"
        met[how] += 1
        kept, before = durable(study) if study.exists() else 0, log.stat().st_size
        assert kept >= before - 1, f"case {case}: a run that had ended is lost"
        assert _ended(context, study, log, None) == "did without", f"case {case}"
        assert_same(tables(study), expected)
        assert log.stat().st_size - before == runs - kept, f"case {case}: a durable run was run again"
        print(f"{case + 1} cases: {dict(met)}", file=sys.stderr, flush=True)
    return {"cases": cases, **met}
