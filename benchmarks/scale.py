"""What many rows, many DEM runs and many threads cost calstudy itself; the DEM model answers at once.

    python benchmarks/scale.py rows --rows 72 360 720
    python benchmarks/scale.py sweep --runs 1000 10000 100000
    python benchmarks/scale.py journal --threads 1 8 64
    python benchmarks/scale.py slots --slots 64 512
    python benchmarks/scale.py reopen --lines 10000 1000000
    python benchmarks/scale.py commands

Times are of the processor, which other work on the machine does not change, unless said otherwise; ratios are
to what is named.

`rows`: a campaign of so many rows, with two calibrated parameters each; peak of the process's memory and of
its threads. `sweep`: a design of so many runs. `journal`: runs recorded by so many threads, in one row.
`slots`: one campaign of so many runs in so many rows over so many slots, without surrogates, and the same
opened again. `reopen`: journals of finished rows with so many lines in all, each with a heap of 40 beads.
`commands`: seconds from the shell's prompt back to it, the least of some tries. Each number of rows or runs
is a process of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
import zlib
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calstudy.calibration.modes import mode_of
from calstudy.calibration.task import Calibration, Evaluate, Task, tasks_of
from calstudy.engines.engine import ProgramEngine
from calstudy.engines.interface import Engine
from calstudy.engines.liggghts import LIGGGHTS
from calstudy.engines.program import Program
from calstudy.engines.queue import Job, LocalExecutor
from calstudy.errors import NumericsError
from calstudy.models.angle_of_repose import AngleOfReposeModel, load_model
from calstudy.models.heap import ANGLE_OF_REPOSE, BULK_DENSITY, PROPORTIONAL, REFERENCE
from calstudy.plan import PARAMETERS
from calstudy.plan_file import load_plan
from calstudy.records import RAYLEIGH_TIME_STEP, Evaluation, Outcome, Phase, Request, Run, Target
from calstudy.study import campaign as campaign_module
from calstudy.study.answers import MaterialTest
from calstudy.study.campaign import Campaign
from calstudy.study.directory.journal import encode
from calstudy.study.directory.store import Store
from calstudy.study.settings import StudySettings
from calstudy.study.sweep import Line, sweep

PLAN = load_plan()
TARGET = Target({ANGLE_OF_REPOSE: 25.0, BULK_DENSITY: 1500.0}, "set", "benchmark")
HEAP = np.random.default_rng(0).uniform(-0.05, 0.05, (200, 3))
COMMANDS = (["--help"], ["plan", "show"], ["plan", "check"], ["plan", "run", "--dry-run"])


def answer(parameters: Mapping[str, float]) -> Run:
    """A run that takes no time."""
    responses = {
        ANGLE_OF_REPOSE: 15 + 30 * parameters["MU_PP"] + 60 * parameters["RF_PP"],
        BULK_DENSITY: 0.6 * parameters["DENS"],
        RAYLEIGH_TIME_STEP: 0.005 * (parameters["DENS"] / parameters["YM"]) ** 0.5,
    }
    return Run(Outcome.OK, "", responses, 1e-3, 1e-3, positions=HEAP.copy())


class Quick:
    """An engine that answers at once."""

    identity, model_hash, particle_diameter, expected_seconds = "quick", "quick", 0.005, 0.0

    def run(self, parameters: Mapping[str, float], seed: int, directory: Path, stop: threading.Event) -> Run:
        """The answer."""
        return answer(parameters)


class QuickExecutor:
    """Ends every job of a sweep as it is submitted."""

    slots = 1

    def submit(self, job: Job) -> Future[Run]:
        """The answer, there already."""
        ended: Future[Run] = Future()
        ended.set_result(answer(job.parameters))
        return ended

    def remove_leftovers(self, scratch: Path, sessions: set[str]) -> None:
        """Nothing is left."""

    def close(self) -> None:
        """Nothing runs."""


def settings() -> StudySettings:
    """Settings of a study with the quick engine."""
    about = ("angle_of_repose", 1, "quick", "none", "none", "quick", "benchmark")
    return StudySettings(PLAN.name, PLAN.hash, *about, "robust", 2, 1, TARGET)


def rows(count: int, folder: Path) -> str:
    """Calibrate so many rows, the smallest of the plan over and over again."""
    least = tasks_of(PLAN, TARGET, mode_of("robust", 2).knowing(PROPORTIONAL), 1)
    small = min(least.values(), key=lambda task: task.samples or 0)
    tasks = {k: replace(small, row=k, sampled_as=k) for k in range(1, count + 1)}
    stop = threading.Event()
    most = 0

    def look() -> None:
        nonlocal most
        while not stop.wait(0.05):
            most = max(most, threading.active_count())

    with Store(folder, settings()) as store:
        engine = MaterialTest(Quick(), PARAMETERS)
        campaign = Campaign(
            tasks, [engine], store, LocalExecutor(2, stop), scratch=folder / "runs", stop=stop
        )
        threading.Thread(target=look).start()
        before = memory()
        summary = campaign.run(tuple(tasks))
        stop.set()
    each = (memory() - before) / count
    return f"{len(summary.finished)} rows: {memory():.0f} MB, {each:.2f} MB a row, at most {most} threads"


def memory() -> float:
    """Peak of this process's memory in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def sweep_of(count: int, folder: Path) -> str:
    """Sweep a design of so many runs."""
    design = [Line("x", "tiny", "ring", seed, REFERENCE) for seed in range(1, count + 1)]
    model = load_model(PLAN.fixed, "tiny", "ring")

    def engine_of(fidelity: str, variant: str) -> ProgramEngine[AngleOfReposeModel]:
        return ProgramEngine(model, Program(LIGGGHTS, (), "0"))

    heard: list[int] = []
    start = time.monotonic()
    table = sweep(design, engine_of, folder, QuickExecutor(), lambda done, *_: heard.append(done))
    seconds = time.monotonic() - start
    return (
        f"{len(table)} runs, said {len(heard)} times: {seconds:.1f} s, {1e3 * seconds / count:.3f} ms a run"
    )


def journal(threads: int, runs: int, slower: float, folder: Path) -> str:
    """Record runs in one row, by so many threads; the disk takes ``slower`` seconds more than this one."""
    evaluations = [
        Evaluation(Request(1, Phase.SAMPLING, k, REFERENCE, k), f"{k:016x}", answer(REFERENCE))
        for k in range(runs)
    ]
    with Store(folder, settings()) as store, ThreadPoolExecutor(threads) as pool:
        force, forced = os.fsync, []

        def count(handle: int) -> None:
            forced.append(handle)
            time.sleep(slower)
            force(handle)

        os.fsync = count
        start, before = time.monotonic(), time.process_time()
        list(pool.map(store.record, evaluations))
        seconds, used = time.monotonic() - start, time.process_time() - before
        os.fsync = force
    return (
        f"{threads} thread(s), {runs} runs: forced to disk {len(forced)} times, "
        f"{1e3 * seconds / runs:.2f} ms a run, {1e3 * used / runs:.2f} ms of a processor"
    )


class Asking:
    """In place of a calibration: asks for so many runs at once, and then gives up."""

    def __init__(self, runs: int) -> None:
        self.runs = runs

    def __call__(self, task: Task, evaluate: Evaluate, *_: object) -> Calibration:
        """Never an answer."""
        seeds = range(self.runs * task.row, self.runs * (task.row + 1))
        evaluate([Request(task.row, Phase.SAMPLING, k, REFERENCE, seed) for k, seed in enumerate(seeds)])
        raise NumericsError("this is all that was to be measured")


def slots(count: int, runs: int, rows: int, folder: Path) -> str:
    """One campaign of so many runs over so many slots; the same opened again; a plain pool of threads."""
    each = tasks_of(PLAN, TARGET, mode_of("robust", 2).knowing(PROPORTIONAL), 1)
    tasks = {k: replace(each[1], row=k, sampled_as=k) for k in range(1, rows + 1)}
    campaign_module.calibrate = Asking(runs // len(tasks))
    force, forced = os.fsync, []

    def note(handle: int) -> None:
        forced.append(handle)
        force(handle)

    def run(engine: Engine) -> tuple[float, float, Campaign]:
        stop = threading.Event()
        with Store(folder, settings()) as store:
            campaign = Campaign(
                tasks,
                [MaterialTest(engine, PARAMETERS)],
                store,
                LocalExecutor(count, stop),
                scratch=folder / "runs",
                retry_failed=True,
                stop=stop,
            )
            start, before = time.monotonic(), time.process_time()
            campaign.run(tuple(tasks))
            return time.monotonic() - start, time.process_time() - before, campaign

    os.fsync = note
    elapsed, used, done = run(Quick())
    os.fsync = force
    peak = memory()
    _, again, reopened = run(Quick())
    with ThreadPoolExecutor(count) as pool:
        before = time.process_time()
        list(pool.map(lambda k: answer(REFERENCE), range(runs)))
        plain = time.process_time() - before
    if (done.progress.runs_done, reopened.progress.runs_done) != (runs, 0):
        raise AssertionError("runs were lost or repeated")
    return (
        f"{runs} runs in {rows} rows over {count} slots: {1e3 * used / runs:.2f} ms a run "
        f"({1e3 * elapsed / runs:.2f} elapsed), {used / plain:.0f} times a plain pool of threads; "
        f"{runs / len(forced):.1f} runs a forcing to disk; {peak:.0f} MB; "
        f"reopened: {1e3 * again / runs:.2f} ms a run"
    )


def reopen(lines: int, folder: Path) -> str:
    """Take up journals of so many lines, 10,000 in each, and parse the same lines as JSON."""
    run_id = f"{0:016x}"
    run = replace(answer(REFERENCE), positions=HEAP[:40])
    _, _, text = encode(Evaluation(Request(1, Phase.SAMPLING, 0, REFERENCE, 1), run_id, run)).partition(b" ")
    tasks = tasks_of(PLAN, TARGET, mode_of("robust", 2).knowing(PROPORTIONAL), 1)
    with Store(folder, settings()) as store:
        for start in range(0, lines, 10_000):
            row = start // 10_000 + 1
            numbers = range(start, min(start + 10_000, lines))
            texts = (text.rstrip().replace(run_id.encode(), b"%016x" % k) for k in numbers)
            content = (b"%08x %s\n" % (zlib.crc32(text), text) for text in texts)
            (folder / "journal" / f"row-{row:02d}.jsonl").write_bytes(b"".join(content))
            (folder / "calibrations" / f"row-{row:02d}.parquet").touch()  # the row is finished
        engine, stop = MaterialTest(Quick(), PARAMETERS), threading.Event()
        campaign = Campaign(
            tasks, [engine], store, LocalExecutor(1, stop), scratch=folder / "runs", stop=stop
        )
        before = time.process_time()
        campaign.answers.take_up(set())
        used = time.process_time() - before
    before = time.process_time()
    for path in (folder / "journal").iterdir():
        for line in path.read_bytes().splitlines():
            json.loads(line[9:])
    plain = time.process_time() - before
    return f"{lines} lines: {used:.1f} s, {used / plain:.1f} times their JSON alone; {memory():.0f} MB"


def commands(tries: int) -> None:
    """Print what each short command takes."""
    for command in COMMANDS:
        took = []
        for _ in range(tries):
            start, before = time.monotonic(), resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            subprocess.run([sys.executable, "-m", "calstudy", *command], check=True, capture_output=True)
            used = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
            took.append((time.monotonic() - start, used))
        elapsed, cpu = map(min, zip(*took, strict=True))
        print(f"calstudy {' '.join(command)}: {elapsed:.2f} s, {cpu:.2f} s of a processor")


def each_in_a_process(work: str, numbers: list[int]) -> None:
    """Run this script for each number: memory that one has taken is not given back to the next."""
    for number in numbers:
        option = ["--rows" if work == "rows" else "--runs", str(number), "--here"]
        subprocess.run([sys.executable, __file__, work, *option], check=True)


def main() -> None:
    """Parse and run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(required=True, dest="work")
    for name, option, default in (("rows", "--rows", [72, 360, 720]), ("sweep", "--runs", [1000, 10_000])):
        verb = verbs.add_parser(name)
        verb.add_argument(option, type=int, nargs="+", default=default, dest="numbers")
        verb.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    verb = verbs.add_parser("journal")
    verb.add_argument("--threads", type=int, nargs="+", default=[1, 8, 64])
    verb.add_argument("--runs", type=int, default=1000)
    verb.add_argument("--slower-ms", type=float, default=0.0, help="let the disk take so much longer")
    verb = verbs.add_parser("slots")
    verb.add_argument("--slots", type=int, nargs="+", default=[512])
    verb.add_argument("--runs", type=int, default=10_000)
    verb.add_argument("--rows", type=int, default=100)
    verbs.add_parser("reopen").add_argument("--lines", type=int, nargs="+", default=[10_000])
    verbs.add_parser("commands").add_argument("--tries", type=int, default=3)
    a = parser.parse_args()
    if a.work == "commands":
        commands(a.tries)
        return
    if a.work in ("rows", "sweep") and not a.here:
        each_in_a_process(a.work, a.numbers)
        return
    works = {
        "journal": lambda: [partial(journal, threads, a.runs, 1e-3 * a.slower_ms) for threads in a.threads],
        "slots": lambda: [partial(slots, number, a.runs, a.rows) for number in a.slots],
        "reopen": lambda: [partial(reopen, number) for number in a.lines],
        "rows": lambda: [partial(rows, number) for number in a.numbers],
        "sweep": lambda: [partial(sweep_of, number) for number in a.numbers],
    }[a.work]()
    for work in works:
        with tempfile.TemporaryDirectory(prefix="calstudy-", dir=os.environ.get("TMPDIR")) as folder:
            print(work(Path(folder) / "out"), flush=True)


if __name__ == "__main__":
    main()
